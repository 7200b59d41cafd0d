"""A link layer that is a script: it grants token holds to a master and answers its requests from a table of octets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

from support import KeepsEvents

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import Fault, SlaveFaulted, SlaveRemark, SlaveState, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.process_image import SlaveImage
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SHORT_ACK, UNANSWERED, Kind, Telegram
from dpstack.params import BusParams
from dpstack.trace import Event

MS = 1_000_000

#: Slave_Diag of an unparameterised device with ident 0696, and of the same one ready for master 2 (octets by hand)
DIAG_FREE = bytes.fromhex("02 05 00 FF 06 96")
DIAG_READY = bytes.fromhex("00 0C 00 02 06 96")
#: of that device while it is not ready, with Stat_Diag, with Prm_Fault, and owned by master 7
DIAG_NOT_READY = bytes.fromhex("02 0C 00 02 06 96")
DIAG_STATIC = bytes.fromhex("00 0E 00 02 06 96")
DIAG_PRM_FAULT = bytes.fromhex("42 05 00 FF 06 96")
DIAG_LOCKED = bytes.fromhex("00 0C 00 07 06 96")

#: outputs of a drive: a safe word (OFF1) and a run
SAFE = b"\x04\x7e\x00\x00"
RUN = b"\x04\x7f\x40\x00"

#: what was sent: DSAP and octets; and the bring-up of :func:`setup`'s slave
Entry = tuple[int | None, str]
DIAG: Entry = (60, "")
SET_PRM: Entry = (61, "88 01 14 0B 06 96 00")
CHK_CFG: Entry = (62, "71")

Answer = Callable[[Request], Telegram | Failure]


def data(request: Request, octets: bytes, fc: int = 0x08) -> Telegram:
    """A data answer (DL unless ``fc`` says otherwise) with the SAPs crosswise."""
    return Telegram(Kind.SD2, 2, request.da, fc, request.ssap, request.dsap, octets)


def says(octets: bytes) -> Callable[[Request], Telegram]:
    """Answers with these data."""
    return lambda request: data(request, octets)


def refuses(status: int) -> Callable[[Request], Telegram]:
    """Answers RS, UE, RR ... without data."""
    return lambda request: Telegram(Kind.SD1, 2, request.da, status)


def high(request: Request) -> Telegram:
    """Four zeros with high priority (DH): there is a diagnosis to be read."""
    return data(request, bytes(4), fc=0x0A)


def silent(request: Request) -> Failure:
    """No answer."""
    return Failure.NO_ANSWER


@dataclass
class ScriptedSlave:
    """A well-behaved slave of fixed octets; tests replace what they need."""

    inputs: bytes = bytes(4)
    free: bytes = DIAG_FREE
    ready: bytes = DIAG_READY
    configured: bool = False
    answers: dict[int | None, Answer] = field(default_factory=dict)

    def __call__(self, request: Request) -> Telegram | Failure:
        special = self.answers.get(request.dsap)
        if special is not None:
            return special(request)
        match request.dsap:
            case 60:
                return data(request, self.ready if self.configured else self.free)
            case 61:
                return SHORT_ACK
            case 62:
                self.configured = True
                return SHORT_ACK
            case None if self.configured:
                return data(request, self.inputs)
            case _:
                return Telegram(Kind.SD1, 2, request.da, 0x03)


class ScriptedPlugin:
    """A drive plugin under the test's control: constant ``outputs``, or an ``error`` in each cycle."""

    def __init__(self) -> None:
        self.outputs = b"\x05\x06\x07\x08"
        self.error: Exception | None = None
        self.losses = 0
        self.events: list[dict[str, object]] = []

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        if self.error is not None:
            raise self.error
        return self.outputs

    def lost(self, now: int) -> None:
        self.losses += 1

    def safe(self, configured: bytes) -> bytes:
        return configured

    def moved(self, address: int) -> str | None:
        return None

    def command(self, op: str, args: object, token: int, now: int) -> None:
        self.events.append({"type": "result", "token": token, "ok": True, "value": op})

    def take_events(self) -> list[dict[str, object]]:
        events, self.events = self.events, []
        return events


