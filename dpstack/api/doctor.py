"""Checks of this computer: adapters, permissions, latency, rates, real-time rights, and advice on each."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final

from dpstack.drivers.realtime import processors
from dpstack.drivers.realtime.rights import SET_UP, Rights, is_privileged, limit
from dpstack.errors import PortBusyError, PortError
from dpstack.params import MAX_T_SL, BusParams
from dpstack.phy.neighbours import Neighbours
from dpstack.phy.patience import ADAPTER
from dpstack.ports.adapters import Abilities, AdapterInfo, list_adapters, probe
from dpstack.ports.holders import PROC, hides_programs, holder_of_path, is_dpstack, keep_off, other_openers
from dpstack.ports.kernel_drivers import STRONGER, Marks
from dpstack.ports.sysfs import CHIPS, SYSFS, Adapter
from dpstack.units import BAUD_RATES, NS_PER_MS, baud_text

__all__ = ["AdapterInfo", "Check", "Computer", "Grade", "examine", "list_adapters"]

#: usual rates of buses with several masters
_USUAL_RATES: Final = (187_500, 500_000)


class Grade(Enum):
    OK = "ok"
    NOTE = "note"  # worth knowing, nothing has to be done
    FINDING = "finding"


@dataclass(frozen=True, slots=True)
class Check:
    """The result of one check. ``topic``: the port's path or the part of the computer; ``todo``: advice."""

    topic: str
    level: Grade
    text: str
    todo: str = ""

    def as_dict(self) -> dict[str, str]:
        """As ``dpstack doctor --json`` prints it."""
        return {"topic": self.topic, "level": self.level.value, "text": self.text, "todo": self.todo}


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """The system functions that the checks call; tests replace them."""

    platform: str = sys.platform
    adapters: Callable[[], list[AdapterInfo]] = list_adapters
    probe: Callable[[str], Abilities] = probe
    limit: Callable[[str], int | None] = limit
    is_root: bool = field(default_factory=is_privileged)
    access: Callable[[str, int], bool] = os.access
    sysfs: Path = Path(SYSFS)
    proc: Path = Path(PROC)
    cpu_dma_latency: Path = Path(processors.CPU_DMA_LATENCY)


def examine(port: str | None = None, computer: Computer | None = None) -> list[Check]:
    """Check the computer and ``port`` (None: every adapter). Sends nothing, and opens no port that a program holds."""
    return list(_examine(port, computer or Computer()))


def _examine(port: str | None, here: Computer) -> Iterator[Check]:
    if here.platform != "linux":
        text = f"this is {here.platform}: ports work through pyserial, and nothing of what follows can be checked"
        yield Check("system", Grade.NOTE, text, "for hard times use Linux")
        return
    yield from _real_time(here)
    yield from _processors(here)
    if port is not None:
        yield from _port(port, here)
        yield from _neighbours(port)
        return
    adapters = here.adapters()
    if not adapters:
        todo = 'plug one in; without one: a port of `dpstack segment`, or port = "virtual"'
        yield Check("adapters", Grade.FINDING, "no serial adapter is plugged in", todo)
    for adapter in adapters:
        yield from _port(adapter.path, here)


def _real_time(here: Computer) -> Iterator[Check]:
    topic = "real time"
    if here.is_root:
        yield Check(topic, Grade.OK, "root may use real-time priorities and lock memory")
        return
    rights = Rights(here.is_root, here.limit("RLIMIT_RTPRIO"), here.limit("RLIMIT_MEMLOCK"))
    if rights.no_priority():
        yield Check(topic, Grade.FINDING, rights.no_priority(), SET_UP)
    else:
        most = "any" if rights.priority is None else f"up to {rights.priority}"
        yield Check(topic, Grade.OK, f"real-time priorities are allowed ({most})")
    if rights.no_memory():
        yield Check(topic, Grade.FINDING, rights.no_memory(), SET_UP)
    else:
        yield Check(topic, Grade.OK, "memory may be locked")


