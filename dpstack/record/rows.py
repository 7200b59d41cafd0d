"""Samples of the process data as lines of CSV or JSON, every cycle or on change."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Final, NamedTuple

from dpstack.record.columns import NOTE, OCTETS, TIME, Block, Cell, Layout, T, differs
from dpstack.text import json_text, printable
from dpstack.units import NS_PER_MS, NS_PER_S, ns_to_s

#: the note of the last row begins so
END: Final = "end of the recording"
#: characters of a cell that every reader of CSV takes (Python's: 131072); a longer description is left out
LONGEST_CELL: Final = 120_000
_QUOTED: Final = frozenset(',"')


class Sample(NamedTuple):
    """The process data of one round. ``t_ns``: since the start; ``wall_ns``: since 1970.

    ``sources``: for each block of the layout its octets, state or quantities; None: not valid. ``lost``: rounds before
    it that are missing.
    """

    layout: Layout
    t_ns: int
    wall_ns: int
    sources: tuple[object, ...]
    lost: int = 0


class _Cells:
    """One block: the values last seen, those last written, and their text."""

    __slots__ = ("block", "source", "text", "values", "written")

    def __init__(self, block: Block) -> None:
        self.block = block
        self.source: object = _NOTHING
        self.values: tuple[Cell, ...] = ()
        self.written: tuple[Cell, ...] | None = None
        self.text = ""

    def is_news(self, dead_band: float) -> bool:
        """Whether a value lies outside the dead band around the one last written."""
        return self.written is None or any(
            differs(column, before, now, dead_band)
            for column, before, now in zip(self.block.columns, self.written, self.values, strict=True)
        )


_NOTHING: Final = object()


class Rows:
    """The lines of one file with the columns of ``layout``. ``form``: "csv" or "jsonl". ``described``: a row of the
    file has the description of the columns already.

    Every sample makes a row; with ``layout.on_change`` only one in which a value has left the ``dead_band`` around its
    value in the last row (in the unit of the column; the column's own one if it is greater).
    """

    def __init__(self, layout: Layout, form: str, dead_band: float = 0.0, *, described: bool = False) -> None:
        self.layout = layout
        self.form = form
        self._csv = form == "csv"
        self._dead_band = dead_band
        self._cells = [_Cells(block) for block in layout.blocks]
        self._described = described or not self._csv
        self._second = -1  # of the last row, since 1970
        self._second_text = ""

    def head(self) -> bytes:
        """The first line: the titles of a CSV file, or the description of the columns."""
        if self._csv:
            titles = [TIME, T, *(column.title for column in self.layout.columns), NOTE]
            return (",".join(map(csv_text, titles)) + "\n").encode()
        return (self.layout.description() + "\n").encode()

    def row(self, sample: Sample, note: str = "") -> bytes | None:
        """The line of ``sample``; None if nothing has changed, on change. ``note``: for people, makes it a row."""
        news = bool(note) or not self.layout.on_change
        for cells, source in zip(self._cells, sample.sources, strict=True):
            if source is cells.source or source == cells.source:
                continue
            cells.source = source
            cells.values = cells.block.cells(source)
            news = news or cells.is_news(self._dead_band)
        if not news:
            return None
        for cells in self._cells:
            if cells.values is not cells.written:
                self._write(cells)
        return self._line(sample, [cells.text for cells in self._cells], note)

    def end(self, t_ns: int, wall_ns: int, note: str) -> bytes:
        """A last row without values."""
        if self._csv:
            texts = ["," * (len(block.columns) - 1) for block in self.layout.blocks]
        else:
            texts = [f"{json_text(column.name)}:null" for block in self.layout.blocks for column in block.columns]
        return self._line(Sample(self.layout, t_ns, wall_ns, ()), texts, note)

    def _write(self, cells: _Cells) -> None:
        cells.written = cells.values
        if self._csv:
            cells.text = ",".join(map(csv_cell, cells.values))
        else:
            pairs = zip(cells.block.columns, cells.values, strict=True)
            cells.text = ",".join(f"{json_text(column.name)}:{_json_cell(value)}" for column, value in pairs)

    def _line(self, sample: Sample, texts: list[str], note: str) -> bytes:
        time = self._time(sample.wall_ns)
        t = f"{ns_to_s(sample.t_ns):.6f}"
        if self._csv:
            if not self._described:
                self._described = True
                description = self.layout.description(note)
                note = note if len(description) > LONGEST_CELL else description
            line = ",".join((time, t, *texts, csv_text(note)))
        else:
            line = ",".join((f'{{"{TIME}":"{time}"', f'"{T}":{t}', *texts, f'"{NOTE}":{json_text(note)}')) + "}"
        return f"{line}\n".encode()

    def _time(self, wall_ns: int) -> str:
        second, rest = divmod(wall_ns, NS_PER_S)
        if second != self._second:
            self._second = second
            self._second_text = f"{datetime.fromtimestamp(second, UTC):%Y-%m-%dT%H:%M:%S}"
        return f"{self._second_text}.{rest // NS_PER_MS:03}Z"


def csv_text(text: str) -> str:
    """A text as a cell of CSV (RFC 4180), on one line."""
    text = printable(text)
    return f'"{text.replace(chr(34), chr(34) * 2)}"' if _QUOTED & set(text) or text.strip() != text else text


def octets_cell(octets: bytes) -> str:
    """Octets as ``x`` and two digits for each. Bare, many programs read 1e05 as the number 100000.0; behind ``0x`` some
    read a number, too."""
    return f"{OCTETS}{octets.hex()}"


def csv_cell(value: Cell) -> str:
    """A value as a cell: numbers, true and false, octets as :func:`octets_cell`; empty if it is not valid."""
    kind = type(value)
    if kind is float:
        return repr(value) if math.isfinite(value) else ""  # type: ignore[arg-type]
    if kind is bool:
        return "true" if value else "false"
    if value is None:
        return ""
    if isinstance(value, bytes):
        return octets_cell(value)
    return csv_text(value) if isinstance(value, str) else str(value)


def _json_cell(value: Cell) -> str:
    if isinstance(value, bytes):
        return f'"{octets_cell(value)}"'
    if isinstance(value, float) and not math.isfinite(value):
        return "null"
    return json_text(value)
