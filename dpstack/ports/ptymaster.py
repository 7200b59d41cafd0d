"""The master end of a pty: who is at the other end, and what that end is set to.

A pty keeps the rate, the raw mode and unread octets of its slave end beyond the last close. A master end without an
opener reads EIO and polls POLLHUP all the time, so it must not stay in a level-triggered selector.
"""

from __future__ import annotations

import contextlib
import os
import select

from dpstack.errors import PortError
from dpstack.ports import posix, termios2
from dpstack.ports.fdport import reason_of
from dpstack.ports.posix import termios


class PtyMaster:
    """A pty pair of which this end is held open, non-blocking; ``path`` is the other end, raw, for others to open."""

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
            # An opener that sets nothing shall not have the line's echo and line editing; the rate stays untouched.
            termios2.set_raw(slave, None)
        except OSError as exc:
            os.close(self.fd)
            raise PortError(f"the pty cannot be set up ({reason_of(exc)})") from None
        finally:
            os.close(slave)
        self._rates = termios2.RateReader()
        self._poll = select.poll()
        self._poll.register(self.fd, 0)  # POLLHUP comes unasked

    def deserted(self) -> bool:
        """True while nobody has the other end open."""
        return bool(self._poll.poll(0))

    def forget(self) -> None:
        """Throw away what the last opener left unread, so that the next one does not find stale octets."""
        with contextlib.suppress(OSError, termios.error):
            slave = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
            try:
                termios.tcflush(slave, termios.TCIFLUSH)
            finally:
                os.close(slave)

    def baud(self) -> int | None:
        """The rate the opener set in bit/s; None when nobody has ever set one."""
        rate = self._rates.read(self.fd)
        return None if rate == termios2.UNTOUCHED else rate

    def close(self) -> None:
        """Close this end; the path vanishes. May be called again."""
        fd, self.fd = self.fd, -1
        if fd >= 0:
            os.close(fd)
