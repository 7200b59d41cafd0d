"""A transmission: octets of one sender on the wire, and the octets that receivers at the same rate get of it.

Receivers at another rate sample the waveform (:mod:`dpstack.phy.uart`).
"""

from __future__ import annotations

from functools import lru_cache
from random import Random
from typing import Final

from msgspec import Struct, field

from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import Telegram
from dpstack.phy.uart import flipped
from dpstack.sim.nodes import Node
from dpstack.units import BITS_PER_CHAR, NS_PER_S, chars_to_ns

#: the time of this many octets on the wire at a rate, in ns
_duration: Final = lru_cache(4_096)(chars_to_ns)


@lru_cache(1_024)  # the same octets are sent again and again
def on_wire(octets: bytes, baud: int) -> tuple[Telegram | None, int]:
    """The telegram that ``octets`` are, None when they are not exactly one, and their time on the wire in ns."""
    return decode(octets), _duration(len(octets), baud)


class Transmission(Struct, eq=False):
    """Octets of one sender on the wire, without gaps. ``telegram`` is None when they are not exactly one.

    ``forced``: a test injected or delayed it, so no station is responsible. ``flips``: inverted bits by octet number
    (see :func:`dpstack.phy.uart.flipped`). ``lost``: it is not on the wire at all. ``whole``: so far it is intact for
    all receivers at its rate. ``heard_ns``: the end of the last readable octet of one that is not whole, set at its
    end. ``repeat_after_ns``: it is on the wire again so long after its end; None: once.
    """

    node: Node | None
    sender: str
    octets: bytes
    baud: int
    start_ns: int
    end_ns: int
    telegram: Telegram | None
    forced: bool = False
    flips: dict[int, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    whole: bool = False
    lost: bool = False
    collided: bool = False
    cut: bool = False
    heard_ns: int = 0
    repeat_after_ns: int | None = None

    @property
    def altered(self) -> bool:
        """Whether a fault has hit it."""
        return bool(self.flips or self.notes) or self.repeat_after_ns is not None

    def cut_short(self, octets: int) -> None:
        """Leave only the first ``octets`` of it on the wire."""
        self.notes.append(f"cut off after {octets} of {len(self.octets)} octets")
        self.octets = self.octets[:octets]
        self.telegram, lasts = on_wire(self.octets, self.baud)
        self.end_ns = self.start_ns + lasts
        self.forced = True

    def again(self) -> Transmission:
        """Its repetition, which no station sends."""
        start_ns = self.end_ns + (self.repeat_after_ns or 0)
        telegram, lasts = on_wire(self.octets, self.baud)
        end_ns = start_ns + lasts
        tx = Transmission(None, self.sender, self.octets, self.baud, start_ns, end_ns, telegram, forced=True)
        tx.notes.append("repeated")
        return tx


#: An octet as a receiver gets it: ns from the first start edge of the transmission to the octet's end, value.
Heard = tuple[int, int]


def receive(octets: bytes, baud: int, flips: dict[int, int]) -> list[Heard]:
    """The octets that a receiver at the sender's rate gets; parity and framing errors drop an octet."""
    received = ((number, flipped(octet, flips.get(number, 0))) for number, octet in enumerate(octets))
    return [(chars_to_ns(number + 1, baud), octet) for number, octet in received if octet is not None]


def garbled(rng: Random) -> int | None:
    """A random character, received during a collision: half of them fail the parity check (None)."""
    return rng.getrandbits(8) if rng.getrandbits(1) else None


def complete(elapsed_ns: int, baud: int, size: int) -> int:
    """The number of octets (of ``size`` without gaps) complete ``elapsed_ns`` after the first start edge."""
    done = min(size, elapsed_ns * baud // (BITS_PER_CHAR * NS_PER_S) + 1)
    while done and chars_to_ns(done, baud) > elapsed_ns:
        done -= 1
    return done
