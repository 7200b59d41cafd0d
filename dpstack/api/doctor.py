"""Is this computer fit for a bus: adapters, permissions, latency, rates, real-time rights; what to do about each."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final

from dpstack.drivers.realtime.rights import SET_UP, Rights, is_privileged, limit
from dpstack.errors import PortBusyError, PortError
from dpstack.params import MAX_T_SL, BusParams
from dpstack.phy.neighbours import Neighbours
from dpstack.phy.patience import ADAPTER
from dpstack.ports.adapters import Abilities, AdapterInfo, list_adapters, probe
from dpstack.ports.holders import PROC, holder_of_path
from dpstack.ports.sysfs import CHIPS, SYSFS, Adapter
from dpstack.units import BAUD_RATES, NS_PER_MS, baud_text

__all__ = ["AdapterInfo", "Check", "Computer", "Level", "examine", "list_adapters"]

#: rates at which buses with several masters are seen
_USUAL_RATES: Final = (187_500, 500_000)


class Level(Enum):
    OK = "ok"
    NOTE = "note"  # worth knowing, nothing has to be done
    FINDING = "finding"


@dataclass(frozen=True, slots=True)
class Check:
    """One thing looked at: ``topic`` is the port's path or the computer's part, ``todo`` what to do about it."""

    topic: str
    level: Level
    text: str
    todo: str = ""

    def as_dict(self) -> dict[str, str]:
        """As ``dpstack doctor --json`` prints it."""
        return {"topic": self.topic, "level": self.level.value, "text": self.text, "todo": self.todo}


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """What the checks look at; tests put another one in its place."""

    platform: str = sys.platform
    adapters: Callable[[], list[AdapterInfo]] = list_adapters
    probe: Callable[[str], Abilities] = probe
    limit: Callable[[str], int | None] = limit
    is_root: bool = field(default_factory=is_privileged)
    access: Callable[[str, int], bool] = os.access
    sysfs: Path = SYSFS
    proc: Path = PROC


def examine(port: str | None = None, computer: Computer | None = None) -> list[Check]:
    """Look at the computer and at ``port``, or at every adapter. Nothing is sent, a held port is not touched."""
    here = computer or Computer()
    if here.platform != "linux":
        text = f"this is {here.platform}: ports work through pyserial, and nothing of what follows can be checked"
        return [Check("system", Level.NOTE, text, "for hard times use Linux")]
    checks = _real_time(here)
    if port is not None:
        return checks + _port(port, here) + _neighbours(port)
    adapters = here.adapters()
    if not adapters:
        todo = 'plug one in; without one: a port of `dpstack segment`, or port = "virtual"'
        return [*checks, Check("adapters", Level.FINDING, "no serial adapter is plugged in", todo)]
    for adapter in adapters:
        checks += _port(adapter.path, here)
    return checks


def _real_time(here: Computer) -> list[Check]:
    if here.is_root:
        return [Check("real time", Level.OK, "root may use real-time priorities and lock memory")]
    checks = []
    rights = Rights(here.is_root, here.limit("RLIMIT_RTPRIO"), here.limit("RLIMIT_MEMLOCK"))
    if rights.no_priority():
        checks.append(Check("real time", Level.FINDING, rights.no_priority(), SET_UP))
    else:
        most = "any" if rights.priority is None else f"up to {rights.priority}"
        checks.append(Check("real time", Level.OK, f"real-time priorities are allowed ({most})"))
    if rights.no_memory():
        checks.append(Check("real time", Level.FINDING, rights.no_memory(), SET_UP))
    else:
        checks.append(Check("real time", Level.OK, "memory may be locked"))
    return checks


def _port(path: str, here: Computer) -> list[Check]:
    from dpstack.ports.tty import existing_ports, how_to_be_permitted, is_pty_path

    if not os.path.exists(path):
        names = ", ".join(existing_ports()) or "none"
        return [Check(path, Level.FINDING, "no such port", f"these exist: {names}")]
    checks = _identity(path, here)
    if not here.access(path, os.R_OK | os.W_OK):
        return [*checks, Check(path, Level.FINDING, "no permission", how_to_be_permitted(path))]
    checks.append(Check(path, Level.OK, "may be opened"))
    is_pty = is_pty_path(path)
    if not is_pty:
        checks += _latency(path, here)
    holder = holder_of_path(path, here.proc)
    if holder is not None:
        todo = f"end it to have the rest checked, or ask it: dpstack ctl {path} status"
        return [*checks, Check(path, Level.NOTE, f"is held by {holder}", todo)]
    try:
        can = here.probe(path)
    except PortBusyError as error:
        return [*checks, Check(path, Level.NOTE, str(error))]
    except PortError as error:
        return [*checks, Check(path, Level.FINDING, str(error), "take another port")]
    return checks + _rates(path, can) + _abilities(path, can, here, is_pty)


def _neighbours(path: str) -> list[Check]:
    """What other masters on its bus would need, while nobody has measured how late it is."""
    from dpstack.ports.tty import is_pty_path

    if is_pty_path(path) or not os.path.exists(path):
        return []
    by_rate = {rate: Neighbours(BusParams.preset(rate), ADAPTER).t_sl for rate in BAUD_RATES}
    wanted = ", ".join(f"{by_rate[rate]} at {baud_text(rate)}" for rate in _USUAL_RATES)
    fastest = max(rate for rate, t_sl in by_rate.items() if t_sl <= MAX_T_SL)
    text = (
        f"other masters on its bus need T_SL above its delay ({ADAPTER.unknown_ns // NS_PER_MS} ms until a run has "
        f"measured it): {wanted}, and none is enough above {baud_text(fastest)}"
    )
    return [Check(path, Level.NOTE, text, "alone on the bus nothing has to be done; else set t_sl on all masters")]


def _identity(path: str, here: Computer) -> list[Check]:
    adapter = Adapter(path, here.sysfs)
    if adapter.usb is None:
        return [Check(path, Level.OK, f"driver {adapter.driver}")] if adapter.driver else []
    chip, most = CHIPS.get(adapter.usb, ("an unknown chip", 0))
    text = f"USB {adapter.usb}, {chip}, driver {adapter.driver or 'unknown'}"
    limit = f"; its maker promises {baud_text(most)} at most" if most else ""
    return [Check(path, Level.OK, text + limit)]


def _latency(path: str, here: Computer) -> list[Check]:
    adapter = Adapter(path, here.sysfs)
    ms = adapter.latency_ms()
    if ms is None:
        return []
    if ms <= 1:
        return [Check(path, Level.OK, f"its latency timer is {ms} ms")]
    if here.access(str(adapter.latency_file), os.W_OK):
        return [Check(path, Level.OK, f"its latency timer is {ms} ms; dpstack sets it to 1 ms while it runs")]
    text = f"its latency timer is {ms} ms and may not be changed: an exchange may take that much longer"
    return [Check(path, Level.FINDING, text, SET_UP)]


def _rates(path: str, can: Abilities) -> list[Check]:
    if not can.rates:
        return [Check(path, Level.FINDING, "takes none of PROFIBUS's rates", "take another adapter")]
    missing = [baud_text(rate) for rate in BAUD_RATES if rate not in can.rates]
    if not missing:
        return [Check(path, Level.OK, "takes every rate of PROFIBUS")]
    text = f"takes {', '.join(map(baud_text, can.rates))}; not {', '.join(missing)}"
    return [Check(path, Level.NOTE, text, "for a rate it does not take use another adapter")]


def _abilities(path: str, can: Abilities, here: Computer, is_pty: bool) -> list[Check]:
    if is_pty:
        return [Check(path, Level.NOTE, "a pty: no parity, no wire, nothing to set; check sums protect the data")]
    checks = []
    if not can.parity:
        text = "has no parity bit: only check sums protect the data"
        checks.append(Check(path, Level.FINDING, text, "PROFIBUS needs 8E1: take an adapter that can do even parity"))
    usb = Adapter(path, here.sysfs).usb is not None
    for has, name, without in (
        (can.low_latency, "low-latency mode", "octets may arrive some ms late; host_slack_ms covers it"),
        (can.counters, "error counters", "damaged octets are known from the marks and check sums alone"),
        (can.marks, "marks of damaged octets", "damaged octets are dropped, not counted"),
        (can.rs485 or usb, "RS-485 mode", "the adapter must switch its direction by itself"),
    ):
        if has:
            text = f"{name}: the adapter's own" if name == "RS-485 mode" and not can.rs485 else f"{name}: there"
            checks.append(Check(path, Level.OK, text))
        else:
            checks.append(Check(path, Level.NOTE, f"{name}: not in its driver", without))
    return checks
