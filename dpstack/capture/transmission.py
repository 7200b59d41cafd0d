"""One transmission on a line: its octets, the time of its first bit, damage."""

from __future__ import annotations

from enum import IntFlag
from typing import NamedTuple


class Damage(IntFlag):
    """Kinds of damage of a transmission; the values are the error bits of a pcapng packet (epb_flags)."""

    FCS = 1 << 24
    TOO_LONG = 1 << 25
    TOO_SHORT = 1 << 26
    START_DELIMITER = 1 << 29
    PARITY_OR_FRAMING = 1 << 31


class Transmission(NamedTuple):
    """Octets that followed each other on a line, or in a file. Octets that are no telegram are one, too.

    ``t_ns``: time of the first bit in ns since 1970, None where the source has no times. ``baud`` in bit/s, 0 where
    the source does not say. ``damage``: a sum of :class:`Damage`. ``note``: one line of the source, for people.
    """

    octets: bytes
    t_ns: int | None = None
    baud: int = 0
    note: str = ""
    damage: int = 0
