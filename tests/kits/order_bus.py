"""A station with acyclic services on a bus of octets: orders to it, and the events with which it ends them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from octet_slave import OctetSlave
from ring_bus import RingBus

from dpstack.dp.master.master import Master
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.active.use_token import Guard
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.trace import Event

MS = 1_000_000
T = TypeVar("T")
E = TypeVar("E", bound=Event)
SlaveT = TypeVar("SlaveT", bound=OctetSlave)


@dataclass
class OrderBus(Generic[SlaveT]):
    """Station 2 with the acyclic services and slaves of ``kind`` at ``addresses``.

    It has a DP master too if :meth:`setups` says how to parameterise slaves. ``tokens`` is the token of the last order.
    """

    addresses: tuple[int, ...] = ()
    mode: str = "whole"
    guard: Guard | None = None
    baud: int = 500_000
    kind: type[SlaveT] = field(kw_only=True)
    bus: RingBus = field(init=False)
    tokens: int = 0

    def __post_init__(self) -> None:
        self.bus = RingBus(self.baud, self.mode)
        self.slaves = {address: self.kind(self.bus, address) for address in self.addresses}
        params = BusParams.preset(self.baud, address=2, gap=0)
        setups = self.setups()
        self.masters = [Master(params, setups)] if setups else []
        self.acyclic = acyclic_services(2, *self.masters)
        self.station = ActiveStation(params, [*self.masters, self.acyclic], guard=self.guard)
        self.bus.stations.append(self.station)
        self.send(GoOnline())

    def setups(self) -> Sequence[SlaveParams]:
        """The slaves that a DP master of this station polls."""
        return ()

    @property
    def slave(self) -> SlaveT:
        """The first slave."""
        return self.slaves[self.addresses[0]]

    def send(self, order: object) -> None:
        self.bus.command(self.station, order)

    def next_token(self) -> int:
        self.tokens += 1
        return self.tokens

    def events_of(self, kind: type[E]) -> list[E]:
        return self.bus.events_of(kind)

    def run(self, ms: int) -> None:
        self.bus.run(ms * MS)

    def until(self, condition: Callable[[], T], ms: int = 20_000) -> T:
        """Run until ``condition()`` is true, for ``ms`` of bus time at most; its result."""
        limit = self.bus.now + ms * MS
        while not (found := condition()):
            assert self.bus.now < limit, "it never came to that"
            self.bus.run(MS)
        return found

    def end_of(self, token: int, kind: type[E], ms: int = 20_000) -> E:
        """Run until the one event of ``kind`` that ends the order with this token."""
        (one,) = self.until(lambda: [e for e in self.events_of(kind) if getattr(e, "token", None) == token], ms)
        return one
