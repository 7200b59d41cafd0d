"""A slave of octets for :class:`ring_bus.RingBus`: FDL status, Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add.

It knows telegrams as numbers only; nothing of the project is used to read or to make them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from ring_bus import RingBus

SC = b"\xe5"
RS, RR, UE, NR, DL = 0x03, 0x02, 0x01, 0x09, 0x08


def sd1(da: int, sa: int, fc: int) -> bytes:
    """A telegram without data."""
    return bytes((0x10, da, sa, fc, (da + sa + fc) & 0xFF, 0x16))


def frame(body: bytes) -> bytes:
    """An SD2 telegram of DA, SA, FC and data unit."""
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


def sd2(da: int, sa: int, fc: int, dsap: int, ssap: int, data: bytes) -> bytes:
    """A telegram with both SAPs."""
    return frame(bytes((da | 0x80, sa | 0x80, fc, dsap, ssap)) + data)


#: what a test replaces an answer by: from the request's octets to those of the answer, None is silence
Say = Callable[[bytes], bytes | None]


@dataclass
class OctetSlave:
    """On ``bus`` at ``address``. ``master`` 255: in Wait_Prm, else in data exchange with that one.

    ``moves`` by Set_Slave_Add: "acknowledges" (the usual way), "at once" (nothing is heard of it at the old address),
    "ignores", "dies". ``delay`` in bits; ``says`` replaces answers by DSAP.
    """

    bus: RingBus
    address: int
    ident: bytes = b"\x12\x34"
    config: bytes = b"\x21"
    inputs: bytes = b""
    outputs: bytes = b""
    master: int = 255
    moves: str = "acknowledges"
    locked: bool = False
    delay: int = 11
    says: dict[int, Say] = field(default_factory=dict)
    requests: list[bytes] = field(default_factory=list)
    kept: tuple[int, bytes] | None = None

    def __post_init__(self) -> None:
        self.bus.slaves[self.address] = self

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        self.requests.append(octets)
        if octets[0] == 0x10:
            answer: bytes | None = sd1(octets[2], self.address, 0x00) if octets[3] == 0x49 else None
        else:
            answer = self.service(octets)
        return None if answer is None else (self.delay, answer)

    def service(self, octets: bytes) -> bytes | None:
        sa, dsap, ssap = octets[5] & 0x7F, octets[7], octets[8]
        if dsap in self.says:
            return self.says[dsap](octets)
        refusal = sd1(sa, self.address, RS)
        free = self.master == 255
        match dsap:
            case 60:
                status = b"\x02\x05\x00" if free else b"\x00\x0c\x00"
                data = status + bytes((self.master,)) + self.ident
            case 59:
                data = self.config
            case 56 | 57:
                data = self.inputs if dsap == 56 else self.outputs
                if free:
                    return refusal
                if not data:
                    return sd1(sa, self.address, NR)
            case 55:
                return self.move(octets[9:-2]) if free else refusal
            case _:
                return refusal
        return sd2(sa, self.address, DL, ssap, dsap, data)

    def move(self, data: bytes) -> bytes | None:
        new, ident, lock = data[0], data[1:3], data[3]
        if ident != self.ident or self.locked or self.moves == "ignores":
            return SC
        del self.bus.slaves[self.address]
        if self.moves != "dies":
            self.address = new
            self.bus.slaves[new] = self
            self.locked = lock != 0
        return SC if self.moves == "acknowledges" else None
