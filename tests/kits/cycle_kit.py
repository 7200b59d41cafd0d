"""A simulated bus with a fixed cycle, and when its cycles really began: read off the wire, octet by octet."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from bus_kit import IDENT, PPO1, mirror
from support import MS, KeepsEvents, S, WorldFactory

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import LinkUser
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry

P500 = BusParams.preset(500_000, address=2)


def slave(address: int, **changes: Any) -> SlaveParams:
    """How the master parameterises a mirror slave with twelve octets each way."""
    values: dict[str, Any] = {"address": address, "name": f"s{address}", "ident": IDENT, "config": PPO1}
    return SlaveParams(**(values | changes))


@dataclass
class CycleBus(KeepsEvents):
    """A master with ``setups`` in Operate in ``world``; ``silent`` addresses have no slave. Everything is kept."""

    world: World
    params: BusParams
    setups: Sequence[SlaveParams]
    cycle_ns: int
    silent: Sequence[int] = ()
    more: Sequence[LinkUser] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    patience: Patience = EXACT
    events: list[Event] = field(default_factory=list)
    wire: list[WireEntry] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.slaves = {s.address: mirror(s.address, self.params) for s in self.setups if s.address not in self.silent}
        for station in self.slaves.values():
            self.world.add(station)
        watchdog_ms = max(200, 5 * self.cycle_ns // MS)
        self.master = Master(
            self.params,
            self.setups,
            MasterSettings(**{"cycle_ns": self.cycle_ns, "watchdog_ms": watchdog_ms, **self.options}),
        )
        users = [self.master, *self.more]
        self.station = ActiveStation(
            self.params, users, patience=self.patience, window=self.master.window, now=self.world.now
        )
        self.station.wire = self.wire.append
        self.world.add(self.station, on_events=self.events.extend)
        self.send(GoOnline())
        self.send(SetMode(Mode.OPERATE))

    def send(self, order: object) -> None:
        """Give the master's station an order now."""
        self.world.command(self.station, order)

    def run(self, ns: int) -> None:
        """Let ``ns`` pass."""
        self.world.run_for(ns)

    def state(self, address: int) -> SlaveState:
        """The state of one slave."""
        return self.master.handlers[address].state

    def until_exchanging(self, within_ns: int = 5 * S) -> None:
        """Run until all slaves that are there are in data exchange."""
        end = self.world.now + within_ns
        while not all(self.state(address) is SlaveState.DATA_EXCHANGE for address in self.slaves):
            assert self.world.now < end, {a: h.state.value for a, h in self.master.handlers.items()}
            self.run(MS)

    def quiet(self) -> None:
        """What was kept so far is forgotten; books too."""
        self.wire.clear()
        self.events.clear()

    def data(self, address: int) -> list[WireEntry]:
        """Data_Exchange requests to ``address``, repetitions left out: SD2, LE 15, no SAPs, FC 5D or 7D."""
        mine = [e for e in self.wire if len(e.octets) > 6 and e.octets[4] & 0x7F == address]
        mine = [e for e in mine if e.octets[0] == 0x68 and e.octets[5] & 0x7F == self.params.address]
        first = [e for n, e in enumerate(mine) if not n or e.octets != mine[n - 1].octets]
        return [e for e in first if e.octets[1] == 15 and e.octets[4:6] == bytes((address, self.params.address))]

    def exchanges(self, address: int) -> list[int]:
        """When they began."""
        return [e.start_ns for e in self.data(address)]

    def requests(self, dsap: int) -> list[WireEntry]:
        """The requests of this master to the SAP."""
        ts = self.params.address
        return [
            e
            for e in self.wire
            if len(e.octets) > 8 and e.octets[0] == 0x68 and e.octets[5] == ts | 0x80 and e.octets[7] == dsap
        ]


def steps(times: list[int]) -> set[int]:
    return {later - earlier for earlier, later in itertools.pairwise(times)}


def running(
    world: WorldFactory,
    *setups: SlaveParams,
    cycle_ns: int = 4 * MS,
    params: BusParams = P500,
    after_ns: int = 20 * MS,
    **more: Any,
) -> CycleBus:
    """A bus ``after_ns`` after all its slaves reached data exchange, at 500 kbit/s with slaves 5 and 6 by default."""
    bus = CycleBus(world(), params, setups or (slave(5), slave(6)), cycle_ns, **more)
    bus.until_exchanging()
    bus.run(after_ns)
    bus.quiet()
    return bus
