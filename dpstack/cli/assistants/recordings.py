"""The tool ``recording``: the values of a recording of ``run --record``, by names and time."""

from __future__ import annotations

from pathlib import Path
from time import monotonic
from typing import Annotated, Final

from msgspec import Meta, Struct

from dpstack.cli.assistants import answers
from dpstack.cli.assistants.bus_tools import value_of
from dpstack.cli.assistants.file_tools import LONGEST_S, RECORDINGS, check_size
from dpstack.cli.assistants.folders import Folders
from dpstack.cli.assistants.foreign import quote, quote_all, quote_or_none
from dpstack.errors import UsageError
from dpstack.record.columns import Cell, Column
from dpstack.record.reader import Recording, Row, seconds_of
from dpstack.text import did_you_mean, iso_time

_COLUMNS: Final = 40
_Time = Annotated[str, Meta(max_length=40, description="UTC, for instance 2026-01-31T12:00:00Z")]


class ReadRecording(Struct, kw_only=True, forbid_unknown_fields=True):
    file: Annotated[str, Meta(max_length=1000, description="a recording of the list that `files` gives")]
    names: Annotated[
        list[Annotated[str, Meta(max_length=200)]],
        Meta(max_length=_COLUMNS, description="slaves, or columns like boiler.level; empty: the first 40 columns"),
    ] = []
    begin: _Time | None = None
    end: _Time | None = None
    limit: Annotated[int, Meta(ge=1, le=answers.MOST, description="rows at most; more are thinned out")] = 50


class _Figures:
    """Figures of one column over the period."""

    def __init__(self) -> None:
        self.values = 0
        self.total = 0.0
        self.low: float | None = None
        self.high: float | None = None
        self.last: Cell = None

    def add(self, value: Cell) -> None:
        if value is None:
            return
        self.values += 1
        self.last = value
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            number = float(value)
            self.total += number
            self.low = number if self.low is None else min(self.low, number)
            self.high = number if self.high is None else max(self.high, number)

    def answer(self, column: Column) -> answers.RecordedColumn:
        return answers.RecordedColumn(
            name=quote(column.name),
            unit=quote_or_none(column.unit),
            values=self.values,
            min=self.low,
            max=self.high,
            mean=None if self.low is None else self.total / self.values,
            last=value_of(self.last),
        )


def read_recording(folders: Folders, given: ReadRecording) -> answers.RecordingAnswer:
    """Read the rows of the period. Raises UsageError for a file that is no recording, an unknown name or time."""
    path = _path(folders, given.file)
    begin, end = _seconds(given.begin, "begin"), _seconds(given.end, "end")
    recording = Recording(path)
    for part in recording.parts:
        if not folders.contains(part.resolve()):
            raise UsageError(f"{given.file}: a part of it is a link out of the folders of this server: {folders}")
    columns = _columns(recording, given.names)
    shown = columns[:_COLUMNS]
    figures = {column.name: _Figures() for column in shown}
    rows: list[Row] = []
    read = inside = 0
    step = 1
    first = last = None
    remarks: list[str] = []
    until = monotonic() + LONGEST_S
    for row in recording.rows():
        read += 1
        if monotonic() > until:
            remarks.append(f"read up to here: the recording takes longer than {LONGEST_S:g} s; name a shorter one")
            break
        if (begin is not None and row.time < begin) or (end is not None and row.time > end):
            continue
        first = row.time if first is None else first
        last = row.time
        for name, figure in figures.items():
            figure.add(row.values.get(name))
        if inside % step == 0:
            rows.append(row)
        inside += 1
        if len(rows) > given.limit:
            rows, step = rows[::2], 2 * step
    return answers.RecordingAnswer(
        file=quote(given.file),
        begin=_time(first),
        end=_time(last),
        rows_read=read,
        rows_in_period=inside,
        step=step,
        columns=[figures[column.name].answer(column) for column in shown],
        columns_left_out=len(columns) - len(shown),
        rows=[
            answers.RecordedRow(
                time=iso_time(row.time),
                values=[value_of(row.values.get(column.name)) for column in shown],
                note=quote_or_none(row.note),
                gap=row.gap,
            )
            for row in rows
        ],
        remarks=quote_all([*remarks, *recording.remarks]),
    )


def _path(folders: Folders, name: str) -> Path:
    """The file, or the name that was given to a rotated recording."""
    try:
        path = folders.file(name, RECORDINGS)
    except UsageError:
        base = folders.place(name, RECORDINGS)
        if base is None:
            raise
        return base
    check_size(path, name)
    return path


def _columns(recording: Recording, names: list[str]) -> list[Column]:
    every = list(recording.columns.values())
    if not names:
        return every
    slaves = {column.slave for column in every if column.slave}
    for name in names:
        if name not in slaves and name not in recording.columns:
            known = [*sorted(slaves), *recording.columns]
            raise UsageError(
                f"no slave or column {name!r}; " + did_you_mean(name, known, "leave `names` out to see them")
            )
    return [column for column in every if column.slave in names or column.name in names]


def _seconds(text: str | None, key: str) -> float | None:
    if text is None:
        return None
    found = seconds_of(text)
    if found is None:
        raise UsageError(f"{key}: {text!r} is no time; write it as 2026-01-31T12:00:00Z")
    return found


def _time(seconds: float | None) -> str | None:
    return None if seconds is None else iso_time(seconds)
