"""A serial port on Linux: 8E1 raw at any rate, read back and locked. Each refusal says what to do about it."""

from __future__ import annotations

import contextlib
import errno
import glob
import os
import stat
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Final

from dpstack.errors import BaudError, PortBusyError, PortError
from dpstack.phy.marked import MarkedOctets
from dpstack.ports import termios2
from dpstack.ports.base import Delivery, reason_of
from dpstack.ports.fdport import FdPort, write_nothing
from dpstack.ports.holders import hides_programs, holder_of, holder_of_path, keep_off, other_openers
from dpstack.ports.kernel_drivers import Marks
from dpstack.ports.posix import fcntl, grp, termios
from dpstack.ports.sysfs import SYSFS, Adapter
from dpstack.ports.tuning import Tuning, clock_of_uart, divided, drop_rts, uart_errors
from dpstack.units import NS_PER_MS, baud_text

#: A rate read back within this share of the wanted one is accepted: adapters divide 3 or 12 MHz.
_TOLERANCE: Final = 0.01
_MARK: Final = 0xFF
_PTY_MAJORS: Final = range(136, 144)  # Linux devices.txt: Unix98 pty slaves
#: the count of a damaged octet comes so late at most behind the octet: the longest poll interval of an interrupt
#: endpoint at full speed, 255 frames (USB 2.0, 9.6.6)
_COUNTED_LATE_NS: Final = 255 * NS_PER_MS


