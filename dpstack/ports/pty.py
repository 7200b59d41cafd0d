"""``--port pty``: a pty made here, whose other end any program may open as its serial port."""

from __future__ import annotations

import os
import select

from dpstack.errors import BaudError
from dpstack.ports.base import Loop
from dpstack.ports.fdport import FdPort
from dpstack.ports.ptymaster import PtyMaster


class PtyPort(FdPort):
    """The master end of a pty pair. ``name`` is "pty" until :meth:`open`, then the path to open at the other end.

    That nobody is at the other end is normal, before the first opener and between two: what is written meanwhile is
    dropped, and the next opener is noticed by its first octet or at the next write. Octets arrive whatever rate the
    opener has set, until :meth:`set_baud` is called: from then on only those that are sent at the port's rate do
    (an opener that sets none is at the rate the port was made with).
    """

    def __init__(self, baud: int, *, paced: bool = False) -> None:
        super().__init__("pty", baud, paced=paced)
        self._made_at = baud
        self._master: PtyMaster | None = None
        #: set while nobody is at the other end: an edge-triggered epoll, since a deserted master is always 'ready'
        self._watch: select.epoll | None = None

    def open_now(self) -> None:
        """Make the pair. Raises PortError."""
        self.close()
        self._master = PtyMaster()
        self.name = self._master.path
        self._use(self._master.fd)

    def line_baud(self) -> int | None:
        """The rate the opener has set, None when it set none or the port is closed."""
        try:
            return self._master.baud() if self._master is not None else None
        except OSError:
            return None

    def set_baud(self, baud: int) -> None:
        """Be at ``baud``: what is sent at another rate is not heard any more. Raises BaudError when not open."""
        if self._master is None:
            raise BaudError("the pty is not open: its rate is set when it is opened")
        self.read_now()
        self.baud = baud
        self._read = self._read_legible

    def _read_legible(self, size: int) -> bytes:
        """As ``os.read``, without what is sent at another rate. Raises OSError."""
        octets = os.read(self._fd, size)
        if octets and (self.line_baud() or self._made_at) != self.baud:
            raise BlockingIOError
        return octets

    def write(self, octets: bytes) -> bool:
        """Write at once or drop; dropped too when nobody is at the other end."""
        if self._watch is not None and not self._returned():
            self.dropped += 1
            return False
        return super().write(octets)

    def _forsake_fd(self, fd: int) -> None:
        watch, self._watch = self._watch, None
        if watch is not None:
            watch.close()
        self._close_fd(fd)

    def _close_fd(self, fd: int) -> None:
        self._master = None
        os.close(fd)

    def _start(self, loop: Loop) -> None:
        if self._master is None:
            return
        if self._master.deserted():
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
        self._master.forget()
        self._begin_watch(self._loop)

    def _begin_watch(self, loop: Loop) -> None:
        watch = select.epoll()
        watch.register(self._fd, select.EPOLLIN | select.EPOLLET)
        watch.poll(0)  # takes the hang-up that is already known
        self._watch = watch
        loop.add_reader(watch.fileno(), self._stirred)

    def _end_watch(self, loop: Loop) -> None:
        watch, self._watch = self._watch, None
        if watch is not None:
            loop.remove_reader(watch.fileno())
            watch.close()

    def _stirred(self) -> None:
        if self._watch is not None and any(event & select.EPOLLIN for _fd, event in self._watch.poll(0)):
            self._resume()

    def _returned(self) -> bool:
        """True when somebody has opened the other end meanwhile."""
        if self._master is None or self._master.deserted():
            return False
        self._resume()
        return True

    def _resume(self) -> None:
        if self._loop is not None:
            self._end_watch(self._loop)
            self._loop.add_reader(self._fd, self._readable)
