"""A simulated bus with a fixed cycle, and when its cycles really began: read off the wire, octet by octet."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from bus_kit import SimBus, setup
from support import MS, WorldFactory

from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.interface import LinkUser
from dpstack.params import BusParams
from dpstack.trace import WireEntry

P500 = BusParams.preset(500_000, address=2)


def slave(address: int, **changes: Any) -> SlaveParams:
    """Parameters of a mirror slave with twelve octets each way."""
    return setup(address, **changes)


@dataclass
class CycleBus(SimBus):
    """A bus whose master keeps every transmission; without acyclic services unless ``more`` has them."""

    more: Sequence[LinkUser] = ()
    wire: list[WireEntry] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.station.wire = self.wire.append

    def quiet(self) -> None:
        """Forget the transmissions and events so far."""
        self.wire.clear()
        self.events.clear()

    def data(self, address: int) -> list[WireEntry]:
        """Data_Exchange requests to ``address``, repetitions left out: SD2, LE 15, no SAPs, FC 5D or 7D."""
        mine = [e for e in self.wire if len(e.octets) > 6 and e.octets[4] & 0x7F == address]
        mine = [e for e in mine if e.octets[0] == 0x68 and e.octets[5] & 0x7F == self.params.address]
        first = [e for n, e in enumerate(mine) if not n or e.octets != mine[n - 1].octets]
        return [e for e in first if e.octets[1] == 15 and e.octets[4:6] == bytes((address, self.params.address))]

    def exchanges(self, address: int) -> list[int]:
        """Start times of the Data_Exchange requests to ``address`` in ns."""
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
