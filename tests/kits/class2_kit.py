"""A class 2 master on a bus of octets, and what came of its services."""

from __future__ import annotations

from dataclasses import dataclass, field

from ring_bus import RingBus

from dpstack.dp.acyclic.class2 import ChangeAddress, ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import Outcome
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.active.use_token import Guard
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams

MS = 1_000_000


@dataclass
class Class2Bus:
    """Station 2 with nothing but a class 2 master, on a :class:`RingBus`."""

    mode: str = "whole"
    guard: Guard | None = None
    bus: RingBus = field(init=False)
    tokens: int = 0

    def __post_init__(self) -> None:
        self.bus = RingBus(mode=self.mode)
        self.class2 = acyclic_services(2)
        params = BusParams.preset(500_000, address=2, gap=0)
        self.station = ActiveStation(params, [self.class2], guard=self.guard)
        self.bus.stations.append(self.station)
        self.bus.command(self.station, GoOnline())
        self.bus.run(20 * MS)

    def send(self, command: object) -> None:
        """An order."""
        self.bus.command(self.station, command)

    def read(self, address: int, service: Service, expected: int | None = None) -> Outcome:
        """The end of one reading service."""
        self.tokens += 1
        self.send(ReadService(self.tokens, address, service, expected))
        return self.end(self.tokens)

    def change(self, change: ChangeAddress) -> Outcome:
        """The end of one change of address."""
        self.send(change)
        return self.end(change.token)

    def end(self, token: int, within_ns: int = 20_000 * MS) -> Outcome:
        """Run until the service has its end."""
        limit = self.bus.now + within_ns
        while not (found := [done for done in self.done if done.token == token]):
            assert self.bus.now < limit, "no end"
            self.bus.run(MS)
        (one,) = found
        return one.outcome

    @property
    def done(self) -> list[ServiceDone]:
        """All ends so far."""
        return [event for event in self.bus.events if isinstance(event, ServiceDone)]
