"""The pcapng file of a capture: a new file, a ring of files, or standard output, written in whole blocks.

Blocks are collected in memory and written by a thread: a slow disk delays nobody who listens. At most
:data:`MOST_WAITING` octets wait for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import stat
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Final

from dpstack.api.files import NEW_FILE, close_written, open_alone, open_new
from dpstack.errors import CaptureFileError, UsageError
from dpstack.record.reader import part_path, part_pattern

#: octets that wait for the disk at most: a minute of a full bus at 1.5 Mbit/s
MOST_WAITING: Final = 32 << 20
#: standard output
STDOUT: Final = "-"
#: at the end: time-out in s for a reader of standard output that reads nothing
_PATIENCE_S: Final = 2.0
_MB: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Ring:
    """At most ``files`` files of about ``megabytes`` (10^6 octets) each; the oldest one is removed for a new one."""

    files: int
    megabytes: float


class CaptureFile:
    """Collects blocks (:meth:`write`, one block a call) and writes them with :meth:`flush`.

    Entering makes the file; of a ring it looks at the directory only. It raises UsageError if there is a file of
    that name already, unless it is empty, or if it cannot be made. A file in which nothing was written is removed.

    The files of a ring are named after ``name``, with a number and the time of their first transmission:
    ``bus_00001_20260131T120000Z.pcapng``. Those of an earlier capture belong to the ring, too.
    """

    def __init__(self, name: str, ring: Ring | None = None) -> None:
        self.name = "standard output" if name == STDOUT else name
        #: paths that were written, the latest one last
        self.paths: list[Path] = []
        self._to_stdout = name == STDOUT
        self._path = Path(name)
        self._ring = ring
        self._number = 0  # of the last file of the ring
        self._fd = -1
        self._jobs: list[bytes | Path] = []  # blocks, and names of files to begin
        self._waiting = 0  # octets
        self._size = 0  # octets of the present file
        self._writing: asyncio.Future[None] | None = None

    def __enter__(self) -> CaptureFile:
        if self._to_stdout:
            sys.stdout.flush()
            self._fd = os.dup(sys.stdout.fileno())
        elif self._ring is None:
            self._fd = open_new(self._path, _OR_STDOUT)
            self.paths.append(self._path)
        else:
            self.paths = _files_of_ring(self._path)
            self._number = max((_number_of(path) for path in self.paths), default=0)
            self._check_directory()
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    @property
    def has_room(self) -> bool:
        """Whether the next block may be written; False while the disk is slower than the bus."""
        return self._waiting < MOST_WAITING

    @property
    def is_full(self) -> bool:
        """Whether the next block belongs into a new file of the ring, which :meth:`begin` makes."""
        return self._ring is not None and (not self._size or self._size >= self._ring.megabytes * _MB)

    def begin(self, t_ns: int) -> None:
        """The blocks from here on belong into a new file of the ring, whose first transmission is of ``t_ns``."""
        self._number += 1
        self._jobs.append(part_path(self._path, self._number, t_ns))
        self._size = 0

    def write(self, block: bytes) -> None:
        """Take one whole block."""
        self._jobs.append(block)
        self._waiting += len(block)
        self._size += len(block)

    async def flush(self, *, last: bool = False) -> None:
        """Write what was collected, in a thread. Raises CaptureFileError: all whole blocks before are in the file.

        ``last``: standard output that nobody reads is given up after some seconds.
        """
        limit = _PATIENCE_S if last and self._to_stdout else None
        try:
            async with asyncio.timeout(limit):
                if self._writing is not None:
                    await asyncio.shield(self._writing)
                jobs, self._jobs = self._jobs, []
                if jobs:
                    self._writing = _in_thread(lambda: self._write_out(jobs))
                    await asyncio.shield(self._writing)
                    self._waiting -= sum(len(job) for job in jobs if isinstance(job, bytes))
        except TimeoutError:
            self._fd = -1  # the thread still writes to it
            raise CaptureFileError(f"{self.name}: nobody has read it for {_PATIENCE_S:g} s") from None

    # --- in the thread ---
    def _write_out(self, jobs: list[bytes | Path]) -> None:
        for is_block, group in groupby(jobs, key=lambda job: isinstance(job, bytes)):
            if is_block:
                self._write_blocks([job for job in group if isinstance(job, bytes)])
            else:
                for job in group:
                    self._begin(Path(str(job)))

    def _begin(self, path: Path) -> None:
        """Begin a file of the ring, after room was made for it."""
        self._close()
        assert self._ring is not None
        try:
            while len(self.paths) >= self._ring.files:
                with contextlib.suppress(FileNotFoundError):
                    self.paths[0].unlink()
                del self.paths[0]
            self._fd = open_alone(path, NEW_FILE | os.O_EXCL)
        except OSError as error:
            raise _write_error(str(path), error) from None
        self.paths.append(path)

    def _write_blocks(self, blocks: list[bytes]) -> None:
        octets = memoryview(b"".join(blocks))
        done = 0
        try:
            while done < len(octets):
                done += os.write(self._fd, octets[done:])
        except OSError as error:
            self._cut(blocks, done)
            raise _write_error(str(self.paths[-1]) if self.paths else self.name, error) from None

    def _cut(self, blocks: list[bytes], done: int) -> None:
        """After ``done`` octets of ``blocks`` nothing more could be written: end the file after a whole block."""
        for block in blocks:
            if done < len(block):
                break
            done -= len(block)
        if done and not self._to_stdout:
            with contextlib.suppress(OSError):  # readers skip a block that was cut
                os.ftruncate(self._fd, os.lseek(self._fd, 0, os.SEEK_CUR) - done)

    def _close(self) -> None:
        fd, self._fd = self._fd, -1
        if fd < 0:
            return
        if self._to_stdout:
            os.close(fd)
        elif close_written(fd, self.paths[-1]):
            self.paths.pop()

    def _check_directory(self) -> None:
        folder = self._path.parent
        try:
            if stat.S_ISDIR(os.stat(self._path).st_mode):
                raise UsageError(f"{self._path}: is a directory; name a file")
        except ValueError as error:  # a path with a zero octet
            raise UsageError(f"{self._path}: {error}; name a file") from None
        except OSError:
            pass  # nothing has the name, as it should be
        if not os.access(folder, os.W_OK | os.X_OK):
            raise UsageError(f"{self._path}: cannot be written; name a file in a directory of yours")


_OR_STDOUT: Final = ", or - for standard output"


def _in_thread(work: Callable[[], None]) -> asyncio.Future[None]:
    """The end of ``work``, which a thread does that nobody waits for when the program ends."""
    loop = asyncio.get_running_loop()
    future: asyncio.Future[None] = loop.create_future()

    def end(error: Exception | None) -> None:
        if not future.done():
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)

    def run() -> None:
        failed = None
        try:
            work()
        except Exception as error:
            failed = error
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(end, failed)

    threading.Thread(target=run, name="capture file", daemon=True).start()
    return future


def _files_of_ring(path: Path) -> list[Path]:
    """The files of earlier captures of the ring ``path``, the oldest one first. Raises UsageError."""
    pattern = part_pattern(path)
    try:
        with os.scandir(path.parent) as entries:
            names = [one.name for one in entries if pattern.fullmatch(one.name) and one.is_file(follow_symlinks=False)]
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot be written ({why}); name a file in a directory of yours") from None
    return sorted((path.with_name(name) for name in names), key=_number_of)


def _number_of(path: Path) -> int:
    return int(path.stem.rsplit("_", 2)[1])


def _write_error(name: str, error: OSError) -> CaptureFileError:
    if error.errno == errno.EPIPE:
        return CaptureFileError(f"{name}: its reader has gone")
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "what was heard up to here is kept"
    return CaptureFileError(f"{name}: cannot be written ({error.strerror or error}); {todo}")