def _processors(here: Computer) -> Iterator[Check]:
    """Isolated processors for the bus process, and sleep states, which make a wake-up late."""
    topic = "processors"
    free = processors.isolated(here.sysfs)
    if free:
        text = f"isolated from other programs: {processors.text_of(free)}"
        yield Check(topic, Grade.OK, text, f"[bus] cpu = {min(free)} puts the bus process there")
    else:
        text = "none is isolated: other programs can delay the bus process if they have a higher priority"
        yield Check(topic, Grade.OK, f"{text}; isolcpus=1 nohz_full=1 on the command line of the kernel isolates one")
    wake_up_us = processors.slowest_wake_up_us(here.sysfs)
    if wake_up_us is None:
        yield Check(topic, Grade.OK, "no sleep states are known: as in most virtual machines, the host decides")
    elif here.access(str(here.cpu_dma_latency), os.W_OK):
        text = f"may be kept from sleep states (up to {wake_up_us} us to wake up) while a fixed cycle runs"
        yield Check(topic, Grade.OK, text)
    else:
        text = f"may not be kept from sleep states: each wake-up may take up to {wake_up_us} us"
        yield Check(topic, Grade.NOTE, f"{text} ({here.cpu_dma_latency})", SET_UP)


def _interrupts(path: str, here: Computer) -> Iterator[Check]:
    """The processors that the interrupts of the port's USB controller go to."""
    found = processors.interrupts_of(path, here.sysfs, here.proc)
    if found is None:
        return
    numbers = ", ".join(map(str, found.numbers))
    where = processors.text_of(found.processors)
    text = f"interrupts of its USB controller {found.controller} ({numbers}) go to processors {where}"
    free = processors.isolated(here.sysfs)
    if not free or found.processors <= free:
        yield Check(path, Grade.OK, text)
        return
    todo = "; ".join(f"echo {min(free)} > /proc/irq/{number}/smp_affinity_list" for number in found.numbers)
    yield Check(path, Grade.NOTE, f"{text}, where other programs run", f"beside the bus process, as root: {todo}")


def _port(path: str, here: Computer) -> Iterator[Check]:
    from dpstack.ports.tty import existing_ports, how_to_be_permitted, is_pty_path

    if not os.path.exists(path):
        names = ", ".join(existing_ports()) or "none"
        yield Check(path, Grade.FINDING, "no such port", f"these exist: {names}")
        return
    adapter, is_pty = Adapter(path, here.sysfs), is_pty_path(path)
    yield from _identity(path, adapter)
    if not here.access(path, os.R_OK | os.W_OK):
        yield Check(path, Grade.FINDING, "no permission", how_to_be_permitted(path))
        return
    yield Check(path, Grade.OK, "may be opened")
    if not is_pty:
        yield from _interrupts(path, here)
    holder, latency_ms = holder_of_path(path, here.proc), adapter.latency_ms()
    if holder is not None:
        yield from _held(path, holder, adapter, here)
        return
    try:
        can = here.probe(path)
    except PortBusyError as error:
        yield Check(path, Grade.NOTE, str(error), _UNSEEN if hides_programs(here.proc) else "")
    except PortError as error:
        yield Check(path, Grade.FINDING, str(error), "take another port")
    else:
        if latency_ms is not None:
            yield _latency(path, latency_ms, can)
        yield from _rates(path, can, adapter)
        yield from _abilities(path, can, adapter, is_pty)


#: if a port is held and no holder can be seen
_UNSEEN: Final = "a program of another user may have it, which only root can see: sudo fuser -v PORT"


def _held(path: str, holder: str, adapter: Adapter, here: Computer) -> Iterator[Check]:
    ask = f", or ask it: dpstack ctl {path} status" if is_dpstack(holder) else ""
    todo = keep_off(holder, adapter.usb) or f"end it to have the rest checked{ask}"
    yield Check(path, Grade.NOTE, f"is held by {holder}", todo)
    for other in sorted(set(other_openers(path, here.proc)) - {holder}):
        text = f"{other} has it open, too, and takes octets away from {holder}"
        yield Check(path, Grade.FINDING, text, keep_off(other, adapter.usb) or "end that program")


def _neighbours(path: str) -> Iterator[Check]:
    """The T_SL that other masters need beside this port, as long as no run has measured its delay."""
    from dpstack.ports.tty import is_pty_path

    if is_pty_path(path) or not os.path.exists(path):
        return
    by_rate = {rate: Neighbours(BusParams.preset(rate), ADAPTER).t_sl for rate in BAUD_RATES}
    wanted = ", ".join(f"{by_rate[rate]} at {baud_text(rate)}" for rate in _USUAL_RATES)
    fastest = max(rate for rate, t_sl in by_rate.items() if t_sl <= MAX_T_SL)
    text = (
        f"other masters on its bus need T_SL above its delay ({ADAPTER.unknown_ns // NS_PER_MS} ms until a run has "
        f"measured it): {wanted}, and none is enough above {baud_text(fastest)}"
    )
    yield Check(path, Grade.NOTE, text, "alone on the bus nothing has to be done; else set t_sl on all masters")


