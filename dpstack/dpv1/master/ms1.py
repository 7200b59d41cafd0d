"""MS1 of a class 1 master: Read and Write to its slaves, and the steps that every MS1 service has (DSAP 51, SSAP 51).

The request is one SRD. The slave answers in it at once, or acknowledges and is polled with empty SRDs; both are legal
(docs/reference/protocol.md#ms1). A slave has one service at a time, others wait in :mod:`dpstack.dp.acyclic.queue`. A
Read without any answer is repeated, a Write is not: the slave may have carried it out, and the outcome says so.

Alarm_Ack is in :mod:`dpstack.dpv1.master.alarm_handler`, the polling in :mod:`dpstack.dpv1.master.srd_polling`.
Decisions on points that the sources leave open: docs/reference/decisions/services.md#ms1-at-the-master.
"""

from __future__ import annotations

import abc
from typing import Final

from msgspec import Struct, structs

from dpstack.dp.acyclic.job import ATTEMPTS, Job, Outcome, ServiceFailure, Steps
from dpstack.dp.acyclic.queue import Provider
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.services import refusal_text
from dpstack.dpv1.master.alarm_orders import need_dpv1
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.master.plugin_queue import PendingRecord, RecordQueue, queue_at
from dpstack.dpv1.master.srd_polling import NO_ANSWERS, Polling, Reply, negative_outcome, service_outcome
from dpstack.dpv1.pdu.error_codes import AGAIN, Code
from dpstack.dpv1.pdu.read_write import (
    PARAMETER_INDEX,
    DataTransport,
    Function,
    Negative,
    ReadReq,
    RecordReq,
    WriteReq,
)
from dpstack.dpv1.timeouts import RESPONSE_TIMEOUT, service_timeout
from dpstack.errors import PduError, UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS1, Req, Telegram
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_S, ns_to_s

_HEAD: Final = 4
_MAYBE: Final = "it may have been carried out: read it back"
#: user of record 47 (``RecordOrder.user``): the drive plugin of the slave
_PLUGIN: Final = -1
#: a turn at record 47 without a Read ends so long after the last answer, any turn so long after the Write
_TURN_PAUSE: Final = 2 * NS_PER_S
_LONGEST_TURN: Final = 10 * NS_PER_S


