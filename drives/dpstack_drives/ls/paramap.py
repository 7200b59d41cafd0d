"""Para Status (COM-31..) and Para Control (COM-51..): which address stands where
(docs/reference/drives/ls-s100.md#parameters-and-maps)."""

from __future__ import annotations

from typing import ClassVar, Final

from msgspec import Struct

from dpstack.profile import MapCodes, ParamKey
from dpstack_drives.ls import table as t
from dpstack_drives.ls import telegrams

#: as delivered
DEFAULT_STATUS: Final = (0x000A, 0x000E, 0x000F)
DEFAULT_CONTROL: Final = (0x0005, 0x0006)


def parse(text: str) -> tuple[int, ...]:
    """``000A 000E dr-03``: four hex digits, ``0x0A``, or a keypad code; 0000 leaves a word empty. Raises ValueError."""
    found = []
    for word in text.split():
        where = t.mapped_address(word)
        if where is None:
            raise ValueError(f"{word!r} is no address; write 000A (four hex digits), dr-03 or In-90")
        found.append(where)
    return tuple(found)


def check(entries: tuple[int, ...], most: int, *, written: bool) -> str | None:
    """Why a map cannot be; None if it can. ``written``: the words are written to the drive."""
    if len(entries) > most:
        return f"{len(entries)} addresses, the telegram has room for {most}"
    for place, where in enumerate(entries):
        if not where:
            continue
        spec = t.spec_at(where)
        if written and where in entries[:place]:
            return f"{where:04X} stands there twice; the last word would win"
        if written and spec is not None and spec.read_only:
            return f"{t.code_of(where)} ({spec.title}) is read only"
    return None


class ParaWord(Struct, frozen=True):
    """A mapped word: the parameter at an address."""

    octets: ClassVar[int] = 2
    key: int

    @property
    def neutral(self) -> bool:
        """Frequency and operation command: 0 is none of either; all others are parameters."""
        return self.key in (t.FREQUENCY, t.OPERATION)

    @property
    def name(self) -> str:
        """``dr-03``, or the address in hex."""
        return t.code_of(self.key)

    def encode(self, value: float) -> int:
        """In its unit if that is known, else the integer on the wire. Raises ValueError."""
        spec = t.spec_at(self.key)
        if spec is not None:
            return spec.to_raw(value)
        if value != int(value) or not 0 <= value <= 0xFFFF:
            raise ValueError(f"{self.name} takes the 16-bit integer on the wire, not {value:g}")
        return int(value)

    def decode(self, raw: int) -> int | float:
        """In its unit if that is known."""
        spec = t.spec_at(self.key)
        return raw if spec is None else spec.to_value(raw)


class ParaMap(Struct, frozen=True):
    """The addresses of one way, 0 for a word that carries nothing."""

    entries: tuple[int, ...]

    @property
    def fields(self) -> tuple[ParaWord | None, ...]:
        return tuple(ParaWord(entry) if entry else None for entry in self.entries)

    def __str__(self) -> str:
        return " ".join(f"{entry:04X}" for entry in self.entries)


def _codes(count: int, first: int) -> MapCodes:
    return MapCodes(tuple(ParamKey(first + place) for place in range(telegrams.MOST)), ParamKey(count))


#: of inputs and outputs: addresses and their number (4.2.8)
CODES: Final = (_codes(t.STATUS_COUNT, t.PARA_STATUS), _codes(t.CONTROL_COUNT, t.PARA_CONTROL))
