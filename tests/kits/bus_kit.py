"""A whole simulated bus in one line: a master with mirror slaves, brought up in a world with a referee."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from support import MS, S

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.slave.application import make_slave
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event

#: PPO1: four words PKW and two words PZD, consistent
PPO1 = bytes.fromhex("F3 F1")
IDENT = 0x1234


def setup(address: int) -> SlaveParams:
    """How a master parameterises :func:`mirror`."""
    return SlaveParams(address=address, name=f"s{address}", ident=IDENT, config=PPO1)


def mirror(address: int, params: BusParams, *, t_sdr: int | None = None) -> PassiveStation:
    """A PPO1 slave whose inputs are its outputs."""
    return make_slave(address, MirrorDevice(IDENT, PPO1), params, t_sdr=t_sdr)


@dataclass
class SimBus:
    """A master and its slaves in ``world``, told to operate."""

    world: World
    params: BusParams
    addresses: Sequence[int]
    t_sdr: int | None = None
    watchdog_ms: int = 200
    events: list[Event] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.slaves = [mirror(address, self.params, t_sdr=self.t_sdr) for address in self.addresses]
        for slave in self.slaves:
            self.world.add(slave)
        setups = [setup(address) for address in self.addresses]
        self.master = Master(self.params, setups, watchdog_ms=self.watchdog_ms)
        self.station = ActiveStation(self.params, [self.master], now=self.world.now)
        self.world.add(self.station, on_events=self.events.extend)
        self.world.command(self.station, GoOnline())
        self.world.command(self.station, SetMode(Mode.OPERATE))

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
