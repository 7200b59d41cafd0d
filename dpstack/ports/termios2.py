"""Linux ``termios2``: raw 8E1 at any rate in one call, and reading the settings back.

TCGETS2/TCSETS2 with BOTHER take rates that have no POSIX constant (45.45, 93.75, 187.5 kbit/s, 6 and 12 Mbit/s). They
are also needed on ptys: the C library's ``tcsetattr`` reports EINVAL there when parity was asked for a second time.
Numbers: Linux ``asm-generic/ioctls.h`` and ``asm-generic/termbits.h``.
"""

from __future__ import annotations

import platform
import struct
import sys
from typing import Final, NamedTuple

from dpstack.ports.posix import fcntl, is_available, termios

TCGETS2: Final = 0x802C542A
TCSETS2: Final = 0x402C542B
_CBAUD: Final = 0o010017
_BOTHER: Final = 0o010000
_CIBAUD: Final = 0o02003600000
_CRTSCTS: Final = 0o20000000000
_LAYOUT: Final = struct.Struct("=4IB19s2I")
_SPEEDS: Final = struct.Struct("=2I")
_SPEEDS_AT: Final = _LAYOUT.size - _SPEEDS.size

#: The rate of a new tty, which nobody has set.
UNTOUCHED: Final = 38_400

#: False where the kernel's numbers are others (alpha, mips, powerpc, sparc ...) or the system is not Linux.
AVAILABLE: Final = (
    sys.platform == "linux"
    and is_available()
    and not platform.machine().startswith(("alpha", "mips", "parisc", "ppc", "sparc"))
)


class Applied(NamedTuple):
    """The settings of a tty after :func:`set_raw`: rate in bit/s, even parity, marks of damaged octets."""

    baud: int
    parity: bool
    marks: bool = False


def set_raw(fd: int, baud: int | None, *, marks: bool = False) -> Applied:
    """Make a tty raw, 8E1, without flow control, at ``baud`` bit/s (None: leave its rate); return what it took.

    A damaged character (parity, framing, break) is dropped by the kernel (INPCK, IGNPAR, IGNBRK), so that the Hamming
    distance of 4 that parity and check sum give together is kept; with ``marks`` it is marked instead (PARMRK, see
    :class:`dpstack.ports.tty.Unmarker`), and a break ignored. Raises OSError where the tty refuses.
    """
    buffer = bytearray(_LAYOUT.size)
    fcntl.ioctl(fd, TCGETS2, buffer, True)
    _i, _o, cflag, _l, line, cc, ispeed, ospeed = _LAYOUT.unpack(buffer)
    chars = bytearray(cc)
    chars[termios.VMIN], chars[termios.VTIME] = 1, 0
    cflag &= ~(termios.CSIZE | termios.CSTOPB | termios.PARODD | termios.HUPCL | _CRTSCTS)
    cflag |= termios.CS8 | termios.PARENB | termios.CLOCAL | termios.CREAD
    if baud is not None:
        cflag = cflag & ~(_CBAUD | _CIBAUD) | _BOTHER
        ispeed = ospeed = baud
    iflag = termios.IGNBRK | termios.INPCK | (termios.PARMRK if marks else termios.IGNPAR)
    fcntl.ioctl(fd, TCSETS2, _LAYOUT.pack(iflag, 0, cflag, 0, line, bytes(chars), ispeed, ospeed))
    fcntl.ioctl(fd, TCGETS2, buffer, True)
    iflag, _o, cflag, _l, _line, _cc, _ispeed, ospeed = _LAYOUT.unpack(buffer)
    return Applied(ospeed, bool(cflag & termios.PARENB), bool(iflag & termios.PARMRK))


class RateReader:
    """Reads the rate of a tty repeatedly without allocating memory."""

    __slots__ = ("_buffer",)

    def __init__(self) -> None:
        self._buffer = bytearray(_LAYOUT.size)

    def read(self, fd: int) -> int:
        """The output rate in bit/s; on the master end of a pty what the slave end is set to. Raises OSError."""
        buffer = self._buffer
        fcntl.ioctl(fd, TCGETS2, buffer, True)
        return int.from_bytes(buffer[_SPEEDS_AT + 4 : _SPEEDS_AT + 8], sys.byteorder)
