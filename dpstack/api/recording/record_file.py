"""The files of a recording, with rotation by size or time. All of it runs in the writer thread."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from dpstack.api.files import NEW_FILE, open_alone, open_new
from dpstack.api.recording.line_file import LineFile, trouble_text
from dpstack.api.recording.parquet import convert
from dpstack.api.recording.rotation import Rotation
from dpstack.errors import UsageError
from dpstack.record.columns import Layout
from dpstack.record.reader import CSV, JOURNAL, PARQUET, SUFFIXES, part_path, part_pattern
from dpstack.record.rows import END, Rows, Sample

#: octets that are written at once at most
_BLOCK: Final = 1 << 16
#: seconds from one attempt to the next if a file cannot be written
_RETRY_S: Final = 1.0
NO_ROTATION: Final = Rotation()


class RecordFile:
    """Writes samples as rows; ``path`` ends in .csv, .jsonl or .parquet.

    With ``rotation``, and if the columns change, parts are written: ``plant_00001_20260131T120000Z.csv``. A Parquet
    file is a CSV file until it is complete; then a process of its own converts it. ``tell`` gets one line about each
    trouble, in the writer thread.

    Making it makes the first file. It raises UsageError for a file that is there already, unless it is empty, for one
    that cannot be made, for another suffix, and for Parquet without pyarrow.
    """

    def __init__(self, path: str | Path, rotation: Rotation, dead_band: float, tell: Callable[[str], None]) -> None:
        self.path = Path(path)
        #: complete files and the present one, the latest last
        self.paths: list[Path] = []
        self._rows_before = 0  # in complete files
        #: a complete file becomes Parquet, which takes its time
        self.converting = False
        #: rows that found no room on the disk
        self.rows_lost = 0
        self._rotation = rotation
        self._dead_band = dead_band
        self._tell = tell
        self._suffix = self.path.suffix.lower()
        if self._suffix not in SUFFIXES:
            raise UsageError(f"{path}: the suffix says the kind of recording; end the name in {', '.join(SUFFIXES)}")
        if self._suffix == PARQUET and importlib.util.find_spec("pyarrow") is None:
            raise UsageError(f"{path}: Parquet needs pyarrow; install it: pip install 'dpstack[parquet]', or take .csv")
        self._in_parts = rotation != NO_ROTATION
        self._file: LineFile | None = None
        self._rows: Rows | None = None
        self._buffer: list[bytes] = []
        self._buffered = 0
        self._began_s = 0.0  # of the present file, monotonic
        self._last: Sample | None = None
        self._notes: list[str] = []
        self._failed_since = ""  # wall clock
        self._failed_rows = 0
        self._retry_s = 0.0
        self._number = self._last_number()
        if self._in_parts:
            self._check_folder()
        else:
            if self._suffix == PARQUET:
                os.close(open_new(self.path))  # refuses a file that is there
                self.path.unlink(missing_ok=True)
            self._open(self.path)

    @property
    def rows_written(self) -> int:
        return self._rows_before + (0 if self._file is None else max(0, self._file.lines - 1))

    # --- in the thread ---
    def take(self, sample: Sample) -> None:
        if self._failed_since:
            self._failed_rows += 1 + sample.lost
            self._last = sample
            return
        rows = self._rows
        if rows is None or self._is_over(sample, rows):
            rows = self._next_part(sample)
            if rows is None:
                return
        if sample.lost:
            self._notes.append(f"{sample.lost} rounds lost, because this computer or its disk was too slow")
        note = "; ".join(self._notes)
        line = rows.row(sample, note)
        self._last = sample
        if line is not None:
            self._notes.clear()
            self._buffer.append(line)
            self._buffered += len(line)
            if self._buffered >= _BLOCK:
                self.flush()

    def flush(self) -> None:
        if self._failed_since:
            if time.monotonic() >= self._retry_s:
                self._retry()
            return
        if self._file is not None and self._buffer:
            lines, before = len(self._buffer), self._file.lines
            octets = b"".join(self._buffer)
            self._buffer.clear()
            self._buffered = 0
            try:
                self._file.write(octets)
            except OSError as error:
                rows = lines - (self._file.lines - before) - (not self._file.lines)
                self._fail(self._file.path, error, rows)

    def close(self, lost: int) -> None:
        """Write the end, and close the last file."""
        self.flush()
        if self._failed_since:
            self._retry()
        if self._failed_since:
            self.rows_lost += self._failed_rows
        if self._file is not None and self._rows is not None and self._last is not None:
            notes = [*self._notes, f"{END}: {self.rows_written} rows"]
            if lost:
                notes.append(f"{lost} rounds lost, because this computer or its disk was too slow")
            if self.rows_lost:
                notes.append(f"{self.rows_lost} rows lost, because the disk was full")
            wall_ns = time.time_ns()
            t_ns = self._last.t_ns + max(0, wall_ns - self._last.wall_ns)
            try:
                self._file.write(self._rows.end(t_ns, wall_ns, "; ".join(notes)))
            except OSError as error:
                self._tell(trouble_text(self._file.path, error))
        self._complete()

    # --- parts ---
    def _is_over(self, sample: Sample, rows: Rows) -> bool:
        """Whether ``sample`` belongs into a new part."""
        if sample.layout is not rows.layout:
            return True
        octets, seconds = self._rotation.octets, self._rotation.seconds
        if octets is not None and self._file is not None and self._file.size + self._buffered >= octets:
            return True
        return seconds is not None and time.monotonic() - self._began_s >= seconds

    def _next_part(self, sample: Sample) -> Rows | None:
        """Begin the file in which ``sample`` is the first row; None if that fails."""
        if self._rows is not None or self._file is None:
            self.flush()
            if self._failed_since:
                return None
            self._complete()
            self._number += 1
            part = part_path(self.path, self._number, sample.wall_ns)
            try:
                self._open(part, exclusive=True)
            except OSError as error:
                self._number -= 1
                self._fail(part, error, 1)
                return None
        return self._begin(sample.layout)

    def _begin(self, layout: Layout) -> Rows:
        form = CSV if self._suffix == PARQUET else self._suffix
        self._rows = Rows(layout, form.removeprefix("."), self._dead_band)
        self._buffer.insert(0, self._rows.head())
        self._buffered += len(self._buffer[0])
        self._began_s = time.monotonic()
        return self._rows

    def _open(self, path: Path, *, exclusive: bool = False) -> None:
        """Raises UsageError for the first file of a user's own name, OSError for a part (``exclusive``)."""
        written = path.with_name(path.name + JOURNAL) if self._suffix == PARQUET else path
        fd = open_alone(written, NEW_FILE | os.O_EXCL) if exclusive else open_new(written)
        self._file = LineFile(written, fd)
        self.paths.append(path)

    def _complete(self) -> None:
        """Close the present file; a Parquet file is made of it."""
        file, self._file, self._rows = self._file, None, None
        if file is None:
            return
        self._rows_before += max(0, file.lines - 1)
        file.close()
        target = self.paths[-1]
        if not file.size:
            self.paths.pop()
        elif self._suffix == PARQUET:
            self.converting = True
            why = convert(file.path, target)
            self.converting = False
            if why is not None:
                self._tell(f"{target}: {why}; the rows are in {file.path.name}")
                self.paths[-1] = file.path

    # --- a full disk ---
    def _fail(self, path: Path, error: OSError, rows: int) -> None:
        self._failed_rows += rows
        self._retry_s = time.monotonic() + _RETRY_S
        if not self._failed_since:
            self._failed_since = f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S}"
            self._tell(
                f"{trouble_text(path, error)}: rows are lost; the recording goes on when it can be written again"
            )

    def _retry(self) -> None:
        """Go on with the last sample, if the disk takes it."""
        self._retry_s = time.monotonic() + _RETRY_S
        if self._last is None:
            return
        sample = self._last._replace(lost=0)
        since, lost = self._failed_since, self._failed_rows
        self._failed_since = ""
        self._failed_rows = 0
        if self._file is not None and self._rows is not None:
            if self._file.lines and sample.layout is self._rows.layout:
                self._rows = Rows(sample.layout, self._rows.form, self._dead_band, described=self._file.lines > 1)
            elif not self._file.lines:
                self._begin(sample.layout)
        note = f"{lost - 1} rows lost since {since}, because the file could not be written"
        self._notes.append(note)
        told, self._tell = self._tell, lambda text: None
        try:
            self.take(sample)
            self.flush()
        finally:
            self._tell = told
        if self._failed_since:
            self._failed_since, self._failed_rows = since, lost
            self._notes = [other for other in self._notes if other != note]
        else:
            self.rows_lost += lost - 1  # the last one is written now
            self._tell(f"{self.path}: can be written again; {lost - 1} rows are lost")

    # --- the folder ---
    def _last_number(self) -> int:
        """The number of the last part that is there."""
        pattern = part_pattern(self.path)
        try:
            names = os.listdir(self.path.parent)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise UsageError(f"{self.path}: cannot be written ({why}); name a file in a directory of yours") from None
        return max((int(match[1]) for name in names if (match := pattern.fullmatch(name))), default=0)

    def _check_folder(self) -> None:
        if self.path.exists():
            raise UsageError(f"{self.path}: there is a file of that name; give the name of a new file")
        if not os.access(self.path.parent, os.W_OK | os.X_OK):
            raise UsageError(f"{self.path}: cannot be written; name a file in a directory of yours")
