"""One slave on a line of its own, octet by octet: telegrams put together by hand, a time of its own."""

from __future__ import annotations

from octet_slave import frame

from dpstack.fdl.passive.station import PassiveStation
from dpstack.machine import pump
from dpstack.params import BusParams

MS = 1_000_000
PARAMS = BusParams.preset(500_000)
BIT = 2_000


class Wire:
    """Feeds octets to a station and takes what it sends, in a time of its own."""

    def __init__(self, station: PassiveStation) -> None:
        self.station = station
        self.now = MS
        self.out: list[tuple[int, bytes]] = []

    def _transmit(self, octets: bytes, now: int) -> int:
        self.out.append((now, octets))
        return now + len(octets) * 11 * BIT

    def ask(self, octets: str) -> str:
        """The answer to ``octets`` as hex, empty for silence."""
        self.now += 1000 * BIT
        self.out.clear()
        end = self.now
        due = pump(self.station, bytes.fromhex(octets), self.now, self._transmit)
        while due <= end + 500 * BIT:
            self.now = max(self.now, due)
            due = pump(self.station, b"", self.now, self._transmit)
        return self.out[0][1].hex(" ").upper() if self.out else ""

    def pass_time(self, ns: int) -> None:
        """Silence, and nothing else."""
        self.now += ns
        pump(self.station, b"", self.now, self._transmit)


def framed(da: int, sa: int, fc: int, unit: str) -> str:
    """An SD2 telegram in hex; ``unit`` is the data unit with SAPs."""
    return frame(bytes((da, sa, fc)) + bytes.fromhex(unit)).hex(" ")