class Ms1Job(Job):
    """A service to the slave of ``handler``: ``octets`` to ``sap``, up to ``longest`` octets in the answer."""

    #: a request without any answer is repeated
    repeats = False
    #: advice when the slave does not answer
    hint = "; try again"
    #: reason for which the slave might have closed the SAP
    why_closed = ""

    def __init__(
        self, title: str, handler: SlaveHandler, ms1: Ms1, octets: bytes, longest: int, sap: int = SAP_MS1
    ) -> None:
        self.address = handler.setup.address
        self.title = title
        #: services at one SAP come one after the other
        self._lane = self.address | (0 if sap == SAP_MS1 else sap << 8)
        self.stale = 0
        self._octets = octets
        self._handler = handler
        self._ms1 = ms1
        self._sap = sap
        self._longest = longest
        self._sent = False
        #: beginning of the data exchange in which the service runs
        self._since = handler.since
        given = 0 if handler.setup.dpv1 is None else handler.setup.dpv1.c1_response_timeout_ns
        self._limit_ns = given or RESPONSE_TIMEOUT
        #: of the service that fetches the answer after the end of this one
        self._late_polling = Polling(self._srd, self._limit_ns)
        self._limit_of = "its C1_Response_Timeout" if given else "no C1_Response_Timeout is known of it"

    @property
    def lane(self) -> int:
        return self._lane

    def bar(self) -> str:
        """See :meth:`Ms1.bar`."""
        why = self._ms1.bar(self._handler, self._since)
        return f"was given up: {why}" if why else ""

    @property
    def timeout_ns(self) -> int:
        """The time for waiting and service together, if no program sets it."""
        return service_timeout(self._limit_ns)

    # --- requests and polls -------------------------------------------------------------------------------------

    def steps(self) -> Steps[Outcome]:
        """Fetch the answer that an earlier service left, send the request, then poll."""
        yield from self._fetch_earlier_answer()
        if self.settled:
            return Outcome()
        polling = Polling(self._srd, self._limit_ns)
        attempts = ATTEMPTS if self.repeats else 1
        self._sent = True
        self._ms1.unfetched[self._lane] = self  # until there is an answer, whatever ends this service
        reply = yield from polling.send(self._octets, attempts)
        while True:
            match reply:
                case Reply.OLD:
                    self.stale += 1
                    reply = yield from polling.send(self._octets, attempts)
                case Reply.WAIT:
                    reply = yield from polling.poll(ATTEMPTS)
                case Reply.DATA:
                    outcome = self.outcome_of(polling.pdu)
                    if outcome is not None:
                        self._answered()
                        return outcome
                    self.stale += 1
                    reply = yield from polling.poll(ATTEMPTS)
                case _:
                    return self._unserved(reply, polling)

    def _fetch_earlier_answer(self) -> Steps[None]:
        unfetched = self._ms1.unfetched  # it stays there if this service is cut short meanwhile
        earlier = unfetched.get(self._lane)
        if earlier is None or earlier._since != self._since:
            return
        polling = earlier._late_polling
        if (yield from polling.poll()) is Reply.DATA and not earlier.accept_late(polling.pdu):
            self.stale += 1
        unfetched.pop(self._lane, None)

    def _srd(self, octets: bytes) -> Request:
        """High priority as all services of DP here; ``answer`` lets the budget of a fixed cycle know its length."""
        return Request(self.address, Req.SRD_HIGH, octets, self._sap, SAP_MS1, patient=True, answer=self._longest)

    # --- answers ------------------------------------------------------------------------------------------------

    @property
    def settled(self) -> bool:
        """The late answer to an earlier request answers this one, too: no request is needed."""
        return False

    def accept_late(self, octets: bytes) -> bool:
        """Process the slave's answer after the end of this service. Returns whether it was of use."""
        return False

    @abc.abstractmethod
    def outcome_of(self, octets: bytes) -> Outcome | None:
        """The outcome by the answer ``octets`` (not empty), None if they answer another request."""

    def _unserved(self, reply: Reply, polling: Polling) -> Outcome:
        """The outcome without an answer to the service."""
        who = f"slave {self.address}"
        match reply, polling.answer:
            case Reply.GUARDED, _:
                self._answered()
                text = f"{who} was not sent {self.title}; this bus is read-only"
                return Outcome(ServiceFailure.GUARDED, text)
            case Reply.NOTHING, Failure() as why:
                what = "does not answer" if why is Failure.NO_ANSWER else "gives no readable answer to"
                return Outcome(NO_ANSWERS[why], f"{who} {what} {self.title}{self.hint}")
            case Reply.CLOSED, Telegram() as answer:
                self._answered()
                status = refusal_text(answer)
                text = f"{who} refuses {self.title} ({status}): SAP {self._sap} is closed; {self.why_closed}"
                return Outcome(ServiceFailure.REFUSED, text, status=status)
        others = f", only {self.stale} to other requests" if self.stale else ""
        why_late = (
            "it was busy all the time" if polling.busy else "it exchanges data, but does not work at this service"
        )
        text = (
            f"{self.title} to slave {self.address} had no answer{others} within {ns_to_s(self._limit_ns):g} s "
            f"({self._limit_of}): {why_late}; try again, or give it longer (dpv1 = {{ response_timeout_ms = ... }})"
        )
        return Outcome(ServiceFailure.LATE, text + (f"; {self.aftermath}" if self.aftermath else ""))

    def _answered(self) -> None:
        self._ms1.unfetched.pop(self._lane, None)


class Turn(Struct):
    """The turn of ``user`` at record 47 of a slave, in the data exchange that began at ``since``.

    A slave has one request and one response at a time, whoever asks. So a Write begins a turn, and the answer to the
    user's Read ends it. Other users wait until then, or until the time ``until`` (NEVER: a service of the user is under
    way), at the latest until ``longest`` (docs/reference/decisions/services.md#turns-at-record-47).
    """

    user: int
    since: int
    until: int = NEVER
    longest: int = NEVER


