"""A whole simulated bus in one line: a master with mirror slaves, brought up in a world with a referee."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from slave_kit import make_slave
from support import MS, S

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event

#: PPO1: four words PKW and two words PZD, consistent
PPO1 = bytes.fromhex("F3 F1")
IDENT = 0x1234


def setup(address: int, dpv1: Dpv1 | None = None) -> SlaveParams:
    """How a master parameterises :func:`mirror`; with ``dpv1``, DPV1_Status stands in front of its parameters."""
    prm = b"" if dpv1 is None else bytes(3)
    return SlaveParams(address=address, name=f"s{address}", ident=IDENT, config=PPO1, user_prm=prm, dpv1=dpv1)


def mirror(address: int, params: BusParams, *, t_sdr: int | None = None) -> PassiveStation:
    """A PPO1 slave whose inputs are its outputs."""
    return make_slave(address, MirrorDevice(IDENT, PPO1), params, t_sdr=t_sdr)


@dataclass
class SimBus:
    """A master with all acyclic services and its slaves in ``world``, told to operate.

    Slaves are mirrors: of PPO1 where an address stands for one, else of the configuration that the master sends.
    ``devices`` take the place of mirrors; ``cycle_ns``: a fixed cycle.
    """

    world: World
    params: BusParams
    addresses: Sequence[int | SlaveParams]
    t_sdr: int | None = None
    watchdog_ms: int = 200
    devices: Mapping[int, DpV0Device] = field(default_factory=dict)
    cycle_ns: int = 0
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        setups = [setup(one) if isinstance(one, int) else one for one in self.addresses]
        devices: dict[int, DpV0Device] = {one.address: MirrorDevice(IDENT, one.config) for one in setups}
        devices |= self.devices
        self.slaves = [make_slave(a, device, self.params, t_sdr=self.t_sdr) for a, device in devices.items()]
        for slave in self.slaves:
            self.world.add(slave)
        self.master = Master(self.params, setups, MasterSettings(watchdog_ms=self.watchdog_ms, cycle_ns=self.cycle_ns))
        self.acyclic = acyclic_services(self.params.address, self.master)
        self.station = ActiveStation(
            self.params, [self.master, self.acyclic], window=self.master.window, now=self.world.now
        )
        self.world.add(self.station, on_events=self.on_events)
        self.send(GoOnline())
        self.send(SetMode(Mode.OPERATE))

    def on_events(self, events: list[Event]) -> None:
        self.events += events

    def send(self, order: object) -> None:
        self.world.command(self.station, order)

    @property
    def apps(self) -> list[SlaveApp]:
        return [slave.responder for slave in self.slaves if isinstance(slave.responder, SlaveApp)]

    @property
    def exchanging(self) -> bool:
        """All slaves are in data exchange."""
        return all(handler.state is SlaveState.DATA_EXCHANGE for handler in self.master.handlers.values())

    def until_exchanging(self, within_ns: int = 5 * S) -> None:
        """Run until all slaves are in data exchange."""
        end = self.world.now + within_ns
        while not self.exchanging:
            assert self.world.now < end, "not all slaves in data exchange: " + ", ".join(
                f"{address} {handler.state.value}" for address, handler in self.master.handlers.items()
            )
            self.world.run_for(MS)
