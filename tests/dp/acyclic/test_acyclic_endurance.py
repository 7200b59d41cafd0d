"""Acyclic services, connections and alarms without end, telegrams lost among them: nothing piles up at either end.

A small share here, 100 000 services and a virtual hour in soak.
"""

from __future__ import annotations

import gc
import random
import sys
from collections import Counter
from collections.abc import Callable

import pytest
from bus_kit import IDENT, PPO1, SimBus, setup
from ms2_kit import connections_of
from support import MS, S, WorldFactory

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.pdu.alarm_blocks import SEQUENCES, Alarm
from dpstack.dp.pdu.dpv1_status import ALARMS, Dpv1
from dpstack.dpv1.master.alarm_orders import AlarmRaised, CloseConnection, CloseConnections, ConnectionOver
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, AlarmSupport, Raised
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.trace import Event

ADDRESSES = (3, 4)
CONNECTIONS = 2
#: how long a slave may take for an answer, and how long it takes where it never answers
LIMIT = 30 * MS
#: records of its own: no, never
REFUSED, NEVER_ANSWERED = 98, 99


class Busy(MirrorDevice):
    """Answers after as many exchanges as the index says; raises alarms where it is told to."""

    def __init__(self) -> None:
        super().__init__(IDENT, PPO1)
        self.records = self
        self.transport = self.ask
        self.ms2 = CONNECTIONS
        self.alarm_server = self.server = AlarmServer(AlarmSupport(frozenset(ALARMS), 32, True), 238)
        self.working: list[tuple[RecordRequest, int]] = []

    def ask(self, request: RecordRequest) -> None:
        match request.service.index:
            case 0:
                request.answer(self.answer(request))
            case index if index == REFUSED:
                request.refuse(Code.INVALID_INDEX)
            case index if index != NEVER_ANSWERED:
                self.working.append((request, index))

    @staticmethod
    def answer(request: RecordRequest) -> bytes:
        return bytes((request.service.slot, request.service.index)) * 30

    def exchange(self, outputs: bytes, now: int) -> bytes:
        for request, left in self.working:
            if left == 1:
                request.answer(self.answer(request))
        self.working = [(request, left - 1) for request, left in self.working if left > 1]
        return super().exchange(outputs, now)


def _of_a_service(sent: Transmission) -> bool:
    """With SAPs, or an SC: data exchange goes on."""
    return len(sent.octets) == 1 or (sent.octets[0] == 0x68 and sent.octets[4] & 0x80 > 0)


