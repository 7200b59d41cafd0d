"""Recordings read from CSV, JSON lines or Parquet, also rotated sets of files.

A line that cannot be read is left out; :attr:`Recording.remarks` says how many there were, and if the first one is.
"""

from __future__ import annotations

import csv
import io
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import MAXYEAR, UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, TypeGuard

from dpstack.errors import UsageError
from dpstack.record.columns import BYTES, NOTE, OCTETS, TIME, Cell, Column, T, unique
from dpstack.text import printable, shortened
from dpstack.units import NS_PER_S

#: suffixes of recordings
CSV: Final = ".csv"
JSONL: Final = ".jsonl"
PARQUET: Final = ".parquet"
SUFFIXES: Final = (CSV, JSONL, PARQUET)
#: a Parquet recording is this CSV file until it is complete
JOURNAL: Final = ".part.csv"
#: octets of the longest line: 125 slaves with names of 200 characters
_LONGEST: Final = 1 << 22
#: characters of a line or a title that a message shows
_SHOWN: Final = 40
#: after this many seconds without a row of the same file nothing is known about the time between (not on change)
GAP_S: Final = 2.5
#: largest number: a larger integer of a damaged file can neither be drawn nor compared with a time
_LARGEST: Final = sys.float_info.max
#: longest time since the start of a program, in s: 3000 years
_LONGEST_S: Final = 1e11
_ROWS_AT_ONCE: Final = 10_000


class Row(NamedTuple):
    """One row. ``time``: s since 1970; ``t``: s since the start of the program that wrote it.

    ``at``: s since the first row of the recording: it never runs back, also if the clock of the computer did.
    ``values`` by the name of the column, None if not valid. ``gap``: nothing is known about the time before.
    """

    time: float
    t: float
    at: float
    values: Mapping[str, Cell]
    note: str = ""
    gap: bool = False


class _Head(NamedTuple):
    """The beginning of one file: its columns in the order of their cells, and its description if it has one."""

    columns: tuple[Column, ...]
    about: Mapping[str, object]


