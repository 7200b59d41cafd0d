"""Simulated buses in virtual time: stations put into a world, and a whole bus of a master and mirror slaves."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from adapter_model import Adapter, Habits
from slave_kit import make_slave
from support import MS, KeepsEvents, S

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.drivers.line.echo import Echo, EchoFilter
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import BusStation, LinkUser
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.sim.world import World
from dpstack.trace import Event

#: PPO1: four words PKW and two words PZD, consistent
PPO1 = bytes.fromhex("F3 F1")
IDENT = 0x1234


def setup(address: int, dpv1: Dpv1 | None = None, **changes: Any) -> SlaveParams:
    """Parameters of a :func:`mirror` at its master; with ``dpv1``, DPV1_Status stands in front of its parameters."""
    values = {"name": f"s{address}", "ident": IDENT, "config": PPO1, "user_prm": b"" if dpv1 is None else bytes(3)}
    return SlaveParams(**{"address": address, "dpv1": dpv1, **values, **changes})


def mirror(address: int, params: BusParams, *, t_sdr: int | None = None) -> PassiveStation:
    """A PPO1 slave whose inputs are its outputs."""
    return make_slave(address, MirrorDevice(IDENT, PPO1), params, t_sdr=t_sdr)


def add_station(
    world: World,
    params: BusParams,
    *users: LinkUser,
    patience: Patience = EXACT,
    habits: Habits | None = None,
    on_events: Callable[[list[Event]], None] | None = None,
) -> ActiveStation:
    """Put an active station with these link users into ``world``: it goes online, a DP master (first) to Operate.

    ``habits``: the station is behind such an adapter.
    """
    master = users[0] if users and isinstance(users[0], Master) else None
    window = None if master is None else master.window
    station = ActiveStation(params, users, patience=patience, window=window, now=world.now)
    plugged: BusStation = station
    if habits is not None:
        plugged = Adapter(station, habits, own=EchoFilter(Echo.AUTO) if habits.echo else None)
    world.add(plugged, on_events=on_events)
    world.command(plugged, GoOnline())
    if master is not None:
        world.command(plugged, SetMode(Mode.OPERATE))
    return station


def all_exchange(master: Master) -> bool:
    """Whether all slaves of ``master`` are in data exchange."""
    return all(handler.state is SlaveState.DATA_EXCHANGE for handler in master.handlers.values())


@dataclass
class SimBus(KeepsEvents):
    """A master with all acyclic services and its slaves in ``world``, ordered to operate.

    Slaves are mirrors: of PPO1 where an address stands for one, else of the configuration that the master sends.
    ``devices`` take the place of mirrors; ``silent`` addresses have no slave. ``more``: link users beside the master
    in place of the acyclic services; ``options``: further settings of the master; ``habits``: of its adapter.
    """

    world: World
    params: BusParams
    addresses: Sequence[int | SlaveParams]
    cycle_ns: int = 0
    t_sdr: int | None = None
    watchdog_ms: int | None = None
    devices: Mapping[int, DpV0Device] = field(default_factory=dict)
    silent: Collection[int] = ()
    more: Sequence[LinkUser] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    patience: Patience = EXACT
    habits: Habits | None = None
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        setups = [setup(one) if isinstance(one, int) else one for one in self.addresses]
        devices: dict[int, DpV0Device] = {one.address: MirrorDevice(IDENT, one.config) for one in setups}
        devices |= self.devices
        self.slaves = {
            address: make_slave(address, device, self.params, t_sdr=self.t_sdr)
            for address, device in devices.items()
            if address not in self.silent
        }
        for slave in self.slaves.values():
            self.world.add(slave)
        watchdog_ms = max(200, 5 * self.cycle_ns // MS) if self.watchdog_ms is None else self.watchdog_ms
        settings = {"watchdog_ms": watchdog_ms, "cycle_ns": self.cycle_ns, **self.options}
        self.master = Master(self.params, setups, MasterSettings(**settings))
        self.acyclic = acyclic_services(self.params.address, self.master)
        more = [self.acyclic] if self.more is None else self.more
        self.station = add_station(
            self.world,
            self.params,
            self.master,
            *more,
            patience=self.patience,
            habits=self.habits,
            on_events=self.on_events,
        )

    def on_events(self, events: list[Event]) -> None:
        self.events += events

    def send(self, order: object, run_ns: int = 0) -> None:
        """Give the master's station an order now, and let ``run_ns`` pass."""
        self.world.command(self.station, order)
        if run_ns:
            self.run(run_ns)

    def run(self, ns: int) -> None:
        """Let ``ns`` pass."""
        self.world.run_for(ns)

    def state(self, address: int) -> SlaveState:
        """The state of one slave."""
        return self.master.handlers[address].state

    @property
    def apps(self) -> list[SlaveApp]:
        return [slave.responder for slave in self.slaves.values() if isinstance(slave.responder, SlaveApp)]

    @property
    def exchanging(self) -> bool:
        """All slaves that are there and that the master knows are in data exchange."""
        known = self.slaves.keys() & self.master.handlers.keys()
        return all(self.state(address) is SlaveState.DATA_EXCHANGE for address in known)

    def until_exchanging(self, within_ns: int = 5 * S) -> Self:
        """Run until all slaves that are there are in data exchange; the bus itself."""
        end = self.world.now + within_ns
        while not self.exchanging:
            assert self.world.now < end, "not all slaves in data exchange: " + ", ".join(
                f"{address} {handler.state.value}" for address, handler in self.master.handlers.items()
            )
            self.run(MS)
        return self
