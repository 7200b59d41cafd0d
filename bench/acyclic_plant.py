"""Eight slaves in virtual time that are asked for records without end: what that does to rotation and cycles."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, NamedTuple

from msgspec.structs import replace

from dpstack.dp.acyclic.job import CancelService
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.fixed_cycle import MissReason
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.telegram_times import acyclic_bits
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import LinkUser, Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import SAP_MS1, Telegram
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S

LENGTHS: Final = (1, 16, 64, 128, 240)
_PPO1: Final = bytes((0xF3, 0xF1))
_IDENT: Final = 0x1234
_OWN: Final = 2
_FIRST: Final = 3
_SLOT: Final = 1
_SLOW_NS: Final = 100 * NS_PER_MS
#: services that wait for each slave at any time
_WAITING: Final = 3
_WITHIN: Final = 60 * NS_PER_S


class Answers(Enum):
    """When a slave answers: in the request itself, with the first poll, after so long."""

    AT_ONCE = "answered at once"
    POLLED = "answered when polled"
    SLOW = f"answered after {_SLOW_NS // NS_PER_MS} ms"


class Load(NamedTuple):
    """The requests that all slaves get without end."""

    write: bool
    octets: int
    answers: Answers

    @property
    def title(self) -> str:
        return f"{'Write' if self.write else 'Read'} of {self.octets}, {self.answers.value}"


@dataclass(frozen=True, slots=True)
class Seen:
    """Figures of ``ns`` of bus time; ``done``: services that ended, ``failed``: those of them without a result."""

    ns: int
    rotation: Histogram
    done: int
    failed: int
    begun: int
    missed: int
    reasons: dict[MissReason, int]

    @property
    def per_s(self) -> float:
        return self.done * NS_PER_S / self.ns


class RecordDevice(MirrorDevice):
    """Records of every length at slot 1, index = length; slow ones are answered later."""

    def __init__(self, answers: Answers) -> None:
        super().__init__(_IDENT, _PPO1)
        places = {(_SLOT, octets): bytes(octets) for octets in LENGTHS}
        self._table = RecordTable(places, places)
        self._slow = answers is Answers.SLOW
        self._waiting: RecordRequest | None = None
        self._answer_at = NEVER
        self._now = 0
        self.records = self

    def ask(self, ticket: RecordRequest) -> None:
        if self._slow:
            self._waiting, self._answer_at = ticket, self._now + _SLOW_NS
        else:
            self._table.ask(ticket)

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """One exchange; the device takes the time from it too."""
        self._now = now
        return super().exchange(outputs, now)

    def wake_at(self) -> int:
        """When the answer is there."""
        return self._answer_at

    def tick(self, now: int) -> None:
        if self._waiting is not None:
            self._table.ask(self._waiting)
        self._waiting, self._answer_at = None, NEVER


class AnswersAtOnce(SlaveApp):
    """Answers in the request itself, as slaves may: what a poll would fetch."""

    def serve(self, request: Telegram, now: int) -> Reply | None:
        """SC would mean that it is to be polled."""
        reply = super().serve(request, now)
        if request.dsap == SAP_MS1 and request.data and reply is not None and reply.short:
            return super().serve(replace(request, data=b""), now)
        return reply


@dataclass
class Plant:
    """A master with ``slaves`` slaves in data exchange and Operate, PPO1, T_SDR ``t_sdr`` bit times."""

    baud: int
    answers: Answers
    slaves: int = 8
    cycle_ns: int = 0
    t_sdr: int = 60
    world: World = field(default_factory=World)
    _ends: list[RecordDone] = field(default_factory=list)
    _orders: int = 0

    def __post_init__(self) -> None:
        self.params = BusParams.preset(self.baud, address=_OWN, gap=0)
        self.addresses = range(_FIRST, _FIRST + self.slaves)
        app = AnswersAtOnce if self.answers is Answers.AT_ONCE else SlaveApp
        for address in self.addresses:
            responder = app(RecordDevice(self.answers), address=address)
            self.world.add(PassiveStation(address, responder, self.params, t_sdr=self.t_sdr))
        self.setups = setups(self.slaves)
        self.master = Master(self.params, self.setups, MasterSettings(cycle_ns=self.cycle_ns, watchdog_ms=2_000))
        users: list[LinkUser] = [self.master, acyclic_services(_OWN, self.master)]
        self._station = ActiveStation(self.params, users, window=self.master.window)
        self.world.add(self._station, on_events=self._on_events)
        self.world.command(self._station, GoOnline())
        self.world.command(self._station, SetMode(Mode.OPERATE))
        handlers = self.master.handlers.values()
        while not all(h.state is SlaveState.DATA_EXCHANGE for h in handlers):
            self.world.run_for(5 * NS_PER_MS)
            if self.world.now > _WITHIN:
                raise RuntimeError("not every slave came into data exchange")
        self.world.run_for(20 * NS_PER_MS)

    @property
    def service_ns(self) -> int:
        """The plan's acyclic service."""
        return self.params.ns(acyclic_bits(self.params, self.setups))

    def check(self) -> None:
        """The referee judges the whole run."""
        if self.world.referee is not None:
            self.world.referee.check()

    def _on_events(self, events: list[Event]) -> None:
        self._ends += [event for event in events if isinstance(event, RecordDone)]

    def look(self, ns: int, load: Load | None = None) -> Seen:
        """Measure for ``ns`` with or without a load; services without an end are cancelled then."""
        waiting: dict[int, int] = {}  # address by order
        self._keep_busy(waiting, load)
        book = self.master.cycles
        begun, missed, reasons = book.begun, book.missed, dict(book.reasons)
        self.master.rotation = Histogram()
        done = failed = 0
        end = self.world.now + ns
        while self.world.now < end:
            self.world.run_for(min(NS_PER_MS // 2, end - self.world.now))
            ends, self._ends = self._ends, []
            done += len(ends)
            failed += sum(each.outcome.failure is not None for each in ends)
            for each in ends:
                del waiting[each.token]
            self._keep_busy(waiting, load)
        reasons = {reason: count - reasons.get(reason, 0) for reason, count in book.reasons.items()}
        found = Seen(ns, self.master.rotation, done, failed, book.begun - begun, book.missed - missed, reasons)
        for order in waiting:
            self.world.command(self._station, CancelService(order))
        if load is not None and not self.cycle_ns:
            self._fetch_what_is_left(load)
        self.world.run_for(20 * NS_PER_MS)
        self._ends.clear()
        return found

    def _fetch_what_is_left(self, load: Load) -> None:
        """Answers that nobody waits for any more are fetched with the next service: they shall not count as its own."""
        before = self._orders
        for address in self.addresses:
            self._orders += 1
            self.world.command(self._station, self._order(address, load._replace(write=False, octets=LENGTHS[0])))
        while sum(done.token > before for done in self._ends) < self.slaves:
            self.world.run_for(5 * NS_PER_MS)

    def _keep_busy(self, waiting: dict[int, int], load: Load | None) -> None:
        if load is None:
            return
        count = Counter(waiting.values())
        for address in self.addresses:
            for _ in range(_WAITING - count[address]):
                self._orders += 1
                waiting[self._orders] = address
                self.world.command(self._station, self._order(address, load))

    def _order(self, address: int, load: Load) -> RecordOrder:
        if load.write:
            return RecordOrder(
                self._orders, Function.WRITE, _SLOT, load.octets, data=bytes(load.octets), address=address
            )
        return RecordOrder(self._orders, Function.READ, _SLOT, load.octets, load.octets, address=address)


def setups(slaves: int) -> list[SlaveParams]:
    """The parameters of the slaves at the master."""
    return [
        SlaveParams(address=_FIRST + n, name=f"s{n}", ident=_IDENT, config=_PPO1, user_prm=bytes(3), dpv1=Dpv1())
        for n in range(slaves)
    ]
