"""Reader of the hardware export of STEP 7 (HW Config, Station > Export): text in, sections out.

A section is a head (``DPSUBSYSTEM 1, DPADDRESS 3, SLOT 7, "...", "..."``), further lines in front of BEGIN, and a body
up to END. The body has keys (``COMMENT "..."``), named blocks with their own BEGIN and END, addresses, symbols and
parameters. Siemens publishes no description of the format. These rules follow exported files
(docs/how-to/step7.md#the-file).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from msgspec import Struct

from dpstack.dp.slot_map import Direction
from dpstack.errors import ConfigError
from dpstack.gsd.text import decode
from dpstack.text import brief, shortened

#: an export of 100 slaves with parameters has 5 MB
MAX_OCTETS: Final = 64_000_000
#: lines that nobody understands and that are named one by one
_MOST_UNKNOWN: Final = 20
#: characters of a line that a remark shows
_SHOWN: Final = 60
#: lines that a text in quotes may have
_MOST_LINES: Final = 50

_HEAD: Final = re.compile(r"(?:STATION|SUBNET|RACK|DPSUBSYSTEM|IOSUBSYSTEM|IRT_DOMAIN|SYNC_DOMAIN)(?=[\s,])")
_PLACE: Final = re.compile(
    r"\b(RACK|DPSUBSYSTEM|IOSUBSYSTEM|IOADDRESS|DPADD?RESS|SLOT|SUBSLOT|SUBMODULE)\s+(\d{1,9})\b"
)
_TEXT: Final = re.compile(r'"((?:[^"]|"")*)"')
_END: Final = re.compile(r"ENDE?")
_KEY: Final = re.compile(r"([A-Za-z_]\w*)(?:\s+(\S.*))?", re.DOTALL)
_PARAMETER: Final = re.compile(r'([^\s,"]+)\s*,(?:\s*([A-Z]+)\s*,)?.*', re.DOTALL)
_NUMBERS: Final = re.compile(r"ADDRESS\s+(\d{1,9}(?:\s*,\s*\d{1,9})*)", re.ASCII)
_SYMBOL: Final = re.compile(r'SYMBOL\s+([IOEQA])\s*,\s*(\d{1,9})\s*,\s*(".*)', re.DOTALL | re.ASCII)
_DIRECTIONS: Final = {"LOCAL_IN_ADDRESSES": Direction.INPUT, "LOCAL_OUT_ADDRESSES": Direction.OUTPUT}
_PARAMETERS: Final = "PARAMETER"
#: shortened copies in forums leave BEGIN and END out
_OF_BODY: Final = frozenset((*_DIRECTIONS, _PARAMETERS, "ADDRESS", "SYMBOL"))
#: words of one language and one alphabet: three letters of cp1251 in a row are Cyrillic, where latin-1 has umlauts
#: between other letters
_CYRILLIC: Final = re.compile(rb"[\xc0-\xff\xa8\xb8]{3}")
_HIGH: Final = re.compile(rb"[A-Za-z][\xc0-\xff]|[\xc0-\xff][A-Za-z]")


@dataclass(frozen=True, slots=True, order=True)
class Remark:
    """A thing of the export that was not understood, or that a reader of the plant must know. Line 0: the whole."""

    line: int
    text: str


class Area(Struct, frozen=True):
    """One range of process data: octets from ``address`` on as the program of the PLC has them.

    ``bit``: the first bit, not 0 if several modules share an octet. ``octets`` 0: an address for diagnosis only.
    """

    direction: Direction
    address: int
    bit: int
    octets: int
    line: int


class Symbol(Struct, frozen=True):
    """A name of the symbol table. ``number`` counts within the module, see ``step7_layout``."""

    direction: Direction
    number: int
    name: str
    comment: str
    line: int


@dataclass(slots=True)
class Section:
    """One section. ``places``: the numbers of its head by their word; ``texts``: its texts in quotes, without the
    ``firmware``, which stands behind the order number without a comma."""

    kind: str
    line: int
    places: dict[str, int]
    texts: list[str]
    firmware: str = ""
    #: lines between head and BEGIN
    options: list[str] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)
    areas: list[Area] = field(default_factory=list)
    symbols: list[Symbol] = field(default_factory=list)
    #: names of the parameters, and the kinds of channels that have some ("AI", "DO")
    parameters: set[str] = field(default_factory=set)
    channels: set[str] = field(default_factory=set)

    def text(self, number: int) -> str:
        return self.texts[number] if number < len(self.texts) else ""

    def place(self, word: str) -> int | None:
        return self.places.get(word)


@dataclass(slots=True)
class Export:
    """A whole export. ``encoding``: the code page of its text; ``cut``: the line of the section in which it ends, 0
    if it is whole."""

    encoding: str
    sections: list[Section] = field(default_factory=list)
    remarks: list[Remark] = field(default_factory=list)
    #: the version of STEP 7 that wrote it
    version: str = ""
    cut: int = 0


def read_cfg(octets: bytes, encoding: str = "") -> Export:
    """Read an export. ``encoding``: the code page of its text, else found out (UTF-8, UTF-16, cp1251, cp1252).

    Raises ConfigError (``what; what to do``) if the octets are no export.
    """
    if len(octets) > MAX_OCTETS:
        raise ConfigError(f"more than {MAX_OCTETS // 1_000_000} MB; give the export of one station")
    text, found = _decoded(octets, encoding)
    if "\0" in text:
        raise ConfigError(
            "is binary, not the text of a STEP 7 export; in HW Config choose Station > Export with the format "
            "Readable, and give the .cfg file"
        )
    export = Export(encoding=found)
    _Reader(export).read(text)
    if not export.sections:
        raise ConfigError(
            "has no section of a STEP 7 export (STATION, SUBNET, RACK, DPSUBSYSTEM); in HW Config choose Station > "
            "Export with the format Readable, and give the .cfg file"
        )
    return export


def _decoded(octets: bytes, encoding: str) -> tuple[str, str]:
    if encoding:
        try:
            return octets.decode(encoding), encoding
        except LookupError:
            raise ConfigError(
                f"no code page is called {brief(encoding)}; give for instance --encoding cp1251, cp1250 or utf-8"
            ) from None
        except (UnicodeError, ValueError) as error:
            raise ConfigError(f"is not {encoding} text ({error}); leave --encoding out, or give another") from None
    text, found = decode(octets)
    if found == "cp1252" and len(_CYRILLIC.findall(octets)) > len(_HIGH.findall(octets)):
        return octets.decode("cp1251", "replace"), "cp1251"
    return text, found


class _Reader:
    """Line by line. ``_depth``: open BEGINs of the section; a head begins a new section at any depth, so that a
    damaged section does not swallow the others."""

    def __init__(self, export: Export) -> None:
        self._export = export
        self._section: Section | None = None
        self._depth = 0
        self._direction: Direction | None = None
        self._in_parameters = False
        self._unknown = 0
        #: open BEGINs of a section that nobody understands, which is one remark
        self._foreign = 0
        #: the line before was not understood, and may be the head of one
        self._headed = False

    def read(self, text: str) -> None:
        for number, line in _lines(text):
            self._line(number, line)
        if self._section is not None:  # each section of a whole export has an END
            self._export.cut = self._section.line
            self._remark(
                self._section.line,
                "the file ends within this section: it was cut; what stands behind is missing, export it again",
            )
        if self._unknown > _MOST_UNKNOWN:
            self._remark(0, f"{self._unknown - _MOST_UNKNOWN} more lines were not understood")

    def _line(self, number: int, line: str) -> None:
        if _HEAD.match(line):
            self._begin(number, line)
        elif self._section is None:
            self._before(number, line)
        elif line == "BEGIN":
            self._depth += 1
        elif _END.fullmatch(line):
            self._end(number)
        elif not self._depth and line.split(None, 1)[0] not in _OF_BODY:
            self._section.options.append(line)
        else:
            self._body(self._section, number, line)

    def _before(self, number: int, line: str) -> None:
        word, _, rest = line.partition(" ")
        if line == "BEGIN" and (self._foreign or self._headed):
            self._foreign, self._headed = self._foreign + 1, False
        elif self._foreign and _END.fullmatch(line):
            self._foreign -= 1
        elif self._foreign:
            return
        elif word == "#STEP7_VERSION":
            self._export.version = rest.strip().strip('"')
        elif not line.startswith("#") and word != "FILEVERSION":
            self._not_understood(number, line)
            self._headed = True

    def _begin(self, number: int, line: str) -> None:
        if self._section is not None and self._depth:
            self._remark(self._section.line, f"this section has no END; it was read up to line {number - 1}")
        head, texts, firmware = line.partition('"')[0], [], ""
        last = -1
        for match in _TEXT.finditer(line):
            if last >= 0 and "," not in line[last : match.start()]:
                firmware = match[1]
            else:
                texts.append(match[1].replace('""', '"').strip())
            last = match.end()
        places = {word.replace("DPADRESS", "DPADDRESS"): int(value) for word, value in _PLACE.findall(head)}
        kind = head.split(",")[0].split()
        self._section = Section(kind[0], number, places, texts, firmware)
        if kind[0] in ("STATION", "SUBNET"):
            self._section.keys["TYPE"] = " ".join(kind[1:])
        self._export.sections.append(self._section)
        self._depth, self._direction, self._in_parameters = 0, None, False
        self._foreign, self._headed = 0, False

    def _end(self, number: int) -> None:
        if not self._depth:
            self._not_understood(number, "END")
            return
        self._depth -= 1
        if not self._depth:
            self._section = None

    def _body(self, section: Section, number: int, line: str) -> None:
        word = line.split(None, 1)[0]
        if word in _DIRECTIONS:
            self._direction, self._in_parameters = _DIRECTIONS[word], False
        elif word == _PARAMETERS:
            self._in_parameters = True
        elif word == "ADDRESS" and self._direction is not None:
            self._area(section, number, line, self._direction)
        elif word == "SYMBOL":
            self._symbol(section, number, line)
        elif self._in_parameters and (found := _PARAMETER.fullmatch(line)):
            section.parameters.add(found[1])
            section.channels.update((found[2],) if found[2] else ())
        elif found := _KEY.fullmatch(line):
            if self._depth == 1:
                section.keys.setdefault(found[1], _value(found[2] or ""))
        else:
            self._not_understood(number, line)

    def _area(self, section: Section, number: int, line: str, direction: Direction) -> None:
        found = _NUMBERS.fullmatch(line)
        numbers = [int(one) for one in found[1].split(",")] if found else []
        if len(numbers) < 3:
            self._not_understood(number, line)
            return
        section.areas.append(Area(direction, numbers[0], numbers[1], numbers[2], number))

    def _symbol(self, section: Section, number: int, line: str) -> None:
        found = _SYMBOL.fullmatch(line)
        texts = [match[1].replace('""', '"') for match in _TEXT.finditer(found[3])] if found else []
        if found is None or not texts:
            self._not_understood(number, line)
            return
        direction = Direction.INPUT if found[1] in "IE" else Direction.OUTPUT
        comment = " ".join(texts[1].split()) if len(texts) > 1 else ""
        section.symbols.append(Symbol(direction, int(found[2]), texts[0].strip(), comment, number))

    def _not_understood(self, number: int, line: str) -> None:
        self._unknown += 1
        if self._unknown <= _MOST_UNKNOWN:
            self._remark(number, f"not understood: {shortened(line, _SHOWN)}")

    def _remark(self, line: int, text: str) -> None:
        self._export.remarks.append(Remark(line, text))


def _value(text: str) -> str:
    found = _TEXT.fullmatch(text)
    return found[1].replace('""', '"') if found else text.strip('"')


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """The lines that are not empty, without blanks around them, with their numbers. A text in quotes may go over
    several lines, unless one of them begins something else."""
    parts: list[str] = []
    begun = 0
    for number, raw in enumerate(text.split("\n"), 1):
        line = raw.strip()
        if parts:
            if _goes_on(line) and len(parts) < _MOST_LINES:
                parts.append(line)
                if line.count('"') % 2:
                    yield begun, "\n".join(parts)
                    parts = []
                continue
            yield begun, f'{" ".join(parts)}"'  # the text never ends: it ends with its line
            parts = []
        if not line:
            continue
        if line.count('"') % 2:
            parts, begun = [line], number
        else:
            yield number, line
    if parts:
        yield begun, f'{" ".join(parts)}"'


def _goes_on(line: str) -> bool:
    return not (_HEAD.match(line) or line == "BEGIN" or _END.fullmatch(line) or re.match(r'[A-Z_]\w* +"', line))
