"""A master of class 2 in octets: telegrams made by hand, answers read as numbers."""

from __future__ import annotations

from octet_wire import BIT, Wire, framed

SC, RS, SILENCE = "SC", "RS", ""
#: send time-out 1 s, features 01 00, no profile, addresses of type 0
INITIATE = "57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00 00"
#: 240 octets of data, features 01 00
OPENED = "57 F0 01 00 00 00 00 00 00 02 00 02 00 00 00 00"
ABORT = "58 00 25"
ABORT_SEQUENCE = "58 00 11"
ABORT_REQUEST = "58 00 12"
ABORT_TIMEOUT = "58 00 13"
ABORT_ADDRESS = "58 00 17"
IDLE = "48 01"


class Class2:
    """Master ``sa`` and slave ``da`` on ``wire``; ``ssap`` of its own."""

    def __init__(self, wire: Wire, sa: int = 1, *, da: int = 8, ssap: int = 50) -> None:
        self.wire = wire
        self.sa = sa
        self.da = da
        self.ssap = ssap
        #: when the slave had its last request, in ns
        self.heard = 0
        self._fc = 0x6C

    def ask(self, sap: int, data: str = "") -> str:
        """SC, RS, or the data that came, in hex. An answer of anything else fails."""
        unit = f"{sap:02X} {self.ssap:02X} {data}"
        fc, self._fc = self._fc, 0x7C if self._fc == 0x5C else 0x5C
        self.heard = self.wire.now + 1000 * BIT
        octets = self.wire.ask(framed(0x80 | self.da, 0x80 | self.sa, fc, unit))
        return self.read(bytes.fromhex(octets), sap)

    def read(self, octets: bytes, sap: int) -> str:
        """The answer of ``sap`` in words."""
        if not octets:
            return SILENCE
        if octets == b"\xe5":
            return SC
        if octets[0] == 0x10:
            assert octets[1:4] == bytes((self.sa, self.da, 0x03)), octets.hex(" ")
            return RS
        length = octets[1]
        assert octets[:4] == bytes((0x68, length, length, 0x68))
        assert octets[4:9] == bytes((0x80 | self.sa, 0x80 | self.da, 0x08, self.ssap, sap)), octets.hex(" ")
        assert octets[-2:] == bytes((sum(octets[4:-2]) & 0xFF, 0x16))
        return octets[9:-2].hex(" ").upper()

    def initiate(self, request: str = INITIATE) -> int:
        """Ask the resource manager; the server SAP that it gives."""
        assert self.ask(49, request) == SC
        return self.manager()

    def manager(self) -> int:
        """Fetch what the resource manager says: 56, server SAP, send time-out."""
        found = bytes.fromhex(self.ask(49))
        assert found[0] == 0x56
        assert len(found) == 4
        return found[1]

    def connect(self) -> int:
        """A whole connection; its server SAP."""
        sap = self.initiate()
        assert self.ask(sap) == OPENED
        return sap

    def service(self, sap: int, request: str) -> str:
        """Asked, acknowledged, and what the first poll brings."""
        assert self.ask(sap, request) == SC
        return self.ask(sap)
