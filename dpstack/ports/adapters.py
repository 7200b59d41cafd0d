"""List of the serial adapters of this computer (``dpstack ports``), and test of what one of them can do."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

from msgspec import Struct, field

from dpstack.errors import BaudError, PortError
from dpstack.ports.holders import PROC, holder_of_path
from dpstack.ports.kernel_drivers import KernelDriver, kernel_driver
from dpstack.ports.posix import importing_pyserial
from dpstack.ports.sysfs import CHIPS, SYSFS, Adapter
from dpstack.units import BAUD_RATES

BY_ID: Final = Path("/dev/serial/by-id")


class AdapterInfo(Struct, frozen=True, kw_only=True):
    """One serial port of this computer. ``by_id`` is its lasting path, ``usb`` vendor:product in hex."""

    path: str
    by_id: str | None
    chip: str
    driver: str | None
    usb: str | None
    serial: str | None
    holder: str | None
    #: the class of its driver
    kernel_driver: KernelDriver | None = None

    def as_dict(self) -> dict[str, object]:
        """The object of ``dpstack ports --json``."""
        told = {name: getattr(self, name) for name in self.__struct_fields__ if name != "kernel_driver"}
        known = self.kernel_driver
        if known is None:
            return {**told, "marks": None, "hamming_distance": None, "max_baud": None}
        return {**told, "marks": known.marks.value, "hamming_distance": known.distance, "max_baud": known.most}

    def class_lines(self) -> list[str]:
        """Abilities of its driver, one line each: damaged octets, rates, delay, RS-485."""
        known = self.kernel_driver
        if known is None:
            return []
        rs485 = "the adapter switches its direction itself" if self.usb else "by the driver (TIOCSRS485), if it has it"
        return [
            f"damaged octets: {known.protection}",
            f"rates: {known.rates}",
            f"delay: {known.delay}",
            f"RS-485: {rs485}",
        ]


def _comports() -> Iterable[Any]:
    with importing_pyserial("the list of serial adapters"):
        from serial.tools import list_ports

    ports: Iterable[Any] = list_ports.comports()
    return ports


def list_adapters(
    comports: Callable[[], Iterable[Any]] = _comports,
    *,
    by_id: Path = BY_ID,
    sysfs: Path = Path(SYSFS),
    proc: Path = Path(PROC),
) -> list[AdapterInfo]:
    """All serial ports that pyserial finds, by path. No port is opened."""
    lasting = {os.path.realpath(link): str(link) for link in sorted(by_id.glob("*"))}
    found = []
    for port in comports():
        adapter = Adapter(port.device, sysfs)
        usb = None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}"
        chip = CHIPS[usb][0] if usb in CHIPS else str(port.description or "")
        found.append(
            AdapterInfo(
                path=port.device,
                by_id=lasting.get(os.path.realpath(port.device)),
                chip="" if chip == "n/a" else chip,
                driver=adapter.driver,
                usb=usb,
                serial=port.serial_number,
                holder=holder_of_path(port.device, proc),
                kernel_driver=kernel_driver(adapter.driver, usb=usb is not None) if sys.platform == "linux" else None,
            )
        )
    return sorted(found, key=lambda info: info.path)


class Abilities(Struct, kw_only=True):
    """The abilities of a port, found by opening it; nothing is sent. ``rates`` in bit/s, of those that dpstack opens.

    ``latency_ms``: FTDI's latency timer while low latency is asked for; None: it has no such timer.
    """

    parity: bool = False
    low_latency: bool = False
    rs485: bool = False
    counters: bool = False
    marks: bool = False
    latency_ms: int | None = None
    rates: list[int] = field(default_factory=list)


def probe(path: str) -> Abilities:
    """Open ``path`` exclusively, try every rate and each ability of its driver. Linux only. Raises PortError."""
    from dpstack.ports import termios2, tuning

    if sys.platform != "linux" or not termios2.AVAILABLE:
        raise PortError(f"{path}: what a port can do is found out on Linux only")
    from dpstack.ports.tty import TtyPort

    port = TtyPort(path, BAUD_RATES[0], listen=True)
    found = Abilities()
    try:
        for baud in BAUD_RATES:
            port.baud = baud
            with contextlib.suppress(BaudError):
                port.open_now()
                found.rates.append(baud)
        if found.rates:
            port.baud = found.rates[0]
            port.open_now()
        fd = port.fd
        if fd is not None:  # the port was tuned when it was opened
            found.low_latency = _answers(lambda fd: tuning.low_latency(fd, True), fd)
            found.latency_ms = Adapter(path).latency_ms()
            found.rs485 = _answers(tuning.try_rs485, fd)
            found.counters = _answers(tuning.uart_errors, fd)
            applied = termios2.set_raw(fd, None, marks=True)
            found.parity, found.marks = applied.parity, applied.marks and not port.driver.is_weak
    finally:
        port.close()
    return found


def _answers(ask: Callable[[int], object], fd: int) -> bool:
    try:
        ask(fd)
    except OSError:
        return False
    return True
