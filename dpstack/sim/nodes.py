"""Register of the stations on the medium: by address, by rate, and those that hear everything.

The look-up of a receiver takes the same time for any number of slaves. Lists are replaced, never changed, so that a
loop over one is not disturbed when a station comes or goes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from dpstack.fdl.interface import BusStation
from dpstack.machine import Transmit
from dpstack.trace import Event
from dpstack.units import NEVER


class Node:
    """One station on the medium with its scheduling.

    ``deadline`` is the last answer of its ``wake_at``, ``due`` when the world calls it (never later), and ``order`` its
    place among those due at the same time. ``entry`` is its next entry in the event heap (never later than ``due``),
    ``later`` are its other ones, the next one last. It hears transmissions that begin at ``hears_from`` or later: it
    cannot hear while it sends.
    """

    def __init__(
        self, station: BusStation, label: str | None, on_events: Callable[[list[Event]], None] | None, now: int
    ) -> None:
        self.station = station
        self.on_events = on_events
        self.address, self.baud, self.hears_all = station.address, station.baud, station.hears_all
        #: a port, without telegrams and edges: it gets octets, each at its end
        self.by_octets: bool = getattr(station, "by_octets", False)
        self.named = label is not None
        self.name = str(station.address) if label is None else label
        self.hears_from = self.sending_until = self.mute_until = now
        self.on_bus = True
        self.deadline = self.due = self.entry = NEVER
        self.order = 0
        self.later: list[int] = []
        self.transmit: Transmit = _not_connected


def _not_connected(octets: bytes, now: int) -> int:
    raise RuntimeError("a station that is on no medium wanted to send")


class Nodes:
    def __init__(self) -> None:
        self._by_station: dict[int, Node] = {}
        #: passive stations by address; two may have the same one
        self.by_address: dict[int, list[Node]] = {}
        self.by_rate: dict[int, list[Node]] = {}
        self.listeners: list[Node] = []
        #: those that get single octets
        self.ports: list[Node] = []

    def __iter__(self) -> Iterator[Node]:
        return iter(list(self._by_station.values()))

    def find(self, station: BusStation) -> Node | None:
        """The node of ``station``, None when it is not on this medium."""
        return self._by_station.get(id(station))

    def add(self, node: Node) -> None:
        self._by_station[id(node.station)] = node
        if node.by_octets:
            self.ports = [*self.ports, node]
        elif node.hears_all:
            self.listeners = [*self.listeners, node]
        self._enter(node)

    def remove(self, node: Node) -> None:
        del self._by_station[id(node.station)]
        self.listeners = [other for other in self.listeners if other is not node]
        self.ports = [other for other in self.ports if other is not node]
        self._leave(node)

    def renew(self, node: Node) -> None:
        """The station's address or rate changed."""
        self._leave(node)
        node.address = node.station.address
        node.baud = node.station.baud
        if not node.named:
            node.name = str(node.address)
        self._enter(node)

    def _enter(self, node: Node) -> None:
        self.by_rate[node.baud] = [*self.by_rate.get(node.baud, ()), node]
        if not node.hears_all:
            self.by_address[node.address] = [*self.by_address.get(node.address, ()), node]

    def _leave(self, node: Node) -> None:
        _drop(self.by_rate, node.baud, node)
        if not node.hears_all:
            _drop(self.by_address, node.address, node)


def _drop(index: dict[int, list[Node]], key: int, node: Node) -> None:
    rest = [other for other in index[key] if other is not node]
    if rest:
        index[key] = rest
    else:
        del index[key]