def _identity(path: str, adapter: Adapter) -> Iterator[Check]:
    if adapter.usb is not None:
        chip, most = CHIPS.get(adapter.usb, ("an unknown chip", 0))
        limit = f"; its maker promises {baud_text(most)} at most" if most else ""
        yield Check(path, Grade.OK, f"USB {adapter.usb}, {chip}, driver {adapter.driver or 'unknown'}{limit}")
    elif adapter.driver:
        yield Check(path, Grade.OK, f"driver {adapter.driver}")


def _latency(path: str, before_ms: int, can: Abilities) -> Check:
    """``before_ms``: the latency timer before low latency was asked for, which often sets it, whoever may write to its
    file."""
    text = f"its latency timer is {before_ms} ms"
    if before_ms <= 1:
        return Check(path, Grade.OK, text)
    if can.latency_ms is not None and can.latency_ms <= 1:
        return Check(path, Grade.OK, f"{text}; dpstack sets it to 1 ms while it runs")
    return Check(path, Grade.FINDING, f"{text} and may not be changed: an exchange may take that much longer", SET_UP)


def _rates(path: str, can: Abilities, adapter: Adapter) -> Iterator[Check]:
    driver = adapter.kernel_driver
    if not driver.tells_rate and can.rates:
        text = f"accepts every rate, and its driver {driver.name} does not say which of them the adapter makes"
        todo = f"look into its manual, or measure: dpstack doctor --measure --port {path}"
        yield Check(path, Grade.NOTE, text, todo)
        return
    missing = [baud_text(rate) for rate in BAUD_RATES if rate not in can.rates]
    if not can.rates:
        yield Check(path, Grade.FINDING, "takes none of PROFIBUS's rates", "take another adapter")
    elif not missing:
        yield Check(path, Grade.OK, "takes every rate of PROFIBUS")
    else:
        text = f"takes {', '.join(map(baud_text, can.rates))}; not {', '.join(missing)}"
        yield Check(path, Grade.NOTE, text, "for a rate it does not take use another adapter")


_MARKS: Final = "marks of damaged octets"


def _abilities(path: str, can: Abilities, adapter: Adapter, is_pty: bool) -> Iterator[Check]:
    if is_pty:
        yield Check(path, Grade.NOTE, "a pty: no parity, no wire, nothing to set; check sums protect the data")
        return
    if not can.parity:
        text = "has no parity bit: only check sums protect the data"
        yield Check(path, Grade.FINDING, text, "PROFIBUS needs 8E1: take an adapter that can do even parity")
    driver = adapter.kernel_driver
    own_rs485 = "the adapter's own" if adapter.usb is not None else ""
    for there, name, without in (
        (can.low_latency and "there", "low-latency mode", "octets may arrive some ms late; host_slack_ms covers it"),
        (can.counters and "there", "error counters", "damaged octets are known from the marks and check sums alone"),
        (can.marks and "there", _MARKS, "damaged octets are dropped, not counted"),
        ("there" if can.rs485 else own_rs485, "RS-485 mode", "the adapter must switch its direction by itself"),
    ):
        if there:
            yield Check(path, Grade.OK, f"{name}: {there}")
        elif name != _MARKS or not driver.is_weak:  # what a weak driver does with them follows
            yield Check(path, Grade.NOTE, f"{name}: not in its driver", without)
    level, todo = (Grade.NOTE, STRONGER) if driver.is_weak else (Grade.OK, "")
    yield Check(path, level, driver.protection, todo)
    yield from _listening(path, adapter)


def _listening(path: str, adapter: Adapter) -> Iterator[Check]:
    text = (
        "a converter that RTS switches drives the bus for the instant in which a program opens the port, until the "
        "program drops RTS: this test, `capture`, `monitor` and `baud` do so at once, and send nothing"
    )
    yield Check(path, Grade.OK, text)
    if adapter.kernel_driver.marks is Marks.PACKET:
        text = f"its driver {adapter.driver} marks all octets of a USB packet as damaged where one of them is"
        yield Check(path, Grade.OK, f"{text}; captures say so at such octets")