class RecordJob(Ms1Job):
    """One Read or Write, ordered by a program, or by a drive plugin: then ``pending`` gets its outcome.

    ``user``: of record 47, see :class:`~dpstack.dpv1.master.orders.RecordOrder`. Raises PduError for a request that
    cannot be encoded.
    """

    why_closed = (
        "it was switched off and on just now, has no Read and Write (C1_Read_Write_supp of its GSD file), "
        "or takes them only with other parameters"
    )

    def __init__(
        self, request: RecordReq, handler: SlaveHandler, ms1: Ms1, user: int, pending: PendingRecord | None = None
    ) -> None:
        longest = _HEAD if isinstance(request, WriteReq) else _HEAD + request.length
        super().__init__(request.title, handler, ms1, request.build(), longest)
        self._request = request
        self._user = user
        self._pending = pending
        self._has_turns = request.index == PARAMETER_INDEX
        self._begun = False
        self.repeats = isinstance(request, ReadReq)
        if not self.repeats:
            self.hint = f"; {_MAYBE}"

    @property
    def aftermath(self) -> str:
        """A warning about a Write without a response, for whatever reason."""
        return _MAYBE if self._sent and not self.repeats else ""

    def bar(self) -> str:
        if self._pending is not None and self._pending.cancelled and not self._sent:
            return "was given up by the drive plugin"
        return super().bar()

    # --- turns at record 47 --------------------------------------------------------------------------------------

    def held_up(self, now: int) -> str:
        """Also forgets a turn that is over."""
        turn = self._ms1.turns.get(self.address) if self._has_turns else None
        if turn is None:
            return ""
        if turn.since != self._since or turn.until <= now:
            del self._ms1.turns[self.address]
            return ""
        return "" if turn.user == self._user else f"record {PARAMETER_INDEX} of this slave was in use all the time"

    def steps(self) -> Steps[Outcome]:
        """A Write of record 47 begins a turn."""
        self._begun = True
        if self._has_turns:
            turn = self._own_turn()
            if turn is None and not self.repeats:
                turn = self._ms1.turns[self.address] = Turn(self._user, self._since)
            if turn is not None:
                turn.until = NEVER
        return (yield from super().steps())

    def _own_turn(self) -> Turn | None:
        turn = self._ms1.turns.get(self.address)
        return turn if turn is not None and turn.user == self._user else None

    def _end_turn(self, outcome: Outcome, now: int) -> None:
        """End the turn of this user, unless the slave took the Write, or answered "not yet" to the Read."""
        turn = self._own_turn()
        if turn is None or not (self._begun or self.repeats):
            return
        turn.longest = min(turn.longest, now + _LONGEST_TURN)
        not_yet = self.repeats and outcome.codes is not None and outcome.codes[1] in AGAIN
        goes_on = not_yet or (not self.repeats and outcome.failure is None)
        cancelled = self._pending is not None and self._pending.cancelled
        turn.until = min(now + _TURN_PAUSE, turn.longest) if goes_on and not cancelled else now

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        if self._has_turns:
            self._end_turn(outcome, now)
        if self._pending is not None:
            self._pending.outcome = outcome
            return []
        return [RecordDone.of(self._request, token, self.address, outcome, self.stale, now)]

    def outcome_of(self, octets: bytes) -> Outcome | None:
        """A response to Alarm_Ack answers an earlier request."""
        if octets[0] == Function.ALARM_ACK:
            return None
        return service_outcome(self.address, self._request, octets)


