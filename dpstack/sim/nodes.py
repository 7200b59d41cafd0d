"""Register of the stations on the medium: by address, by baud rate, and the listeners to all telegrams.

The look-up of a receiver takes the same time for any number of slaves. A station that comes or goes replaces the lists
and does not change them, so that a running loop over a list goes on undisturbed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from dpstack.fdl.interface import BusStation, Hears, TellsMoves
from dpstack.fdl.telegram import Telegram
from dpstack.machine import Transmit
from dpstack.params import BROADCAST
from dpstack.trace import Event
from dpstack.units import NEVER, NOW


class Node:
    """A station on the medium and its entries in the event heap.

    ``deadline``: last result of the station's ``wake_at``. ``due``: time at which the world calls the station (never
    after ``deadline``); ``order``: its place among the stations due at the same time. ``entries``: times of its heap
    entries, the next one (never after ``due``) last, below them NEVER. The station hears transmissions that begin at
    ``hears_from`` or later, because it cannot hear while it sends.
    """

    def __init__(
        self, station: BusStation, label: str | None, on_events: Callable[[list[Event]], None] | None, now: int
    ) -> None:
        self.station = station
        self.on_events = on_events
        self.address, self.baud, self.hears_all = station.address, station.baud, station.hears_all
        #: a port gets no telegrams and edges, but each octet at its end
        self.by_octets: bool = getattr(station, "by_octets", False)
        self.named = label is not None
        self.name = str(station.address) if label is None else label
        self.hears_from = self.sending_until = self.mute_until = now
        self.on_bus = True
        self.deadline = self.due = NEVER
        self.order = 0
        self.entries = [NEVER]
        self.transmit: Transmit = _not_connected
        #: the other stations that hear its telegrams, by their DA
        self.hearers: dict[int, tuple[Node, ...]] = {}
        self.take_tx, self.sent = station.take_tx, station.sent
        self.hear = station.hear if isinstance(station, Hears) else self._hear_in_steps
        self.unread = station.unread if isinstance(station, Hears) else ()
        #: the station's address or rate may have changed
        self.moved = self._asked = not isinstance(station, TellsMoves)
        if isinstance(station, TellsMoves):
            station.on_move = self._note_move

    def _note_move(self) -> None:
        self.moved = True

    def follow(self) -> bool:
        """Whether address or rate of the station have changed."""
        station = self.station
        self.moved = self._asked
        return station.address != self.address or station.baud != self.baud

    def _hear_in_steps(self, telegram: Telegram, start: int, end: int) -> int:
        """As :meth:`~dpstack.fdl.interface.Hears.hear`."""
        if self.station.hears_all or telegram.da != BROADCAST:
            self.station.activity(start)
        self.station.telegram(telegram, end)
        return NOW


def _not_connected(octets: bytes, now: int) -> int:
    raise RuntimeError("a station that is on no medium wanted to send")


class Hearers(dict[int, tuple[Node, ...]]):
    """The stations that hear a telegram, by its DA: those that hear all, then the addressed ones. Found once.

    ``all_addressed`` False: a telegram to all addresses nobody.
    """

    def __init__(self, nodes: Nodes, *, all_addressed: bool) -> None:
        self._nodes = nodes
        self._all_addressed = all_addressed

    def __missing__(self, da: int) -> tuple[Node, ...]:
        nodes = self._nodes
        addressed: list[Node] = []
        if da != BROADCAST:
            addressed = nodes.by_address.get(da, [])
        elif self._all_addressed:
            addressed = [node for same_rate in nodes.by_rate.values() for node in same_rate if not node.hears_all]
        self[da] = found = (*nodes.listeners, *addressed)
        return found


class _Others(dict[int, tuple[Node, ...]]):
    """:class:`Hearers` of the telegrams of ``node``: it does not hear itself."""

    def __init__(self, node: Node, hearers: Hearers) -> None:
        self._node = node
        self._hearers = hearers

    def __missing__(self, da: int) -> tuple[Node, ...]:
        self[da] = found = tuple(other for other in self._hearers[da] if other is not self._node)
        return found


class Nodes:
    def __init__(self) -> None:
        self._by_station: dict[int, Node] = {}
        #: passive stations by address; two may have the same address
        self.by_address: dict[int, list[Node]] = {}
        self.by_rate: dict[int, list[Node]] = {}
        self.listeners: list[Node] = []
        #: the stations that get single octets
        self.ports: list[Node] = []
        #: the rate of all stations if they have the same one and none is a port, else 0
        self.common_rate = 0
        #: the stations that hear a telegram, and those that get its start edge
        self.hearers = Hearers(self, all_addressed=True)
        #: octets -> their telegram and its time on the wire in ns at the common rate, of the last plain transmissions
        self.plain: dict[bytes, tuple[Telegram | None, int]] = {}
        self.told = Hearers(self, all_addressed=False)

    def __iter__(self) -> Iterator[Node]:
        return iter(list(self._by_station.values()))

    def find(self, station: BusStation) -> Node | None:
        """The node of ``station``, None when it is not on this medium."""
        return self._by_station.get(id(station))

    def add(self, node: Node) -> None:
        self._by_station[id(node.station)] = node
        node.hearers = _Others(node, self.hearers)
        if node.by_octets:
            self.ports = [*self.ports, node]
        elif node.hears_all:
            self.listeners = [*self.listeners, node]
        self._index(node)

    def remove(self, node: Node) -> None:
        del self._by_station[id(node.station)]
        self.listeners = [other for other in self.listeners if other is not node]
        self.ports = [other for other in self.ports if other is not node]
        self._unindex(node)

    def renew(self, node: Node) -> None:
        """The station's address or rate changed."""
        self._unindex(node)
        node.address = node.station.address
        node.baud = node.station.baud
        if not node.named:
            node.name = str(node.address)
        self._index(node)

    def _index(self, node: Node) -> None:
        self.by_rate[node.baud] = [*self.by_rate.get(node.baud, ()), node]
        if not node.hears_all:
            self.by_address[node.address] = [*self.by_address.get(node.address, ()), node]
        self._changed()

    def _unindex(self, node: Node) -> None:
        _drop(self.by_rate, node.baud, node)
        if not node.hears_all:
            _drop(self.by_address, node.address, node)
        self._changed()

    def _changed(self) -> None:
        self.common_rate = 0 if self.ports or len(self.by_rate) != 1 else next(iter(self.by_rate))
        self.plain.clear()
        self.hearers.clear()
        self.told.clear()
        for node in self._by_station.values():
            node.hearers.clear()


def _drop(index: dict[int, list[Node]], key: int, node: Node) -> None:
    rest = [other for other in index[key] if other is not node]
    if rest:
        index[key] = rest
    else:
        del index[key]
