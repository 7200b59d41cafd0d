"""Tuning of an open Linux serial port: low latency, RS-485 mode, error counters; restored at the end.

A driver that lacks one of them is tolerated; a notice says so, and ``dpstack doctor`` explains it. The functions for
ioctl raise OSError (ENOTTY or EINVAL as a rule) if the driver lacks it. Numbers and layouts: Linux serial.h,
tty_flags.h, asm-generic/ioctls.h.
"""

from __future__ import annotations

import contextlib
import errno
import struct
from collections.abc import Callable
from typing import Final, TypeVar

from dpstack.ports.base import reason_of
from dpstack.ports.posix import fcntl, termios
from dpstack.ports.sysfs import Adapter

T = TypeVar("T")

#: types of serial.h whose divisor is a whole number: 8250 to 16550A, 16650, 16750, 16654, 16850, NS16550A
_WHOLE_DIVISORS: Final = frozenset({1, 2, 3, 4, 6, 7, 8, 11, 12, 14})

#: every telegram with data ends with ED; SC and the token do not, and ED within data only causes an early packet
ED: Final = 0x16

# struct serial_struct: flags are its fifth int
TIOCGSERIAL: Final = 0x541E
TIOCSSERIAL: Final = 0x541F
ASYNC_LOW_LATENCY: Final = 1 << 13
_SERIAL_SIZE: Final = 128
_FLAGS: Final = struct.Struct("=I")
_FLAGS_AT: Final = 16
_TYPE_AND_BASE: Final = struct.Struct("=i24xi")

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


#: its sixth to tenth counters
_CAUSES: Final = ("frame", "overrun", "parity", "brk", "buf_overrun")


def low_latency(fd: int, on: bool) -> bool:
    """Let the driver deliver octets at once (FTDI: after 1 ms instead of 16), or not. Returns whether it did before.

    Raises OSError also if the driver takes the setting and does not keep it: it has no such mode.
    """
    buffer = _query(fd, TIOCGSERIAL, _SERIAL_SIZE)
    (flags,) = _FLAGS.unpack_from(buffer, _FLAGS_AT)
    was = bool(flags & ASYNC_LOW_LATENCY)
    if was is not on:
        _FLAGS.pack_into(buffer, _FLAGS_AT, flags ^ ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, TIOCSSERIAL, buffer, True)
        (flags,) = _FLAGS.unpack_from(_query(fd, TIOCGSERIAL, _SERIAL_SIZE), _FLAGS_AT)
        if bool(flags & ASYNC_LOW_LATENCY) is not on:
            raise _has_not("low-latency mode")
    return was


def clock_of_uart(fd: int) -> int | None:
    """The rate of a PC's UART at the divisor 1, which divides it by whole numbers; None for others, and for those that
    do not say it. The rate that such a port reads back is the one it was asked for, whatever the chip makes."""
    try:
        kind, base = _TYPE_AND_BASE.unpack_from(_query(fd, TIOCGSERIAL, _SERIAL_SIZE))
    except OSError:
        return None
    return base if kind in _WHOLE_DIVISORS and base > 0 else None