class Plant(SimBus):
    """Station 2 with its slaves in data exchange, or with class 2 alone."""

    def __init__(self, world: World, baud: int, seed: int, *, cyclic: bool = True, mode: int = 7) -> None:
        self.random = random.Random(seed)
        params = BusParams.preset(baud, address=2, gap=0)
        self.tokens = 0
        self.ended = 0
        self.owed: dict[int, str] = {}
        self.open: list[int] = []
        self.counts: Counter[str] = Counter()
        self.handlers: list[Callable[[Event], None]] = []
        self.busy = {address: Busy() for address in ADDRESSES}
        dpv1 = Dpv1(c1_response_timeout_ns=LIMIT, alarms=tuple(ALARMS), alarm_mode=mode)
        setups = [setup(address, dpv1) for address in (ADDRESSES if cyclic else ())]
        super().__init__(world, params, setups, watchdog_ms=60_000, devices=self.busy)
        self.until_exchanging(20 * S)
        self.between = 0

    def lose(self, share: float, least_between: int = 0) -> None:
        """From now on that share of the telegrams of services is damaged, so many at the least between two of them (a
        slave whose every answer is lost leaves data exchange)."""

        def lost(sent: Transmission) -> bool:
            if not _of_a_service(sent):
                return False
            self.between += 1
            if self.between <= least_between or self.random.random() >= share:
                return False
            self.between = 0
            return True

        self.world.faults.damage(lost, times=None)

    def on_events(self, events: list[Event]) -> None:
        for event in events:
            match event:
                case RecordDone() | InitiateDone():
                    what = self.owed.pop(event.token)  # a second end: KeyError
                    self.ended += 1
                    failure = event.outcome.failure
                    self.counts[f"{what}: {'done' if failure is None else failure.name}"] += 1
                    if isinstance(event, InitiateDone):
                        if failure is None:
                            self.open.append(event.token)
                    elif failure is None:
                        assert event.index not in (REFUSED, NEVER_ANSWERED)
                        if what != "write":
                            assert event.outcome.data == bytes((event.slot, event.index)) * 30
                    elif failure is ServiceFailure.NEGATIVE:
                        assert event.index == REFUSED
                case ConnectionOver():
                    self.open.remove(event.connection)
            for handler in self.handlers:
                handler(event)

    def order(self, what: str) -> None:
        """One more service, or a connection closed. What cannot be just now is refused."""
        r = self.random
        self.tokens += 1
        token, address, slot = self.tokens, r.choice(ADDRESSES), r.randrange(200)
        index = r.choices((0, 1, 4, REFUSED, NEVER_ANSWERED), (60, 20, 17, 2, 1))[0]
        order: object
        match what:
            case "read":
                order = RecordOrder(token, Function.READ, slot, index, 60, address=address)
            case "write":
                order = RecordOrder(token, Function.WRITE, slot, index, data=bytes(r.randrange(1, 60)), address=address)
            case "open" if len(self.open) < len(ADDRESSES) * CONNECTIONS:
                order = OpenConnection(token, address, InitiateReq(S), LIMIT)
            case "close" if self.open and r.random() < 0.05:
                self.send(CloseConnection(r.choice(self.open)))
                return
            case "over" if self.open:
                ref = r.choice(self.open)
                order = r.choice(
                    (
                        RecordOrder(token, Function.READ, slot, index, 60, connection=ref),
                        RecordOrder(token, Function.WRITE, slot, index, data=bytes(9), connection=ref),
                        RecordOrder(token, Function.DATA_TRANSPORT, slot, index, data=bytes(60), connection=ref),
                    )
                )
                what = "write" if order.function is Function.WRITE else "over"
            case _:
                return
        self.owed[token] = what
        try:
            self.send(order)
        except UsageError:  # its connection is being given back
            assert what in ("over", "write")
            del self.owed[token]

    def keep_busy(self, services: int) -> None:
        """Until so many have ended."""
        until = self.ended + services
        while self.ended < until:
            before, began = self.ended, self.world.now
            for what in ("read", "write", "open", "over", "over", "close"):
                if len(self.owed) < 16:
                    self.order(what)
            self.world.run_for(2 * MS)
            assert self.ended > before or self.world.now - began < 5 * S

    def settle(self) -> None:
        """Nothing is under way any more, at either end."""
        self.world.faults.clear()
        end = self.world.now + 20 * S
        while self.owed or not self.exchanging:
            assert self.world.now < end, "a service without end"
            self.world.run_for(50 * MS)
        self.send(CloseConnections())
        self.world.run_for(S)
        assert not self.open
        assert self.acyclic.waiting == connections_of(self.acyclic) == 0
        self.send(GoOffline())
        self.world.run_for(30 * S)
        assert [ms2_of(app).free for app in self.apps] == [CONNECTIONS] * len(ADDRESSES)
        assert all(app.stats.connections == app.stats.closed for app in self.apps)


def in_use() -> tuple[int, int]:
    """Pieces of memory, and octets of all lists, dicts and their like."""
    gc.collect()
    return sys.getallocatedblocks(), sum(map(sys.getsizeof, gc.get_objects()))


