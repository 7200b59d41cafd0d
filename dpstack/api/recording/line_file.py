"""A file of whole lines, also on a disk that becomes full."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

from dpstack.api.files import close_written

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class LineFile:
    """Appends whole lines to the open file ``fd``, and owns it. ``size``: octets in the file; ``lines``: of them."""

    def __init__(self, path: Path, fd: int) -> None:
        self.path = path
        self.size = os.fstat(fd).st_size
        self.lines = 0
        self._fd = fd

    def write(self, octets: bytes) -> None:
        """Append ``octets``, whole lines. Raises OSError: the file then ends after the last line that found room."""
        view = memoryview(octets)
        done = 0
        try:
            while done < len(octets):
                done += os.write(self._fd, view[done:])
        except OSError:
            kept = octets.rfind(b"\n", 0, done) + 1
            if done > kept:
                with contextlib.suppress(OSError):  # readers leave out a line that was cut
                    os.ftruncate(self._fd, self.size + kept)
                    os.lseek(self._fd, 0, os.SEEK_END)
            self._count(octets[:kept])
            raise
        self._count(octets)

    def _count(self, octets: bytes) -> None:
        self.size += len(octets)
        self.lines += octets.count(b"\n")

    def close(self) -> None:
        """Close the file; one without a line is removed."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            close_written(fd, self.path)


def trouble_text(path: Path, error: OSError) -> str:
    """One line on a file that cannot be written."""
    if error.errno in FULL:
        return f"{path}: the disk is full; make room there"
    return f"{path}: cannot be written ({error.strerror or error})"
