"""From a configuration to running parts: parameters, plan, master, station, and what keeps them running."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.api.bench import VirtualBench
from dpstack.api.config import Config, rate_findings
from dpstack.api.planning import adapter_notes, other_masters, refuse_misfit, with_t_tr
from dpstack.api.slave_config import SlaveConfig
from dpstack.api.streams import Rounds
from dpstack.dp.acyclic import Acyclic
from dpstack.dp.master import Master
from dpstack.dp.plan import Case, Plan, make_plan
from dpstack.dp.reading import reading_only
from dpstack.dp.scanner import Scanner
from dpstack.drivers.aio import AsyncioRuntime, OnFailure, patience_of
from dpstack.drivers.base import OnEvents, Runtime
from dpstack.drivers.echo import Echo
from dpstack.drivers.virtual import VirtualRuntime
from dpstack.fdl.active import ActiveStation
from dpstack.fdl.livelist import LiveList, live_allowance
from dpstack.fdl.user import LinkUser
from dpstack.params import BusParams
from dpstack.phy.neighbours import Neighbours
from dpstack.phy.patience import EXACT, Patience, slack
from dpstack.ports import Delivery, Port, open_port
from dpstack.profile import DriveCore
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS, NS_PER_S

ECHO: Final = {None: Echo.AUTO, True: Echo.ON, False: Echo.OFF}
#: a read-only bus asks the whole live list and the diagnosis of each slave anew so often
_LIST_PERIOD: Final = 10 * NS_PER_S
_DIAGNOSIS_PERIOD: Final = 500 * NS_PER_MS


def plan_bus(config: Config, baud: int | None = None) -> Plan:
    """The plan of ``config`` at ``baud`` (default: its own rate). Raises ConfigError.

    What keeps the bus from being opened is told there, and stands in the plan as a finding.
    """
    rate = config.baud if baud is None else baud
    setups = config.setups(rate)
    params = with_t_tr(config, config.params(rate), setups)
    notes = [note for slave in config.slaves for note in slave.notes]
    pty, slack_ns, beside = False, 0, ""
    if config.bus.port is not None and not config.virtual:
        port = port_of(config, rate)
        patience = patience_for(config, port)
        pty, slack_ns = port.delivery is Delivery.HOST, patience.known_ns
        beside = Neighbours(params, patience).advice()
        if port.delivery is Delivery.ADAPTER:
            notes += adapter_notes(config, params, setups)
    findings = rate_findings(config, rate)
    return make_plan(
        params,
        setups,
        others=other_masters(config, rate),
        cycle_ns=config.bus.cycle_ns,
        pty=pty,
        host_slack_ns=slack_ns,
        data_control_ns=config.bus.data_control_time_ms * NS_PER_MS if config.bus.auto_clear else 0,
        findings=findings,
        notes=notes,
        beside=beside,
    )


def port_of(config: Config, baud: int, name: str | None = None) -> Port:
    """The port of ``config`` (or ``name``, treated as it says), not open yet. Raises PortError."""
    return open_port(name or config.port, baud, event_char=config.bus.event_char, rs485=config.bus.rs485)


def patience_for(config: Config, port: Port) -> Patience:
    """How long to wait on ``port``: the user's ``host_slack_ms``, or by its kind."""
    if config.bus.host_slack_ms is not None:
        return slack(round(config.bus.host_slack_ms * NS_PER_MS), patience_of(port))
    return patience_of(port)


@dataclass(slots=True)
class Parts:
    """Everything one bus is made of."""

    config: Config
    plan: Plan
    master: Master
    station: ActiveStation
    runtime: Runtime
    world: World | None
    #: of a read-only bus: what shows the state of its stations
    watcher: Scanner | None
    #: the simulated slaves, where they are part of it
    bench: VirtualBench | None
    rounds: Rounds


def compose(
    config: Config,
    on_events: OnEvents,
    on_failure: OnFailure,
    world: World | None = None,
    *,
    watched: bool = True,
) -> Parts:
    """Build the parts of ``config``, with simulated slaves in a world of its own when its port is "virtual".

    ``on_failure`` is told when a machine raised (a defect of ours). ``world`` puts the master into an existing
    simulated bus, with nothing added. A read-only bus has a guard in front of all that could write, and is watched
    unless told otherwise. Raises ConfigError, PortError.
    """
    plan = plan_bus(config)
    params = plan.params
    refuse_misfit(config, plan, config.setups())
    virtual = world is not None or config.virtual
    port = None if virtual else port_of(config, params.baud)
    patience = EXACT if port is None else patience_for(config, port)
    read_only = config.bus.read_only
    master = Master(
        params,
        config.setups(),
        watchdog_ms=plan.watchdog_ms,
        absent_share=patience.unknown_share,
        auto_clear=config.bus.auto_clear,
        data_control_ns=config.bus.data_control_time_ms * NS_PER_MS,
        read_only=read_only,
        cycle_ns=config.bus.cycle_ns,
        cycle_freeze=config.bus.cycle_freeze,
        cycle_sync=config.bus.cycle_sync,
    )
    watcher = _watcher(config, params, patience) if read_only and watched else None
    users: list[LinkUser] = [master] if watcher is None else [master, watcher]
    users.append(Acyclic(params.address, master))
    guard = reading_only if read_only else None
    station = ActiveStation(params, users, patience=patience, guard=guard, budget=master.budget)
    if port is not None:
        # a pty is given what a stalled computer needs, and a user's own figure stands
        tune = port.delivery is Delivery.ADAPTER and config.bus.host_slack_ms is None
        runtime = AsyncioRuntime(
            port,
            station,
            on_events,
            echo=ECHO[config.bus.echo],
            on_failure=on_failure,
            tune=station.set_patience if tune else None,
        )
        return Parts(config, plan, master, station, runtime, None, watcher, None, Rounds(master))
    bench = None
    if world is None:
        world = World(referee=False)
        bench = VirtualBench(world, params)
        for slave in config.slaves:
            bench.add(slave)
    virtual_runtime = VirtualRuntime(world, station, on_events, on_failure=on_failure)
    return Parts(config, plan, master, station, virtual_runtime, world, watcher, bench, Rounds(master))


def _watcher(config: Config, params: BusParams, patience: Patience) -> Scanner:
    """The scanner of a read-only bus: the whole list quickly once, then within its share, slaves twice a second."""
    live = LiveList(
        params.address,
        period_ns=_LIST_PERIOD,
        allowance=live_allowance(params, patience, 0),
        quick_start=True,
    )
    wanted = [slave.address for slave in config.slaves]
    return Scanner(params.address, live, period_ns=_DIAGNOSIS_PERIOD, wanted=wanted)


def attach_core(master: Master, slave: SlaveConfig, *, simulated: bool) -> DriveCore | None:
    """Put the drive plugin of ``slave`` onto its process image; None where it has none.

    ``simulated``: the slave is one of ours, in the same process.
    """
    if slave.profile is None or slave.raw:
        return None
    core = slave.profile.core(slave.name, slave.telegram, slave.options, simulated=simulated)
    master.handlers[slave.address].image.unit = core
    return core


__all__ = [
    "ECHO",
    "Case",
    "Parts",
    "Plan",
    "attach_core",
    "compose",
    "patience_for",
    "plan_bus",
    "port_of",
]
