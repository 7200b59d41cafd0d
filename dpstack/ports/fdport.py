"""Base class of the ports that are a file descriptor: Linux ttys, ptys and sockets."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Final

from dpstack.ports.base import Loop, Port, reason_of

#: Octets of one read at most; a telegram has up to 255 octets. Small enough for Python's own allocator.
CHUNK: Final = 470

#: Chunks that one call of ``read_now`` returns at most (30 KB, 27 ms of the line at 12 Mbit/s).
_CHUNKS: Final = 64
#: The octets behind them are thrown away, in blocks, at most this many in one call: a far end that sends without end,
#: faster than this computer can process it, must not block the loop for ever.
_BLOCK: Final = 65_536
_BLOCKS: Final = 16


def _read_nothing(_size: int) -> bytes:
    raise BlockingIOError


def write_nothing(_octets: bytes) -> int:
    """Of a port that is closed, or only listens."""
    return 0


class FdPort(Port):
    """A port that is read and written by two functions on one non-blocking descriptor."""

    def __init__(self, name: str, baud: int, *, paced: bool) -> None:
        super().__init__(name, baud, paced=paced)
        self._fd = -1
        self._read: Callable[[int], bytes] = _read_nothing
        self._send = write_nothing

    @property
    def fd(self) -> int | None:
        """The descriptor while the port is open."""
        return self._fd if self._fd >= 0 else None

    def read_now(self) -> bytes:
        octets = b""
        for _ in range(_CHUNKS):
            try:
                chunk = self._read(CHUNK)
            except OSError:  # nothing there; the reader in the loop notices a loss
                return octets
            octets = octets + chunk if octets else chunk
            if len(chunk) < CHUNK:
                return octets
        self._discard()
        return octets

    def _discard(self) -> None:
        """Throw away and count the octets that arrive faster than they can be processed."""
        for _ in range(_BLOCKS):
            try:
                size = len(self._read(_BLOCK))
            except OSError:
                return
            self.discarded += size
            if size < CHUNK:
                return

    def close(self) -> None:
        self.detach()
        self._release()

    def release_after_fork(self) -> None:
        """Close the child's copy of the descriptor, and nothing else."""
        super().release_after_fork()
        self._release()

    def _release(self) -> None:
        fd, self._fd = self._fd, -1
        self._read, self._send = _read_nothing, write_nothing
        if fd >= 0:
            self._close_fd(fd)

    def _use(self, fd: int) -> None:
        """Read and write on ``fd``, an open non-blocking descriptor."""
        self._fd = fd
        self._read, self._send = partial(os.read, fd), partial(os.write, fd)

    def _close_fd(self, fd: int) -> None:
        os.close(fd)

    def _start(self, loop: Loop) -> None:
        if self._fd >= 0:
            loop.add_reader(self._fd, self._readable)

    def _stop(self, loop: Loop) -> None:
        if self._fd >= 0:
            loop.remove_reader(self._fd)

    def pause_reading(self, paused: bool) -> bool:
        if self._loop is None:
            return False
        (self._stop if paused else self._start)(self._loop)
        return True

    def _readable(self) -> None:
        try:
            chunk = self._read(CHUNK)
        except BlockingIOError:
            return
        except OSError as exc:
            self._hung_up(reason_of(exc))
            return
        if not chunk:
            self._hung_up("the other end hung up")
        elif self._on_data is not None:
            self._on_data(chunk)

    def _hung_up(self, reason: str) -> None:
        self._lose(reason)