def divided(clock: int, baud: int) -> int:
    """The rate in bit/s that a UART with ``clock`` makes for the wish ``baud``: as the kernel chooses its divisor."""
    return round(clock / max(1, (clock + baud // 2) // baud))


def get_rs485(fd: int) -> tuple[int, ...]:
    """The eight words of the RS-485 mode, flags first."""
    return _RS485.unpack(_query(fd, TIOCGRS485, _RS485.size))


def set_rs485(fd: int, words: tuple[int, ...]) -> None:
    """Set the RS-485 mode, flags first. Raises OSError also if the driver takes it and does not keep it."""
    fcntl.ioctl(fd, TIOCSRS485, bytearray(_RS485.pack(*words)), True)
    if (get_rs485(fd)[0] ^ words[0]) & RS485_ENABLED:
        raise _has_not("RS-485 mode")


def try_rs485(fd: int) -> None:
    """Raises OSError if the driver has no RS-485 mode. Only setting shows it (here: what is set already): a port
    without the mode answers the question after it with zeros."""
    set_rs485(fd, get_rs485(fd))


def uart_errors(fd: int) -> dict[str, int]:
    """Characters with an error since the driver was loaded, modulo 2**32, by cause."""
    return dict(zip(_CAUSES, _ICOUNT.unpack(_query(fd, TIOCGICOUNT, _ICOUNT.size))[6:11], strict=True))


def drop_rts(fd: int) -> bool:
    """Drop RTS, which the system raises when it opens a tty; False if the tty has no such line."""
    try:
        fcntl.ioctl(fd, termios.TIOCMBIC, struct.pack("=I", termios.TIOCM_RTS))
    except OSError:
        return False
    return True


def _has_not(what: str) -> OSError:
    """As a driver answers that does not know the request."""
    return OSError(errno.ENOTTY, f"no {what}")


def _query(fd: int, request: int, size: int) -> bytearray:
    buffer = bytearray(size)
    fcntl.ioctl(fd, request, buffer, True)
    return buffer


class Tuning:
    """The settings of one open descriptor.

    ``event_char``: let an FTDI deliver at every ED octet instead of waiting for its timer. ``rs485`` False: the
    driver's RS-485 mode is left as it is (a converter behind an RS-232 port switches by itself). ``notices``: one line
    for each thing that is tolerated. ``errors``: the driver's error counters at the start, None if it has none.
    """

    def __init__(self, fd: int, adapter: Adapter, *, event_char: bool = False, rs485: bool = True) -> None:
        self.notices: list[str] = []
        self._fd = fd
        self._adapter = adapter
        self._undo: list[Callable[[], object]] = []
        self._missing: list[str] = []
        if self._try("low-latency mode", lambda: low_latency(fd, True)) is False:
            self._undo.append(lambda: low_latency(fd, False))
        self._latency_timer()
        if rs485:
            self._rs485()
        self.errors = self._try("error counters", lambda: uart_errors(fd))
        if event_char:
            self._event_char()
        if self._missing:
            self.notices.append(f"its driver has no {', no '.join(self._missing)} (see `dpstack doctor`)")

    def restore(self) -> None:
        """Restore all settings, as far as the port is still there."""
        undo, self._undo = self._undo, []
        for step in reversed(undo):
            with contextlib.suppress(OSError):
                step()

    def damage(self) -> dict[str, int]:
        """The driver's error counts since the start, by name; empty if it cannot count."""
        if self.errors is None:
            return {}
        try:
            now = uart_errors(self._fd)
        except OSError:  # the device was unplugged
            return {}
        return {cause: (now[cause] - then) % (1 << 32) for cause, then in self.errors.items()}

    def _try(self, what: str, step: Callable[[], T]) -> T | None:
        """The result of ``step``; None if the driver does not have ``what``."""
        try:
            return step()
        except OSError:
            self._miss(what)
            return None

    def _miss(self, what: str) -> None:
        """Note that a port of the computer lacks ``what``. No USB adapter needs it: it switches its direction by
        itself, and the class of its driver says the rest."""
        if self._adapter.usb is None:
            self._missing.append(what)

    def _latency_timer(self) -> None:
        """FTDI's latency timer: newer kernels set it with the low-latency mode, for others sysfs may."""
        before = self._adapter.latency_ms()
        if before is None or before <= 1:
            return
        try:
            self._adapter.set_latency_ms(1)
        except OSError as exc:
            self.notices.append(
                f"its latency timer stays at {before} ms ({reason_of(exc)}), which every exchange may cost: "
                f"run once what `dpstack doctor --fix` says"
            )
            return
        self._undo.append(lambda: self._adapter.set_latency_ms(before))

    def _rs485(self) -> None:
        try:
            before = get_rs485(self._fd)
        except OSError:
            self._miss("RS-485 mode")
            return
        if before[0] & RS485_ENABLED:
            return  # set by the administrator or by the device tree
        off = RS485_RTS_AFTER_SEND | RS485_RX_DURING_TX
        flags = before[0] & ~off | RS485_ENABLED | RS485_RTS_ON_SEND
        try:
            set_rs485(self._fd, (flags, *before[1:]))
        except OSError as exc:
            if exc.errno == errno.ENOTTY:
                self._miss("RS-485 mode")
                return
            self.notices.append(f"its driver refuses the RS-485 mode ({reason_of(exc)}): who switches the direction?")
            return
        self._undo.append(lambda: set_rs485(self._fd, before))

    def _event_char(self) -> None:
        try:
            self._adapter.set_event_char(ED)
        except OSError as exc:
            self.notices.append(f"event_char cannot be set ({reason_of(exc)}): it is for FTDI chips, leave it out")
            return
        self._undo.append(lambda: self._adapter.set_event_char(None))
