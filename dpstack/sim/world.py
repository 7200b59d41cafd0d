"""The virtual world: stations on one simulated bus line, in integer nanoseconds, driven by a heap of events.

Deterministic: the same seed, stations and orders give the same wire log to the nanosecond. The world drives every
station in the steps of :func:`dpstack.machine.pump` and nothing else: on input, at its deadline, after commands. Where
nothing else can come between, several steps are one call (:class:`dpstack.fdl.interface.Hears`).

The medium decodes a telegram once if all stations receive it intact, and delivers it whole when its last bit is on the
line. In other cases it delivers octets one by one: noise, a collision, another baud rate, octets that are no telegram,
a sender that is cut off.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from heapq import heappop, heappush
from itertools import count
from random import Random
from typing import Any, Final

from msgspec import Struct

from dpstack.errors import UsageError
from dpstack.fdl.interface import BusStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import run_due
from dpstack.params import BusParams
from dpstack.phy.uart import Receiver, waveform
from dpstack.sim.faults import Faults
from dpstack.sim.nodes import Node, Nodes
from dpstack.sim.referee import Referee
from dpstack.sim.transmission import Heard, Transmission, complete, garbled, on_wire, receive
from dpstack.trace import Event, WireLog
from dpstack.units import NEVER, chars_to_ns, ns_to_s

Callback = Callable[[Any], None]

# Order of events in the same nanosecond: octets, ends of transmissions, commands from outside, timers, start edges.
# A start edge cannot hold back a station whose timer ends at the same instant: both send.
_OCTETS: Final = 0
_ENDS: Final = 1 << 56
_ORDERS: Final = 2 << 56
_TIMERS: Final = 3 << 56
_EDGES: Final = 4 << 56

_NO_ADDRESS: Final = -1
#: :meth:`World._run_on` runs so many transmissions at most, and begins with hardly more that wait to be judged
_AT_ONCE: Final = range(500)
#: telegrams that it knows without asking
_MOST_KNOWN: Final = 1_024
_STEPWISE: Final = -1  # no event is run before the one that asks for it is over


class _Stream(Struct, eq=False):
    """Octets of ``tx`` that the stations at ``rate`` get one by one; ``ports_only``: the telegram is intact."""

    tx: Transmission
    rate: int
    heard: list[Heard]
    ports_only: bool = False
    index: int = 0


class _Jam(Struct, eq=False):
    """A collision: one garbled character after another until the last transmission has ended."""

    baud: int
    start_ns: int
    until_ns: int
    count: int = 0

    def end_of(self, count: int) -> int:
        return self.start_ns + chars_to_ns(count, self.baud)


class Medium:
    """One bus line. ``transmissions``: number of transmissions begun; ``baud``: rate of the last one."""

    def __init__(self, world: World, nodes: Nodes, seed: int) -> None:
        self.transmissions = 0
        self.baud = 0
        #: delayed and repeated transmissions; their start edge is announced with the next step of a station
        self.late: list[Transmission] = []
        #: end of the last transmission that was not plain (:meth:`World._run_on`), in ns
        self.busy_until = 0
        self._world = world
        self._heap = world.heap
        self._ticks = world.ticks
        self._nodes = nodes
        self._log = world.log
        self._faults = world.faults
        self._referee = world.referee
        self._rng = Random(seed)
        self._current: Transmission | None = None  # the one on the wire that ends last
        self._jam: _Jam | None = None
        self._receivers: dict[int, Receiver] = {}  # by rate, of stations at another rate than the sender's
        self._octet_ns = 0  # end of the last octet that was delivered outside of a whole telegram
        self._on_end: Callback = self._transmission_ended

    # --- sending ---
    def transmit(self, node: Node, octets: bytes, now: int) -> int:
        """``node`` puts ``octets`` on the line at ``now``; returns the end of the last bit in ns."""
        telegram, lasts = on_wire(octets, node.baud)
        tx = Transmission(node, node.name, octets, node.baud, now, now + lasts, telegram)
        if node.sending_until > now:
            raise RuntimeError(f"station {node.name} sends {octets.hex(' ')} while it is still sending")
        if self._faults.armed:
            self._faults.apply(tx)
        return self.send(node, tx, now)

    def send(self, node: Node, tx: Transmission, now: int) -> int:
        """``node`` puts ``tx`` on the line; returns its end."""
        if node.mute_until > now:
            tx.lost = True
            tx.notes.append("silenced")
        node.sending_until = tx.end_ns
        node.hears_from = max(node.hears_from, tx.end_ns)
        self._start_or_schedule(tx, now)
        return tx.end_ns

    def take_over(self, tx: Transmission) -> None:
        """A plain transmission is on the line, and something may happen before it ends."""
        node = tx.node
        if node is not None:
            node.sending_until = node.hears_from = tx.end_ns
        self.busy_until = tx.end_ns
        self._current = tx
        self._schedule_end(tx)
        self._announce_edge(tx)

    def inject(self, octets: bytes, baud: int, now: int, sender: str) -> None:
        """Put ``octets`` that no station sends on the line at ``now``."""
        telegram, lasts = on_wire(octets, baud)
        tx = Transmission(None, sender, octets, baud, now, now + lasts, telegram, forced=True)
        if self._faults.armed:
            self._faults.apply(tx)
        self._start_or_schedule(tx, now)

    def _schedule_end(self, tx: Transmission) -> None:
        heappush(self._heap, (tx.end_ns, _ENDS + next(self._ticks), self._on_end, tx))
        self._world.free = _STEPWISE

    def cut(self, node: Node, now: int) -> None:
        """End the transmission of ``node``, which is unplugged: no station receives an unfinished octet."""
        tx = self._current
        if tx is None or tx.node is not node or tx.end_ns <= now:
            return
        sent = tx.octets[: complete(now - tx.start_ns, tx.baud, len(tx.octets))]
        tx.notes.append(f"cut off after {len(sent)} of {len(tx.octets)} octets")
        whole, tx.whole = tx.whole, False
        if whole:
            self._octet_ns = now
        tx.octets = sent
        tx.telegram = None
        tx.end_ns = now
        tx.cut = True
        self._end(tx)
        self._current = None
        self.busy_until = now
        if whole and sent:
            self._deliver_octets(sent, tx.baud, tx.start_ns, ports=False)

    def announce_late_edges(self) -> None:
        """Announce the start edges of the transmissions in ``late``."""
        late, self.late = self.late, []
        now = self._world.now
        for tx in late:
            if self._heap[0][0] <= now:
                self._world.schedule(now, _EDGES, self._announce_edge, tx)
            else:
                self._announce_edge(tx)

    def _announce_edge(self, tx: Transmission) -> None:
        """Announce the start edge of ``tx`` to the stations that hear all and to the addressee.

        An edge brings no deadline forward (:class:`BusStation`): a station that an edge puts off is asked for its new
        deadline when the old one is reached.
        """
        if tx.cut:
            return
        start = tx.start_ns
        telegram = tx.telegram
        for node in self._nodes.told[_NO_ADDRESS if telegram is None else telegram.da]:
            if node.hears_from <= start and (node.baud == tx.baud or node.hears_all):
                node.station.activity(start)

    def tell_edge(self, telegram: Telegram, sender: Node, now: int) -> None:
        """Announce the start edge of a plain ``telegram`` before its time: it may come again."""
        for node in self._nodes.told[telegram.da]:
            if node is not sender and node.hears_from <= now:
                node.station.activity(now)

    # --- the line ---
    def _start_or_schedule(self, tx: Transmission, now: int) -> None:
        if tx.repeat_after_ns is not None and not tx.lost:
            again = tx.again()
            self._world.schedule(again.start_ns, _TIMERS, self._begin_late, again)
        if tx.lost:
            self._world.schedule(tx.end_ns, _ENDS, self._transmission_ended, tx)
        elif tx.start_ns > now:
            self._world.schedule(tx.start_ns, _TIMERS, self._begin_late, tx)
        else:
            self._begin(tx)

    def _begin_late(self, tx: Transmission) -> None:
        if tx.node is None or (tx.node.on_bus and tx.node.mute_until <= self._world.now):
            self._begin(tx, late=True)

    def _begin(self, tx: Transmission, *, late: bool = False) -> None:
        """Put ``tx`` on the line now, and announce its start edge after all other events of this instant."""
        self.transmissions += 1
        self.baud = baud = tx.baud
        start = tx.start_ns
        self._schedule_end(tx)
        before = self._current
        if before is not None and self.busy_until > start:
            self._collide(tx, before)
            if tx.end_ns > before.end_ns:
                self._current = tx
                self.busy_until = tx.end_ns
        else:
            self._current = tx
            self.busy_until = tx.end_ns
            if tx.flips or tx.telegram is None or baud != self._nodes.common_rate:
                self._begin_octets(tx)
            else:
                tx.whole = True
        if late:
            self.late.append(tx)
        elif self._heap[0][0] <= start:
            self._world.schedule(start, _EDGES, self._announce_edge, tx)
        else:
            self._announce_edge(tx)

    def _begin_octets(self, tx: Transmission) -> None:
        """Begin a transmission of which some stations get single octets: ports, stations at another rate, or all."""
        baud = tx.baud
        self._octet_ns = tx.start_ns
        if tx.flips:
            tx.notes.append("damaged")
        tx.whole = not tx.flips and tx.telegram is not None
        nodes = self._nodes
        if not tx.whole or nodes.ports:
            self._schedule_octets(_Stream(tx, baud, receive(tx.octets, baud, tx.flips), ports_only=tx.whole))
        rates = nodes.by_rate
        if len(rates) > 1 or baud not in rates:
            self._sample_at_other_rates(tx)

    def _transmission_ended(self, tx: Transmission) -> None:
        if not tx.cut:  # cut() has ended it already
            self._end(tx)

    def _end(self, tx: Transmission) -> None:
        """The last bit of ``tx`` is on the line: judge and log it, deliver it if it is whole, and run its hearers."""
        start, end = tx.start_ns, tx.end_ns
        telegram = tx.telegram if tx.whole else None
        log, referee = self._log, self._referee
        log.settle()
        if referee is not None:
            if telegram is not None:
                referee.ended(tx)
            elif not tx.lost:
                tx.heard_ns = self._octet_ns
                referee.ended(tx)
        log.add((start, end, tx.octets, tx.sender, "; ".join(tx.notes)))
        if telegram is None:
            return
        # not the sender: it hears only later transmissions
        hearing = [n for n in self._nodes.hearers[telegram.da] if n.hears_from <= start and n.baud == tx.baud]
        for node in hearing:
            node.station.telegram(telegram, end)
        for node in hearing:
            self._world.run_station(node, node.station.wake_at())

    def _deliver_octets(self, octets: bytes, rate: int, since: int, *, ports: bool = True, others: bool = True) -> None:
        """Deliver ``octets`` to the stations at ``rate``: to ``ports``, and to all ``others``."""
        pump_station = self._world.pump_station
        for node in self._nodes.by_rate.get(rate, ()):
            if node.hears_from <= since and node.on_bus and (ports if node.by_octets else others):
                pump_station(node, octets)

    # --- octet by octet ---
    def _sample_at_other_rates(self, tx: Transmission) -> None:
        """Deliver the characters that receivers at other rates read in ``tx``."""
        levels = waveform(tx.octets, tx.flips)
        for rate in self._nodes.by_rate:
            if rate == tx.baud:
                continue
            receiver = self._receivers.get(rate)
            if receiver is None:
                receiver = self._receivers[rate] = Receiver(rate)
            got = receiver.sample(tx.start_ns, levels, tx.baud)
            self._schedule_octets(_Stream(tx, rate, [(c.at_ns - tx.start_ns, c.octet) for c in got if c.good]))
            if receiver.due < NEVER:
                self._world.schedule(receiver.due, _OCTETS, self._deliver_late_character, (receiver, tx.start_ns))

    def _deliver_late_character(self, late: tuple[Receiver, int]) -> None:
        """Deliver a character that ends after its transmission, unless another transmission has begun in it."""
        receiver, since = late
        for char in receiver.idle(self._world.now):
            if char.good:
                self._deliver_octets(bytes((char.octet,)), receiver.baud, since)

    def _schedule_octets(self, stream: _Stream) -> None:
        if stream.heard:
            self._world.schedule(stream.tx.start_ns + stream.heard[0][0], _OCTETS, self._deliver_octet, stream)

    def _deliver_octet(self, stream: _Stream) -> None:
        tx = stream.tx
        if tx.collided or tx.cut:
            return
        offset, octet = stream.heard[stream.index]
        at_ns = tx.start_ns + offset
        stream.index += 1
        if stream.index < len(stream.heard):
            at = tx.start_ns + stream.heard[stream.index][0]
            self._world.schedule(at, _OCTETS, self._deliver_octet, stream)
        if stream.ports_only:
            self._deliver_octets(bytes((octet,)), stream.rate, tx.start_ns, others=False)
            return
        if stream.rate == tx.baud:
            self._octet_ns = at_ns
        self._deliver_octets(bytes((octet,)), stream.rate, tx.start_ns)

    def _collide(self, late: Transmission, early: Transmission) -> None:
        """Garble both transmissions from here to the end of the longer one."""
        now = late.start_ns
        if self._referee is not None:
            self._referee.collision(late, early, now if early.whole else self._octet_ns)
        if not early.collided:
            early.collided = True
            early.notes.append("collision")
            if early.whole:
                early.whole = False
                self._octet_ns = now
                self._world.schedule(now, _OCTETS, self._deliver_complete_octets, (early, now))
        late.collided = True
        late.notes.append("collision")
        for receiver in self._receivers.values():
            receiver.reset()
        until = max(early.end_ns, late.end_ns)
        jam = self._jam
        if jam is not None and jam.until_ns > now:
            jam.until_ns = max(until, jam.until_ns)
            return
        self._jam = jam = _Jam(late.baud, now, until)
        self._world.schedule(jam.end_of(1), _OCTETS, self._deliver_garbled_octet, jam)

    def _deliver_complete_octets(self, collision: tuple[Transmission, int]) -> None:
        """Deliver the octets of a telegram that were complete before the collision."""
        tx, at = collision
        sent = complete(at - tx.start_ns, tx.baud, len(tx.octets))
        if sent:
            self._deliver_octets(tx.octets[:sent], tx.baud, tx.start_ns, ports=False)

    def _deliver_garbled_octet(self, jam: _Jam) -> None:
        since = jam.end_of(jam.count)
        jam.count += 1
        if jam.end_of(jam.count + 1) <= jam.until_ns:
            self._world.schedule(jam.end_of(jam.count + 1), _OCTETS, self._deliver_garbled_octet, jam)
        octet = garbled(self._rng)
        if octet is None:
            return
        self._octet_ns = jam.end_of(jam.count)
        for node in self._nodes:
            if node.hears_from <= since and node.on_bus:
                self._world.pump_station(node, bytes((octet,)))


class World:
    """A bus and its stations in virtual time; ``now`` in ns begins at ``start_ns``.

    ``seed``: of all random faults. With ``referee`` one checks the wire: call ``world.referee.check()`` at the end.
    ``log`` keeps the last ``keep`` transmissions.
    """

    def __init__(self, *, seed: int = 0, start_ns: int = 0, referee: bool = True, keep: int = 400) -> None:
        #: virtual time in ns
        self.now = start_ns
        #: the last transmissions, at most ``keep``
        self.log = WireLog(keep)
        #: faults of the line: noise, lost or damaged telegrams
        self.faults = Faults(2 * seed)
        #: checks the wire against the standard; ``world.referee.check()`` raises for a violation. None without one
        self.referee: Referee | None = Referee(self.log, start_ns) if referee else None
        #: the events to come, and the numbers that keep their order within a nanosecond; the last one never comes
        self.heap: list[tuple[int, int, Callback, Any]] = [(NEVER, 0, _nothing, None)]
        #: numbers that keep the order of events of the same time
        self.ticks = count(1)
        self._nodes = Nodes()
        self._medium = Medium(self, self._nodes, 2 * seed + 1)
        self._on_timer: Callback = self._run_timer
        self._horizon = _STEPWISE  # a station's deadline up to this time needs no heap entry if it is the next event
        self._stop: Callable[[], bool] | None = None  # asked after each event of :meth:`run`
        self._stopped = False  # it has said yes
        #: where the last run was stopped on its short way: the station that goes on, its deadline, and the other one
        #: whose deadline is not in the heap; the next run goes on there, what else may come settles it before
        self._left: tuple[Node, int, Node | None] | None = None
        #: see :meth:`_is_free`; whatever takes the line, or comes into the heap, brings it forward
        self.free = _STEPWISE

    def __repr__(self) -> str:
        return f"<World at {ns_to_s(self.now):.6f} s, {len(list(self._nodes))} stations>"

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
        """Connect ``station`` now. ``name``: its name in the wire log (default: its address).

        The world calls ``on_events`` with the station's events as they happen. Two stations may have one address.
        """
        if self._nodes.find(station) is not None:
            raise UsageError(f"station {station.address} is on this bus already")
        self._settle()
        node = Node(station, name, on_events, self.now)
        node.transmit = partial(self._medium.transmit, node)
        self._nodes.add(node)
        self.free = _STEPWISE
        params = getattr(station, "params", None)
        if self.referee is not None and node.hears_all and isinstance(params, BusParams):
            self.referee.know(params)
        self.pump_station(node, b"")

    def remove(self, station: BusStation) -> None:
        """Disconnect ``station`` at once, even in the middle of a telegram."""
        node = self._node(station)
        self._nodes.remove(node)
        self.free = _STEPWISE
        node.on_bus = False
        self._medium.cut(node, self.now)

    def command(self, station: BusStation, command: object) -> None:
        """Pass ``command`` to the station and pump it."""
        node = self._node(station)
        station.command(command, self.now)
        self.pump_station(node, b"")

    def poke(self, station: BusStation) -> None:
        """Pump the station after a change from outside (its address, the deadline of its application)."""
        node = self._node(station)
        poke: Callable[[], None] | None = getattr(station, "poke", None)
        if poke is not None:  # a passive station keeps the deadline of its application
            poke()
        self.pump_station(node, b"")

    def silence(self, station: BusStation, for_ns: int, *, deaf: bool = False) -> None:
        """Keep all octets of the station off the wire for ``for_ns``; ``deaf``: it receives none either."""
        node = self._node(station)
        node.mute_until = self.now + for_ns
        if deaf:
            node.hears_from = max(node.hears_from, node.mute_until)

    def unplug(self, station: BusStation) -> None:
        """Cut the station off the line until :meth:`plug`, even in the middle of a telegram. Its clock goes on."""
        node = self._node(station)
        self._medium.cut(node, self.now)
        node.sending_until = min(node.sending_until, self.now)
        node.mute_until = node.hears_from = NEVER

    def plug(self, station: BusStation) -> None:
        """Connect the station again. It hears transmissions that begin from now on."""
        node = self._node(station)
        node.mute_until = node.hears_from = self.now

    def inject(self, octets: bytes, *, baud: int | None = None, sender: str = "injected") -> None:
        """Put ``octets`` that no station sends on the line now; ``baud`` None: the common rate of the stations."""
        rates = self._nodes.by_rate
        if baud is None:
            if len(rates) != 1:
                raise UsageError(f"stations at {len(rates)} baud rates: say at which one to inject")
            (baud,) = rates
        self._settle()
        self._medium.inject(octets, baud, self.now, sender)

    # --- time ---
    def call_at(self, at_ns: int, callback: Callable[[], None]) -> None:
        """Call ``callback`` when the world's time is ``at_ns`` (after the octets that end then, before timers)."""
        if at_ns < self.now:
            raise UsageError(f"call_at({at_ns}): the world's time is {self.now} already")
        self._settle()
        self.schedule(at_ns, _ORDERS, _call, callback)

    def next_at(self) -> int:
        """The time of the next event in ns; NEVER without one."""
        self._settle()
        return self.heap[0][0]

    def step(self) -> None:
        """Advance to the next event and run it. Raises UsageError if none exists."""
        self._settle()
        if self.heap[0][0] == NEVER:
            raise UsageError("nothing will ever happen in this world: no station waits for a time, nothing is sent")
        self.now, _, call, argument = heappop(self.heap)
        call(argument)

    def run_until(self, at_ns: int) -> None:
        """Run every event up to and including ``at_ns`` and advance to that time."""
        self.run(at_ns, None)

    def run_for(self, ns: int) -> None:
        """Run every event of the next ``ns`` nanoseconds."""
        self.run_until(self.now + ns)

    def run(self, until_ns: int, stop: Callable[[], bool] | None) -> bool:
        """Run like :meth:`run_until`, but end with the event after which ``stop()`` is true, at its time.

        ``until_ns`` may be NEVER. ``stop`` only looks: the world may be in the middle of an event when it is asked, so
        orders and injected octets wait for the end of the run. Returns whether ``stop()`` ended it; None never does.
        """
        heap = self.heap
        self._horizon = horizon = min(until_ns, NEVER - 1)
        self._stop = stop
        self._stopped = False
        left = self._left
        try:
            if left is not None:
                if left[1] <= horizon:
                    self._go_on(*left)
                    if stop is not None and (self._stopped or stop()):
                        return True
                else:
                    self._settle()
            while heap[0][0] <= horizon:
                self.now, _, call, argument = heappop(heap)
                call(argument)
                if stop is not None and (self._stopped or stop()):
                    return True
        finally:
            self._horizon = _STEPWISE
        if self.now < until_ns < NEVER:
            self.now = until_ns
        return False

    # --- for the medium ---
    def schedule(self, at: int, order: int, call: Callback, argument: object) -> None:
        """Call ``call(argument)`` at ``at``; ``order`` decides between those of the same nanosecond."""
        heappush(self.heap, (at, order + next(self.ticks), call, argument))
        if at < self.free:
            self.free = at

    def pump_station(self, node: Node, chunk: bytes) -> None:
        """Pump the station with ``chunk`` (may be empty), see :meth:`run_station`."""
        if node.on_bus:
            station = node.station
            if chunk:
                station.receive(chunk, self.now)
            self.run_station(node, station.wake_at())

    def run_station(self, node: Node, deadline: int) -> None:
        """Run the station if its ``deadline`` is reached, schedule its next one, pass on its events."""
        if node.on_bus:
            station = node.station
            if deadline <= self.now:
                deadline = run_due(station, self.now, node.transmit)
            self._follow(node, deadline, station.take_events())

    def _follow(self, node: Node, deadline: int, events: list[Event]) -> None:
        """The station ran, and has a new ``deadline`` and ``events``."""
        if node.moved and node.follow():
            self._renew(node)
        node.deadline = deadline
        if self._medium.late:
            self._medium.announce_late_edges()
        if deadline < node.due:
            self._set_timer(node)
            self._schedule_timer(node)
        if events and node.on_events is not None:
            node.on_events(events)

    def _go_on(self, node: Node, at: int, waiting: Node | None) -> None:
        """Go on where the last run was stopped."""
        self._left = None
        self.now = at
        if waiting is node:
            waiting = None
            node.due = NEVER
        self._run_on(node, waiting)

    def _settle(self) -> None:
        """Put the deadlines into the heap with which the last run was stopped on its short way."""
        if self._left is not None:
            node, _, waiting = self._left
            self._left = None
            if waiting is not None:
                self._schedule_timer(waiting)
            self._follow(node, node.station.wake_at(), node.station.take_events())

    def _run_on(self, node: Node, waiting: Node | None = None) -> None:
        """Run ``node``, whose deadline is reached, and what follows from it as long as nothing else comes before: its
        transmission, the station that hears that, its answer. Most exchanges need no entry in the heap.

        Plain transmissions go this way: whole ones, at the rate of all stations, on a silent line, that no fault has
        hit, if nothing else happens before they end.

        ``waiting``: the only station with a deadline that is in the heap only after this.
        """
        stop, medium, log, faults, nodes = self._stop, self._medium, self.log, self.faults, self._nodes
        now, is_judged, sent = self.now, log.is_judged, 0
        if len(log.waiting) > len(_AT_ONCE):
            log.settle()
        if len(nodes.plain) == _MOST_KNOWN:
            nodes.plain.clear()
        self.free = _STEPWISE
        baud, known = nodes.common_rate, nodes.plain
        try:
            for _ in _AT_ONCE:
                # bound methods that are attributes are read first: called as methods they are looked up as such in vain
                take_tx, has_sent = node.take_tx, node.sent
                octets = take_tx(now)
                if octets is None:
                    run_due(node.station, now, node.transmit)
                    break
                found = known.get(octets)
                if found is None:
                    found = on_wire(octets, node.baud)
                    if baud and len(known) < _MOST_KNOWN:
                        known[octets] = found
                telegram, lasts = found
                end = now + lasts
                if (
                    telegram is None
                    or (end >= self.free and not self._is_free(end, waiting))
                    or node.hears_from > now  # it is deaf, or sends already
                    or node.mute_until > now
                ):
                    has_sent(medium.transmit(node, octets, now))
                    break
                if faults.armed:
                    tx = Transmission(node, node.name, octets, baud, now, end, telegram)
                    faults.apply(tx)
                    if tx.altered:
                        has_sent(medium.send(node, tx, now))
                        break
                sent += 1
                deadline = node.deadline = has_sent(end)
                if now < deadline < node.due:
                    node.due = deadline  # as in _set_timer()
                    node.order = _TIMERS + next(self.ticks)
                    if waiting is None:
                        waiting = node
                    elif waiting is not node:
                        self._schedule_timer(node)
                if (
                    deadline <= now
                    or node.moved
                    or (node.unread and any(node.unread))
                    or (end >= self.free and not self._is_free(end, waiting))
                    or (waiting is not None and waiting.due <= end and not self._waits_on(waiting, end, telegram, node))
                    or (stop is not None and stop() and self._note_stop())
                ):
                    medium.take_over(Transmission(node, node.name, octets, baud, now, end, telegram, whole=True))
                    break
                start, self.now = now, end
                add_plain = log.add_plain
                if is_judged:
                    add_plain((start, end, octets, node.name, "", telegram, node, baud))
                else:
                    add_plain((start, end, octets, node.name, ""))
                hearer: Node | None = None
                others: list[tuple[Node, int]] | None = None
                for other in node.hearers[telegram.da]:
                    if other.hears_from <= start:
                        if hearer is not None:
                            others = [(hearer, deadline)] if others is None else [*others, (hearer, deadline)]
                        hearer, hear = other, other.hear
                        deadline = hear(telegram, start, end)
                if hearer is None:  # a token to itself, an SDN to nobody: the sender goes on
                    now = node.due
                    if (
                        waiting is not node
                        or now <= end
                        or (now >= self.free and not self._is_free(now, waiting))
                        or (stop is not None and stop() and self._note_stop())
                    ):
                        return
                else:
                    node = hearer
                    if others is not None:
                        for other, at in others:
                            if end < at >= other.due and not (other.moved or any(other.unread)):
                                other.deadline = at
                            else:
                                self.run_station(other, other.station.wake_at())
                        if not node.on_bus:
                            return
                    node.deadline = deadline
                    if (
                        deadline <= end
                        or node.moved
                        or (node.unread and any(node.unread))
                        or (deadline >= self.free and not self._is_free(deadline, waiting))
                        or (waiting is not None and waiting.due <= deadline and not self._put_off(waiting, deadline))
                    ):
                        break
                    if stop is not None and stop():
                        self._stopped = True
                        self._left = node, deadline, waiting
                        waiting = None
                        return
                    now = deadline
                self.now = now
                if waiting is node:
                    waiting = None
                    node.due = NEVER
        finally:
            if sent:
                medium.transmissions += sent
                medium.baud = baud
            if waiting is not None:
                self._schedule_timer(waiting)
        self._follow(node, node.station.wake_at(), node.station.take_events())

    def _is_free(self, at: int, waiting: Node | None) -> bool:
        """Whether :meth:`_run_on` may go on until after ``at``: no event comes before, the line is silent, and all
        stations have one rate. It need not ask again before ``free``."""
        free = not (self._medium.busy_until > self.now or at > self._horizon or self._comes_first(at, waiting))
        if not (free and self._nodes.common_rate):
            return False
        self.free = min(self.heap[0][0], self._horizon + 1)
        return True

    def _comes_first(self, at: int, waiting: Node | None) -> bool:
        """Whether an event of the heap comes before ``at``, or then: all but timers that were put off since."""
        heap = self.heap
        while heap[0][0] <= at:
            due, _, call, node = heap[0]
            if call is not self._on_timer or node.due <= due:
                return True
            heappop(heap)
            node.entries.pop()
            if node.on_bus and node is not waiting:
                self._schedule_timer(node)
        return False

    def _waits_on(self, waiting: Node, end: int, telegram: Telegram, sender: Node) -> bool:
        """Whether the edge of ``telegram``, which ``sender`` begins now, puts off the deadline of ``waiting``."""
        self._medium.tell_edge(telegram, sender, self.now)
        return self._put_off(waiting, end)

    def _note_stop(self) -> bool:
        self._stopped = True
        return True

    def _renew(self, node: Node) -> None:
        """The address or the rate of the station changed."""
        if node.station.baud != node.baud:
            # the transmission on the wire began before its receiver was at this rate
            node.hears_from = max(node.hears_from, self.now)
        self._nodes.renew(node)
        self.free = _STEPWISE

    def _set_timer(self, node: Node) -> None:
        """The station's deadline is earlier than the time at which it is called: call it earlier."""
        if node.due > self.now:
            node.due = max(node.deadline, self.now)
            node.order = _TIMERS + next(self.ticks)

    def _schedule_timer(self, node: Node) -> None:
        """Put the timer of ``node`` into the heap if it has no entry before that.

        Later entries stay: a watchdog that every exchange postpones has one heap entry, not one for each exchange.
        """
        if node.due < node.entries[-1]:
            node.entries.append(node.due)
            heappush(self.heap, (node.due, node.order, self._on_timer, node))
            if node.due < self.free:
                self.free = node.due

    def _put_off(self, node: Node, at: int) -> bool:
        """Whether an edge has put off the deadline of ``node``, which was before ``at``, until after ``at``."""
        if node.due == at:
            return False
        deadline = node.deadline = node.station.wake_at()
        if deadline <= at:
            return False
        node.due = deadline
        node.order = _TIMERS + next(self.ticks)
        return True

    # --- inside ---
    def _run_timer(self, node: Node) -> None:
        node.entries.pop()
        now = self.now
        if node.due > now:  # postponed, or set anew
            if node.on_bus:
                self._schedule_timer(node)
            return
        deadline = node.deadline
        if deadline <= now:
            deadline = node.deadline = node.station.wake_at()
        if deadline <= now:
            node.due = NEVER
            if node.on_bus and self._horizon >= now and not self._medium.late:
                self._run_on(node)
            else:
                self.run_station(node, deadline)
        elif node.on_bus:
            node.due = deadline  # an edge has put it off
            node.order = _TIMERS + next(self.ticks)
            self._schedule_timer(node)

    def _node(self, station: BusStation) -> Node:
        node = self._nodes.find(station)
        if node is None:
            raise UsageError(f"{station!r} is not on this bus: add() it first")
        self._settle()
        return node


def _call(callback: Callable[[], None]) -> None:
    callback()


def _nothing(_: object) -> None:
    raise RuntimeError("an event came that never comes")
