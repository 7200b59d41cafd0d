"""CSV files of logic analysers: samples or changes of several channels, a row each.

Sources: libsigrok, output/csv.c; Saleae, "Binary and CSV export formats" (Logic 2: ``Time [s],Channel 0``, a level may
be ``X`` for no data; Logic 1: ``Time[s], Channel 0``); DSView (``Time(s),0`` behind ``; Sample rate: 10 MHz``).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from itertools import islice
from typing import BinaryIO, Final

from dpstack.capture.waveforms.levels import (
    KEPT,
    MOST_CHANNELS,
    MOST_RATE,
    PIECE,
    Change,
    Piece,
    Waveform,
    before_damage,
    estimated_rate,
    parse_rate,
    pieces_of,
)
from dpstack.units import NS_PER_S

_BLOCK: Final = 1 << 20
#: octets in which the comments and the headings stand
_MOST_HEAD: Final = 1 << 16
#: rows from which the period of the samples is estimated
_ESTIMATED: Final = 4000
_STATED: Final = re.compile(r"(?:Samplerate|Sample rate|META samplerate): *([\d.]+ ?[kMG]?(?:Hz)?)\s*$")
_NAMED: Final = re.compile(r"Channels \(\d+/\d+\): (.*)")
_TIME: Final = re.compile(r"time(?:stamp)? ?(?:[\[(](s|ms|us|µs|ns)[\])])?$", re.IGNORECASE)
_UNITS_NS: Final = {"s": 1e9, "ms": 1e6, "us": 1e3, "µs": 1e3, "ns": 1.0}
#: headings of libsigrok's column of times
_LONG_UNITS_NS: Final = {
    "milliseconds": 1e6,
    "microseconds": 1e3,
    "nanoseconds": 1.0,
    "picoseconds": 1e-3,
}
#: times and values, no headings
_VALUE: Final = re.compile(r"X|[-+]?\d[-+.:\dTZe]*|", re.IGNORECASE)
#: ns of a tick at least
_LEAST_TICK: Final = 1e-3
_LEVELS: Final = {b"0": 0, b"1": 1, b"X": KEPT, b"x": KEPT}


class LevelTable(Waveform):
    """Raises CaptureFileError for headings and first rows that are not understood."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        super().__init__(file, name)
        self.rate = 0
        self._named: list[str] = []
        heading, first, self._body, self._line = self._head()
        self._separator = next((one for one in (b",", b"\t", b";") if one in first), b",")
        cells = first.split(self._separator)
        named = self._named or [str(number) for number in range(len(cells))]
        titles = [
            title.strip().strip('"') for title in heading.decode(errors="replace").split(self._separator.decode())
        ]
        self._time = _time_column(titles if heading else [])
        if not heading:
            self._time = 0 if len(cells) == len(self._named) + 1 else None
            titles = ["Time"] * (self._time == 0) + named
        elif "logic" in titles:  # libsigrok's label=units; the names stand in the comment
            trigger = titles[-1:] if titles[-1] == "Trigger" else []
            titles = titles[: self._time == 0] + (self._named or named[: titles.count("logic")]) + trigger
        if len(cells) != len(titles):
            raise self._bad(f"{len(cells)} columns under {len(titles)} headings", self._line)
        self._columns = [
            number
            for number, cell in enumerate(cells)
            if number != self._time and cell.strip() in _LEVELS and titles[number] != "Trigger"
        ][:MOST_CHANNELS]
        self.channels = tuple(titles[number] for number in self._columns)
        if not self.channels:
            raise self._bad("no column of levels (0 or 1)", self._line)
        if len(cells) > len(self._columns) + (self._time is not None) + ("Trigger" in titles):
            self.remarks.append("analog channels are ignored")
        self._width = 0
        if self._time is None:
            self._use_rows(first)
        else:
            self._use_times(titles[self._time], cells[self._time])

    def _use_rows(self, first: bytes) -> None:
        """There are no times: each row is a sample."""
        if not 0 < self.rate <= MOST_RATE:
            raise self.wrong(
                "neither times nor the sample rate stand in the file; export it with its header, or as .sr or VCD"
            )
        self._tick_ns = NS_PER_S / self.rate
        self._first = 0
        if len(first.split(self._separator)) == len(self._columns):
            self._width = len(first) + 1  # all rows are alike: read whole blocks

    def _use_times(self, title: str, text: bytes) -> None:
        unit = _TIME.match(title)
        if title == "samples":
            raise self.wrong(
                "the times are missing (sigrok-cli writes zeros when it converts); convert to .sr first, or to VCD"
            )
        if title in _LONG_UNITS_NS:
            unit_ns = _LONG_UNITS_NS[title]
        elif unit is not None and unit[1]:
            unit_ns = _UNITS_NS[unit[1].lower()]
        elif self.rate:  # libsigrok's label=channel: the largest unit in which a sample is no fraction
            unit_ns = float(NS_PER_S)
            while unit_ns * self.rate > NS_PER_S:
                unit_ns /= 1000
        else:
            raise self.wrong(f"the unit of the times under {title!r} is unknown; export them in seconds")
        decimals = len(text.strip().partition(b".")[2])
        self._tick_ns = max(_LEAST_TICK, unit_ns / 10**decimals if decimals < 16 and b"e" not in text else 0.0)
        self._ticks: Callable[[bytes], int] = _Decimal(unit_ns / self._tick_ns)
        if b":" in text:
            self._tick_ns, self._ticks = 1.0, _Iso()
        ticks = [one.at for one in before_damage(islice(self._changes([0], self._ticks), _ESTIMATED))]
        self._first = ticks[0] if ticks else 0
        self.begin_ns = round(self._first * self._tick_ns)
        self.stated = 0 < self.rate <= MOST_RATE
        if not self.stated:
            self.rate, self.period_ns = estimated_rate(ticks, self._tick_ns)
            return
        # libsigrok 0.5.2 counts with whole units a sample, so that 24 MHz has 41 ns and all times are too short
        whole = int(NS_PER_S / self.rate / self._tick_ns)
        if whole and not any(tick % whole for tick in ticks):
            self._tick_ns = NS_PER_S / self.rate / whole
            self.begin_ns = round(self._first * self._tick_ns)

    def _head(self) -> tuple[bytes, bytes, int, int]:
        """The headings (empty: none), the first row, its place in the file and its line."""
        self.file.seek(0)
        head = self.file.read(_MOST_HEAD)
        at = 3 if head.startswith(b"\xef\xbb\xbf") else 0
        heading, number = b"", 0
        while (end := head.find(b"\n", at)) >= 0:
            number += 1
            row = head[at:end].rstrip(b"\r")
            text = row.decode(errors="replace")
            if row.startswith((b";", b"META")):
                if found := _STATED.search(text):
                    self.rate = parse_rate(found[1])
                elif found := _NAMED.search(text):
                    self._named = [name.strip() for name in found[1].split(",")]
            elif row.strip():
                cells = [cell.strip(' "') for cell in re.split("[,;\t]", text)]
                values = all(map(_VALUE.fullmatch, cells)) and cells != self._named  # a channel may be called 0
                if heading or values:
                    return heading, row, at, number
                heading = row
            at = end + 1
        raise self.wrong("no row of levels behind the headings")

    def pieces(self, channels: Sequence[int]) -> Iterator[Piece]:
        if self._width:
            yield from self._blocks(channels)
            return
        per_tick = self._tick_ns * self.rate / NS_PER_S
        first = self._first
        changes = self._changes(channels, None if self._time is None else self._ticks)
        yield from pieces_of((Change(round((at - first) * per_tick), *what) for at, *what in changes), self.rate)

    def _blocks(self, channels: Sequence[int]) -> Iterator[Piece]:
        """Rows of one width: the levels of a channel stand in equal distances."""
        width, start = self._width, 0
        self.file.seek(self._body)
        size = PIECE * width
        while block := self.file.read(size):
            while len(block) < size and (more := self.file.read(size - len(block))):
                block += more
            rows = len(block) // width
            whole = rows * width
            for channel in channels:
                levels = block[2 * self._columns[channel] : whole : width]
                if levels.strip(b"01") or levels.translate(None, b"01") or block.count(b"\n") != rows:
                    raise self._bad("a row has another form than the first one", self._line + start)
                yield Piece(channel, start, levels)
            start += rows
            if block[whole:].strip():
                raise self._bad("the file ends within a row", self._line + start)

    def _changes(self, channels: Sequence[int], ticks: Callable[[bytes], int] | None) -> Iterator[Change]:
        """A change for each channel that changes in a row, with its time in ticks; the last row once more."""
        columns = [(channel, self._columns[channel]) for channel in channels]
        before: list[bytes] = [b""] * (max(self._columns) + 1)
        least = max(*self._columns, self._time or 0) + 1 if len(self._columns) > 1 else self._columns[0] + 1
        at = -1
        for number, row in self._rows():
            cells = row.split(self._separator)
            if len(cells) < least:
                raise self._bad("a row has too few columns", number)
            if ticks is None:
                now = at + 1
            else:
                try:
                    now = ticks(cells[self._time or 0])
                except (ValueError, OverflowError):
                    raise self._bad(f"{_shown(cells[self._time or 0])} is no time", number) from None
                if now < at and at != -1:
                    raise self._bad("the time is before the one of the row before", number)
            at = now
            for channel, column in columns:
                cell = cells[column]
                if cell != before[column]:
                    before[column] = cell
                    level = _LEVELS.get(cell.strip())
                    if level is None:
                        raise self._bad(f"{_shown(cell)} is no level (0 or 1)", number)
                    yield Change(at, channel, level)
        yield Change(at, channels[0], KEPT)

    def _rows(self) -> Iterator[tuple[int, bytes]]:
        """The rows that are not empty, with the numbers of their lines."""
        self.file.seek(self._body)
        number, rest = self._line, b""
        while block := self.file.read(_BLOCK):
            *lines, rest = (rest + block).split(b"\n")
            if len(rest) > _BLOCK:
                raise self._bad(f"a row has more than {_BLOCK} characters", number)
            for line in lines:
                row = line.rstrip(b"\r")
                if row:
                    yield number, row
                number += 1
        if rest.strip():
            yield number, rest

    def _bad(self, text: str, line: int) -> Exception:
        return self.wrong(f"line {line}: {text}")