class Ms1(Provider):
    """MS1 between ``master`` and its slaves: Read and Write of programs and of drive plugins."""

    def __init__(self, master: Master | None) -> None:
        self.master = master
        #: services that ended without the slave's answer, by lane; the next service fetches that answer
        self.unfetched: dict[int, Ms1Job] = {}
        #: the last turn at record 47 of each slave, by address
        self.turns: dict[int, Turn] = {}

    # --- slaves -------------------------------------------------------------------------------------------------

    def slave(self, address: int) -> SlaveHandler:
        """The handler of a slave, with or without DP-V1. Raises UsageError."""
        handlers = {} if self.master is None else self.master.handlers
        if address not in handlers:
            raise UsageError(f"station {address} is no slave of this master: MS1 is between a slave and its own master")
        return handlers[address]

    def dpv1_slave(self, address: int) -> SlaveHandler:
        """The handler of a slave that is parameterised for DP-V1. Raises UsageError."""
        handler = self.slave(address)
        need_dpv1(handler.setup, read_only=self.master is not None and self.master.context.settings.read_only)
        return handler

    def bar(self, handler: SlaveHandler, since: int) -> str:
        """The reason for which no service that began in the data exchange ``since`` can end any more; empty while it
        can. MS1 closes when the slave leaves data exchange (docs/reference/protocol.md#ms1), and in Stop the master
        sends nothing to slaves.
        """
        master = self.master
        if master is None or master.handlers.get(handler.setup.address) is not handler:
            return "the slave was removed from this bus, or parameterised anew; repeat it afterwards"
        if master.mode <= Mode.STOP:
            mode = master.mode.name.capitalize()
            return f"the master is in {mode}, where nothing is sent to slaves; repeat it in Clear or Operate"
        state = handler.state
        if state is SlaveState.DATA_EXCHANGE and handler.since == since:
            return ""
        why = "" if handler.fault is None else f" ({handler.fault.text})"
        if state is SlaveState.DATA_EXCHANGE:
            return f"the slave left data exchange{why} and came back; repeat it"
        return f"the slave is not in data exchange but in {state.value}{why}; repeat it when it is"

    # --- orders of programs -------------------------------------------------------------------------------------

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        if not isinstance(order, RecordOrder) or order.address is None:
            return None
        service = order.service
        if isinstance(service, DataTransport):
            raise UsageError("Data_Transport goes over a class 2 connection only: name one instead of an address")
        try:
            job = RecordJob(service, self.dpv1_slave(order.address), self, order.user)
        except PduError as error:
            raise UsageError(str(error)) from None
        return order.token, job, order.timeout_ns

    # --- requests of drive plugins -------------------------------------------------------------------------------

    def queue_jobs(self, now: int) -> None:
        """A request that a unit made since the Data_Exchange of this hold goes out in the same hold."""
        master = self.master
        if master is None:
            return
        for handler in master.handlers.values():
            queue = None if handler.setup.dpv1 is None else queue_at(handler.image.plugin)
            if queue is None or handler.state is not SlaveState.DATA_EXCHANGE:  # before that it waits
                continue
            job = self._next(handler, queue) if self.queue.room(handler.setup.address) else None
            if job is not None:
                self.queue.put(job, job.timeout_ns, now)

    def _next(self, handler: SlaveHandler, queue: RecordQueue) -> RecordJob | None:
        """The next service of a unit; None for an impossible one, which ends at once.

        No record is longer than C1_Max_Data_Len: a longer Write is refused here, a Read is shortened.
        """
        pending = queue.take()
        if pending is None:
            return None
        dpv1 = handler.setup.dpv1
        longest = MAX_RECORD if dpv1 is None else dpv1.c1_max_data_len
        request = pending.request
        if isinstance(request, WriteReq) and longest < len(request.data) <= MAX_RECORD:
            # as the slave would, if it can answer a request longer than its buffer: the unit may do with less
            refusal = Negative(Function.WRITE, Code.WRITE_LENGTH_ERROR)
            pending.outcome = negative_outcome(handler.setup.address, request.title, refusal)
            return None
        if isinstance(request, ReadReq):
            request = structs.replace(request, length=min(request.length, longest))
        try:
            return RecordJob(request, handler, self, _PLUGIN, pending)
        except PduError as error:
            pending.outcome = Outcome(ServiceFailure.LENGTH, str(error))
            return None
