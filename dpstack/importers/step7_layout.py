"""Places of the symbols of an exported slave in its process data: bits, words, numbers.

The number of a symbol counts within its module. In exported files it is the bit of a module that STEP 7 addresses by
bits; the octet of a GSD module whose identifier counts words; the channel of an analogue module of Siemens' own. If
neither the identifier nor the order number says which, the operand in the name of the symbol does ("PEW 272"), or
nothing does.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Final

from msgspec import Struct

from dpstack.dp.slot_map import Direction, Slot
from dpstack.gsd.identifiers import parse_identifiers
from dpstack.importers.step7_cfg import Area, Remark, Section, Symbol

_BIT: Final = 1
_WORD: Final = 16
#: I 0.3, PEW272, IW 512, AD 20: area, width, octet, bit
_OPERAND: Final = re.compile(r"(?:^|[^A-Za-z])P?[EIAQ]([BWD]?)[ _]*(\d{1,5})(?:\.([0-7]))?$")
_OF_WIDTH: Final = {"B": ("u8", 1), "W": ("i16", 2), "D": ("i32", 4)}
#: order numbers of analogue modules: S7-300 (33x), ET 200S, SP, iSP (134, 135)
_ANALOGUE: Final = re.compile(r"6ES7\s*(?:33|13[45])")
_DIGITAL: Final = re.compile(r"6ES7\s*(?:32|13[12])")
#: code of a floating point number in the manufacturer octets of an identifier (profile PA: 84 08 05 with status)
_FLOAT: Final = 0x08
#: where the octets of modules are, by direction and address in the PLC
OctetsOf = dict[tuple[Direction, int], int]
_LETTERS: Final = {Direction.INPUT: "I", Direction.OUTPUT: "Q"}


class Place(Struct, frozen=True):
    """A symbol in the process data: ``spec`` as the configuration has it, ``operand`` as the program of the PLC."""

    direction: Direction
    name: str
    spec: str
    operand: str
    comment: str
    line: int
    #: the name in the symbol table, if ``name`` is another
    symbol: str = ""

    @property
    def remark(self) -> str:
        """For the line of the configuration: ``I 0.3: Not-Aus``."""
        symbol = "" if self.symbol in ("", self.name) else f"{self.symbol!r}"
        return ": ".join(part for part in (" ".join(p for p in (self.operand, symbol) if p), self.comment) if part)


def places(section: Section, slot: Slot, octets_of: OctetsOf, *, own: bool) -> Iterator[Place | Remark]:
    """The places of the symbols of ``section``, whose octets are those of ``slot``; a remark for each that has none.

    ``octets_of``: the modules in front of it. ``own``: a module of Siemens' own, not of a GSD file.
    """
    for direction, area in slot.areas():
        symbols = [symbol for symbol in section.symbols if symbol.direction is direction]
        said = [one for one in section.areas if one.direction is direction and one.octets]
        octets = sum(one.octets for one in said)
        shared = octets_of.get((direction, said[0].address)) if len(said) == 1 and said[0].bit else None
        if shared is not None and not area.octets:
            yield from _of_bits(section, symbols, shared, said[0])
            continue
        if octets != area.octets and (octets or symbols):
            yield Remark(
                section.line,
                f"{section_title(section)}: ADDRESS gives {octets} octets of {direction}s, its identifier octets "
                f"{area.octets}; the identifier counts",
            )
        if any(one.bit for one in said):
            names = ", ".join(symbol.name for symbol in symbols)
            if names:
                yield Remark(
                    section.line,
                    f"{section_title(section)}: its address begins within an octet (packed addresses), so the places "
                    f"of {names} are not known: give them by hand",
                )
            continue
        kind = _kind(section, slot, direction, own=own)
        yield from _of_symbols(section, symbols, area.at, area.octets, kind, [one.address for one in said])


def octets_alone(sections: Iterable[Section]) -> Iterator[tuple[Section, int, int]]:
    """The sections with process data, and the octets of inputs and outputs that each has for itself.

    With packed addresses (ET 200S) a module that does not begin with bit 0 shares the octet of one in front of it.
    """
    seen: OctetsOf = {}
    for section in sections:
        areas = [area for area in section.areas if area.octets]
        alone = [area for area in areas if not (area.bit and (area.direction, area.address) in seen)]
        if areas:
            ins, outs = (sum(area.octets for area in alone if area.direction is one) for one in Direction)
            yield section, ins, outs
        seen |= {(area.direction, area.address): 0 for area in areas}


def _of_bits(section: Section, symbols: list[Symbol], at: int, area: Area) -> Iterator[Place | Remark]:
    """The places of symbols in an octet that several modules share; their numbers count from the first bit of their
    module, unless one of them can only count from bit 0."""
    first = 0 if any(area.bit + symbol.number >= 8 for symbol in symbols) else area.bit
    for symbol in symbols:
        bit = first + symbol.number
        if bit >= 8:
            yield _lost(section, symbol, f"number {symbol.number} lies outside the octet that it shares")
            continue
        operand = f"{_LETTERS[symbol.direction]} {area.address}.{bit}"
        yield Place(symbol.direction, symbol.name, f"bool@{at}.{bit}", operand, symbol.comment, symbol.line)


def section_title(section: Section) -> str:
    """For messages: ``slave 3, slot 7 (75x-430 8DI)``."""
    slot = section.place("SLOT")
    place = "" if slot is None else f", slot {slot}"
    return f"slave {section.place('DPADDRESS')}{place} ({section.text(0)})"


class _Kind(Struct, frozen=True):
    """``type`` of the values, their ``octets`` (0: bits), and the octets that one step of the number stands for."""

    type: str = ""
    octets: int = 0
    step: int = 1


_BITS: Final = _Kind("bool")


def _kind(section: Section, slot: Slot, direction: Direction, *, own: bool) -> _Kind | None:
    """The kind of values of a slot; None if nothing says it."""
    letter = direction.name[0]
    width = slot.area(direction).width
    if own and (f"A{letter}" in section.channels or _ANALOGUE.match(section.text(0))):
        return _Kind("i16", 2, 2)
    if own and (f"D{letter}" in section.channels or _DIGITAL.match(section.text(0))):
        return _BITS
    parts = [part for part in parse_identifiers(slot.config) if (part.inputs, part.outputs)[direction.name == "OUTPUT"]]
    if parts and all(part.manufacturer[:1] == bytes((_FLOAT,)) for part in parts):
        return _Kind("f32", 4)
    if width == _WORD:
        return _Kind("i16", 2, 2 if own else 1)
    return _BITS if width == _BIT else None


def _of_symbols(
    section: Section, symbols: list[Symbol], at: int, octets: int, kind: _Kind | None, addresses: list[int]
) -> Iterator[Place | Remark]:
    start = addresses[0] if len(addresses) == 1 else None
    if kind is None and (octets == 1 or any(symbol.number >= octets for symbol in symbols)):
        kind = _BITS
    if kind is not None and kind.octets == 2:
        kind = _words(symbols, octets, kind)
    for symbol in symbols:
        letter = _LETTERS[symbol.direction]
        found = kind or _by_operand(symbol, start)
        if found is None:
            number = symbol.number
            as_octets = f' or "i16@{at + number}"' if number + 2 <= octets else ""
            why = f"whether its number {number} counts bits or octets is not in the export: add it by hand, as "
            yield _lost(section, symbol, f'{why}"bool@{at + number // 8}.{number % 8}"{as_octets}')
            continue
        bits = not found.octets
        octet, bit = divmod(symbol.number, 8) if bits else (symbol.number * found.step, 0)
        if octet + max(found.octets, 1) > octets:
            yield _lost(section, symbol, f"number {symbol.number} lies outside the {octets} octets of its module")
            continue
        place = f".{bit}" if bits else ""
        width = {0: "", 1: "B", 2: "W", 4: "D"}[found.octets]
        operand = "" if start is None else f"{letter}{width} {start + octet}{place}"
        yield Place(
            symbol.direction, symbol.name, f"{found.type}@{at + octet}{place}", operand, symbol.comment, symbol.line
        )


def _words(symbols: Iterable[Symbol], octets: int, kind: _Kind) -> _Kind:
    """``kind`` with the step that fits all symbols: odd numbers are channels, numbers above the channels octets."""
    numbers = [symbol.number for symbol in symbols]
    if kind.step == 1 and any(number % 2 for number in numbers):
        return _Kind(kind.type, 2, 2)
    if kind.step == 2 and any(number * 2 + 2 > octets for number in numbers) and not any(n % 2 for n in numbers):
        return _Kind(kind.type, 2, 1)
    return kind


def _by_operand(symbol: Symbol, start: int | None) -> _Kind | None:
    """The kind by the operand at the end of the name, if it is the address of the symbol."""
    found = _OPERAND.search(symbol.name)
    if found is None or start is None:
        return None
    width, octet, bit = found[1], int(found[2]), found[3]
    if bit is not None and not width and 8 * (octet - start) + int(bit) == symbol.number:
        return _BITS
    if bit is None and width and octet - start == symbol.number:
        return _Kind(*_OF_WIDTH[width])
    return None


def _lost(section: Section, symbol: Symbol, why: str) -> Remark:
    about = f" ({symbol.comment})" if symbol.comment else ""
    return Remark(symbol.line, f"{section_title(section)}: symbol {symbol.name!r}{about} has no place: {why}")