class _Decimal:
    """Ticks of a time written as a decimal number."""

    def __init__(self, factor: float) -> None:
        self._factor = factor

    def __call__(self, text: bytes) -> int:
        return round(float(text) * self._factor)


class _Iso:
    """Nanoseconds since 1970 of times such as ``2026-09-22T08:20:18.204048396+00:00``."""

    def __init__(self) -> None:
        self._second = b""
        self._ns = 0

    def __call__(self, text: bytes) -> int:
        text = text.strip().strip(b'"')
        second, _, rest = text.partition(b".")
        if second != self._second:
            zone = re.search(rb"(?:Z|[+-]\d\d:\d\d)$", text)
            written = (second[:19] + (zone[0].replace(b"Z", b"+00:00") if zone else b"+00:00")).decode(
                "ascii", "replace"
            )
            self._second, self._ns = second, round(datetime.fromisoformat(written).timestamp()) * NS_PER_S
        digits = re.match(rb"\d{1,9}", rest)
        return self._ns + (int(digits[0].ljust(9, b"0")) if digits else 0)


def _time_column(titles: Sequence[str]) -> int | None:
    """The column of times: the first one, if its heading says so."""
    if titles and (_TIME.match(titles[0]) or titles[0] in _LONG_UNITS_NS or titles[0] == "samples"):
        return 0
    return None


def _shown(text: bytes) -> str:
    return repr(text[:30].decode(errors="replace").strip())
