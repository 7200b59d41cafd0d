"""One transmission on a line: its octets, the time of its first bit, damage."""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntFlag
from itertools import repeat
from typing import Final, NamedTuple

from msgspec import Struct


class Damage(IntFlag):
    """Kinds of damage of a transmission; the values are the error bits of a pcapng packet (epb_flags)."""

    FCS = 1 << 24
    TOO_LONG = 1 << 25
    TOO_SHORT = 1 << 26
    START_DELIMITER = 1 << 29
    PARITY_OR_FRAMING = 1 << 31


#: kinds of damage in words
DAMAGE_TEXTS: Final = {
    Damage.FCS: "check sequence",
    Damage.TOO_LONG: "too long",
    Damage.TOO_SHORT: "too short",
    Damage.START_DELIMITER: "start octet",
    Damage.PARITY_OR_FRAMING: "parity or framing",
}


def damage_text(damage: int) -> str:
    """The causes in a sum of :class:`Damage` in words."""
    return ", ".join(text for bit, text in DAMAGE_TEXTS.items() if damage & bit)


class Transmission(NamedTuple):
    """Octets that followed each other on a line, or in a file. Octets that are no telegram are one, too.

    ``t_ns``: time of the first bit in ns since 1970, None if the source has no times. ``baud`` in bit/s, 0 if
    the source does not say. ``damage``: a sum of :class:`Damage`. ``note``: one line of the source, for people.
    """

    octets: bytes
    t_ns: int | None = None
    baud: int = 0
    note: str = ""
    damage: int = 0


class Columns(Struct, frozen=True):
    """Transmissions at one rate, with times, and without notes and damage; iterating over it makes them one by one."""

    baud: int
    octets: list[bytes]
    times: list[int]

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[Transmission]:
        values = zip(self.octets, self.times, repeat(self.baud), repeat(""), repeat(0))
        return map(tuple.__new__, repeat(Transmission), values)
