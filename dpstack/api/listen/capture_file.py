"""The pcapng file of a capture: a new file or standard output, written in whole blocks.

Blocks are collected in memory and written by a thread: a slow disk delays nobody who listens. What finds
:data:`MOST_WAITING` octets before it is not kept, and counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import stat
import sys
from pathlib import Path
from typing import Final

from dpstack.errors import CaptureFileError, UsageError

#: octets that wait for the disk at most: a minute of a full bus at 1.5 Mbit/s
MOST_WAITING: Final = 32 << 20
#: standard output
STDOUT: Final = "-"


class CaptureFile:
    """Collects blocks (:meth:`write`, one block a call) and writes them with :meth:`flush`.

    Entering makes the file. It raises UsageError where there is a file of that name already, unless it is empty, or
    where it cannot be made. A file in which nothing was written is removed at the end.
    """

    def __init__(self, name: str) -> None:
        self.name = "standard output" if name == STDOUT else name
        self._to_stdout = name == STDOUT
        self._path = Path(name)
        self._fd = -1
        self._blocks: list[bytes] = []
        self._waiting = 0
        self._writing: asyncio.Future[None] | None = None

    def __enter__(self) -> CaptureFile:
        if self._to_stdout:
            sys.stdout.flush()
            self._fd = os.dup(sys.stdout.fileno())
        else:
            self._fd = _open_new(self._path)
        return self

    def __exit__(self, *_: object) -> None:
        fd, self._fd = self._fd, -1
        if fd >= 0:
            empty = not self._to_stdout and not os.fstat(fd).st_size
            os.close(fd)
            if empty:
                with contextlib.suppress(OSError):
                    self._path.unlink()

    @property
    def has_room(self) -> bool:
        """Whether the next block is kept; False while the disk is slower than the bus."""
        return self._waiting < MOST_WAITING

    def write(self, block: bytes) -> None:
        """Take one whole block."""
        self._blocks.append(block)
        self._waiting += len(block)

    async def flush(self) -> None:
        """Write what was collected, in a thread. Raises CaptureFileError: all whole blocks before are in the file."""
        if self._writing is not None:
            await asyncio.shield(self._writing)
        blocks, self._blocks = self._blocks, []
        if not blocks:
            return
        self._writing = asyncio.ensure_future(asyncio.to_thread(self._write_out, blocks))
        await asyncio.shield(self._writing)
        self._waiting -= sum(map(len, blocks))

    def _write_out(self, blocks: list[bytes]) -> None:
        octets = memoryview(b"".join(blocks))
        done = 0
        try:
            while done < len(octets):
                done += os.write(self._fd, octets[done:])
        except OSError as error:
            self._cut(blocks, done)
            raise _write_error(self.name, error) from None

    def _cut(self, blocks: list[bytes], done: int) -> None:
        """After ``done`` octets of ``blocks`` nothing more could be written: end the file after a whole block."""
        for block in blocks:
            if done < len(block):
                break
            done -= len(block)
        if done and not self._to_stdout:
            with contextlib.suppress(OSError):  # readers skip a block that was cut
                os.ftruncate(self._fd, os.lseek(self._fd, 0, os.SEEK_CUR) - done)


def _open_new(path: Path) -> int:
    flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        fd = os.open(path, flags | getattr(os, "O_NONBLOCK", 0), 0o666)
    except ValueError as error:  # a path with a zero octet
        raise UsageError(f"{path}: {error}; name a file") from None
    except IsADirectoryError:
        raise UsageError(f"{path}: is a directory; name a file") from None
    except OSError as error:
        raise UsageError(
            f"{path}: cannot be written ({error.strerror or error}); name a file in a directory of yours"
        ) from None
    found = os.fstat(fd)
    if stat.S_ISREG(found.st_mode) and not found.st_size:
        return fd
    os.close(fd)
    if stat.S_ISREG(found.st_mode):
        raise UsageError(f"{path}: there is a file of that name; give the name of a new file")
    raise UsageError(f"{path}: is a device or a pipe; name an ordinary file, or - for standard output")


def _write_error(name: str, error: OSError) -> CaptureFileError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    todo = "make room there, or name a file elsewhere" if full else "what was heard up to here is kept"
    return CaptureFileError(f"{name}: cannot be written ({error.strerror or error}); {todo}")
