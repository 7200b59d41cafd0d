"""PCD1 to PCD4 of PPO2 and PPO4: function codes as cyclic words (docs/reference/drives/fuji.md#pcd-words).

o40 to o43 (PNU 915) say what is written, o48 to o51 (PNU 916) what is read: group and number in four hex digits, F26 is
041A. They act after power-on. Of doubled assignments of writes the lowest counts; S01 and S05 cannot be written.
"""

from __future__ import annotations

import re
from typing import ClassVar, Final

from msgspec import Struct

from dpstack.profile import MapCodes, ParamKey
from dpstack_drives.fuji import table as t

COUNT: Final = 4
EMPTY: Final = "-"
_BARE: Final = re.compile(r"[0-9A-Fa-f]{4}")
#: the assignments of inputs and outputs
CODES: Final = (
    MapCodes(tuple(ParamKey(t.PNU_PCD_READ, index=index) for index in t.ARRAYS[t.PNU_PCD_READ])),
    MapCodes(tuple(ParamKey(t.PNU_PCD_WRITE, index=index) for index in t.ARRAYS[t.PNU_PCD_WRITE])),
)


class PcdWord(Struct, frozen=True):
    """A cyclic word: the function code with this assignment (041A)."""

    octets: ClassVar[int] = 2
    key: int

    @property
    def neutral(self) -> bool:
        """Group S is commands and set points, all others are kept."""
        return self.key >> 8 == t.GROUPS["S"]

    @property
    def name(self) -> str:
        """``F26``."""
        return t.code_of(self.key)

    def encode(self, value: float) -> int:
        """In its unit if the format is known, else the integer on the wire. Raises ValueError."""
        if self.key == t.S06 and int(value) & t.S06_IGNORED:
            raise ValueError("S06: bits 0 and 1 (run forward, reverse) are ignored here: start() and speed do that")
        spec = t.spec_at(self.key)
        if spec is not None:
            return spec.to_raw(value) & 0xFFFF
        if value != int(value) or not -0x8000 <= value <= 0xFFFF:
            raise ValueError(f"{self.name}: its format is in no manual of ours, give the 16-bit integer on the wire")
        return int(value) & 0xFFFF

    def decode(self, raw: int) -> int | float:
        """In its unit if the format is known."""
        spec = t.spec_at(self.key)
        return raw if spec is None else spec.to_value(raw)


class PcdMap(Struct, frozen=True):
    """Assignments of PCD1 to PCD4, 0 for none; as text the function codes in order, ``-`` for none."""

    entries: tuple[int, ...] = ()

    @property
    def fields(self) -> tuple[PcdWord | None, ...]:
        return tuple(PcdWord(entry) if entry else None for entry in self.entries)

    def __str__(self) -> str:
        return " ".join(t.code_of(entry) if entry else EMPTY for entry in self.entries).rstrip(f" {EMPTY}")


def parse(text: str, *, outputs: bool) -> PcdMap:
    """``F26 M16 - 0806``: function codes or their hex digits. Raises ValueError if the drive would ignore one."""
    words = text.replace(",", " ").split()
    if len(words) > COUNT:
        raise ValueError(f"{len(words)} words, there are {COUNT} (PCD1 to PCD4)")
    entries: list[int] = []
    for word in words:
        found = t.address(word)
        if word == EMPTY:
            entry = 0
        elif found is not None:
            entry = found[0] - t.GROUP_OFFSET << 8 | found[1]
        elif _BARE.fullmatch(word):
            entry = int(word, 16)
        else:
            raise ValueError(f"{word!r} is no function code; write F26, 041A (group and number in hex) or -")
        if outputs and entry in t.READ_ONLY_HERE:
            raise ValueError(f"{t.code_of(entry)} can only be read: its assignment would be ignored")
        if outputs and entry and entry in entries:
            raise ValueError(f"{t.code_of(entry)} twice: only the first one would count")
        entries.append(entry)
    return PcdMap((*entries, *(0,) * (COUNT - len(entries))))
