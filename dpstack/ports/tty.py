"""A serial port on Linux: 8E1 raw at any rate, read back, exclusive, and every refusal with what to do about it."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import glob
import grp
import os
import stat
import termios
from typing import Final

from dpstack.errors import BaudError, PortBusyError, PortError
from dpstack.ports import termios2
from dpstack.ports.base import Delivery
from dpstack.ports.fdport import FdPort, reason_of
from dpstack.units import baud_text

#: Read back within this share of the wanted rate it is the wanted rate: adapters divide 3 or 12 MHz.
_TOLERANCE: Final = 0.01
_PTY_MAJORS: Final = range(136, 144)  # Linux devices.txt: Unix98 pty slaves

# TIOCGSERIAL, TIOCSSERIAL: struct serial_struct, flags are its fifth int (Linux serial.h, tty_flags.h)
_TIOCGSERIAL: Final = 0x541E
_TIOCSSERIAL: Final = 0x541F
_ASYNC_LOW_LATENCY: Final = 1 << 13
_FLAGS_AT: Final = 16


class TtyPort(FdPort):
    """A tty by its path: a UART, a USB adapter, or the slave end of a pty (which has no parity and no pace)."""

    def __init__(self, name: str, baud: int, *, paced: bool | None = None) -> None:
        is_pty = _is_pty(name)
        super().__init__(name, baud, paced=not is_pty if paced is None else paced)
        self.delivery = Delivery.HOST if is_pty else Delivery.ADAPTER

    async def open(self) -> None:
        """Open, lock, set and flush. Raises PortError, PortBusyError, BaudError."""
        self.open_now()

    def open_now(self) -> None:
        """As :meth:`open`, for callers without a loop."""
        self.close()
        self.notices = []
        fd = self._open_file()
        try:
            self._check_and_lock(fd)
            self.notices += self._set(fd, self.baud)
            _ask_low_latency(fd)
            # Octets survive the last close of a pty, and a UART may have heard anything meanwhile.
            termios.tcflush(fd, termios.TCIOFLUSH)
        except termios.error as exc:
            os.close(fd)
            raise PortError(f"{self.name}: cannot be flushed ({exc.args[-1]})") from None
        except BaseException:
            os.close(fd)
            raise
        self._use(fd)

    def line_baud(self) -> int | None:
        """The rate the tty is set to."""
        return self.baud if self._fd >= 0 else None

    def set_baud(self, baud: int) -> None:
        """Set the open tty to ``baud``. Raises BaudError."""
        if self._fd < 0:
            raise BaudError(f"{self.name} is not open: its rate is set when it is opened")
        try:
            self._set(self._fd, baud)
        except BaudError:
            with contextlib.suppress(OSError):
                termios2.set_raw(self._fd, self.baud)
            raise
        self.baud = baud
        with contextlib.suppress(termios.error):  # a loss shows itself to the reader in the loop
            termios.tcflush(self._fd, termios.TCIFLUSH)

    def _open_file(self) -> int:
        try:
            return os.open(self.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            raise PortError(f"{self.name}: no such port; {_existing()}") from None
        except PermissionError:
            raise PortError(f"{self.name}: no permission; {_how_to_be_permitted(self.name)}") from None
        except IsADirectoryError:
            raise PortError(f"{self.name} is a directory, not a serial port; {_existing()}") from None
        except OSError as exc:
            if exc.errno == errno.EBUSY:
                raise PortBusyError(f"{self.name} is held by another program: end it or take another port") from None
            if exc.errno in (errno.ENXIO, errno.ENODEV, errno.EIO):
                raise PortError(f"{self.name}: no device behind it ({reason_of(exc)}); {_existing()}") from None
            raise PortError(f"{self.name}: cannot be opened ({reason_of(exc)})") from None

    def _check_and_lock(self, fd: int) -> None:
        if not os.isatty(fd):
            kind = _kind(os.fstat(fd).st_mode)
            raise PortError(f"{self.name} is no serial port but {kind}; {_existing()}")
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PortBusyError(
                f"{self.name} is held by {holder_of(fd)}: end that program or take another port"
            ) from None
        except OSError as exc:
            self.notices.append(f"cannot be locked ({reason_of(exc)}), other programs may open it too")

    def _set(self, fd: int, baud: int) -> list[str]:
        """Set the tty to ``baud`` 8E1; returns what is tolerated. Raises BaudError."""
        try:
            applied = termios2.set_raw(fd, baud)
        except OSError as exc:
            raise BaudError(
                f"{self.name} refuses {baud_text(baud)} 8E1 ({reason_of(exc)}): choose another rate or adapter"
            ) from None
        if abs(applied.baud - baud) > baud * _TOLERANCE:
            raise BaudError(
                f"{self.name} cannot do {baud_text(baud)}, it set itself to {baud_text(applied.baud)}: "
                f"choose another rate or adapter"
            )
        notices = []
        if applied.baud != baud:
            notices.append(f"runs at {applied.baud} bit/s instead of {baud}")
        if not applied.parity:
            notices.append("has no parity bit (8E1 was asked for), only check sums protect the data")
        return notices


def _ask_low_latency(fd: int) -> None:
    """Ask the driver to deliver at once (FTDI: 1 ms instead of 16). Many ports cannot; that is no fault."""
    serial = bytearray(128)
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, _TIOCGSERIAL, serial, True)
        flags = int.from_bytes(serial[_FLAGS_AT : _FLAGS_AT + 4], "little") | _ASYNC_LOW_LATENCY
        serial[_FLAGS_AT : _FLAGS_AT + 4] = flags.to_bytes(4, "little")
        fcntl.ioctl(fd, _TIOCSSERIAL, serial, True)


def _is_pty(name: str) -> bool:
    try:
        return os.major(os.stat(name).st_rdev) in _PTY_MAJORS
    except OSError:
        return name.startswith("/dev/pts/")


def _kind(mode: int) -> str:
    if stat.S_ISREG(mode):
        return "a file"
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        return "another device"
    return "something else"


def existing_ports() -> list[str]:
    """The paths of the serial ports that are plugged in, adapters by their lasting name where there is one."""
    by_id = {os.path.realpath(path): path for path in sorted(glob.glob("/dev/serial/by-id/*"))}
    devices = sorted(path for kind in ("USB", "ACM", "AMA", "XRUSB") for path in glob.glob(f"/dev/tty{kind}*"))
    return [f"{path} ({by_id[path]})" if path in by_id else path for path in devices]


def _existing() -> str:
    ports = existing_ports()
    if ports:
        return "these exist: " + ", ".join(ports)
    return 'no serial adapter is plugged in (try --port pty, or port = "virtual")'


def _how_to_be_permitted(name: str) -> str:
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        group = grp.getgrgid(os.stat(name).st_gid).gr_name
    if group == "root":
        return "ask the administrator for a udev rule that gives the port to the group dialout"
    return f"add yourself to the group {group} (sudo usermod -aG {group} $USER) and log in again"


def holder_of(fd: int) -> str:
    """Who holds the flock on the file behind ``fd``, as far as the kernel tells: "minicom (pid 4711)"."""
    info = os.fstat(fd)
    wanted = f"{os.major(info.st_dev):02x}:{os.minor(info.st_dev):02x}:{info.st_ino}"
    with contextlib.suppress(OSError), open("/proc/locks", encoding="ascii", errors="replace") as locks:
        for line in locks:
            fields = line.split()
            # "1: FLOCK ADVISORY WRITE 4711 00:18:5 0 EOF"; waiting ones have an arrow after the number
            if len(fields) > 5 and fields[1] == "FLOCK" and fields[5] == wanted:
                return _program(int(fields[4]))
    return "another program"


def _program(pid: int) -> str:
    if pid == os.getpid():
        return f"this program itself (pid {pid})"
    with contextlib.suppress(OSError), open(f"/proc/{pid}/comm", encoding="utf-8", errors="replace") as comm:
        return f"{comm.read().strip()} (pid {pid})"
    return f"pid {pid}" if pid > 0 else "another program"
