"""The shared medium: transmissions, collisions, and the delivery of telegrams and octets to the stations.

A telegram that reaches everybody intact is decoded once and delivered whole when its last bit is on the line. In other
cases octets are delivered one by one: noise, a collision, another baud rate, octets that are no telegram, a sender that
is cut off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Any, Final, Protocol

from dpstack.params import BROADCAST
from dpstack.phy.uart import Receiver, waveform
from dpstack.sim.faults import Faults
from dpstack.sim.nodes import Node, Nodes
from dpstack.sim.referee import Referee
from dpstack.sim.transmission import Heard, Transmission, complete, garbled, receive
from dpstack.trace import WireEntry, WireLog
from dpstack.units import NEVER, chars_to_ns

# Order of events in the same nanosecond: octets, ends of transmissions, commands from outside, timers, start edges.
# A start edge cannot hold back a station whose timer ends at the same instant: both send.
OCTETS: Final = 0
ENDS: Final = 1 << 59
ORDERS: Final = 1 << 60
TIMERS: Final = 2 << 60
EDGES: Final = 3 << 60

_LENGTHS: Final = 256
_NEW: Final = tuple.__new__  # NamedTuple's own constructor costs twice as much


class Scheduler(Protocol):
    """The part of the world that the medium uses."""

    now: int

    def schedule(self, at: int, order: int, call: Callable[[Any], None], argument: object) -> None:
        """Call ``call(argument)`` at ``at``."""

    def settle(self, node: Node, chunk: bytes) -> None:
        """Pump the station and schedule its new deadline."""

    def rearm(self, node: Node) -> None: ...


@dataclass(slots=True, eq=False)
class _Stream:
    """Octets that are delivered one by one to the stations at ``rate``; of an intact telegram only to ports."""

    tx: Transmission
    rate: int
    heard: list[Heard]
    ports_only: bool = False
    index: int = 0


@dataclass(slots=True, eq=False)
class _Jam:
    """A collision: one garbled character after another until the last transmission has ended."""

    baud: int
    start_ns: int
    until_ns: int
    count: int = 0

    def end_of(self, count: int) -> int:
        return self.start_ns + chars_to_ns(count, self.baud)


class Medium:
    """One line. ``transmissions`` counts those begun on it, ``baud`` is the rate of the last one."""

    def __init__(
        self, scheduler: Scheduler, nodes: Nodes, log: WireLog, faults: Faults, referee: Referee | None, seed: int
    ) -> None:
        self.transmissions = 0
        self.baud = 0
        #: transmissions whose start edge the stations do not know yet
        self.starting: list[Transmission] = []
        self._scheduler = scheduler
        self._nodes = nodes
        self._log = log
        self._faults = faults
        self._referee = referee
        self._rng = Random(seed)
        self._durations: dict[int, list[int]] = {}
        self._current: Transmission | None = None  # the one on the wire that ends last
        self._jam: _Jam | None = None
        self._receivers: dict[int, Receiver] = {}  # by rate, of stations at another rate than the sender's
        self._octet_ns = 0  # the end of the last octet that was delivered by itself

    # --- sending ---
    def transmit(self, node: Node, octets: bytes, now: int) -> int:
        """``node`` puts ``octets`` on the line at ``now``; returns the end of the last bit in ns."""
        if node.sending_until > now:
            raise RuntimeError(f"station {node.name} sends {octets.hex(' ')} while it is still sending")
        baud = node.baud
        tx = Transmission(node, node.name, octets, baud, now, now + self.duration(len(octets), baud))
        if self._faults.armed:
            self._faults.judge(tx)
        if node.mute_until > now:
            tx.lost = True
            tx.notes.append("silenced")
        end = node.sending_until = tx.end_ns
        if end > node.hears_from:
            node.hears_from = end
        self._put(tx, now)
        return end

    def inject(self, octets: bytes, baud: int, now: int, sender: str) -> None:
        """Octets that no station sends begin at ``now``."""
        tx = Transmission(None, sender, octets, baud, now, now + self.duration(len(octets), baud))
        if self._faults.armed:
            self._faults.judge(tx)
        self._put(tx, now)

    def cut(self, node: Node, now: int) -> None:
        """``node`` is unplugged: its transmission ends here, nobody receives an unfinished octet."""
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
        self._record(tx)
        self._current = None
        if whole and sent:
            self._hand_octets(sent, tx.baud, tx.start_ns, ports=False)

    def duration(self, size: int, baud: int) -> int:
        """The time of ``size`` octets on the wire in ns, from a table."""
        table = self._durations.get(baud)
        if table is None:
            table = self._durations[baud] = [chars_to_ns(n, baud) for n in range(_LENGTHS)]
        return table[size] if size < _LENGTHS else chars_to_ns(size, baud)

    def edge(self, tx: Transmission) -> None:
        """Announce the start edge of ``tx`` to the stations."""
        if tx.cut:
            return
        now = tx.start_ns
        rearm = self._scheduler.rearm
        for node in self._nodes.listeners:
            if node.hears_from <= now:
                node.station.activity(now)
                rearm(node)
        if tx.telegram is not None:
            for node in self._nodes.by_address.get(tx.telegram.da, ()):
                if node.hears_from <= now and node.baud == tx.baud:
                    node.station.activity(now)
                    rearm(node)

    # --- the line ---
    def _put(self, tx: Transmission, now: int) -> None:
        if tx.lost:
            self._scheduler.schedule(tx.end_ns, ENDS, self._over, tx)
        elif tx.start_ns > now:
            self._scheduler.schedule(tx.start_ns, TIMERS, self._begin_late, tx)
        else:
            self._begin(tx)

    def _begin_late(self, tx: Transmission) -> None:
        if tx.node is None or tx.node.on_bus:
            self._begin(tx)

    def _begin(self, tx: Transmission) -> None:
        self.transmissions += 1
        baud = self.baud = tx.baud
        self._scheduler.schedule(tx.end_ns, ENDS, self._over, tx)
        self.starting.append(tx)
        before = self._current
        if before is not None and before.end_ns > tx.start_ns:
            self._collide(tx, before)
            if tx.end_ns > before.end_ns:
                self._current = tx
            return
        self._current = tx
        self._octet_ns = tx.start_ns
        if tx.flips:
            tx.notes.append("damaged")
        tx.whole = not tx.flips and tx.telegram is not None
        if not tx.whole or self._nodes.ports:
            self._flow(_Stream(tx, baud, receive(tx.octets, baud, tx.flips), ports_only=tx.whole))
        rates = self._nodes.by_rate
        if len(rates) > 1 or baud not in rates:
            self._sample(tx)

    def _over(self, tx: Transmission) -> None:
        """The last bit of ``tx`` is on the line."""
        if tx.cut:
            return
        self._record(tx)
        if tx.whole:
            self._hand_telegram(tx)

    def _record(self, tx: Transmission) -> None:
        if self._referee is not None and not tx.lost:
            if not tx.whole:
                tx.heard_ns = self._octet_ns
            self._referee.heard(tx)
        notes = "; ".join(tx.notes) if tx.notes else ""
        self._log.add(_NEW(WireEntry, (tx.start_ns, tx.end_ns, tx.octets, tx.sender, notes)))

    def _hand_telegram(self, tx: Transmission) -> None:
        telegram = tx.telegram
        assert telegram is not None
        start = tx.start_ns
        end = tx.end_ns
        baud = tx.baud
        nodes = self._nodes
        da = telegram.da
        others = nodes.by_rate.get(baud, []) if da == BROADCAST else nodes.by_address.get(da, [])
        heard: list[Node] = []
        for node in nodes.listeners:
            if node.hears_from <= start and node.baud == baud:
                heard.append(node)
                node.station.telegram(telegram, end)
        for node in others:  # the sender hears from its own end on; listeners have got it already
            if node.hears_from <= start and node.baud == baud and not node.hears_all:
                heard.append(node)
                node.station.telegram(telegram, end)
        settle = self._scheduler.settle
        for node in heard:
            settle(node, b"")

    def _hand_octets(self, octets: bytes, rate: int, since: int, *, ports: bool = True, others: bool = True) -> None:
        """Deliver to ``ports`` (False: they have got the octets already) and to ``others``."""
        settle = self._scheduler.settle
        for node in self._nodes.by_rate.get(rate, ()):
            if node.hears_from <= since and node.on_bus and (ports if node.by_octets else others):
                settle(node, octets)

    # --- octet by octet ---
    def _sample(self, tx: Transmission) -> None:
        """Deliver the characters that receivers at other rates read in ``tx``."""
        levels = waveform(tx.octets, tx.flips)
        for rate in self._nodes.by_rate:
            if rate == tx.baud:
                continue
            receiver = self._receivers.get(rate)
            if receiver is None:
                receiver = self._receivers[rate] = Receiver(rate)
            got = receiver.hear(tx.start_ns, levels, tx.baud)
            self._flow(_Stream(tx, rate, [(c.at_ns - tx.start_ns, c.octet) for c in got if c.good]))
            if receiver.due < NEVER:
                self._scheduler.schedule(receiver.due, OCTETS, self._tail, (receiver, tx.start_ns))

    def _tail(self, late: tuple[Receiver, int]) -> None:
        """Deliver a character that ends after its transmission, unless another transmission has begun in it."""
        receiver, since = late
        for char in receiver.idle(self._scheduler.now):
            if char.good:
                self._hand_octets(bytes((char.octet,)), receiver.baud, since)

    def _flow(self, stream: _Stream) -> None:
        if stream.heard:
            self._scheduler.schedule(stream.tx.start_ns + stream.heard[0][0], OCTETS, self._octet, stream)

    def _octet(self, stream: _Stream) -> None:
        tx = stream.tx
        if tx.collided or tx.cut:
            return
        offset, octet = stream.heard[stream.index]
        at_ns = tx.start_ns + offset
        stream.index += 1
        if stream.index < len(stream.heard):
            at = tx.start_ns + stream.heard[stream.index][0]
            self._scheduler.schedule(at, OCTETS, self._octet, stream)
        if stream.ports_only:
            self._hand_octets(bytes((octet,)), stream.rate, tx.start_ns, others=False)
            return
        if stream.rate == tx.baud:
            self._octet_ns = at_ns
        self._hand_octets(bytes((octet,)), stream.rate, tx.start_ns)

    def _collide(self, late: Transmission, early: Transmission) -> None:
        """Both are garbled from here to the end of the longer one."""
        now = late.start_ns
        if self._referee is not None:
            self._referee.collision(late, early, now if early.whole else self._octet_ns)
        if not early.collided:
            early.collided = True
            early.notes.append("collision")
            if early.whole:
                early.whole = False
                self._octet_ns = now
                self._scheduler.schedule(now, OCTETS, self._first_part, (early, now))
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
        self._scheduler.schedule(jam.end_of(1), OCTETS, self._jammed, jam)

    def _first_part(self, collision: tuple[Transmission, int]) -> None:
        """Deliver the octets of a telegram that were complete before the collision."""
        tx, at = collision
        sent = complete(at - tx.start_ns, tx.baud, len(tx.octets))
        if sent:
            self._hand_octets(tx.octets[:sent], tx.baud, tx.start_ns, ports=False)

    def _jammed(self, jam: _Jam) -> None:
        since = jam.end_of(jam.count)
        jam.count += 1
        if jam.end_of(jam.count + 1) <= jam.until_ns:
            self._scheduler.schedule(jam.end_of(jam.count + 1), OCTETS, self._jammed, jam)
        octet = garbled(self._rng)
        if octet is None:
            return
        self._octet_ns = jam.end_of(jam.count)
        for node in self._nodes:
            if node.hears_from <= since and node.on_bus:
                self._scheduler.settle(node, bytes((octet,)))
