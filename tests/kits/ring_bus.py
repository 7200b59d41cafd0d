"""A small simulated wire for tests of the active station: exact, in virtual time, independent of ``dpstack.sim``.

It delivers whole telegrams, octets, or chunks, and garbles transmissions that overlap. Test slaves get and answer
literal octets.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from support import KeepsEvents

from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.codec import decode
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Telegram
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS, chars_to_ns


@dataclass
class Sent:
    """A transmission on the wire."""

    start: int
    end: int
    octets: bytes
    sender: int
    garbled: bool = False


@dataclass
class ListUser(LinkUser):
    """A link user that sends the requests in its lists and notes the calls of the station."""

    high: list[Request] = field(default_factory=list)
    low: list[Request] = field(default_factory=list)
    #: requests of every token hold, before ``high`` and ``low``
    per_hold: list[Request] = field(default_factory=list)
    results: list[tuple[Request, Telegram | Failure, int]] = field(default_factory=list)
    starts: list[tuple[Request, int]] = field(default_factory=list)
    tokens: list[int] = field(default_factory=list)
    asked: list[bool] = field(default_factory=list)
    commands: list[object] = field(default_factory=list)
    ticks: list[int] = field(default_factory=list)
    at: int = NEVER
    events: list[Event] = field(default_factory=list)
    _hold: list[Request] = field(default_factory=list)

    def token_received(self, now: int) -> None:
        self.tokens.append(now)
        self._hold = list(self.per_hold)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        self.asked.append(high_only)
        if self._hold:
            return self._hold.pop(0)
        if self.high:
            return self.high.pop(0)
        if self.low and not high_only:
            return self.low.pop(0)
        return None

    def started(self, request: Request, at: int) -> None:
        self.starts.append((request, at))

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        assert type(now) is int
        self.results.append((request, outcome, now))

    def command(self, command: object, now: int) -> bool:
        if command == "mine":
            self.commands.append(command)
            return True
        return False

    def wake_at(self) -> int:
        return self.at

    def tick(self, now: int) -> None:
        self.ticks.append(now)
        self.at = NEVER

    def take_events(self) -> list[Event]:
        events = self.events.copy()
        self.events.clear()
        return events

    @property
    def outcomes(self) -> list[Telegram | Failure]:
        return [outcome for _, outcome, _ in self.results]


#: a slave of literal octets: request and time to answer (delay in bits after the request's end, octets) or None
Answer = Callable[[bytes, int], tuple[int, bytes] | None]


class RingBus(KeepsEvents):
    """The wire. ``mode``: how stations hear, 'whole', 'octets' or 'chunk'; ``drop(sent)`` garbles a transmission."""

    def __init__(self, baud: int = 500_000, mode: str = "whole") -> None:
        self.baud = baud
        self.mode = mode
        self.now = 0
        self.stations: list[ActiveStation] = []
        self.slaves: dict[int, Answer] = {}
        self.log: list[Sent] = []
        self._unfinished: list[Sent] = []  # at the last transmission
        self.events: list[Event] = []
        self.drop: Callable[[Sent], bool] = lambda sent: False
        self._heap: list[tuple[int, int, Callable[[], None]]] = []
        self._count = 0
        # by the station and not by its id, which the next station may get when one is killed
        self._due: dict[ActiveStation, int] = {}
        self.deaf: set[ActiveStation] = set()

    # --- stations ------------------------------------------------------------------------------------------------
    def master(
        self,
        address: int,
        *users: LinkUser,
        patience: Patience = EXACT,
        online: bool = True,
        run_ms: int = 0,
        **changes: int,
    ) -> ActiveStation:
        """A further station, after it has run for ``run_ms``."""
        params = BusParams.preset(self.baud, address=address).replace(**changes)
        station = ActiveStation(params, users, patience=patience, now=self.now)
        self.stations.append(station)
        if online:
            self.command(station, GoOnline(), run_ms)
        return station

    def kill(self, station: ActiveStation) -> None:
        self.stations.remove(station)

    def command(self, station: ActiveStation, command: object, run_ms: int = 0) -> None:
        """Give the station an order now, and run on."""
        station.command(command, self.now)
        self.pump(station)
        if run_ms:
            self.run_ms(run_ms)

    def pump(self, station: ActiveStation, chunk: bytes = b"") -> None:
        if station not in self.stations:
            return
        at = pump(station, chunk, self.now, lambda octets, now: self.transmit(octets, now, station.address, station))
        if events := station.take_events():
            latest = self.now + self.ns(3000)
            assert all(type(event.t_ns) is int and 0 <= event.t_ns <= latest for event in events)
            self.events += events
        if at < NEVER:
            self._due[station] = at
            self.at(max(at, self.now), lambda: self._wake(station, at))

    def _wake(self, station: ActiveStation, at: int) -> None:
        if self._due.get(station) == at:
            self._due[station] = -1
            self.pump(station)

    # --- the wire ------------------------------------------------------------------------------------------------
    def at(self, when: int, call: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._heap, (when, self._count, call))

    def ns(self, bits: int) -> int:
        return (bits * 1_000_000_000 + self.baud // 2) // self.baud

    def transmit(self, octets: bytes, now: int, sender: int, station: ActiveStation | None = None) -> int:
        end = now + chars_to_ns(len(octets), self.baud)
        sent = Sent(now, end, octets, sender)
        if self.drop(sent):
            sent.garbled = True
        self._unfinished = [other for other in self._unfinished if other.end > now]
        for other in self._unfinished:
            sent.garbled = other.garbled = True
        self._unfinished.append(sent)
        self.log.append(sent)
        if self.mode == "whole":
            self.at(now, lambda: self._edge(station))
        if self.mode == "octets":
            for i in range(len(octets)):
                self.at(now + chars_to_ns(i + 1, self.baud), partial(self._octet, sent, station, i))
        self.at(end, lambda: self._end(sent, station))
        return end

    def _hearers(self, station: ActiveStation | None) -> list[ActiveStation]:
        return [s for s in self.stations if s is not station and s not in self.deaf]

    def _edge(self, sender: ActiveStation | None) -> None:
        for station in self._hearers(sender):
            station.activity(self.now)
            self.pump(station)

    def _octet(self, sent: Sent, sender: ActiveStation | None, i: int) -> None:
        octet = sent.octets[i : i + 1] if not sent.garbled else bytes((sent.octets[i] ^ 0x5A,))
        for station in self._hearers(sender):
            self.pump(station, octet)

    def _end(self, sent: Sent, sender: ActiveStation | None) -> None:
        telegram = None if sent.garbled else decode(sent.octets)
        for station in self._hearers(sender):
            if self.mode == "octets":
                continue
            if sent.garbled or telegram is None:
                self.pump(station, bytes(o ^ 0x5A for o in sent.octets))
            elif self.mode == "chunk":
                self.pump(station, sent.octets)
            else:
                station.telegram(telegram, self.now)
                self.pump(station)
        if not sent.garbled and len(sent.octets) > 3:
            da = sent.octets[4 if sent.octets[0] == 0x68 else 1] & 0x7F
            slave = self.slaves.get(da)
            answer = slave(sent.octets, self.now) if slave is not None else None
            if answer is not None:
                bits, octets = answer
                self.at(self.now + self.ns(bits), lambda: self._say(octets, da))

    def _say(self, octets: bytes, sender: int) -> None:
        self.transmit(octets, self.now, sender)

    # --- time ----------------------------------------------------------------------------------------------------
    def run(self, ns: int) -> None:
        self.run_until(self.now + ns)

    def run_ms(self, ms: int) -> None:
        self.run(ms * NS_PER_MS)

    def run_until(self, at: int) -> None:
        heap, pop = self._heap, heapq.heappop
        while heap and heap[0][0] <= at:
            self.now, _, call = pop(heap)
            call()
        self.now = at

    def run_bits(self, bits: int) -> None:
        self.run(self.ns(bits))

    def until(self, station: ActiveStation, *states: State) -> None:
        """Run in small steps until ``station`` is in one of ``states``."""
        for _ in range(1_000_000):
            if station.state in states:
                return
            self.run_bits(1)
        raise AssertionError(f"{states} not reached")

    def octets(self) -> list[str]:
        return [sent.octets.hex(" ") for sent in self.log]

    @property
    def healed(self) -> bool:
        """Every master is in the ring, and its LAS has all of them."""
        everybody = {station.address for station in self.stations}
        return all(station.in_ring and station.las == everybody for station in self.stations)


def ring_of(
    *addresses: int, baud: int = 500_000, mode: str = "whole", patience: Patience = EXACT, ms: int = 300, **changes: int
) -> RingBus:
    """A wire with these masters when all are in one ring, after ``ms`` at the latest."""
    bus = RingBus(baud, mode)
    for address in addresses:
        bus.master(address, patience=patience, online=True, **changes)
    while not bus.healed and bus.now < ms * NS_PER_MS:
        bus.run_ms(5)
    assert bus.healed
    return bus


def fixed(request: str, answer: str, delay: int = 11) -> Answer:
    """A slave with a single request and answer, both in hex."""

    def say(octets: bytes, now: int) -> tuple[int, bytes] | None:
        return (delay, bytes.fromhex(answer)) if octets == bytes.fromhex(request) else None

    return say
