"""Tables of the async serial analyser of Saleae Logic: a row for each character.

Sources: Saleae's SerialAnalyzer: Logic 1 writes ``Time [s],Value,Parity Error,Framing Error``, Logic 2 ``name,type,
start_time,duration,data,error`` with the error ``parity`` or ``framing``. The time is the one of the start edge.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from itertools import islice, pairwise
from typing import BinaryIO, Final

from dpstack.capture.waveforms.levels import before_damage
from dpstack.errors import CaptureFileError, UsageError
from dpstack.phy.uart import Character
from dpstack.text import some_of
from dpstack.units import BAUD_RATES, BITS_PER_CHAR, NS_PER_S, chars_to_ns

_LOGIC_1: Final = ["Time [s]", "Value", "Parity Error", "Framing Error"]
_LOGIC_2: Final = {"name", "type", "start_time", "data"}
_HEX: Final = re.compile(r"0x([0-9A-F]{1,2})$", re.IGNORECASE)
#: octets of a line
_MOST_LINE: Final = 1 << 16
#: characters from which the rate is found
_FIRST: Final = 2000
#: the rate found differs from the one of the distances by this factor at most: stop bits may be longer
_NEAR: Final = 1.15


class CharacterTable:
    """The characters of one analyser in ``file``. ``channels``: the names of the analysers; ``channel``: the one that
    is read, ``baud``: its rate (0: found). Raises CaptureFileError, UsageError for an unknown ``channel``."""

    def __init__(self, file: BinaryIO, name: str, baud: int, channel: str) -> None:
        self.name = name
        self.remarks: list[str] = []
        self._file = file
        rows = self._rows()
        self._titles = [title.strip() for title in next(rows, (0, [""]))[1]]
        self._is_logic_1 = self._titles == _LOGIC_1
        if not self._is_logic_1 and not set(self._titles) >= _LOGIC_2:
            raise self._wrong(1, f"not the headings of an async serial analyser: {some_of(self._titles, 6)}")
        self.channel = channel
        first = before_damage(islice(self._raw(), _FIRST))
        names = list(dict.fromkeys(name for name, *_ in first))
        if not names:
            raise CaptureFileError(f"{name}: the table has no characters")
        if channel and channel not in names:
            raise UsageError(f"{name}: no analyser {channel!r}; its analysers: {some_of(names, 16)}")
        self.channel = channel or names[0]
        if len(names) > 1 and not channel:
            self.remarks.append(f"other analysers are left out: {some_of(names[1:])}; choose with --channel")
        starts = [start_ns for name, start_ns, *_ in first if name == self.channel]
        self.begin_ns = starts[0]
        digits = next((n for n in (9, 8, 7, 6) if any(start % 10 ** (10 - n) for start in starts)), 6)
        self.resolution_ns = 10 ** (9 - digits)
        self.baud = baud or self._find(starts)

    def characters(self) -> Iterator[Character]:
        length_ns, shift_ns = chars_to_ns(1, self.baud), min(0, self.begin_ns)
        for name, start_ns, octet, errors in self._raw():
            if name == self.channel:
                at_ns = start_ns - shift_ns + length_ns
                yield Character(at_ns, octet, "parity" in errors, "framing" in errors)

    def _find(self, starts: list[int]) -> int:
        distances = sorted(b - a for a, b in pairwise(starts) if b > a)
        if distances:
            rate = BITS_PER_CHAR * NS_PER_S / distances[len(distances) // 10]
            for baud in BAUD_RATES:
                if 1 / _NEAR < rate / baud < _NEAR:
                    return baud
        raise CaptureFileError(
            f"{self.name}: the distances of the characters fit no rate of PROFIBUS with 8 data bits and even parity; "
            "name it with --baud"
        )

    def _raw(self) -> Iterator[tuple[str, int, int, str]]:
        """Name, start in ns, octet and errors of each character."""
        places = {title: place for place, title in enumerate(self._titles)}
        rows = self._rows()
        next(rows)
        before = None
        for line, row in rows:
            cells = [*row, *[""] * (len(self._titles) - len(row))]
            if self._is_logic_1:
                name, start, value = "Async Serial", cells[0], cells[1]
                errors = ("parity " if cells[2].strip() else "") + ("framing" if cells[3].strip() else "")
            else:
                if cells[places["type"]] != "data":
                    continue
                name, start, value = (cells[places[title]] for title in ("name", "start_time", "data"))
                errors = cells[places["error"]] if "error" in places else ""
            octet = _HEX.match(value.strip())
            if octet is None:
                raise self._wrong(
                    line, f"{value[:20]!r} is no octet such as 0x68; set the analyser to hexadecimal and export again"
                )
            try:
                start_ns = round(float(start) * NS_PER_S)
            except (ValueError, OverflowError):
                raise self._wrong(line, f"{start[:30]!r} is no time in seconds") from None
            if before is not None and start_ns < before:
                raise self._wrong(line, "the time is before the one of the row before")
            before = start_ns
            yield name, start_ns, int(octet[1], 16), errors

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        self._file.seek(0)
        lines = iter(lambda: self._file.readline(_MOST_LINE), b"")
        reader = csv.reader(line.decode(errors="replace").lstrip("\ufeff") for line in lines)
        try:
            for row in reader:
                if row:
                    yield reader.line_num, row
        except csv.Error as error:
            raise self._wrong(reader.line_num, str(error)) from None

    def _wrong(self, line: int, text: str) -> CaptureFileError:
        return CaptureFileError(f"{self.name}: line {line}: {text}")
