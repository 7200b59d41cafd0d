"""The virtual world: stations on one medium, in integer nanoseconds, driven by a heap of events.

Deterministic: the same seed, stations and orders give the same wire log to the nanosecond. Every station is driven
through :func:`dpstack.machine.pump` and nothing else: on input, when its deadline is reached, after commands.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from heapq import heappop, heappush
from typing import Any

from dpstack.errors import UsageError
from dpstack.fdl.interface import BusStation
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.sim.faults import Faults
from dpstack.sim.medium import EDGES, ORDERS, TIMERS, Medium
from dpstack.sim.nodes import Node, Nodes
from dpstack.sim.referee import Referee
from dpstack.trace import Event, WireLog
from dpstack.units import NEVER

Callback = Callable[[Any], None]


class World:
    """A bus and its stations in virtual time; ``now`` in ns begins at ``start_ns``.

    ``seed`` of all random faults. With ``referee`` the wire is checked: call ``world.referee.check()`` at the end.
    ``log`` keeps the last ``keep`` transmissions.
    """

    def __init__(self, *, seed: int = 0, start_ns: int = 0, referee: bool = True, keep: int = 400) -> None:
        self.now = start_ns
        self.log = WireLog(keep)
        self.faults = Faults(2 * seed)
        self.referee: Referee | None = Referee(self.log, start_ns) if referee else None
        self._heap: list[tuple[int, int, Callback, Any]] = []
        self._count = 0
        self._nodes = Nodes()
        self._medium = Medium(self, self._nodes, self.log, self.faults, self.referee, 2 * seed + 1)
        self._on_due: Callback = self._due

    @property
    def transmissions(self) -> int:
        """The number of transmissions that have begun."""
        return self._medium.transmissions

    @property
    def baud(self) -> int:
        """The rate of the last transmission (500 kbit/s before the first)."""
        return self._medium.baud or 500_000

    # --- stations ---
    def add(
        self, station: BusStation, *, name: str | None = None, on_events: Callable[[list[Event]], None] | None = None
    ) -> None:
        """Connect ``station``, now. ``name``: its name in the wire log (default: its address).

        ``on_events`` is called with the station's events as they happen. Two stations may have one address.
        """
        if self._nodes.find(station) is not None:
            raise UsageError(f"station {station.address} is on this bus already")
        node = Node(station, name, on_events, self.now)
        node.transmit = partial(self._medium.transmit, node)
        self._nodes.add(node)
        params = getattr(station, "params", None)
        if self.referee is not None and node.hears_all and isinstance(params, BusParams):
            self.referee.know(params)
        self.settle(node, b"")

    def remove(self, station: BusStation) -> None:
        """Disconnect ``station``, or switch it off: at once, also in the middle of a telegram."""
        node = self._node(station)
        self._nodes.remove(node)
        node.on_bus = False
        self._medium.cut(node, self.now)

    def command(self, station: BusStation, command: object) -> None:
        """Pass ``command`` to the station and pump it."""
        node = self._node(station)
        station.command(command, self.now)
        self.settle(node, b"")

    def poke(self, station: BusStation) -> None:
        """Pump the station after a change from outside (its address, its application)."""
        self.settle(self._node(station), b"")

    def silence(self, station: BusStation, for_ns: int, *, deaf: bool = False) -> None:
        """For ``for_ns`` nothing that the station sends reaches the wire; ``deaf``: it does not hear either."""
        node = self._node(station)
        node.mute_until = self.now + for_ns
        if deaf:
            node.hears_from = max(node.hears_from, node.mute_until)

    def inject(self, octets: bytes, *, baud: int | None = None, sender: str = "injected") -> None:
        """Put ``octets`` of no station on the line now; ``baud`` None is the common rate of the stations."""
        rates = self._nodes.by_rate
        if baud is None:
            if len(rates) != 1:
                raise UsageError(f"stations at {len(rates)} baud rates: say at which one to inject")
            (baud,) = rates
        self._medium.inject(octets, baud, self.now, sender)
        self._announce()

    # --- time ---
    def call_at(self, at_ns: int, callback: Callable[[], None]) -> None:
        """Call ``callback`` when the world's time is ``at_ns`` (after the octets that end then, before timers)."""
        if at_ns < self.now:
            raise UsageError(f"call_at({at_ns}): the world's time is {self.now} already")
        self.schedule(at_ns, ORDERS, _call, callback)

    def next_at(self) -> int:
        """The time of the next event in ns; NEVER when there is none."""
        heap = self._heap
        return heap[0][0] if heap else NEVER

    def step(self) -> None:
        """Run the next event, whenever it is. Raises UsageError when there is none."""
        if not self._heap:
            raise UsageError("nothing will ever happen in this world: no station waits for a time, nothing is sent")
        self.now, _, call, argument = heappop(self._heap)
        call(argument)

    def run_until(self, at_ns: int) -> None:
        """Run every event up to and including ``at_ns``; then that is the time."""
        heap = self._heap
        while heap and heap[0][0] <= at_ns:
            self.now, _, call, argument = heappop(heap)
            call(argument)
        if at_ns > self.now:
            self.now = at_ns

    def run_for(self, ns: int) -> None:
        """Run every event of the next ``ns`` nanoseconds."""
        self.run_until(self.now + ns)

    def run(self, until_ns: int, stop: Callable[[], bool]) -> bool:
        """Like :meth:`run_until`, but ends after the event after which ``stop()`` is true, at its time.

        ``until_ns`` may be NEVER. True when it was stopped.
        """
        heap = self._heap
        while heap and heap[0][0] <= until_ns:
            self.now, _, call, argument = heappop(heap)
            call(argument)
            if stop():
                return True
        if self.now < until_ns < NEVER:
            self.now = until_ns
        return False

    # --- called by the medium ---
    def schedule(self, at: int, order: int, call: Callback, argument: object) -> None:
        """Call ``call(argument)`` at ``at``; ``order`` decides between those of the same nanosecond."""
        self._count += 1
        heappush(self._heap, (at, order + self._count, call, argument))

    def settle(self, node: Node, chunk: bytes) -> None:
        """Pump the station with ``chunk`` (may be empty), schedule its deadline, pass on its events."""
        if not node.on_bus:
            return
        station = node.station
        deadline = pump(station, chunk, self.now, node.transmit)
        if station.address != node.address or station.baud != node.baud:
            if station.baud != node.baud:
                # the transmission on the wire began before its receiver was at this rate
                node.hears_from = max(node.hears_from, self.now)
            self._nodes.renew(node)
        node.deadline = deadline
        if deadline < node.due:
            self._arm(node)
        if self._medium.starting:
            self._announce()
        events = station.take_events()
        if events and node.on_events is not None:
            node.on_events(events)

    def rearm(self, node: Node) -> None:
        """Schedule the station after a call that sends nothing: only its deadline may have changed."""
        node.deadline = node.station.wake_at()
        if node.deadline < node.due:
            self._arm(node)

    # --- inside ---
    def _arm(self, node: Node) -> None:
        """Call the station earlier: at its deadline. It gets a new heap entry only where it has none before that.

        Later entries stay: a watchdog that every exchange postpones has one entry, not one for each exchange.
        """
        due = node.deadline
        if due < self.now:
            due = self.now
        if due >= node.due:
            return
        node.due = due
        self._count += 1
        node.order = TIMERS + self._count
        if due < node.entry:
            self._enter(node)

    def _enter(self, node: Node) -> None:
        node.later.append(node.entry)
        node.entry = node.due
        heappush(self._heap, (node.due, node.order, self._on_due, node))

    def _due(self, node: Node) -> None:
        if not node.on_bus:
            return
        node.entry = node.later.pop()
        if node.due > self.now:  # postponed
            if node.due < node.entry:
                self._enter(node)
            return
        node.due = NEVER
        if node.deadline > self.now:
            if node.deadline < NEVER:
                self._arm(node)
        else:
            self.settle(node, b"")

    def _announce(self) -> None:
        """Announce start edges, after all other events of this instant."""
        medium = self._medium
        starting, medium.starting = medium.starting, []
        heap = self._heap
        for tx in starting:
            if heap and heap[0][0] <= self.now:
                self.schedule(self.now, EDGES, medium.edge, tx)
            else:
                medium.edge(tx)

    def _node(self, station: BusStation) -> Node:
        node = self._nodes.find(station)
        if node is None:
            raise UsageError(f"{station!r} is not on this bus: add() it first")
        return node


def _call(callback: Callable[[], None]) -> None:
    callback()
