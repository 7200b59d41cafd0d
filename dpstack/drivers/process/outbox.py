"""Messages on their way to the other process, which may have stopped reading: nobody waits for it."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from typing import Final, Protocol

from dpstack.drivers.process.messages import Message, framed

#: beyond this events are dropped (and counted) until somebody reads again
FULL: Final = 256 * 1024
_LAST_WORDS_S: Final = 0.5


class WriterLoop(Protocol):
    """What an outbox needs of its loop: of asyncio's, or of the bus process's."""

    def add_writer(self, fd: int, callback: Callable[[], object], /) -> object:
        """Call back whenever ``fd`` takes octets."""

    def remove_writer(self, fd: int, /) -> object: ...


class Outbox:
    """Messages on their way into ``sock``, in order."""

    def __init__(self, loop: WriterLoop, sock: socket.socket) -> None:
        self._loop = loop
        self._sock = sock
        self._waiting = bytearray()
        self._watched = False

    @property
    def full(self) -> bool:
        """Nobody reads: only what somebody has asked for is still taken."""
        return len(self._waiting) > FULL

    @property
    def waiting(self) -> bool:
        """Something was not taken yet."""
        return bool(self._waiting)

    def send(self, message: Message) -> None:
        """Put one message at the end; as much as the socket takes leaves at once."""
        self._waiting += framed(message)
        if not self._watched:
            self._flush()

    def _flush(self) -> None:
        waiting = self._waiting
        try:
            while waiting:
                del waiting[: self._sock.send(waiting)]
        except BlockingIOError:
            pass
        except OSError:  # the application has gone; whoever reads the socket is told so
            waiting.clear()
        if bool(waiting) is not self._watched:
            self._watched = bool(waiting)
            if waiting:
                self._loop.add_writer(self._sock.fileno(), self._flush)
            else:
                self._loop.remove_writer(self._sock.fileno())

    def forget(self) -> None:
        """What was not taken yet goes nowhere."""
        self._waiting.clear()
        if self._watched:
            self._watched = False
            self._loop.remove_writer(self._sock.fileno())

    def close(self) -> None:
        """The last words, with a bound, then hang up."""
        if self._watched:
            self._loop.remove_writer(self._sock.fileno())
        with contextlib.suppress(OSError):
            self._sock.settimeout(_LAST_WORDS_S)
            self._sock.sendall(self._waiting)
        self._sock.close()
