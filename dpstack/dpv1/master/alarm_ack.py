"""Alarm_Ack of a class 1 master (MS1): to SAP 51 between Read and Write, or to SAP 50 with Extra_Alarm_SAP.

The positive response repeats the request. After a lost response the master first asks the slave for the response that
it may still have, then sends the request again (:class:`~dpstack.dpv1.master.ms1.Ms1Job`).
"""

from __future__ import annotations

from dpstack.dp.acyclic.job import ACKS, Outcome, ServiceFailure
from dpstack.dp.acyclic.queue import Provider
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.slave_reports import NO_ALARMS, DiagObserver
from dpstack.dp.pdu.alarm_blocks import HEAD
from dpstack.dpv1.master.alarm_handler import AlarmBook, AlarmHandler, OpenAlarm
from dpstack.dpv1.master.ms1 import Ms1, Ms1Job
from dpstack.dpv1.master.orders import AcknowledgeAlarm, HoldAlarms
from dpstack.dpv1.master.srd_polling import negative_outcome
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative, parse_response
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS1, SAP_MS1_ALARM, Telegram
from dpstack.trace import Event


class AckJob(Ms1Job):
    """The acknowledgement of ``known``, one of ``alarms``."""

    hint = ""
    why_closed = "see Extra_Alarm_SAP_supp of its GSD file (dpv1 = { extra_alarm_sap = ... })"

    def __init__(self, known: OpenAlarm, alarms: AlarmHandler, handler: SlaveHandler, ms1: Ms1) -> None:
        alarm = known.alarm
        title = f"{Function.ALARM_ACK.title} of {alarm.title}, slot {alarm.slot}, sequence number {alarm.sequence}"
        self._ack = AlarmAck.of(alarm)
        self._known = known
        self._alarms = alarms
        super().__init__(title, handler, ms1, self._ack.build(), HEAD, SAP_MS1_ALARM if alarms.extra_sap else SAP_MS1)

    @property
    def settled(self) -> bool:
        """The master has fetched the response to an earlier acknowledgement."""
        return self._known.answered

    def accept_late(self, octets: bytes) -> bool:
        outcome = self.outcome_of(octets)
        if outcome is None or outcome.failure is not None:
            return False
        self._known.answered = True
        return True

    def outcome_of(self, octets: bytes) -> Outcome | None:
        """The response has slot, type and specifier of the request."""
        try:
            if octets[0] & 0x80:
                response = parse_response(octets)
                if not isinstance(response, Negative) or response.function != Function.ALARM_ACK:
                    return None
                return negative_outcome(self.address, self.title, response)
            return Outcome() if octets[0] == Function.ALARM_ACK and AlarmAck.parse(octets) == self._ack else None
        except PduError as error:
            text = f"slave {self.address} answers {self.title} with what cannot be read: {error}"
            return Outcome(ServiceFailure.LENGTH, text)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """The alarm handler emits the event of the alarm's end."""
        self._alarms.ended(self._known, outcome, now)
        return []


class Alarms(Provider):
    """The alarms of the slaves of a class 1 master: their handlers, orders, acknowledgements."""

    def __init__(self, ms1: Ms1) -> None:
        self._ms1 = ms1
        self._books: dict[int, AlarmBook] = {}
        #: of slaves that are parameterised for DP-V1
        self._alarms: dict[int, AlarmHandler] = {}
        if ms1.master is not None:
            ms1.master.roster.observe(self._observer)

    def _observer(self, handler: SlaveHandler, before: SlaveHandler | None) -> DiagObserver:
        address = handler.setup.address
        self._alarms.pop(address, None)
        if before is None:
            self._books[address] = AlarmBook()
        if handler.setup.dpv1 is None:
            return NO_ALARMS
        alarms = self._alarms[address] = AlarmHandler(handler, self._books[address])
        return alarms

    def command(self, order: object, now: int) -> bool:
        """HoldAlarms and AcknowledgeAlarm, also for an alarm that is over. Raises UsageError as for a service."""
        match order:
            case HoldAlarms(address, on):
                handler = self._ms1.dpv1_slave(address) if on else self._ms1.slave(address)
                book = self._books[handler.setup.address]
                book.hold = on
                if not on:
                    book.untaken.clear()
                    if address in self._alarms:
                        self._alarms[address].release(None, now)
            case AcknowledgeAlarm(address, number):
                handler = self._ms1.slave(address)
                self._books[handler.setup.address].untaken.discard(number)
                if address in self._alarms:
                    self._alarms[address].release(number, now)
            case _:
                return False
        return True

    def queue_jobs(self, now: int) -> None:
        """Acknowledgements go out in the hold of the Data_Exchange before them, one at a time for each slave."""
        for alarms in self._alarms.values():
            known = alarms.next_ack(now) if alarms.busy else None
            if known is not None:
                alarms.begin_ack(known)
                job = AckJob(known, alarms, alarms.handler, self._ms1)
                self.queue.put(job, job.timeout_ns, now, token=ACKS, first=True)

    def request_ended(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Silence leaves the slave in doubt whether its diagnosis was read."""
        if isinstance(outcome, Telegram) or outcome in (Failure.ABANDONED, Failure.HELD_BACK, Failure.REFUSED):
            return
        alarms = self._alarms.get(request.da)
        if alarms is not None:
            alarms.missed()
