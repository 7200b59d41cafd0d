"""A class 2 master on a bus of octets, and the outcomes of its services."""

from __future__ import annotations

from dataclasses import dataclass, field

from octet_slave import OctetSlave
from order_bus import MS, OrderBus

from dpstack.dp.acyclic.class2 import ChangeAddress, ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import Outcome


@dataclass
class Class2Bus(OrderBus[OctetSlave]):
    """Station 2 with nothing but a class 2 master. Tests add slaves to ``bus``."""

    kind: type[OctetSlave] = field(default=OctetSlave, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.run(20)

    def read(self, address: int, service: Service, expected: int | None = None) -> Outcome:
        """The outcome of one reading service."""
        token = self.next_token()
        self.send(ReadService(token, address, service, expected))
        return self.end(token)

    def change(self, change: ChangeAddress) -> Outcome:
        """The outcome of one change of address."""
        self.send(change)
        return self.end(change.token)

    def end(self, token: int) -> Outcome:
        """Run until the service has ended."""
        return self.end_of(token, ServiceDone).outcome

    @property
    def done(self) -> list[ServiceDone]:
        """The ends of all services so far."""
        return self.events_of(ServiceDone)


__all__ = ["MS", "Class2Bus"]
