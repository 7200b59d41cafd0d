"""The number of the MQTT session on disk (bdSeq), and the lock against a second gateway with the same id.

A will of the last session may arrive when the next one has begun. So each session has a number of its own, which is on
disk before the connection is made; the file is never half written, and lasts through SIGKILL and a loss of power.
"""

from __future__ import annotations

import fcntl
import os
import re
import weakref
from pathlib import Path
from typing import Final

from dpstack.errors import ConfigError
from dpstack.text import printable

#: numbers of sessions are 0 to 255 (tck-id-message-flow-edge-node-birth-publish-will-message-payload-bdSeq)
NUMBERS: Final = 256
_NAME: Final = "bdseq"
_LINE: Final = re.compile(rb"([0-9]{1,3})\n")


class SessionFile:
    """The folder ``folder`` of one edge node; it is made if it is missing (rights 0700).

    ``damaged``: there is a file, but no number in it, so nobody knows the number of the last session.

    Raises ConfigError if another program has the folder, or if it cannot be used.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise _unusable(folder, error) from None
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            found = self._read()
        except BlockingIOError:
            os.close(self._fd)
            raise ConfigError(
                f"another gateway on this computer has the same group and node ({folder}); give this one another node"
            ) from None
        except OSError as error:
            os.close(self._fd)
            raise _unusable(folder, error) from None
        # if open() of the connector was cancelled, nobody has this object when its thread has made it
        self._release = weakref.finalize(self, os.close, self._fd)
        self.damaged = found is None
        self._last = -1 if found is None else found

    def next(self) -> int:
        """The number of the next session, which is on disk now. Raises OSError if it cannot be written: do not
        connect then."""
        number = (self._last + 1) % NUMBERS
        new = f"{_NAME}.new"
        fd = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600, dir_fd=self._fd)
        try:
            os.write(fd, b"%d\n" % number)
            os.fsync(fd)
        finally:
            os.close(fd)
        os.replace(new, _NAME, src_dir_fd=self._fd, dst_dir_fd=self._fd)
        os.fsync(self._fd)
        self._last = number
        return number

    def close(self) -> None:
        """Give the folder free for another gateway."""
        self._fd = -1
        self._release()

    def _read(self) -> int | None:
        """The number in the file; -1 without a file, None if the file has no number."""
        try:
            fd = os.open(_NAME, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW, dir_fd=self._fd)
        except FileNotFoundError:
            return -1
        try:
            found = _LINE.fullmatch(os.read(fd, 16))
        finally:
            os.close(fd)
        number = NUMBERS if found is None else int(found[1])
        return number if number < NUMBERS else None


def _unusable(folder: Path, error: OSError) -> ConfigError:
    text = printable(error.strerror or str(error))
    return ConfigError(f"the state of the MQTT session cannot be kept in {folder}: {text}")
