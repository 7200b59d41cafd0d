"""Linux ``termios2``: raw 8E1 at any rate in one call, and reading the settings back.

TCGETS2/TCSETS2 with BOTHER take rates that have no POSIX constant (45.45, 93.75, 187.5 kbit/s, 6 and 12 Mbit/s). They
are also needed on ptys: the C library's ``tcsetattr`` reports EINVAL there when parity was asked for a second time.
Numbers: Linux ``asm-generic/ioctls.h`` and ``asm-generic/termbits.h``.
"""

from __future__ import annotations

import os
import struct
import sys
from typing import Final

from msgspec import Struct

from dpstack.ports.posix import fcntl, is_available, termios

TCGETS2: Final = 0x802C542A
TCSETS2: Final = 0x402C542B
_CBAUD: Final = 0o010017
_BOTHER: Final = 0o010000
_CIBAUD: Final = 0o02003600000
_CRTSCTS: Final = 0o20000000000
_CMSPAR: Final = 0o10000000000
_LAYOUT: Final = struct.Struct("=4IB19s2I")
_SPEEDS: Final = struct.Struct("=2I")
_SPEEDS_AT: Final = _LAYOUT.size - _SPEEDS.size

#: The rate of a new tty, which nobody has set.
UNTOUCHED: Final = 38_400

#: False if the kernel's numbers are others (alpha, mips, powerpc, sparc ...) or the system is not Linux.
AVAILABLE: Final = (
    sys.platform == "linux"
    and is_available()
    and not os.uname().machine.startswith(("alpha", "mips", "parisc", "ppc", "sparc"))
)


class Applied(Struct, frozen=True):
    """The settings of a tty after :func:`set_raw`: rate in bit/s, even parity, marks of damaged octets. ``differs``:
    other settings that read back otherwise than they were asked for, in words. ``kept``: the rate is the one that was
    set before."""

    baud: int
    parity: bool
    marks: bool = False
    differs: tuple[str, ...] = ()
    kept: bool = False


class Settings(Struct, frozen=True):
    """Settings of a tty that another program may change: rate in bit/s, frame and input flags as termios has them."""

    baud: int
    frame: int
    input_flags: int


def set_raw(fd: int, baud: int | None, *, marks: bool = False) -> Applied:
    """Make a tty raw, 8E1, without flow control, at ``baud`` bit/s (None: leave its rate); return what it took.

    A damaged character (parity, framing, break) is dropped by the kernel (INPCK, IGNPAR, IGNBRK), so that the Hamming
    distance of 4 that parity and check sum give together is kept; with ``marks`` it is marked instead (PARMRK, see
    :class:`dpstack.ports.tty.Unmarker`), and a break ignored. At the last close, also of a killed program, the kernel
    lowers RTS and DTR (HUPCL): a converter that RTS switches must not go on driving the bus. Raises OSError if the
    tty refuses.
    """
    buffer = bytearray(_LAYOUT.size)
    fcntl.ioctl(fd, TCGETS2, buffer, True)
    _i, _o, cflag, _l, line, cc, ispeed, ospeed = _LAYOUT.unpack(buffer)
    before = ospeed
    chars = bytearray(cc)
    chars[termios.VMIN], chars[termios.VTIME] = 1, 0
    cflag &= ~(termios.CSIZE | termios.CSTOPB | termios.PARODD | _CMSPAR | _CRTSCTS)
    cflag |= termios.CS8 | termios.PARENB | termios.CLOCAL | termios.CREAD | termios.HUPCL
    if baud is not None:
        cflag = cflag & ~(_CBAUD | _CIBAUD) | _BOTHER
        ispeed = ospeed = baud
    iflag = termios.IGNBRK | termios.INPCK | (termios.PARMRK if marks else termios.IGNPAR)
    fcntl.ioctl(fd, TCSETS2, _LAYOUT.pack(iflag, 0, cflag, 0, line, bytes(chars), ispeed, ospeed))
    fcntl.ioctl(fd, TCGETS2, buffer, True)
    iflag, _o, cflag, _l, _line, _cc, _ispeed, ospeed = _LAYOUT.unpack(buffer)
    kept = baud is not None and ospeed == before != baud
    return Applied(ospeed, bool(cflag & termios.PARENB), bool(iflag & termios.PARMRK), _differs(cflag), kept)


def _differs(cflag: int) -> tuple[str, ...]:
    """The settings of ``cflag`` that are not those of 8E1 without flow control; parity apart."""
    others = {
        "not 8 data bits": cflag & termios.CSIZE != termios.CS8,
        "two stop bits": cflag & termios.CSTOPB,
        "odd parity": cflag & termios.PARENB and cflag & termios.PARODD and not cflag & _CMSPAR,
        "mark or space parity": cflag & termios.PARENB and cflag & _CMSPAR,
        "flow control by RTS and CTS": cflag & _CRTSCTS,
    }
    return tuple(name for name, there in others.items() if there)


def set_odd_parity(fd: int, odd: bool) -> None:
    """Change nothing but the parity of a tty. Raises OSError."""
    buffer = bytearray(_LAYOUT.size)
    fcntl.ioctl(fd, TCGETS2, buffer, True)
    values = list(_LAYOUT.unpack(buffer))
    values[2] = values[2] | termios.PARODD if odd else values[2] & ~termios.PARODD
    fcntl.ioctl(fd, TCSETS2, _LAYOUT.pack(*values))


def settings(fd: int) -> Settings:
    """The present settings. Raises OSError."""
    buffer = bytearray(_LAYOUT.size)
    fcntl.ioctl(fd, TCGETS2, buffer, True)
    iflag, _o, cflag, _l, _line, _cc, _ispeed, ospeed = _LAYOUT.unpack(buffer)
    frame = termios.CSIZE | termios.CSTOPB | termios.PARENB | termios.PARODD | _CMSPAR | _CRTSCTS
    flags = termios.INPCK | termios.IGNPAR | termios.PARMRK | termios.ISTRIP | termios.IXON | termios.ICRNL
    return Settings(ospeed, cflag & frame, iflag & flags)


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
