"""The telegrams of a capture as Parquet files: a row a telegram, a file for each hour, in folders named after segment,
day and hour.

docs/reference/telegram-table.md describes the files. A file gets its name when it is whole; before, it is a hidden one
that no pattern for Parquet files finds.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import secrets
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from operator import itemgetter
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from dpstack.decode.columns import CAPTURE, COLUMNS, FIXED, OF_STEP, VERSION, Cells, fixed_cells
from dpstack.decode.course import Step
from dpstack.decode.telegram import Explained
from dpstack.errors import DpError, UsageError
from dpstack.record.reader import PARQUET, pyarrow_with_parquet
from dpstack.text import json_text, shortened
from dpstack.units import NS_PER_S

#: rows that wait in memory, and rows of a row group: as many as DuckDB gives one of its threads
ROWS: Final = 122_880
#: key of the schema's metadata
METADATA: Final = "dpstack.telegrams"
#: types of columns that count up from row to row: the differences need a third of the space
_COUNTING: Final = ("timestamp", "int64")
#: octets of the longest telegram
_LONGEST: Final = 255
_HOUR_NS: Final = 3600 * NS_PER_S
#: the last time that a timestamp in ns can have, in the year 2262
_MOST_NS: Final = 2**63 - 1
#: the longest T_SDR that is kept, a hundred days; up to there a float of us has all ns
_MOST_US: Final = 9e12
#: octets of a name in a path
_MOST_NAME: Final = 200
#: times before (1990) are those of a clock that nobody has set, or count from the begin of a capture
_CLOCK_NS: Final = 20 * 365 * 24 * _HOUR_NS
#: stands for the name of standard input
_STDIN: Final = Path("standard-input")
#: what readers of partitioned folders take for "no value"
_NO_VALUE: Final = "__HIVE_DEFAULT_PARTITION__"
#: number and time in the name of a file of a ring
_PART: Final = re.compile(r"_\d{5,9}_\d{8}T\d{6}Z$")


def segment_of(source: Path) -> str:
    """The name of a segment after its configuration or capture; all files of a ring have one."""
    return _PART.sub("", source.stem)


def segment_folder(name: str) -> str:
    """The folder of the segment ``name``, which readers of partitioned folders take apart. Raises UsageError."""
    part = quote(_unicode(name), safe="")
    if not name or name == _NO_VALUE or len(part) > _MOST_NAME:
        raise UsageError(f"{shortened(name)!r} is no name of a segment; give a short one, for instance --segment press")
    return f"segment={part}"


def _unicode(text: str) -> str:
    """``text`` without lone surrogates, which stand for octets of a file name that are no UTF-8."""
    return text.encode(errors="surrogateescape").decode(errors="replace")


class TelegramTable:
    """Writes the telegrams of the capture ``source`` below ``folder``. ``on_file`` gets path and rows of each file when
    it has its name.

    The names follow from the capture: its own name, and a check sum that tells it from others of this name. The same
    capture written again replaces its files, also after it has grown. The check sum is of the first transmission with
    its time. A transmission without the time of a clock may begin any capture: the check sum is then also of the
    capture's folder, and for standard input (``source`` None) of as many transmissions as are written together.

    ``on_name`` gets the common begin of the files' names before the first one exists; what it raises ends the capture.

    :meth:`add` and :meth:`close` raise DpError if a file cannot be written. Leaving the context removes what is not
    whole.
    """

    def __init__(
        self,
        folder: Path,
        segment: str,
        source: Path | None,
        on_file: Callable[[Path, int], None],
        on_name: Callable[[str], None] = lambda name: None,
    ) -> None:
        self._arrow = arrow = pyarrow_with_parquet()
        self._folder = folder / segment_folder(segment)
        self._on_file = on_file
        self._on_name = on_name
        self._source = source
        name = _STDIN if source is None else source
        self._capture = _unicode(name.name)
        about = {"version": VERSION, "segment": _unicode(segment), "capture": self._capture}
        types = {
            "timestamp": arrow.timestamp("ns"),  # without a zone, in which DuckDB before 2.0 loses the ns
            "string": arrow.dictionary(arrow.int32(), arrow.string()),
            "bool": arrow.bool_(),
        }
        self._types = {one.name: types.get(one.type) or getattr(arrow, one.type)() for one in COLUMNS}
        self._schema = arrow.schema(self._types.items(), metadata={METADATA: json_text(about, encoding="ascii")})
        self._stem = quote(_unicode(name.stem), safe="")[: _MOST_NAME // 2]
        self._digest: Any = None  # the check sum
        self._name = ""  # of the files, without part and suffix
        self._begun: dict[int, int] = {}  # files by hour
        self._file: _HourFile | None = None
        #: name of the port of the next telegrams
        self.port = ""
        self._summed = False  # the check sum is also of the rows that wait
        # the rows that wait
        self._first = 0  # number of the first one
        self._times: list[int | None] = []
        self._steps: list[Step] = []
        self._which: list[int] = []  # index in _cells
        self._cells: list[Cells] = []
        self._known: dict[object, int] = {}

    def __enter__(self) -> TelegramTable:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.abandon()

    def add(self, one: Explained) -> None:
        """Add the next telegram of the capture: its number follows that of the one before."""
        sent, step = one.transmission, one.step
        request = step.request
        key = sent.octets, one.service, one.error, request and request.da, sent.damage, sent.baud, self.port
        which = self._known.get(key)
        if which is None:
            which = len(self._cells)
            self._cells.append(fixed_cells(one, self.port))
            if len(sent.octets) <= _LONGEST:  # a file may have any number of long ones
                self._known[key] = which
            if not which:
                self._begin(one)
        if self._summed:
            self._digest.update(sent.octets)
        self._times.append(sent.t_ns)
        self._which.append(which)
        self._steps.append(step)
        if len(self._times) == ROWS:
            self._flush()

    def close(self) -> None:
        """Write the rows that wait, and complete the last file."""
        self._flush()
        self._finish()

    def _begin(self, one: Explained) -> None:
        """Begin the rows that will be written together with the first one of them."""
        sent = one.transmission
        if self._digest is None:
            first = f"{self._capture}\n{self.port}\n{sent.t_ns}\n".encode(errors="replace") + sent.octets
            self._digest = hashlib.sha256(first)
            if sent.t_ns is None or sent.t_ns < _CLOCK_NS:
                if self._source is None:
                    self._summed = True
                else:
                    self._digest.update(os.fsencode(os.path.realpath(self._source.parent)))
        self._first = one.number

    def _flush(self) -> None:
        if not self._times:
            return
        if not self._begun:
            self._summed = False
            self._name = f"{self._stem}-{self._digest.hexdigest()[:12]}"
            self._on_name(self._name)
        for hour, rows in self._by_hour(self._batch()):
            if self._file is not None and self._file.hour != hour:
                self._finish()
            if self._file is None:
                self._file = _HourFile(self._arrow, hour, self._path(hour), self._schema)
            self._file.write(rows)
        for waiting in (self._times, self._steps, self._which, self._cells, self._known):
            waiting.clear()

    def _finish(self) -> None:
        if self._file is not None:
            self._file.finish()
            self._on_file(self._file.path, self._file.rows)
            self._file = None

    def _path(self, hour: int) -> Path:
        """The path of the next file of ``hour`` (since 1970), in a folder that exists. A capture whose clock was set
        back has several for one hour."""
        part = self._begun[hour] = self._begun.get(hour, 0) + 1
        begin = datetime.fromtimestamp(hour * 3600, UTC)
        # an hour without a zero before it: of 07 DuckDB makes a text, of 7 a number
        folder = self._folder / f"date={begin:%Y-%m-%d}" / f"hour={begin.hour}"
        path = folder / f"{self._name}{f'-{part}' if part > 1 else ''}{PARQUET}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            raise _write_error(path, error) from None
        return path

    # --- rows --------------------------------------------------------------------------------------------------------
    def _batch(self) -> Any:
        """The rows that wait, as a record batch."""
        arrow, count = self._arrow, len(self._times)
        which = arrow.array(self._which, arrow.int32())
        ones = arrow.repeat(arrow.scalar(1, arrow.int64()), count)  # a range of Python takes ten times as long
        arrays = {
            "time": self._timestamps(),
            "number": arrow.compute.cumulative_sum(ones, start=self._first - 1),
            CAPTURE.name: arrow.repeat(self._capture, count).dictionary_encode(),
        }
        for column, cells in zip(FIXED, zip(*self._cells, strict=True), strict=True):
            arrays[column.name] = self._array(column.name, cells).take(which)
        arrays["t_sdr_ns"] = self._nanoseconds(_of_steps("response_us", self._steps))
        for column in OF_STEP[1:]:
            arrays[column.name] = self._array(column.name, _of_steps(column.name, self._steps))
        return arrow.RecordBatch.from_arrays([arrays[one.name] for one in COLUMNS], schema=self._schema)

    def _array(self, name: str, cells: Sequence[object]) -> Any:
        return self._arrow.array(cells, self._types[name])

    def _timestamps(self) -> Any:
        """The times; null if a timestamp cannot have it, as a file may claim it."""
        try:
            found = self._arrow.array(self._times, self._arrow.int64())
        except OverflowError:
            fitting = [t if t is None or abs(t) <= _MOST_NS else None for t in self._times]
            found = self._arrow.array(fitting, self._arrow.int64())
        return found.cast(self._arrow.timestamp("ns"))

    def _nanoseconds(self, micros: Sequence[float | None]) -> Any:
        """T_SDR in whole ns; far out of range, as a file may claim it, it is null."""
        compute = self._arrow.compute
        found = self._arrow.array(micros, self._arrow.float64())
        found = compute.if_else(compute.less(compute.abs(found), _MOST_US), found, None)
        return compute.round(compute.multiply(found, 1000.0)).cast(self._arrow.int64())

    def _by_hour(self, batch: Any) -> Iterator[tuple[int, Any]]:
        """The rows of each hour since 1970. Rows without a time stand in the first one."""
        times = batch.column("time").cast(self._arrow.int64()).fill_null(0)
        span = self._arrow.compute.min_max(times).as_py()
        first = span["min"] // _HOUR_NS
        if first == span["max"] // _HOUR_NS:
            yield first, batch
            return
        found: dict[int, list[int]] = {}
        for index, t_ns in enumerate(times.to_pylist()):
            found.setdefault(t_ns // _HOUR_NS, []).append(index)
        for hour, indices in found.items():
            yield hour, batch.take(self._arrow.array(indices, self._arrow.int32()))


def _of_steps(name: str, steps: Sequence[Step]) -> list[Any]:
    return list(map(itemgetter(Step._fields.index(name)), steps))


class _HourFile:
    """A Parquet file of one hour, hidden until :meth:`finish`."""

    def __init__(self, arrow: Any, hour: int, path: Path, schema: Any) -> None:
        self.hour = hour
        self.path = path
        self.rows = 0
        self._hidden = path.with_name(f".{secrets.token_hex(8)}.tmp")
        try:
            self._file = self._hidden.open("xb")
        except OSError as error:
            raise _write_error(path, error) from None
        self._writer = arrow.parquet.ParquetWriter(
            self._file,
            schema,
            compression="zstd",
            use_dictionary=[one.name for one in COLUMNS if one.type not in _COUNTING],
            column_encoding={one.name: "DELTA_BINARY_PACKED" for one in COLUMNS if one.type in _COUNTING},
            store_schema=False,  # plain strings for its readers: Dask cannot join dictionaries that have no value
        )
        self._writer.add_key_value_metadata(schema.metadata)

    def write(self, rows: Any) -> None:
        """Add a row group. Raises DpError."""
        try:
            self._writer.write_batch(rows)
        except OSError as error:
            raise _write_error(self.path, error) from None
        self.rows += rows.num_rows

    def finish(self) -> None:
        """Complete the file, and give it its name once it is on the disk. Raises DpError."""
        try:
            self._writer.close()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self._hidden, self.path)
        except OSError as error:
            raise _write_error(self.path, error) from None
        with contextlib.suppress(OSError):  # not every system can
            folder = os.open(self.path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def abandon(self) -> None:
        """Remove the file if it has no name yet."""
        with contextlib.suppress(OSError):
            self._hidden.unlink()
        if self._file.closed:
            return
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self._file.fileno())  # the writer writes its end
        os.close(null)
        with contextlib.suppress(OSError):
            self._writer.close()
            self._file.close()


def _write_error(path: Path, error: OSError | ValueError) -> DpError:
    number = getattr(error, "errno", None)
    full = number in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there" if full else "name a folder of yours with --parquet"
    return DpError(
        f"{path}: cannot be written ({getattr(error, 'strerror', None) or error}); {todo} and give the same command "
        "again: all files with a name are whole, and it replaces them"
    )
