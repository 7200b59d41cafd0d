"""Alarm_Ack of a class 1 master (MS1): to SAP 51 between Read and Write, or to SAP 50 with Extra_Alarm_SAP.

The positive response repeats the request. One whose response was lost is not sent again before the slave was asked for
the response it may still have (:class:`~dpstack.dpv1.master.ms1_job.Ms1Job`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.alarm_blocks import HEAD
from dpstack.dpv1.master.alarm_handler import AlarmHandler, OpenAlarm
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.ms1_job import Ms1Job
from dpstack.dpv1.master.response_check import negative_outcome
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative, parse_response
from dpstack.errors import PduError
from dpstack.fdl.telegram import SAP_MS1, SAP_MS1_ALARM
from dpstack.trace import Event


class AckJob(Ms1Job):
    """The acknowledgement of ``known``, one of ``alarms``."""

    hint = ""
    why_closed = "see Extra_Alarm_SAP_supp of its GSD file (dpv1 = { extra_alarm_sap = ... })"

    def __init__(self, known: OpenAlarm, alarms: AlarmHandler, handler: SlaveHandler, ms1: Ms1) -> None:
        sap = SAP_MS1_ALARM if alarms.extra_sap else SAP_MS1
        self._ack = AlarmAck.of(known.alarm)
        super().__init__(handler, ms1, self._ack.build(), HEAD, sap)
        self._known = known
        self._alarms = alarms

    @property
    def title(self) -> str:
        """With what it acknowledges."""
        alarm = self._known.alarm
        return f"{Function.ALARM_ACK.title} of {alarm.title}, slot {alarm.slot}, sequence number {alarm.sequence}"

    @property
    def settled(self) -> bool:
        """The response to an earlier one was fetched."""
        return self._known.answered

    def late(self, octets: bytes) -> bool:
        """The response after all."""
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


def ack_jobs(handlers: Iterable[SlaveHandler], ms1: Ms1, now: int) -> Iterator[AckJob]:
    """The acknowledgements that are due: one at a time for each slave."""
    for handler in handlers:
        alarms = handler.alarms
        known = None if alarms is None else alarms.next_ack(handler.exchanges, now)
        if alarms is not None and known is not None:
            alarms.asked(known)
            yield AckJob(known, alarms, handler, ms1)
