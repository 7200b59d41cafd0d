"""A serial driver that exists in memory only, and the sysfs tree of an adapter."""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from pathlib import Path

import pytest

_ioctl = fcntl.ioctl


class FakeDriver:
    """Answers the serial ioctls; what is None it has not (ENOTTY). Other requests go to the real descriptor.

    ``refuses``: requests answered with EINVAL; ``lacks``: with ENOTTY; ``deaf``: taken without effect. ``uart``: type
    and baud base of TIOCGSERIAL. ``asked``: the requests so far.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.flags: int | None = 0x40
        self.rs485: list[int] | None = [0] * 8
        self.counts: list[int] | None = [0] * 20
        self.refuses: set[int] = set()
        self.lacks: set[int] = set()
        self.deaf: set[int] = set()
        self.uart = (0, 0)
        self.asked: list[int] = []
        monkeypatch.setattr(fcntl, "ioctl", self.ioctl)

    def ioctl(self, fd: int, request: int, argument: bytearray | bytes = b"", mutate: bool = True) -> int:
        self.asked.append(request)
        if request in self.refuses:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        if request in self.lacks:
            raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))
        if request in self.deaf:
            return 0
        if request not in (0x541E, 0x541F, 0x542E, 0x542F, 0x545D):
            return self._real(fd, request, argument, mutate)
        assert isinstance(argument, bytearray)
        words = {0x541: self.flags, 0x542: self.rs485, 0x545: self.counts}[request >> 4]
        if words is None:
            raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))
        match request:
            case 0x541E:
                struct.pack_into("=i12xI8xi", argument, 0, self.uart[0], self.flags, self.uart[1])
            case 0x541F:
                (self.flags,) = struct.unpack_from("=I", argument, 16)
            case 0x542E:
                struct.pack_into("=8I", argument, 0, *(self.rs485 or ()))
            case 0x542F:
                self.rs485 = list(struct.unpack_from("=8I", argument))
            case 0x545D:
                struct.pack_into("=20I", argument, 0, *(self.counts or ()))
        return 0

    def _real(self, fd: int, request: int, argument: bytearray | bytes, mutate: bool) -> int:
        if isinstance(argument, bytearray):
            return int(_ioctl(fd, request, argument, mutate))
        _ioctl(fd, request, argument)
        return 0


def plug_in(root: Path, tty: str, usb: str = "0403:6001", driver: str = "ftdi_sio", latency: int | None = 16) -> Path:
    """An adapter in the sysfs tree ``root``; returns the folder of its settings."""
    interface = root / "devices" / "usb1" / "1-1" / "1-1:1.0"
    port = interface / tty
    port.mkdir(parents=True)
    vendor, _, product = usb.partition(":")
    if product:
        (interface.parent / "idVendor").write_text(vendor + "\n")
        (interface.parent / "idProduct").write_text(product + "\n")
    drivers = root / "bus" / "usb-serial" / "drivers" / driver
    drivers.mkdir(parents=True)
    (port / "driver").symlink_to(drivers)
    if latency is not None:
        (port / "latency_timer").write_text(f"{latency}\n")
        (port / "event_char").write_text("")
    devices = root / "bus" / "usb-serial" / "devices"
    devices.mkdir(parents=True)
    (devices / tty).symlink_to(port)
    (root / "class" / "tty" / tty).mkdir(parents=True)
    (root / "class" / "tty" / tty / "device").symlink_to(port)
    return port
