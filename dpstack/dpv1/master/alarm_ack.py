"""Alarm_Ack of a class 1 master (MS1): to SAP 51 between Read and Write, or to SAP 50 with Extra_Alarm_SAP.

The positive response repeats the request. One whose response was lost is not sent again before the slave was asked for
the response it may still have (:class:`~dpstack.dpv1.master.ms1_job.Ms1Job`).
"""

from __future__ import annotations

from dpstack.dp.acyclic.job import ACKS, Outcome, Provider, ServiceFailure
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.alarm_blocks import HEAD
from dpstack.dpv1.master.alarm_events import AcknowledgeAlarm, AlarmBook, HoldAlarms
from dpstack.dpv1.master.alarm_handler import AlarmHandler, OpenAlarm
from dpstack.dpv1.master.ms1_job import Ms1Access, Ms1Job
from dpstack.dpv1.master.response_check import negative_outcome
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative, parse_response
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_MS1, SAP_MS1_ALARM, Telegram
from dpstack.trace import Event


class AckJob(Ms1Job):
    """The acknowledgement of ``known``, one of ``alarms``."""

    hint = ""
    why_closed = "see Extra_Alarm_SAP_supp of its GSD file (dpv1 = { extra_alarm_sap = ... })"

    def __init__(self, known: OpenAlarm, alarms: AlarmHandler, handler: SlaveHandler, ms1: Ms1Access) -> None:
        sap = SAP_MS1_ALARM if alarms.extra_sap else SAP_MS1
        self._ack = AlarmAck.of(known.alarm)
        super().__init__(handler, ms1, self._ack.build(), HEAD, sap)
        self._known = known
        self._alarms = alarms

    @property
    def title(self) -> str:
        alarm = self._known.alarm
        return f"{Function.ALARM_ACK.title} of {alarm.title}, slot {alarm.slot}, sequence number {alarm.sequence}"

    @property
    def settled(self) -> bool:
        """The response to an earlier one was fetched."""
        return self._known.answered

    def late(self, octets: bytes) -> bool:
        outcome = self.judged(octets)
        if outcome is None or outcome.failure is not None:
            return False
        self._known.answered = True
        return True

    def judged(self, octets: bytes) -> Outcome | None:
        """The response has slot, type and specifier of the request."""
        try:
            if octets[0] & 0x80:
                return self._refusal(octets)
            response = AlarmAck.parse(octets) if octets[0] == Function.ALARM_ACK else None
        except PduError as error:
            text = f"slave {self.address} answers {self.title} with what cannot be read: {error}"
            return Outcome(failure=ServiceFailure.LENGTH, text=text)
        return Outcome() if response == self._ack else None

    def _refusal(self, octets: bytes) -> Outcome | None:
        response = parse_response(octets)
        if not isinstance(response, Negative) or response.function != Function.ALARM_ACK:
            return None
        return negative_outcome(f"slave {self.address}", self.title, response)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """Told to the handling of alarms, which tells on."""
        self._alarms.ended(self._known, outcome, now)
        return []


class Alarms(Provider):
    """The alarms of the slaves of a class 1 master: who reads them in the diagnoses, orders, acknowledgements."""

    def __init__(self, ms1: Ms1Access) -> None:
        self._ms1 = ms1
        self._books: dict[int, AlarmBook] = {}
        #: of slaves that are parameterised for DP-V1
        self._alarms: dict[int, AlarmHandler] = {}
        if ms1.master is not None:
            ms1.master.observe(self._observer)

    def _observer(self, handler: SlaveHandler, before: SlaveHandler | None) -> AlarmHandler | None:
        setup = handler.setup
        self._alarms.pop(setup.address, None)
        if before is None:
            self._books[setup.address] = AlarmBook()
        if setup.dpv1 is None:
            return None
        book = self._books[setup.address]
        alarms = AlarmHandler(setup, handler.findings, handler.emit, handler.want_diagnosis, book)
        self._alarms[setup.address] = alarms
        return alarms

    def command(self, order: object, now: int) -> bool:
        """HoldAlarms and AcknowledgeAlarm, of an alarm that is over too. Raises UsageError as for a service."""
        match order:
            case HoldAlarms(address, on):
                handler = self._ms1.handler(address) if on else self._ms1.slave(address)
                book = self._books[handler.setup.address]
                book.hold = on
                if not on:
                    book.untaken.clear()
                    if address in self._alarms:
                        self._alarms[address].release(now)
            case AcknowledgeAlarm(address, number):
                handler = self._ms1.slave(address)
                self._books[handler.setup.address].untaken.discard(number)
                if address in self._alarms:
                    self._alarms[address].acknowledge(number, now)
            case _:
                return False
        return True

    def ask(self, now: int) -> None:
        """Acknowledgements go out in the hold of the Data_Exchange before them, one at a time for each slave."""
        for address, alarms in self._alarms.items():
            if not alarms.busy:
                continue
            handler = self._ms1.slave(address)
            known = alarms.next_ack(handler.exchanges, now)
            if known is not None:
                alarms.asked(known)
                job = AckJob(known, alarms, handler, self._ms1)
                self.queue.put(job, job.timeout_ns, now, token=ACKS, first=True)

    def heard(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Silence leaves the slave in doubt."""
        if isinstance(outcome, Telegram) or outcome in (Failure.ABANDONED, Failure.HELD_BACK, Failure.REFUSED):
            return
        alarms, master = self._alarms.get(request.da), self._ms1.master
        handler = None if master is None else master.handlers.get(request.da)
        if alarms is not None and handler is not None:
            alarms.missed(handler.exchanges)
