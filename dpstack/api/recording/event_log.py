"""The log of events: one line each, with wall clock; a few files, the oldest one removed.

``bus.log``, ``bus.log.1`` (the one before) ... ``bus.log.5``; a new one begins after 10 MB.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from dpstack.api.files import open_alone, write_error
from dpstack.api.recording.line_file import LineFile, trouble_text
from dpstack.api.recording.writer_thread import WriterThread
from dpstack.text import iso_time, json_text, printable

MOST_OCTETS: Final = 10_000_000
#: older files that are kept
KEPT: Final = 5
#: lines that wait for the disk at most
_MOST_WAITING: Final = 10_000
#: only the owner writes, others of the group may read
_MODE: Final = 0o640
_FLAGS: Final = os.O_RDWR | os.O_CREAT | os.O_APPEND
#: the beginning of a log, as :meth:`_LogFiles._encoded` writes it
_TIME: Final = rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z"
_TEXT: Final = re.compile(_TIME + rb"[ \d.-]{13,} (?:info   |warning|error  ) ")
_JSON: Final = re.compile(rb'\{"time": ?"' + _TIME + rb'", ?"event": ?"')
_BEGIN_LEN: Final = 100
_RETRY_S: Final = 1.0
#: seconds to wait at the end for a disk that does not answer
_PATIENCE_S: Final = 2.0

Line = Mapping[str, object]


class EventLog:
    """Appends events to the file ``path``; JSON lines if it ends in .jsonl or .json, else lines of text.

    Opening raises UsageError for a file that is no log of this kind (an empty one is), that is being written already,
    or that cannot be made; for a link, a directory, a device, a pipe. ``tell`` gets one line
    about each trouble, in the writer thread. :meth:`put` never waits; :meth:`close` writes the rest.
    """

    def __init__(
        self, path: str | Path, tell: Callable[[str], None] = lambda text: None, *, most_octets: int = MOST_OCTETS
    ) -> None:
        self._sink = _LogFiles(Path(path), tell, most_octets)
        self._thread: WriterThread[Line] = WriterThread("event log", self._sink, _MOST_WAITING)

    def put(self, line: Line) -> None:
        """Write the event ``line`` (as in ``run --json``, with ``severity`` and ``text``) with the present time."""
        self._thread.put({"time": iso_time(time.time()), **line})

    def close(self) -> bool:
        """Write the rest. False if the disk did not answer, or lines are lost for another reason."""
        self._thread.finish()
        return self._thread.ended(_PATIENCE_S) and not self._thread.lost and not self._sink.lost


class _LogFiles:
    """The files, in the writer thread."""

    def __init__(self, path: Path, tell: Callable[[str], None], most_octets: int) -> None:
        self.lost = 0
        self._path = path
        self._tell = tell
        self._most = most_octets
        self._json = path.suffix.lower() in (".jsonl", ".json")
        self._lines: list[bytes] = []
        self._failing = 0  # lines that could not be written since the first
        self._retry_s = 0.0
        try:
            self._file: LineFile | None = self._open()
        except (ValueError, OSError) as error:
            raise write_error(path, error) from None

    def _open(self) -> LineFile:
        """Open the log, or make it. Raises OSError, also for a file that is no log of this kind; ValueError."""
        fd = open_alone(self._path, _FLAGS, _MODE)
        try:
            begin = os.read(fd, _BEGIN_LEN)
            if begin and not (_JSON if self._json else _TEXT).match(begin):
                what = "a log of JSON lines" if self._json else "a log of text lines"
                raise FileExistsError(errno.EEXIST, f"there is a file of that name, but it is not {what}")
        except OSError:
            os.close(fd)
            raise
        return LineFile(self._path, fd)

    def take(self, item: Line) -> None:
        self._lines.append(self._encoded(item))

    def flush(self) -> None:
        if not self._lines or (self._failing and time.monotonic() < self._retry_s):
            return
        lines = self._lines
        if self._failing:
            text = f"{self._failing} lines lost, because the file could not be written"
            self._lines = lines = [self._encoded(self._remark(text)), *lines]
        written = 0
        try:
            if self._file is not None and self._file.size >= self._most:
                self._rotate()
            if self._file is None:
                self._file = self._open()
            written = self._file.lines
            self._file.write(b"".join(lines))
        except OSError as error:
            done = 0 if self._file is None else self._file.lines - written
            self._fail(error, len(lines) - done - bool(self._failing and not done))
        else:
            if self._failing:
                self._tell(f"{self._path}: can be written again; {self._failing} lines are lost")
            self._failing = 0
        self._lines = []

    def close(self, lost: int) -> None:
        if lost:
            self.lost += lost
            text = f"{lost} lines lost, because this computer or its disk was too slow"
            self._lines.append(self._encoded(self._remark(text)))
        self._retry_s = 0.0
        self.flush()
        if self._file is not None:
            self._file.close()

    def _fail(self, error: OSError, lines: int) -> None:
        if not self._failing:
            self._tell(f"{trouble_text(self._path, error)}: lines of the log are lost until then")
        self._failing += lines
        self.lost += lines
        self._retry_s = time.monotonic() + _RETRY_S

    def _rotate(self) -> None:
        """Rename the files; if that fails the log goes on in the same one."""
        with contextlib.suppress(OSError):
            for number in range(KEPT - 1, 0, -1):
                with contextlib.suppress(FileNotFoundError):
                    os.replace(self._older(number), self._older(number + 1))
            os.replace(self._path, self._older(1))
            if self._file is not None:
                self._file.close()
            self._file = None

    def _older(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.name}.{number}")

    def _remark(self, text: str) -> Line:
        return {"time": iso_time(time.time()), "event": "notice", "severity": "warning", "text": text}

    def _encoded(self, line: Line) -> bytes:
        if self._json:
            return (json_text(line) + "\n").encode()
        t = line.get("t")
        since = f" {t:>12.6f}" if isinstance(t, (int, float)) else " " * 13
        return (
            printable(f"{line['time']}{since} {line.get('severity', 'info'):<7} {line.get('text', '')}").encode()
            + b"\n"
        )
