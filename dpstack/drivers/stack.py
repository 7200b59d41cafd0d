"""The machines of one bus, from plain data: what every driver runs, in this process or in one of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.acyclic.class2 import Class2
from dpstack.dp.acyclic.queue import Acyclic
from dpstack.dp.master.master import Master
from dpstack.dp.master.read_only import reading_only
from dpstack.dp.master.scanner import Scanner
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_ack import Alarms
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.ms1_job import Ms1Access
from dpstack.dpv1.master.ms2 import Ms2
from dpstack.dpv1.master.plugin_jobs import PluginJobs
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.interface import LinkUser
from dpstack.fdl.livelist import LiveList, live_allowance
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.units import NS_PER_MS, NS_PER_S

#: a read-only bus asks the whole live list and the diagnosis of each slave anew so often
_LIST_PERIOD: Final = 10 * NS_PER_S
_DIAGNOSIS_PERIOD: Final = 500 * NS_PER_MS


@dataclass(frozen=True, slots=True, kw_only=True)
class StackSpec:
    """What the machines of a bus are made from. ``watched``: a read-only bus shows the state of its stations."""

    params: BusParams
    patience: Patience
    slaves: tuple[SlaveParams, ...]
    watchdog_ms: int
    auto_clear: bool
    data_control_ns: int
    safe_after_stall: bool = True
    application_watchdog_ns: int = 0
    read_only: bool
    watched: bool
    cycle_ns: int = 0
    cycle_freeze: tuple[int, ...] = ()
    cycle_sync: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Stack:
    """The machines: ``station`` is the one to be pumped. ``watcher``: of a read-only bus that is watched."""

    master: Master
    station: ActiveStation
    watcher: Scanner | None


def build_stack(spec: StackSpec) -> Stack:
    """Make them. A read-only bus has a guard in front of all that could write. Raises ConfigError."""
    params, patience = spec.params, spec.patience
    master = Master(
        params,
        spec.slaves,
        watchdog_ms=spec.watchdog_ms,
        absent_share=patience.unknown_share,
        auto_clear=spec.auto_clear,
        data_control_ns=spec.data_control_ns,
        safe_after_stall=spec.safe_after_stall,
        application_watchdog_ns=spec.application_watchdog_ns,
        read_only=spec.read_only,
        cycle_ns=spec.cycle_ns,
        cycle_freeze=spec.cycle_freeze,
        cycle_sync=spec.cycle_sync,
    )
    watcher = _watcher(spec) if spec.read_only and spec.watched else None
    users: list[LinkUser] = [master] if watcher is None else [master, watcher]
    users.append(acyclic_services(params.address, master))
    guard = reading_only if spec.read_only else None
    station = ActiveStation(params, users, patience=patience, guard=guard, budget=master.budget)
    master.ring = lambda: station.las
    return Stack(master, station, watcher)


def acyclic_services(own: int, master: Master | None = None) -> Acyclic:
    """All acyclic services of the station ``own``; ``master``: the class 1 master of the same station, if any."""
    ms1 = Ms1Access(master)
    return Acyclic(master, (Class2(own, master), Ms1(ms1), Alarms(ms1), PluginJobs(ms1), Ms2(own, master)))


def _watcher(spec: StackSpec) -> Scanner:
    """The scanner of a read-only bus: the whole list quickly once, then within its share, slaves twice a second."""
    own = spec.params.address
    live = LiveList(
        own,
        period_ns=_LIST_PERIOD,
        allowance=live_allowance(spec.params, spec.patience, 0),
        quick_start=True,
    )
    return Scanner(own, live, period_ns=_DIAGNOSIS_PERIOD, wanted=[slave.address for slave in spec.slaves])
