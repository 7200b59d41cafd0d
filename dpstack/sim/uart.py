"""What receivers at the sender's rate make of damaged octets and collisions: parity and framing errors drop the octet.

Intact telegrams never come here; receivers at another rate sample the waveform (:mod:`dpstack.phy.uart`).
"""

from __future__ import annotations

from random import Random

from dpstack.phy.uart import flipped
from dpstack.units import BITS_PER_CHAR, chars_to_ns

#: An octet as a receiver gets it: ns from the first start edge of the transmission to the octet's end, value.
Heard = tuple[int, int]


def receive(octets: bytes, baud: int, flips: dict[int, int]) -> list[Heard]:
    """The octets a receiver at the sender's rate gets; ``flips`` are the inverted bits by octet number."""
    heard: list[Heard] = []
    for number, octet in enumerate(octets):
        mask = flips.get(number)
        got = octet if mask is None else flipped(octet, mask)
        if got is not None:
            heard.append((chars_to_ns(number + 1, baud), got))
    return heard


def garbled(rng: Random) -> int | None:
    """A character of which nothing can be known (a collision): half of them fail the parity check."""
    return rng.getrandbits(8) if rng.getrandbits(1) else None


def complete(elapsed_ns: int, baud: int, size: int) -> int:
    """How many of ``size`` octets without gaps are complete ``elapsed_ns`` after the first start edge."""
    done = min(size, elapsed_ns * baud // (BITS_PER_CHAR * 1_000_000_000) + 1)
    while done and chars_to_ns(done, baud) > elapsed_ns:
        done -= 1
    return done
