"""``--port pty``: a pty made here, whose other end any program may open as its serial port.

A pty keeps the rate, the raw mode and unread octets of its slave end beyond the last close. A master end without an
opener reads EIO and polls POLLHUP all the time, so it must not stay in a level-triggered selector.
"""

from __future__ import annotations

import contextlib
import os
import select

from dpstack.errors import BaudError, PortError
from dpstack.ports import posix, termios2
from dpstack.ports.base import Loop, reason_of
from dpstack.ports.fdport import FdPort
from dpstack.ports.posix import termios


class PtyMaster:
    """A pty pair whose master end is held open, non-blocking; ``path`` is the slave end, raw, for others to open."""

    __slots__ = ("_poll", "_rates", "fd", "path")

    def __init__(self) -> None:
        posix.check("a pty")
        try:
            self.fd, slave = os.openpty()
        except OSError as exc:
            raise PortError(f"the system gives no pty ({reason_of(exc)}): close some terminals") from None
        try:
            os.set_blocking(self.fd, False)
            self.path = os.ttyname(slave)
            # raw even for an opener that sets nothing: no echo, no line editing; the rate stays untouched
            termios2.set_raw(slave, None)
        except OSError as exc:
            os.close(self.fd)
            raise PortError(f"the pty cannot be set up ({reason_of(exc)})") from None
        finally:
            os.close(slave)
        self._rates = termios2.RateReader()
        self._poll = select.poll()
        self._poll.register(self.fd, 0)  # POLLHUP comes unasked

    def has_no_opener(self) -> bool:
        """Whether nobody has the other end open."""
        return bool(self._poll.poll(0))

    def discard_unread(self) -> None:
        """Throw away the unread octets of the last opener, so that the next one finds no stale octets."""
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
            finally:
                os.close(slave)

    def baud(self) -> int | None:
        """The rate of the opener in bit/s; None when nobody has ever set one."""
        rate = self._rates.read(self.fd)
        return None if rate == termios2.UNTOUCHED else rate

    def close(self) -> None:
        """Close this end; the path vanishes. May be called again."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)


class PtyPort(FdPort):
    """The master end of a pty pair. ``name`` is "pty" until :meth:`open`, then the path to open at the other end.

    The other end may be closed, before the first opener and between two: octets written meanwhile are dropped, and the
    port notices the next opener at its first octet or at the next write. Octets arrive at any rate of the opener until
    :meth:`set_baud` is called: from then on only those at the port's rate (an opener that sets no rate has the one
    that the port was made with).
    """

    def __init__(self, baud: int, *, paced: bool = False) -> None:
        super().__init__("pty", baud, paced=paced)
        self._made_at = baud
        self._master: PtyMaster | None = None
        #: while nobody has the other end open: an edge-triggered epoll, since such a master is always 'ready'
        self._watch: select.epoll | None = None

    def open_now(self) -> None:
        """Make the pair. Raises PortError."""
        self.close()
        self._master = PtyMaster()
        self.name = self._master.path
        self._use(self._master.fd)

    def line_baud(self) -> int | None:
        try:
            return self._master.baud() if self._master is not None else None
        except OSError:
            return None

    def set_baud(self, baud: int) -> None:
        """From now on receive only at ``baud``. Raises BaudError when not open."""
        if self._master is None:
            raise BaudError("the pty is not open: its rate is set when it is opened")
        self.read_now()
        self.baud = baud
        self._read = self._read_legible

    def _read_legible(self, size: int) -> bytes:
        """Like ``os.read``, without the octets sent at another rate. Raises OSError."""
        octets = os.read(self._fd, size)
        if octets and (self.line_baud() or self._made_at) != self.baud:
            raise BlockingIOError
        return octets

    def write(self, octets: bytes) -> bool:
        """Drops the octets also while nobody has the other end open."""
        if self._watch is not None and not self._has_new_opener():
            return self._drop()
        return super().write(octets)

    def _close_fd(self, fd: int) -> None:
        self._master = None
        watch, self._watch = self._watch, None
        if watch is not None:  # of a port released after a fork, which was not detached
            watch.close()
        os.close(fd)

    def _start(self, loop: Loop) -> None:
        if self._master is None:
            return
        if self._master.has_no_opener():
            self._begin_watch(loop)
        else:
            loop.add_reader(self._fd, self._readable)

    def _stop(self, loop: Loop) -> None:
        self._end_watch(loop)
        if self._fd >= 0:
            loop.remove_reader(self._fd)

    def _hung_up(self, reason: str) -> None:
        if self._loop is None or self._master is None:
            return
        self._loop.remove_reader(self._fd)
        self._master.discard_unread()
        self._begin_watch(self._loop)

    def _begin_watch(self, loop: Loop) -> None:
        watch = select.epoll()
        watch.register(self._fd, select.EPOLLIN | select.EPOLLET)
        watch.poll(0)  # consumes the pending hang-up
        self._watch = watch
        loop.add_reader(watch.fileno(), self._on_watch)

    def _end_watch(self, loop: Loop) -> None:
        watch, self._watch = self._watch, None
        if watch is not None:
            loop.remove_reader(watch.fileno())
            watch.close()

    def _on_watch(self) -> None:
        if self._watch is not None and any(event & select.EPOLLIN for _fd, event in self._watch.poll(0)):
            self._resume()

    def _has_new_opener(self) -> bool:
        """Whether somebody has opened the other end meanwhile."""
        if self._master is None or self._master.has_no_opener():
            return False
        self._resume()
        return True

    def _resume(self) -> None:
        if self._loop is not None:
            self._end_watch(self._loop)
            self._loop.add_reader(self._fd, self._readable)