@dataclass
class ScriptedLink(KeepsEvents):
    """Grants holds every ``period`` ns; every request takes ``step`` ns."""

    master: Master
    slaves: dict[int, ScriptedSlave] = field(default_factory=dict)
    now: int = 1_000
    step: int = 100_000
    period: int = 100_000
    requests: list[Request] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    @property
    def slave(self) -> ScriptedSlave:
        """Slave 3."""
        return self.slaves[3]

    @property
    def image(self) -> SlaveImage:
        """The process image of slave 3."""
        return self.master.images[3]

    def next_request(self) -> Request:
        """The first request of a token hold, which the test carries on itself."""
        self.now += self.period
        self.master.token_received(self.now)
        request = self.master.next_request(self.now, False)
        assert request is not None
        return request

    def hold(self) -> list[Request]:
        """One token hold; the requests made in it."""
        self.now += self.period
        self.master.token_received(self.now)
        made: list[Request] = []
        while (request := self.master.next_request(self.now, False)) is not None:
            made.append(request.replaced())  # the master gives its requests of Data_Exchange again
            self.master.started(request, self.now)
            self.now += self.step
            self.master.result(request, self._answer(request), self.now)
            assert len(made) < 1000
        self.requests += made
        self.events += self.master.take_events()
        return made

    @contextmanager
    def without(self, address: int) -> Iterator[None]:
        """One slave is switched off for a while, and comes back unparameterised."""
        slave = self.slaves.pop(address)
        yield
        slave.configured = False
        self.slaves[address] = slave

    def high_answer(self) -> None:
        """One hold in which slave 3 answers Data_Exchange with high priority."""
        self.slave.answers[None] = high
        self.hold()
        del self.slave.answers[None]

    def _answer(self, request: Request) -> Telegram | Failure:
        if request.function in UNANSWERED:
            return SHORT_ACK
        slave = self.slaves.get(request.da)
        return Failure.NO_ANSWER if slave is None else slave(request)

    def run(self, ns: int) -> None:
        """Holds until ``ns`` have passed."""
        end = self.now + ns
        while self.now < end:
            self.hold()

    def run_long(self, ns: int) -> None:
        """As :meth:`run`, with a hold every 2 ms: seconds of waiting cost a twentieth of the time."""
        before, self.period = self.period, 2 * MS
        self.run(ns)
        self.period = before

    def run_anew(self, ns: int) -> None:
        """Forget the requests so far, and run."""
        self.requests.clear()
        self.run(ns)

    def stall(self, ns: int, run_ns: int) -> None:
        """Nobody asks the master for ``ns``; then it runs for ``run_ns``."""
        self.now += ns
        self.run(run_ns)

    def send(self, order: object, run_ns: int = 0) -> None:
        """Give the master an order now, and run for ``run_ns``."""
        self.master.command(order, self.now)
        self.run(run_ns)

    def send_anew(self, order: object, run_ns: int = 0) -> None:
        """As :meth:`send`; the requests so far are forgotten."""
        self.requests.clear()
        self.send(order, run_ns)

    def state(self, address: int) -> SlaveState:
        """The state of one slave."""
        return self.master.handlers[address].state

    def states(self, address: int) -> list[str]:
        """All states of one slave, as its events report them."""
        return [e.state.value for e in self.events_of(SlaveStateChanged) if e.address == address]

    def fault(self, address: int) -> Fault:
        """The last fault of one slave."""
        fault = self.master.handlers[address].fault
        assert fault is not None
        return fault

    def only_fault(self) -> Fault:
        """The one fault that was reported, of any slave."""
        (event,) = self.events_of(SlaveFaulted)
        return event.fault

    def faults(self, address: int) -> list[str]:
        """The kinds of all reported faults of one slave."""
        return [e.fault.kind.value for e in self.events_of(SlaveFaulted) if e.address == address]

    def remarks(self, address: int) -> list[str]:
        """All remarks about one slave."""
        return [e.message for e in self.events_of(SlaveRemark) if e.address == address]


def setup(address: int = 3, **changes: Any) -> SlaveParams:
    """A slave with four octets each way, as :class:`ScriptedSlave` is."""
    values: dict[str, Any] = {"address": address, "name": f"s{address}", "ident": 0x0696, "config": b"\x71"}
    return SlaveParams(**(values | changes))


def link(*setups: SlaveParams, slaves: dict[int, ScriptedSlave] | None = None, **options: Any) -> ScriptedLink:
    """A master (its ``options``) at the start; all slaves are there unless ``slaves`` says which."""
    master = Master(BusParams.preset(500_000, address=2), setups, MasterSettings(**options))
    given = {s.address: ScriptedSlave() for s in setups} if slaves is None else slaves
    return ScriptedLink(master, given)


def link_to(**slave: Any) -> ScriptedLink:
    """A master at the start with slave 3, a :class:`ScriptedSlave` with these fields."""
    return link(setup(), slaves={3: ScriptedSlave(**slave)})


def exchanging(*setups: SlaveParams, **options: Any) -> ScriptedLink:
    """All slaves are in data exchange, in Clear."""
    bus = link(*setups, **options)
    bus.run(5 * MS)
    assert all(h.state is SlaveState.DATA_EXCHANGE for h in bus.master.handlers.values())
    return bus


def operating(*setups: SlaveParams, **options: Any) -> ScriptedLink:
    """All slaves are in data exchange, in Operate; what was said until then is forgotten."""
    bus = link(*setups, **options)
    bus.run(20 * MS)
    bus.send(SetMode(Mode.OPERATE), 5 * MS)
    assert mode_of(bus) is Mode.OPERATE
    bus.requests.clear()
    bus.events.clear()
    return bus


def mode_of(bus: ScriptedLink) -> Mode:
    return bus.master.mode


def wire(bus: ScriptedLink, address: int = 3) -> list[Entry]:
    """The requests to one slave."""
    return [(r.dsap, r.data.hex(" ").upper()) for r in bus.requests if r.da == address]


def outputs(bus: ScriptedLink, address: int = 3) -> list[bytes]:
    """The outputs that were sent to one slave, without repetitions."""
    sent = [r.data for r in bus.requests if r.da == address and r.dsap is None]
    return [octets for octets, _ in groupby(sent)]


def squeezed(entries: list[Entry]) -> list[Entry]:
    """Without repetitions."""
    return [entry for entry, _ in groupby(entries)]