class Recording:
    """A recording, one file or a rotated set. Entering a loop over :meth:`rows` reads it anew.

    ``path``: a file; if none exists of that name, the parts that ``--rotate`` made of it
    (``plant_00001_20260131T120000Z.csv``). Raises UsageError for anything that is no recording.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.parts = parts_of(self.path)
        self.remarks: list[str] = []
        self._heads = [_read_head(part) for part in self.parts]
        #: all columns by name
        self.columns: Mapping[str, Column] = unique([column for head in self._heads for column in head.columns])
        #: the description in the first file; empty if it has none
        self.about = about = self._heads[0].about
        config = about.get("config")
        self.config = config if isinstance(config, str) else None
        #: whether rows were written on change only, so that a value holds until the next row
        self.on_change = about.get("on_change") is True

    def rows(self) -> Iterator[Row]:
        """All rows in their order. Raises UsageError if a file can no longer be read."""
        self.remarks.clear()
        last: Row | None = None
        for part, head in zip(self.parts, self._heads, strict=True):
            first = True
            for time, t, cells, note in _rows_of(part, head, self.remarks):
                step = 0.0 if last is None else time - last.time if first or t < last.t else t - last.t
                at = 0.0 if last is None else last.at + max(0.0, step)
                apart = last is not None and ((first and step > GAP_S) or (not self.on_change and step > GAP_S))
                last = Row(time, t, at, cells, note, apart)
                first = False
                yield last


def parts_of(path: Path) -> tuple[Path, ...]:
    """The files of the recording ``path``, the oldest one first. Raises UsageError if none exists."""
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: a recording ends in {', '.join(SUFFIXES)}; give a file that run --record wrote")
    try:
        if path.is_file():
            return (path,)
        if path.is_dir():
            raise UsageError(f"{path}: is a directory; name a file")
        pattern = part_pattern(path)
        found = sorted(
            (int(match[1]), one)
            for one in path.parent.iterdir()
            if (match := pattern.fullmatch(one.name)) is not None and one.is_file()
        )
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot be read ({why}); name a recording") from None
    if found:
        return tuple(one for _, one in found)
    journal = path.with_name(path.name + JOURNAL)
    if journal.is_file():
        return (journal,)
    raise UsageError(f"{path}: there is no such file, and no part of it ({path.stem}_00001_TIME{path.suffix})")


def part_path(path: Path, number: int, wall_ns: int) -> Path:
    """The path of a part of ``path`` that begins at ``wall_ns`` (ns since 1970)."""
    when = datetime.fromtimestamp(wall_ns // NS_PER_S, UTC)
    return path.with_name(f"{path.stem}_{number:05}_{when:%Y%m%dT%H%M%SZ}{path.suffix}")


def part_pattern(path: Path) -> re.Pattern[str]:
    """The names that :func:`part_path` gives; group 1 is the number."""
    journal = f"(?:{re.escape(JOURNAL)})?" if path.suffix.lower() == PARQUET else ""
    return re.compile(rf"{re.escape(path.stem)}_(\d{{5,9}})_\d{{8}}T\d{{6}}Z{re.escape(path.suffix)}{journal}")


# --- the beginning of a file -----------------------------------------------------------------------------------------
def _read_head(path: Path) -> _Head:
    try:
        if path.suffix.lower() == PARQUET:
            return _parquet_head(path)
        with path.open("rb") as file:
            first, second = _whole_line(file), _whole_line(file)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror or error}); name a recording") from None
    if first is None:
        raise UsageError(f"{path}: is empty, or its first line is cut: no recording; give another file")
    if path.suffix.lower() == JSONL:
        about = _about_of(first)
        if about is None:
            raise _no_recording(path, first, "its first line describes no columns")
        return _Head(_columns_of(about, path), about)
    titles = _csv_cells(first) or []
    if titles[:2] != [TIME, T]:
        raise _no_recording(path, first, f"its first columns are not {TIME} and {T}")
    cells = _csv_cells(second) if second is not None else None
    has_note = titles[-1] == NOTE
    found = None if cells is None or len(cells) != len(titles) or not has_note else _about_of(cells[-1])
    columns = tuple(Column.of_title(title) for title in titles[2 : -1 if has_note else None])
    if found is not None:
        described = _columns_of(found, path)
        if tuple(column.title for column in described) == tuple(column.title for column in columns):
            return _Head(described, found)
    return _Head(columns, {})


def _no_recording(path: Path, line: str, why: str) -> UsageError:
    shown = shortened(printable(line.strip()), _SHOWN)
    return UsageError(f'{path}: is no recording ({why}: "{shown}"); give a file that run --record wrote')


def _about_of(text: str) -> Mapping[str, object] | None:
    try:
        found = json.loads(text, parse_constant=_refuse, parse_float=_finite)
    except (ValueError, RecursionError):
        return None
    about = found.get("recording") if isinstance(found, dict) else None
    return about if isinstance(about, dict) else None


def _refuse(number: str) -> float:
    """NaN and Infinity, which JSON does not have."""
    raise ValueError(f"{number} is no number")


def _finite(text: str) -> float:
    number = float(text)
    return number if abs(number) <= _LARGEST else _refuse(text)


def _columns_of(about: Mapping[str, object], path: Path) -> tuple[Column, ...]:
    try:
        return tuple(_described_columns(about))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        why = printable(str(error))
        text = f"{path}: the description of its columns cannot be read ({why}); give an unchanged recording"
        raise UsageError(text) from None


def _described_columns(about: Mapping[str, Any]) -> Iterator[Column]:
    """Raises ValueError, TypeError, KeyError, AttributeError for anything but a description of ours."""
    for slave in about["slaves"]:
        name, address = slave["name"], slave.get("address")
        if not isinstance(name, str) or not isinstance(address, (int, type(None))):
            raise ValueError(f"name = {name!r}, address = {address!r}")
        for column in slave["columns"]:
            yield Column.of_dict(name, address, column)


# --- rows ------------------------------------------------------------------------------------------------------------
_Cells = tuple[float, float, Mapping[str, Cell], str]


def _rows_of(path: Path, head: _Head, remarks: list[str]) -> Iterator[_Cells]:
    try:
        if path.suffix.lower() == PARQUET:
            yield from _parquet_rows(path, head)
            return
        with path.open("rb") as file:
            yield from _line_rows(file, path, head, remarks)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror or error}); name a recording") from None


def _line_rows(file: BinaryIO, path: Path, head: _Head, remarks: list[str]) -> Iterator[_Cells]:
    read = _json_row if path.suffix.lower() == JSONL else _csv_row
    wrong, first_wrong, number = 0, 0, 1
    file.readline(_LONGEST)
    while line := file.readline(_LONGEST):
        number += 1
        if not line.endswith(b"\n"):
            remarks.append(f"{path}: line {number}, the last one, is cut: left out")
            break
        found = read(line, head)
        if found is None:
            wrong += 1
            first_wrong = first_wrong or number
        else:
            yield found
    if wrong:
        lines = "line cannot be read and is" if wrong == 1 else "lines cannot be read and are"
        remarks.append(f"{path}: {wrong} {lines} left out, the first is line {first_wrong}")


def _csv_row(line: bytes, head: _Head) -> _Cells | None:
    cells = _csv_cells(line.decode("utf-8", "replace"))
    if cells is None or len(cells) not in (len(head.columns) + 2, len(head.columns) + 3):
        return None
    time, t = seconds_of(cells[0]), _number(cells[1])
    if time is None or not _is_time(t):
        return None
    note = _note_of(cells[-1]) if len(cells) == len(head.columns) + 3 else ""
    return time, t, {c.name: _cell(text, c) for c, text in zip(head.columns, cells[2:], strict=False)}, note


def _note_of(text: str) -> str:
    """The note in a cell, which may also describe the columns."""
    if not text.startswith("{") or _about_of(text) is None:
        return text
    told = json.loads(text).get(NOTE)
    return told if isinstance(told, str) else ""


def _json_row(line: bytes, head: _Head) -> _Cells | None:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    time, t, note = seconds_of(found.get(TIME)), found.get(T), found.get(NOTE, "")
    if time is None or not _is_time(t):
        return None
    values = {column.name: _plain(found.get(column.name), column) for column in head.columns}
    return time, float(t), values, note if isinstance(note, str) else ""


def _is_time(t: object) -> TypeGuard[int | float]:
    """Whether ``t`` is a time since the start of a program, in s."""
    return isinstance(t, (int, float)) and not isinstance(t, bool) and abs(t) <= _LONGEST_S


def _known(value: Any) -> Any:
    """``value``; None for a number beyond the range of a float."""
    return None if isinstance(value, (int, float)) and not -_LARGEST <= value <= _LARGEST else value


def _plain(value: object, column: Column) -> Cell:
    """A value of JSON; None for lists, objects, and numbers beyond the range of a float."""
    return _read(value, column) if isinstance(value, (bool, int, float, str)) else None


def _read(value: Any, column: Column) -> Cell:
    """A value of JSON or Parquet."""
    if column.type == BYTES and isinstance(value, str):
        return value.removeprefix(OCTETS)  # version 1 had none
    found: Cell = _known(value)
    return found


def _cell(text: str, column: Column) -> Cell:
    if not text:
        return None
    if column.type == "number":
        return _number(text)
    if column.type == "bool":
        return {"true": True, "false": False}.get(text)
    if column.type:
        return text.removeprefix(OCTETS) if column.type == BYTES else text
    plain = {"true": True, "false": False}.get(text.lower())
    number = _number(text) if plain is None else plain
    return text if number is None else number


def _number(text: str) -> int | float | None:
    """None for anything but a number within the range of a float."""
    number: int | float
    try:
        number = int(text)
    except ValueError:
        try:
            number = float(text)
        except ValueError:
            return None
    return number if -_LARGEST <= number <= _LARGEST else None


def seconds_of(text: object) -> float | None:
    """The time of an ISO text in s since 1970, of the years 1 to 9998 UTC; None for anything else."""
    if not isinstance(text, str):
        return None
    try:
        when = datetime.fromisoformat(text)
        when = (when if when.tzinfo is not None else when.replace(tzinfo=UTC)).astimezone(UTC)
        return when.timestamp() if when.year < MAXYEAR else None  # rounded it would be beyond the last year
    except (ValueError, OverflowError):
        return None


def _whole_line(file: BinaryIO) -> str | None:
    line = file.readline(_LONGEST)
    return line.decode("utf-8", "replace").removeprefix("\ufeff") if line.endswith(b"\n") else None


def _csv_cells(line: str) -> list[str] | None:
    """The cells of one line; None if the line has no cells."""
    if '"' not in line and "\r" not in line and "\0" not in line:
        return line.removesuffix("\n").split(",")
    try:
        rows = list(csv.reader(io.StringIO(line, newline=""), strict=True))
    except csv.Error:
        return None
    return rows[0] if len(rows) == 1 else None


# --- Parquet ---------------------------------------------------------------------------------------------------------
def pyarrow_with_parquet() -> Any:
    """The package pyarrow, with its modules parquet and csv. Raises UsageError if it is not installed."""
    try:
        import pyarrow
        import pyarrow.csv
        import pyarrow.parquet
    except ImportError:
        raise UsageError("Parquet needs pyarrow; install it: pip install 'dpstack[parquet]'") from None
    return pyarrow


def _parquet_file(path: Path) -> Any:
    parquet = pyarrow_with_parquet().parquet
    try:
        return parquet.ParquetFile(str(path))
    except (ValueError, OSError) as error:  # pyarrow's errors are both
        if isinstance(error, FileNotFoundError):
            raise
        raise UsageError(
            f"{path}: is no Parquet file, or one that is cut; give a file that run --record wrote"
        ) from None


def _parquet_head(path: Path) -> _Head:
    with _parquet_file(path) as file:
        schema = file.schema_arrow
        about = _about_of((schema.metadata or {}).get(b"recording", b"").decode("utf-8", "replace"))
        names = list(schema.names)
    if names[:2] != [TIME, T]:
        raise _no_recording(path, ", ".join(names), f"its first columns are not {TIME} and {T}")
    if about:
        return _Head(_columns_of(about, path), about)
    return _Head(tuple(Column.of_title(name) for name in names[2:] if name != NOTE), {})


def _parquet_rows(path: Path, head: _Head) -> Iterator[_Cells]:
    with _parquet_file(path) as file:
        for batch in file.iter_batches(batch_size=_ROWS_AT_ONCE):
            columns: Sequence[Sequence[Any]] = [column.to_pylist() for column in batch.columns]
            names = batch.schema.names
            notes = columns[names.index(NOTE)] if NOTE in names else None
            for number, (time, t) in enumerate(zip(columns[0], columns[1], strict=True)):
                seconds = time.timestamp() if isinstance(time, datetime) else seconds_of(time)
                if seconds is None or not _is_time(t):
                    continue
                cells = {c.name: _read(columns[place + 2][number], c) for place, c in enumerate(head.columns)}
                note = notes[number] if notes else None
                yield seconds, float(t), cells, _note_of(note) if isinstance(note, str) else ""
