"""Serial adapters in sysfs: driver, USB identity, FTDI's latency timer and event character."""

from __future__ import annotations

import os
from typing import Final

from dpstack.ports.kernel_drivers import KernelDriver, kernel_driver

SYSFS: Final = "/sys"

#: USB vendor and product to chip and its highest rate in bit/s (makers' data sheets; by what users report)
CHIPS: Final[dict[str, tuple[str, int]]] = {
    "0403:6001": ("FTDI FT232R", 3_000_000),
    "0403:6010": ("FTDI FT2232", 12_000_000),
    "0403:6011": ("FTDI FT4232H", 12_000_000),
    "0403:6014": ("FTDI FT232H", 12_000_000),
    "0403:6015": ("FTDI FT-X", 3_000_000),
    "10c4:ea60": ("Silicon Labs CP210x", 3_000_000),
    "1a86:7523": ("WCH CH340", 2_000_000),
    "1a86:5523": ("WCH CH341", 2_000_000),
    "1a86:55d3": ("WCH CH343", 6_000_000),
    "1a86:55d4": ("WCH CH9102", 6_000_000),
    "067b:2303": ("Prolific PL2303", 6_000_000),
}
#: FTDI: an event character is enabled by this bit beside it
_EVENT_ON: Final = 0x100


class Adapter:
    """The adapter behind the tty ``name`` (a path or a link to it) as sysfs below ``root`` shows it. Opens no port."""

    def __init__(self, name: str, root: str | os.PathLike[str] = SYSFS) -> None:
        self._tty = os.path.basename(os.path.realpath(name))
        self._device = os.path.join(root, "class/tty", self._tty, "device")
        self._usb_serial = os.path.join(root, "bus/usb-serial/devices", self._tty)

    @property
    def driver(self) -> str | None:
        """The kernel driver, for instance ftdi_sio."""
        for place in (self._usb_serial, self._device):
            link = os.path.join(place, "driver")
            if os.path.exists(link):
                return os.path.basename(os.path.realpath(link))
        return None

    @property
    def usb(self) -> str | None:
        """``vendor:product`` in hex; None if it is no USB adapter."""
        folder = os.path.realpath(self._device if os.path.exists(self._device) else self._usb_serial)
        while True:
            vendor, product = (_read(os.path.join(folder, name)) for name in ("idVendor", "idProduct"))
            if vendor and product:
                return f"{vendor}:{product}".lower()
            above = os.path.dirname(folder)
            if above == folder:
                return None
            folder = above

    @property
    def kernel_driver(self) -> KernelDriver:
        """Abilities of its driver."""
        return kernel_driver(self.driver, usb=self.usb is not None)

    @property
    def latency_file(self) -> str:
        return os.path.join(self._usb_serial, "latency_timer")

    def latency_ms(self) -> int | None:
        """FTDI's latency timer in ms; None without one."""
        text = _read(self.latency_file)
        return int(text) if text is not None and text.isdecimal() else None

    def set_latency_ms(self, ms: int) -> None:
        """Raises OSError (as a rule: no permission)."""
        _write(self.latency_file, str(ms))

    def set_event_char(self, octet: int | None) -> None:
        """Let the chip deliver as soon as ``octet`` arrives (None: off). Raises OSError, also if it is no FTDI."""
        _write(os.path.join(self._usb_serial, "event_char"), str(0 if octet is None else _EVENT_ON | octet))


def _read(path: str) -> str | None:
    try:
        with open(path, encoding="ascii", errors="replace") as file:
            return file.read().strip()
    except OSError:
        return None


def _write(path: str, text: str) -> None:
    """Write to an existing file, and never create it."""
    fd = os.open(path, os.O_WRONLY | os.O_TRUNC | os.O_CLOEXEC)
    try:
        os.write(fd, text.encode())
    finally:
        os.close(fd)
