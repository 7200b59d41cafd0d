"""Processors of this computer on Linux: the ones of the bus process, isolated ones, sleep states, interrupts of a port.

The bus process takes its processors from ``[bus] cpu`` (:func:`run_on`) and keeps all processors from deep sleep while
a fixed cycle runs (:class:`AwakeProcessors`). ``dpstack doctor`` reads the rest. The places in ``/sys``, ``/proc`` and
``/dev`` are parameters, for tests.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.text import runs_of

if TYPE_CHECKING:  # the bus process starts sooner without it
    from pathlib import Path

#: an open descriptor with a number of microseconds written to it limits the wake-up time (linux/pm_qos.h)
CPU_DMA_LATENCY: Final = "/dev/cpu_dma_latency"
#: 0 us as the kernel reads it: s32
_AT_ONCE: Final = bytes(4)
_USB_BUS: Final = r"usb\d+"


class AwakeProcessors:
    """Keeps the processors out of sleep states that take time to leave, while :meth:`hold` said so.

    Without the right to open the file at ``path`` nothing is held: ``dpstack doctor`` says so. The kernel ends the
    request with the descriptor, also after the death of this process.
    """

    def __init__(self, path: str | Path = CPU_DMA_LATENCY) -> None:
        self._path = path
        self._fd: int | None = None
        self._wanted = False

    def is_held(self) -> bool:
        """Whether the request to the kernel stands."""
        return self._fd is not None

    def hold(self, wanted: bool) -> None:
        """Begin or end the request; cheap if nothing changes. Does not raise."""
        if wanted is self._wanted:
            return
        self._wanted = wanted
        fd, self._fd = self._fd, None
        if fd is not None:
            os.close(fd)
        if wanted:
            with contextlib.suppress(OSError):
                fd = os.open(self._path, os.O_WRONLY | os.O_CLOEXEC)
                try:
                    os.write(fd, _AT_ONCE)
                except OSError:
                    os.close(fd)
                    raise
                self._fd = fd


def run_on(processors: Sequence[int], sysfs: str | Path = "/sys") -> None:
    """Let this process run on these processors only. Raises ConfigError if one is missing or not permitted."""
    wanted = set(processors)
    there = listed(os.path.join(sysfs, "devices/system/cpu/online"))
    if there and not wanted <= there:
        raise ConfigError(
            f"[bus]: cpu = {text_of(wanted)}: processor {min(wanted - there)} is not there (online: {text_of(there)})"
        )
    try:
        os.sched_setaffinity(0, wanted)
        permitted = os.sched_getaffinity(0)
    except OSError:
        permitted = os.sched_getaffinity(0) - wanted
    if permitted != wanted:  # the kernel leaves out what a control group does not permit
        raise ConfigError(
            f"[bus]: cpu = {text_of(wanted)}: this process may not run on processor {min(wanted - permitted)} "
            f"(permitted: {text_of(permitted)}); a container or a control group (cpuset) limits it"
        )


def listed(path: str | Path) -> set[int]:
    """The processors in a file of the kernel, such as ``0-3,6``; empty without the file."""
    try:
        with open(path, encoding="ascii") as file:
            text = file.read().strip()
    except (OSError, ValueError):
        return set()
    found: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        if first.isdecimal() and (not last or last.isdecimal()):
            found.update(range(int(first), int(last or first) + 1))
    return found


def text_of(processors: Iterable[int]) -> str:
    """Processors as the kernel lists them: ``0-3,6``."""
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in runs_of(processors)) or "none"


def isolated(sysfs: Path) -> set[int]:
    """Processors without other programs (``isolcpus``), and those without timer ticks (``nohz_full``)."""
    folder = sysfs / "devices/system/cpu"
    return listed(folder / "isolated") | listed(folder / "nohz_full")


def slowest_wake_up_us(sysfs: Path) -> int | None:
    """The longest wake-up time of the sleep states of processor 0, in us; None if none are known."""
    times = []
    for path in sorted((sysfs / "devices/system/cpu/cpu0/cpuidle").glob("state*/latency")):
        with contextlib.suppress(OSError, ValueError):
            times.append(int(path.read_text("ascii")))
    return max(times, default=None)


class Interrupts(Struct, frozen=True):
    """Interrupts of the USB controller of a port: their ``numbers``, and the processors that may get them."""

    controller: str
    numbers: tuple[int, ...]
    processors: frozenset[int]


def interrupts_of(tty: str, sysfs: Path, proc: Path) -> Interrupts | None:
    """The interrupts of the USB controller of ``tty`` (a path or a link); None if it has none, or they are not
    known."""
    import re  # here, as a bus process does not ask

    device = (sysfs / "class/tty" / os.path.basename(os.path.realpath(tty)) / "device").resolve()
    bus = next((folder for folder in device.parents if re.fullmatch(_USB_BUS, folder.name)), None)
    if bus is None:
        return None
    controller = bus.parent
    numbers = sorted(int(path.name) for path in (controller / "msi_irqs").glob("[0-9]*"))
    if not numbers:
        numbers = sorted({*listed(controller / "irq")} - {0}) or _named_interrupts(bus.name, proc)
    processors: set[int] = set()
    for number in numbers:
        processors |= listed(proc / "irq" / str(number) / "smp_affinity_list")
    return Interrupts(controller.name, tuple(numbers), frozenset(processors)) if processors else None


def _named_interrupts(bus: str, proc: Path) -> list[int]:
    """Interrupts whose line in /proc/interrupts names the USB bus: those of a controller that is no PCI device."""
    import re

    try:
        lines = (proc / "interrupts").read_text("utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        number, _, rest = line.strip().partition(":")
        if number.isdecimal() and re.search(rf"\b{bus}\b", rest):
            found.append(int(number))
    return found
