"""What a Linux serial driver can do beyond termios, by ioctl: low latency, RS-485, error counters.

Each raises OSError (ENOTTY or EINVAL as a rule) where the driver has it not. Numbers and layouts: Linux serial.h,
tty_flags.h, asm-generic/ioctls.h.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from dpstack.ports.posix import fcntl

# struct serial_struct: flags are its fifth int
TIOCGSERIAL: Final = 0x541E
TIOCSSERIAL: Final = 0x541F
ASYNC_LOW_LATENCY: Final = 1 << 13
_SERIAL_SIZE: Final = 128
_FLAGS: Final = struct.Struct("=I")
_FLAGS_AT: Final = 16

# struct serial_rs485: flags, delay before and after in ms, five words
TIOCGRS485: Final = 0x542E
TIOCSRS485: Final = 0x542F
_RS485: Final = struct.Struct("=8I")
RS485_ENABLED: Final = 1
RS485_RTS_ON_SEND: Final = 2
RS485_RTS_AFTER_SEND: Final = 4
RS485_RX_DURING_TX: Final = 16

# struct serial_icounter_struct: cts dsr rng dcd rx tx frame overrun parity brk buf_overrun, nine reserved
TIOCGICOUNT: Final = 0x545D
_ICOUNT: Final = struct.Struct("=20I")


class UartErrors(NamedTuple):
    """Characters with an error since the driver was loaded, modulo 2**32."""

    frame: int
    overrun: int
    parity: int
    brk: int
    buf_overrun: int

    def since(self, before: UartErrors) -> dict[str, int]:
        """What came since ``before``, by name."""
        return {name: (now - then) % (1 << 32) for name, now, then in zip(self._fields, self, before, strict=True)}


def get_low_latency(fd: int) -> bool:
    """Whether the driver delivers at once."""
    buffer = bytearray(_SERIAL_SIZE)
    fcntl.ioctl(fd, TIOCGSERIAL, buffer, True)
    (flags,) = _FLAGS.unpack_from(buffer, _FLAGS_AT)
    return bool(flags & ASYNC_LOW_LATENCY)


def set_low_latency(fd: int, on: bool) -> bool:
    """Ask the driver to deliver at once (FTDI: 1 ms instead of 16), or no longer; returns what it was."""
    buffer = bytearray(_SERIAL_SIZE)
    fcntl.ioctl(fd, TIOCGSERIAL, buffer, True)
    (flags,) = _FLAGS.unpack_from(buffer, _FLAGS_AT)
    was = bool(flags & ASYNC_LOW_LATENCY)
    if was is not on:
        _FLAGS.pack_into(buffer, _FLAGS_AT, flags ^ ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, TIOCSSERIAL, buffer, True)
    return was


def get_rs485(fd: int) -> tuple[int, ...]:
    """The eight words of the RS-485 mode, flags first."""
    buffer = bytearray(_RS485.size)
    fcntl.ioctl(fd, TIOCGRS485, buffer, True)
    return _RS485.unpack(buffer)


def set_rs485(fd: int, words: tuple[int, ...]) -> None:
    """Set the eight words of the RS-485 mode."""
    fcntl.ioctl(fd, TIOCSRS485, bytearray(_RS485.pack(*words)), True)


def errors(fd: int) -> UartErrors:
    buffer = bytearray(_ICOUNT.size)
    fcntl.ioctl(fd, TIOCGICOUNT, buffer, True)
    return UartErrors(*_ICOUNT.unpack(buffer)[6:11])