def endure(world: WorldFactory, services: int, rows: int, seed: int) -> list[tuple[int, int]]:
    """``services`` in each of so many rows, one telegram in a hundred lost; the memory in use after each row."""
    plant = Plant(world(seed=seed), 12_000_000, seed)
    plant.lose(0.01)
    used = []
    for _ in range(rows):
        plant.keep_busy(services)
        used.append(in_use())
    for each in ("read: done", "write: done", "over: done", "open: done", "write: NEGATIVE"):
        assert plant.counts[each], plant.counts
    plant.settle()
    assert plant.exchanging is False
    return used


def test_services_pile_up_nowhere(world: WorldFactory) -> None:
    endure(world, 150, 1, 1)


@pytest.mark.soak
def test_100_000_services_pile_up_nowhere(world: WorldFactory) -> None:
    """What is in use after the first fifth (every list has had its length, every cache its contents) stays."""
    first, *later = endure(world, 20_000, 5, 2)
    assert max(pieces for pieces, _ in later) < first[0] + 2_000, (first, later)
    assert max(octets for _, octets in later) < first[1] + 100_000, (first, later)


@pytest.mark.parametrize(
    ("seconds", "seed"), [(120, 1), *(pytest.param(3600, seed, marks=pytest.mark.soak) for seed in range(2))]
)
def test_idle_keeps_connections(world: WorldFactory, seconds: int, seed: int) -> None:
    """Two connections to each slave, over which nothing goes but Idle; one telegram in fifty lost."""
    plant = Plant(world(seed=seed), 9_600, seed, cyclic=False)
    for address in ADDRESSES * CONNECTIONS:
        plant.tokens += 1
        plant.owed[plant.tokens] = "open"
        plant.send(OpenConnection(plant.tokens, address, InitiateReq(2 * S), S))
    plant.world.run_for(4 * S)
    assert len(plant.open) == len(ADDRESSES) * CONNECTIONS
    plant.lose(0.02)
    for _ in range(seconds // 60):
        plant.world.run_for(60 * S)
        assert connections_of(plant.acyclic) == len(ADDRESSES) * CONNECTIONS
        assert plant.acyclic.waiting <= len(ADDRESSES) * CONNECTIONS  # an Idle of each at the most
    assert all(len(ms2_of(app).connections) == CONNECTIONS for app in plant.apps)
    plant.settle()


@pytest.mark.parametrize(
    ("count", "mode", "seed"),
    [(50, 0, 1), (50, 7, 1), *(pytest.param(5_000, mode, mode, marks=pytest.mark.soak) for mode in (0, 1, 7))],
)
def test_sequence_numbers_wrap(world: WorldFactory, count: int, mode: int, seed: int) -> None:
    """``count`` alarms of each slave, pauses of all lengths between them, one telegram in a hundred lost."""
    plant = Plant(world(seed=seed), 187_500, seed, mode=mode)
    plant.lose(0.05, 4)
    heard: dict[int, list[Alarm]] = {address: [] for address in ADDRESSES}
    last = dict.fromkeys(ADDRESSES, -1)

    def on_event(event: Event) -> None:
        if isinstance(event, AlarmRaised):
            heard[event.address].append(event.alarm)
            assert event.alarm.data == last_number(event.address).to_bytes(4, "big")

    def last_number(address: int) -> int:
        last[address] += 1
        return last[address]

    plant.handlers.append(on_event)
    raised: dict[int, list[Raised]] = {address: [] for address in ADDRESSES}
    for number in range(count):
        for address, device in plant.busy.items():
            raised[address].append(device.server.alarm(Alarm(1, 1, 1, data=number.to_bytes(4, "big"))))
        plant.world.run_for(plant.random.choice((0, 1, 5, 20, 20, 100, 700)) * MS)
        while any(len(device.server.pending) > SEQUENCES // 2 for device in plant.busy.values()):
            plant.world.run_for(20 * MS)
    plant.settle()
    for address in ADDRESSES:
        assert last[address] == count - 1
        assert all(one.end is AlarmEnd.ACKNOWLEDGED for one in raised[address])
        assert [alarm.sequence for alarm in heard[address]] == [number % SEQUENCES for number in range(count)]
