"""Construction of the objects behind a bus from its configuration: plan, master, station, runtime, drive plugins."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from msgspec import Struct

from dpstack.api.bus.plan_checks import (
    adapter_notes,
    clock_notes,
    data_control_ns,
    isochronous_notes,
    other_masters,
    refuse_forbidden,
    refuse_misfit,
    with_t_tr,
)
from dpstack.api.config.bus import SAFE
from dpstack.api.config.config import ECHO, Config, port_of, rate_findings
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.plan.plan import Plan, make_plan
from dpstack.dp.plan.rotation_time import Case
from dpstack.drivers.line.port_latency import patience_of
from dpstack.errors import ConfigError
from dpstack.phy.neighbours import Neighbours
from dpstack.phy.patience import EXACT, Patience, slack
from dpstack.ports.base import Delivery
from dpstack.units import NS_PER_MS

if TYPE_CHECKING:
    from dpstack.api.config.drives_source import DriveConfig
    from dpstack.api.slave.drive import DrivePlugin
    from dpstack.api.slave_side.virtual_bench import VirtualBench
    from dpstack.api.streams import Rounds
    from dpstack.dp.master.master import Master
    from dpstack.drivers.process.client import ProcessRuntime
    from dpstack.drivers.process.plugins import AttachPlugin
    from dpstack.drivers.runtime import OnEvents, OnFailure, OnRefused, Runtime
    from dpstack.drivers.snapshots import View
    from dpstack.ports.base import Port
    from dpstack.profile import DriveCore, DriveProfile, DriveStatus
    from dpstack.profile.drive_profile import DeviceProfile
    from dpstack.profile.master.device_core import DeviceCore
    from dpstack.profile.master.several_drives import SeveralDrives
    from dpstack.sim.world import World

__all__ = ["Case", "Plan"]  # for the command line


#: the plugin of a drive, or of another device: a copy of it for a plugin in a bus process
Plugin: TypeAlias = "DrivePlugin | DeviceCore"
Plugins: TypeAlias = "tuple[Plugin, ...]"


def plan_bus(config: Config, baud: int | None = None) -> Plan:
    """The plan of ``config`` at ``baud`` (default: its own rate). Raises ConfigError.

    Reasons why the bus cannot be opened raise nothing here: they are findings of the plan.
    """
    rate = config.baud if baud is None else baud
    setups = config.slave_params
    params = with_t_tr(config, config.params(rate), setups)
    of_slaves = (note for slave in config.slaves for note in slave.notes)
    notes = [*of_slaves, *_forbidden(config), *_groups_without_slaves(config), *_connected(config)]
    others = other_masters(config, rate)
    pty, slack_ns, beside = False, 0, ""
    patience = None
    if config.bus.port is not None and not config.virtual:
        port = port_of(config, rate)
        patience = patience_for(config, port)
        pty, slack_ns = port.delivery is Delivery.HOST, patience.known_ns
        beside = Neighbours(params, patience).advice() if others.count else ""
        if port.delivery is Delivery.ADAPTER:
            notes += adapter_notes(config, params, setups)
    notes += [*isochronous_notes(config, patience), *clock_notes(config)]
    findings = rate_findings(config, rate)
    return make_plan(
        params,
        setups,
        others=others,
        cycle_ns=config.bus.cycle_ns,
        pty=pty,
        host_slack_ns=slack_ns,
        data_control_ns=data_control_ns(config),
        findings=findings,
        notes=notes,
        beside=beside,
    )


def _groups_without_slaves(config: Config) -> Iterator[str]:
    known = {group for slave in config.slaves for group in slave.params.groups}
    named = ", ".join(map(str, sorted(known))) or "none"
    for key, groups in (("cycle_freeze", config.bus.cycle_freeze), ("cycle_sync", config.bus.cycle_sync)):
        if empty := ", ".join(str(group) for group in sorted(set(groups) - known)):
            yield (
                f"{key} = {list(groups)}: no slave is in group {empty}, so its telegrams have no effect there; give "
                f"groups = [...] to the slaves that are meant, or leave the group out (groups of this bus: {named})"
            )


def _forbidden(config: Config) -> Iterator[str]:
    for slave in config.slaves:
        if slave.refuse_master:
            yield (
                f"slave {slave.address} ({slave.name}): dpstack will not be its master (refuse_master): "
                f"{slave.refuse_master}"
            )


def _connected(config: Config) -> Iterator[str]:
    names = ", ".join(config.connectors)
    for slave in config.slaves:
        if slave.drives and names:
            yield (
                f"slave {slave.address} ({slave.name}): {names}: the named values of its drives are published, not "
                f"their states, and no order reaches them from there"
            )


def patience_for(config: Config, port: Port) -> Patience:
    """The waiting times on ``port``: of ``host_slack_ms``, or of the kind of port."""
    if config.bus.host_slack_ms is not None:
        return slack(round(config.bus.host_slack_ms * NS_PER_MS), patience_of(port))
    return patience_of(port)


class Parts(Struct, kw_only=True, eq=False):
    """The objects of one bus, whether its machines run in this process or in a bus process."""

    plan: Plan
    view: View
    runtime: Runtime
    #: "asyncio", "process", or "virtual" on a simulated bus
    driver: str
    #: plugins of the configured slaves by address: one of a slave with a drive or device, several of several drives
    plugins: Mapping[int, Plugins]
    #: attaches the plugins of a new slave to its process image; none for a slave without. Raises ConfigError
    attach: Callable[[SlaveConfig], Awaitable[Plugins]]
    rounds: Rounds
    world: World | None = None
    #: the simulated slaves; None without any
    bench: VirtualBench | None = None


def compose(
    config: Config,
    on_events: OnEvents,
    on_failure: OnFailure,
    on_refused: OnRefused,
    *,
    world: World | None,
    watched: bool,
    dp: bool = True,
) -> Parts:
    """Build the parts of ``config``, with simulated slaves in a world of its own when its port is "virtual".

    The runtime calls ``on_failure`` when a machine has raised (a defect of dpstack) or the bus process has ended, and
    ``on_refused`` when the bus process refuses an order that no caller awaits. ``world``: the master joins this
    simulated bus, and none of its slaves are simulated. ``watched``: a read-only bus, which sends no request that could
    write, asks its slaves for their state. ``dp`` False: a station without a DP master. Raises ConfigError, PortError.
    """
    from dpstack.api.bus.driver_choice import PROCESS, driver_for  # these here, as a plan needs no driver
    from dpstack.api.streams import Rounds
    from dpstack.dp.master.settings import MasterSettings, StackSpec

    refuse_forbidden(config, config.slaves)
    plan = plan_bus(config)
    refuse_misfit(config, plan, config.slave_params)
    virtual = world is not None or config.virtual
    port = None if virtual else port_of(config, plan.params.baud)
    patience = EXACT if port is None else patience_for(config, port)
    spec = StackSpec(
        params=plan.params,
        patience=patience,
        slaves=config.slave_params,
        master=MasterSettings(
            watchdog_ms=plan.watchdog_ms,
            absent_divisor=patience.unknown_divisor,
            auto_clear=config.bus.auto_clear,
            data_control_ns=config.bus.data_control_time_ms * NS_PER_MS,
            safe_after_stall=config.bus.after_stall == SAFE,
            application_watchdog_ns=config.bus.application_watchdog_ms * NS_PER_MS,
            read_only=config.bus.read_only or not dp,
            cycle_ns=config.bus.cycle_ns,
            cycle_freeze=config.bus.cycle_freeze,
            cycle_sync=config.bus.cycle_sync,
            clock_sync_ns=config.bus.clock_sync_ns,
            clock_is_virtual=virtual,
        ),
        watched=watched and dp,
        dp=dp,
    )
    driver = driver_for(config, port)
    # not on a pty, whose waiting times allow for a stalled computer; nor if the user gives host_slack_ms
    tune = port is not None and port.delivery is Delivery.ADAPTER and config.bus.host_slack_ms is None
    bench = None
    view: View
    runtime: Runtime
    if driver == PROCESS:
        from dpstack.drivers.process.client import ProcessRuntime
        from dpstack.drivers.process.messages import SetUp

        orders = [(slave, order) for slave in config.slaves if (order := plugin_of(slave)) is not None]
        setup = SetUp(
            port=config.port,
            event_char=config.bus.event_char,
            rs485=config.bus.rs485,
            echo=ECHO[config.bus.echo],
            tune=tune,
            stack=spec,
            plugins=tuple(order for _, order in orders),
            cpus=config.bus.cpus,
        )
        view = runtime = remote = ProcessRuntime(setup, on_events, on_failure, on_refused)
        plugins = {slave.address: remote_plugins(remote, slave) for slave, _ in orders}
        attach_new = partial(attach_remote, remote)
    else:
        from dpstack.drivers.stack import Stack  # these here, as the machines of the others run in a bus process

        view = stack = Stack(spec)
        station = stack.station
        if port is not None:
            if any(slave.dpv1 is not None for slave in spec.slaves):
                from dpstack.dp.pdu import layouts

                layouts.load()  # for alarms

            from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
            from dpstack.drivers.line.last_clear import LastClear

            runtime = stack.line = AsyncioRuntime(
                port,
                station,
                on_events,
                echo=ECHO[config.bus.echo],
                on_failure=on_failure,
                tune=station.set_patience if tune else None,
                last_clear=LastClear(station),
            )
        else:
            from dpstack.drivers.virtual.runtime import VirtualRuntime

            if world is None:
                from dpstack.api.slave_side.virtual_bench import VirtualBench
                from dpstack.sim.world import World

                world = World(referee=False)
                bench = VirtualBench(world, plan.params)
                for slave in config.slaves:
                    bench.add(slave)
                for cpu in config.ppi:
                    bench.add_cpu(cpu)
            runtime = stack.line = VirtualRuntime(world, station, on_events, on_failure=on_failure)
        attach = partial(attach_core, stack.master, simulated=world is not None)
        plugins = {slave.address: attach(slave) for slave in config.slaves}
        attach_new = partial(_attach_async, attach)
    return Parts(
        plan=plan,
        view=view,
        runtime=runtime,
        driver=driver,
        plugins=plugins,
        attach=attach_new,
        rounds=Rounds(view),
        world=world,
        bench=bench,
    )


async def _attach_async(attach: Callable[[SlaveConfig], Plugins], slave: SlaveConfig) -> Plugins:
    return attach(slave)


def attach_core(master: Master, slave: SlaveConfig, *, simulated: bool) -> Plugins:
    """Attach the plugin of ``slave`` to its process image; none for a slave without plugin.

    ``simulated``: the slave is simulated in this process.
    """
    device, image = device_core_of(slave), master.handlers[slave.address].image
    if device is not None:
        image.plugin = device
        return (device,)
    if slave.drives and not slave.raw:
        from dpstack.api.slave.drive import DrivePlugin

        image.plugin = joined = several_of(slave, simulated=simulated)
        return tuple(
            DrivePlugin(core, partial(joined.status_of, name), True, _comparison(master, slave.address, core))
            for name, core in joined.cores.items()
        )
    core = core_of(slave, simulated=simulated)
    if core is None:
        return ()
    from dpstack.api.slave.drive import DrivePlugin

    image.plugin = core
    return (DrivePlugin(core, core.status, False, _comparison(master, slave.address, core)),)


def _comparison(master: Master, address: int, core: DriveCore) -> Callable[[float], bool]:
    """Whether the slave gets a set point of ``core`` already: not after the plugin has failed."""

    def has_setpoint(fraction: float) -> bool:
        if not core.has_setpoint(fraction):
            return False
        handler = master.handlers.get(address)
        return handler is not None and handler.plugin_host.fault is None

    return has_setpoint


def device_core_of(slave: SlaveConfig) -> DeviceCore | None:
    """The plugin of a device that is no drive; None for another slave, or one whose outputs the application sets."""
    profile = slave.device_profile
    return None if profile is None or slave.raw else profile.core(slave.name, slave.telegram, slave.options)


def several_of(slave: SlaveConfig, *, simulated: bool = False) -> SeveralDrives:
    """The plugin of a slave with several drives. ``simulated``: the slave is simulated in this process."""
    from dpstack.dpv1.master.plugin_queue import RecordQueue
    from dpstack.profile.master.several_drives import DrivePart, SeveralDrives

    records = None if slave.params.dpv1 is None else RecordQueue()
    parts = [
        DrivePart(
            one.profile.core(
                one.name,
                one.telegram,
                one.options,
                simulated=simulated,
                records=records,
                record_object=one.record_object,
            ),
            one.inputs,
            one.outputs,
        )
        for one in slave.drives
    ]
    return SeveralDrives(parts, slave.params.output_len, records)


def core_of(slave: SlaveConfig, drive: DriveConfig | None = None, *, simulated: bool = False) -> DriveCore | None:
    """The drive plugin of ``slave``, or of ``drive``, one of its several; None for a slave without one, or whose
    outputs the application sets as octets.

    ``simulated``: the slave is simulated in this process.
    """
    if drive is not None:
        return several_of(slave, simulated=simulated).cores[drive.name]
    if slave.profile is None or slave.raw:
        return None
    from dpstack.dpv1.master.plugin_queue import RecordQueue

    records = None if slave.params.dpv1 is None else RecordQueue()
    return slave.profile.core(slave.name, slave.telegram, slave.options, simulated=simulated, records=records)


def plugin_of(slave: SlaveConfig) -> AttachPlugin | None:
    """The order that attaches the plugin of ``slave`` in the bus process; None for a slave without plugin.

    Raises ConfigError for a plugin that has no entry point to import.
    """
    if not slave.has_plugin or slave.raw:
        return None
    from dpstack.drivers.process.plugins import AttachPlugin, DriveOfSeveral

    if slave.drives:
        return AttachPlugin(
            address=slave.address,
            place="dpstack.profile.master.several_drives:SeveralDrives",
            name=slave.name,
            records=slave.params.dpv1 is not None,
            drives=tuple(
                DriveOfSeveral(
                    *_place_of(slave, one.profile),
                    one.name,
                    one.telegram,
                    dict(one.options),
                    one.record_object,
                    one.inputs,
                    one.outputs,
                )
                for one in slave.drives
            ),
            octets=slave.params.output_len,
        )
    profile = slave.any_profile
    assert profile is not None
    place, argument = _place_of(slave, profile)
    return AttachPlugin(
        address=slave.address,
        place=place,
        argument=argument,
        name=slave.name,
        telegram=slave.telegram,
        options=dict(slave.options),
        records=slave.params.dpv1 is not None,
    )


def _place_of(slave: SlaveConfig, profile: DriveProfile | DeviceProfile) -> tuple[str, str]:
    """``place`` and ``argument`` by which the bus process finds ``profile``. Raises ConfigError."""
    from dpstack.profile import registry

    if profile.file:
        return "dpstack.devices.finding:profile_at", f"{profile.digest} {profile.file}"
    place = registry.places().get(profile.name)
    if place is None:
        raise ConfigError(
            f"slave {slave.address} ({slave.name}): its drive plugin {profile.name!r} is an object of this "
            f"program, and the bus process is handed names only; give it an entry point of the group {registry.GROUP}, "
            'or take driver = "asyncio"'
        )
    return place, ""


def remote_plugins(runtime: ProcessRuntime, slave: SlaveConfig) -> Plugins:
    """The plugins of ``slave`` in the bus process. Copies here check ranges and convert references."""
    device = device_core_of(slave)
    if device is not None:
        return (device,)
    from dpstack.api.slave.drive import DrivePlugin
    from dpstack.drivers.process.messages import typed
    from dpstack.profile import DriveStatus

    def status(core: DriveCore, name: str | None = None) -> DriveStatus:
        found = runtime.drive_status(slave.address)
        if name is not None:  # one of several
            found = found.get(name) if isinstance(found, dict) else None
        return core.status() if found is None else typed(found, DriveStatus)

    if slave.drives:
        cores = several_of(slave).cores
        return tuple(DrivePlugin(core, partial(status, core, name), several=True) for name, core in cores.items())
    core = core_of(slave)
    assert core is not None
    return (DrivePlugin(core, partial(status, core)),)


async def attach_remote(runtime: ProcessRuntime, slave: SlaveConfig) -> Plugins:
    """Attach the plugin of ``slave`` in the running bus process; none for a slave without plugin.

    Raises ConfigError if it cannot be imported there.
    """
    plugin = plugin_of(slave)
    if plugin is None:
        return ()
    await runtime.order(plugin)
    return remote_plugins(runtime, slave)