class TtyPort(FdPort):
    """A tty by its path: a UART, a USB adapter, or the slave end of a pty (which has no parity and no pace).

    ``listen``: only for listening. It is opened for reading only, RTS is dropped at once, the RS-485 mode is left as
    it is, and octets that the tty marks as damaged are kept (:class:`MarkedOctets`).
    """

    def __init__(
        self,
        name: str,
        baud: int,
        *,
        paced: bool | None = None,
        marks: bool | None = None,
        event_char: bool = False,
        rs485: bool = True,
        listen: bool = False,
        sysfs: str | os.PathLike[str] = SYSFS,
    ) -> None:
        is_pty = is_pty_path(name)
        super().__init__(name, baud, paced=not is_pty if paced is None else paced)
        self.delivery = Delivery.HOST if is_pty else Delivery.ADAPTER
        self._event_char = event_char
        self._rs485 = rs485 and not listen
        self._listen = listen
        self._sysfs = sysfs
        self._marks = not is_pty if marks is None else marks
        self._adapter = Adapter(name, sysfs)
        #: the class of its driver
        self.driver = self._adapter.kernel_driver
        self._set_to = termios2.Settings(0, 0, 0)  # as it was set last
        self._errors = 0  # the driver's count of damaged octets at the last look, if it only counts them
        self._unmarker = Unmarker(keep=listen)
        self._unmark = False
        self._counted: Counter[str] = Counter()  # the driver's counters up to the last close
        self._tuning: Tuning | None = None

    def open_now(self) -> None:
        """Open, lock, set and flush. Raises PortError, PortBusyError, BaudError."""
        self.close()
        self.notices = []
        fd = self._open_file()
        self._adapter = Adapter(self.name, self._sysfs)
        self.driver = self._adapter.kernel_driver
        try:
            if self._listen:  # the system has raised it; drop it before anything that takes time
                drop_rts(fd)
            self._check_and_lock(fd)
            self.notices += self._set(fd, self.baud)
            # octets survive the last close of a pty, and a UART may have received others meanwhile
            termios.tcflush(fd, termios.TCIOFLUSH)
            if self.delivery is Delivery.ADAPTER:
                self._unmarker.packets = self.driver.marks in (Marks.PACKET, Marks.MISPLACED)
                self._tuning = Tuning(fd, self._adapter, event_char=self._event_char, rs485=self._rs485)
                self.notices += self._tuning.notices
                self.notices += self._of_class()
                self._hold_alone(fd)
            self.damaged_octets = self._damaged_octets()
            if self._listen and not drop_rts(fd) and self.delivery is Delivery.ADAPTER:
                self.notices.append("its RTS line cannot be dropped: a converter that RTS switches would drive the bus")
        except termios.error as exc:
            os.close(fd)
            raise PortError(f"{self.name}: cannot be flushed ({exc.args[-1]})") from None
        except BaseException:
            os.close(fd)
            raise
        self._use(fd)

    def _of_class(self) -> list[str]:
        """Notices on what the class of the driver lacks."""
        notices = [self.driver.protection] if self.driver.is_weak and not self._listen else []
        if not self.driver.tells_rate:
            notices.append(f"its driver {self.driver.name} does not say which rate the adapter makes")
        return notices

    def _hold_alone(self, fd: int) -> None:
        """Let nobody else open the tty: another reader steals octets, and ``stty`` reaches the chip at once. Not on a
        pty, where this would outlive the last close."""
        with contextlib.suppress(OSError):
            fcntl.ioctl(fd, termios.TIOCEXCL)

    def _damaged_octets(self) -> str:
        if self.delivery is Delivery.ADAPTER and self.driver.marks in (Marks.NONE, Marks.UNKNOWN, Marks.COUNTED):
            count = "only counts damaged octets" if self.driver.marks is Marks.COUNTED else "marks no damaged octet"
            return f"the port {count}: {self.driver.protection}"
        if not self._unmark:
            return "the port does not report damaged octets" if not self._marks else "the port drops damaged octets"
        if not self._listen:
            return "the port drops octets with a parity or framing error"
        if self._unmarker.packets:
            return "octets with a parity or framing error are marked, by whole packets of the adapter"
        return "octets with a parity or framing error are marked at their place"

    def damage(self) -> dict[str, int]:
        """``marked``: octets that the tty has marked as damaged; the others are the driver's counters."""
        counted = Counter(self._counted) + Counter(super().damage())
        if self._tuning is not None:
            counted.update(self._tuning.damage())
        if self._marks:
            counted["marked"] = self._unmarker.damaged
        return dict(counted)

    def inspection(self) -> Callable[[], list[str]] | None:
        if self._fd < 0 or self.delivery is not Delivery.ADAPTER:
            return None
        fd = os.dup(self._fd)  # the port may be closed meanwhile, and the number belong to another file
        return partial(self._inspect, fd, self.baud, self._set_to)

    def _inspect(self, fd: int, baud: int, wanted: termios2.Settings) -> list[str]:
        """See :meth:`inspection`. Closes ``fd``. Raises OSError."""
        try:
            others = other_openers(self.name)
            found = []
            now = termios2.settings(fd)
            if now != wanted:
                termios2.set_raw(fd, baud, marks=self._marks)
                frame = "" if now.frame == wanted.frame else ", another frame than 8E1"
                done = f"it is set to {baud_text(baud)} 8E1 again"
                found.append(f"another program has set it to {baud_text(now.baud)}{frame}; {done}")
        finally:
            os.close(fd)
        for holder in others:
            todo = keep_off(holder, self._adapter.usb) or "end that program"
            found.append(f"{holder} has it open, too, and takes octets away: {todo}")
        if found and not others and hides_programs():
            found[0] += ": a process of another user may have it, which only root can see (sudo fuser -v)"
        return found

    def line_baud(self) -> int | None:
        return self.baud if self._fd >= 0 else None

    def set_baud(self, baud: int) -> None:
        if self._fd < 0:
            raise self._not_open()
        try:
            self._set(self._fd, baud)
        except BaudError:
            with contextlib.suppress(OSError):
                termios2.set_raw(self._fd, self.baud, marks=self._marks)
            raise
        self.baud = baud
        self._unmarker.reset()
        with contextlib.suppress(termios.error):  # the reader in the loop notices a loss
            termios.tcflush(self._fd, termios.TCIFLUSH)

    def _open_file(self) -> int:
        try:
            access = os.O_RDONLY if self._listen else os.O_RDWR
            return os.open(self.name, access | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            raise PortError(f"{self.name}: no such port; {_existing()}") from None
        except PermissionError:
            raise PortError(f"{self.name}: no permission; {how_to_be_permitted(self.name)}") from None
        except IsADirectoryError:
            raise PortError(f"{self.name} is a directory, not a serial port; {_existing()}") from None
        except OSError as exc:
            if exc.errno == errno.EBUSY:
                holder = holder_of_path(self.name)
                raise PortBusyError(f"{self.name} is held by {_held(holder, self._adapter.usb)}") from None
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
            raise PortBusyError(f"{self.name} is held by {_held(holder_of(fd), self._adapter.usb)}") from None
        except OSError as exc:
            self.notices.append(f"cannot be locked ({reason_of(exc)}), other programs may open it too")

    def _set(self, fd: int, baud: int) -> list[str]:
        """Set the tty to ``baud`` 8E1; returns notices on what failed and is tolerated. Raises BaudError."""
        if self.driver.most is not None and baud > self.driver.most:
            most = f"its driver {self.driver.name} sends its chip {baud_text(self.driver.most)} at most"
            raise self._cannot(baud, f"{most}, whatever it reads back")
        try:
            applied = termios2.set_raw(fd, baud, marks=self._marks)
        except OSError as exc:
            raise self._refuses(baud, reason_of(exc)) from None
        clock = clock_of_uart(fd) if self.delivery is Delivery.ADAPTER and self._adapter.usb is None else None
        made = applied.baud if clock is None else divided(clock, baud)
        if abs(made - baud) > baud * _TOLERANCE:
            if clock is not None:
                raise self._cannot(baud, f"its chip divides {baud_text(clock)} and makes {baud_text(made)} of it")
            if applied.kept:
                raise self._cannot(baud, "its driver keeps the rate that was set before")
            raise self._cannot(baud, f"it set itself to {baud_text(applied.baud)}")
        notices = []
        if made != baud:
            notices.append(f"runs at {made} bit/s instead of {baud}")
        if not applied.parity:
            notices.append("has no parity bit (8E1 was asked for), only check sums protect the data")
        if applied.differs:
            notices.append(f"reads back with {', '.join(applied.differs)}, where 8E1 was asked for: the bus needs 8E1")
        self._unmark = applied.marks
        self._set_to = termios2.settings(fd)
        return notices

    def _cannot(self, baud: int, why: str) -> BaudError:
        return BaudError(f"{self.name} cannot do {baud_text(baud)}, {why}: choose another rate or adapter")

    def _use(self, fd: int) -> None:
        super()._use(fd)
        if self._listen:
            self._send = write_nothing
        if self._unmark:
            self._unmarker.reset()
            self._read = self._read_unmarked
        if self.delivery is Delivery.ADAPTER and self.driver.marks is Marks.COUNTED and not self._listen:
            with contextlib.suppress(OSError):
                self._errors = self._count(fd)
                self._read = self._read_counted

    @staticmethod
    def _count(fd: int) -> int:
        """Damaged octets that the driver has counted: parity and framing errors."""
        errors = uart_errors(fd)
        return errors["parity"] + errors["frame"]

    def _read_counted(self, size: int) -> bytes:
        """Like :meth:`_read_unmarked`, for a driver that only counts damaged octets: those that come together with a
        new count are dropped, and what was delivered shortly before is in doubt. Raises OSError."""
        octets = self._read_unmarked(size) if self._unmark else os.read(self._fd, size)
        errors = self._count(self._fd)
        if errors == self._errors:
            return octets
        self._errors = errors
        if self.on_doubt is not None:
            self.on_doubt(_COUNTED_LATE_NS)
        if octets:
            raise BlockingIOError
        return octets

    def _read_unmarked(self, size: int) -> bytes:
        """Intact octets (for listening: all, with their marks); empty only at the end of the file, like ``os.read``.

        Raises OSError.
        """
        chunk = os.read(self._fd, size)
        octets = self._unmarker.feed(chunk)
        if chunk and not octets:
            raise BlockingIOError  # nothing but marks
        return octets

    def release_after_fork(self) -> None:
        # the lock and the settings belong to the open file, which is the parent's
        self._tuning = None
        super().release_after_fork()

    def close(self) -> None:
        self.detach()
        tuning, self._tuning = self._tuning, None
        if tuning is not None:
            self._counted.update(tuning.damage())
            tuning.restore()
        if self._fd >= 0:
            with contextlib.suppress(OSError):  # a process forked meanwhile has the descriptor, and the lock, too
                if self.delivery is Delivery.ADAPTER:
                    fcntl.ioctl(self._fd, termios.TIOCNXCL)
                fcntl.flock(self._fd, fcntl.LOCK_UN)
        super().close()

    def _hung_up(self, reason: str) -> None:
        if self.delivery is Delivery.ADAPTER:
            reason = "the adapter is gone: its plug was pulled, or it lost its power"
        super()._hung_up(reason)


def is_pty_path(name: str) -> bool:
    """Whether ``name`` is the slave end of a pty."""
    try:
        return os.major(os.stat(name).st_rdev) in _PTY_MAJORS
    except OSError:
        return name.startswith("/dev/pts/")


def _held(holder: str | None, usb: str | None) -> str:
    """The holder of a port, and what to do."""
    if holder is None:
        unseen = " of another user, which only root can see (sudo fuser -v)" if hides_programs() else ""
        return f"another program{unseen}: end it or take another port"
    return f"{holder}: {keep_off(holder, usb) or 'end that program or take another port'}"


def _kind(mode: int) -> str:
    if stat.S_ISREG(mode):
        return "a file"
    if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
        return "another device"
    return "something else"


def existing_ports() -> list[str]:
    """The paths of the serial ports that are plugged in, adapters by their lasting name if there is one."""
    by_id = {os.path.realpath(path): path for path in sorted(glob.glob("/dev/serial/by-id/*"))}
    devices = sorted(path for kind in ("USB", "ACM", "AMA", "XRUSB") for path in glob.glob(f"/dev/tty{kind}*"))
    return [f"{path} ({by_id[path]})" if path in by_id else path for path in devices]


def _existing() -> str:
    ports = existing_ports()
    if ports:
        return "these exist: " + ", ".join(ports)
    return 'no serial adapter is plugged in (without one: a port of `dpstack segment`, or port = "virtual")'


def how_to_be_permitted(name: str) -> str:
    """Advice to a user who has no permission on ``name``."""
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        group = grp.getgrgid(os.stat(name).st_gid).gr_name
    if group == "root":
        return "ask the administrator for a udev rule that gives the port to the group dialout"
    return f"add yourself to the group {group} (sudo usermod -aG {group} $USER) and log in again"


class Unmarker:
    """Takes the marks of damaged characters (PARMRK) out of the octets of a tty. Marks may be cut by a chunk's end.

    With INPCK and PARMRK and without IGNPAR a character with a parity or framing error arrives as FF 00 x, and a
    genuine FF is doubled (termios(3)). A damaged octet is dropped, as with IGNPAR: the telegram becomes too short, as
    its length and FCS reveal. ``damaged`` counts these octets, which IGNPAR would not. ``odd``: FF followed by neither
    FF nor 00, which should not occur: read as two octets.

    ``keep``: damaged octets are kept, with their places; ``packets``: the driver marks whole packets alike.
    """

    __slots__ = ("_held", "_keep", "damaged", "odd", "packets")

    def __init__(self, *, keep: bool = False) -> None:
        self._keep = keep
        self.packets = False
        self.damaged = 0
        self.odd = 0
        self._held = b""  # the beginning of an incomplete mark

    def feed(self, chunk: bytes) -> bytes:
        if not self._held and _MARK not in chunk:
            return chunk
        octets, self._held = self._held + chunk, b""
        kept = bytearray()
        places: list[int] = []
        at, end = 0, len(octets)
        while True:
            mark = octets.find(_MARK, at)
            if mark < 0:
                kept += octets[at:]
                return self._with_marks(kept, places)
            kept += octets[at:mark]
            second = octets[mark + 1] if mark + 1 < end else None
            if second is None or (second == 0 and mark + 2 >= end):
                self._held = octets[mark:]
                return self._with_marks(kept, places)
            if second == _MARK:
                kept.append(_MARK)
                at = mark + 2
            elif second == 0:
                self.damaged += 1
                if self._keep:
                    places.append(len(kept))
                    kept.append(octets[mark + 2])
                at = mark + 3
            else:
                self.odd += 1
                kept += octets[mark : mark + 2]
                at = mark + 2

    def _with_marks(self, kept: bytearray, places: list[int]) -> bytes:
        """``kept`` with its marks, if there are any. If all octets are marked, perhaps the adapter marks packets."""
        if not places:
            return bytes(kept)
        return MarkedOctets(bytes(kept), tuple(places), packets=self.packets or 1 < len(places) == len(kept))

    def reset(self) -> None:
        """Forget an incomplete mark, after the line was opened again. The counters stay."""
        self._held = b""
