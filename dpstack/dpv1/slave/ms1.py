"""MS1 of a slave: requests come in, records answer now or later, the master polls for the answer.

Decisions where the sources leave something open: docs/decisions/services.md#ms1-at-the-slave.
"""

from __future__ import annotations

from typing import Protocol

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative, UnacceptableError, parse_request
from dpstack.dpv1.slave.alarms import AlarmServer
from dpstack.dpv1.slave.record_requests import Asker, Records, Ticket, Told, put
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import SAP_MS1, Resp


class Ms1Told(Told, Protocol):
    """Where MS1 tells what it refused, and which alarm is over."""

    def acknowledged(self, alarm: Alarm, master: int, now: int) -> None:
        """An alarm is over."""


class Ms1Server:
    """MS1 of one slave application: ``records`` and ``alarms``, None where the device has none; without both the SAP is
    closed."""

    __slots__ = ("_alarm_answer", "_alarms", "_answer", "_asker", "_report", "_ticket", "enabled", "records")

    def __init__(self, records: Records | None, report: Ms1Told, alarms: AlarmServer | None = None) -> None:
        self.records = records
        self._alarms = alarms
        self._alarm_answer: bytes | None = None  # at the extra SAP
        #: DPV1_Enable was in Set_Prm
        self.enabled = False
        self._report = report
        self._ticket: Ticket | None = None
        self._answer: bytes | None = None  # to what no application is asked
        self._asker: Asker | None = None

    @property
    def open(self) -> bool:
        """The SAP is open, as far as parameters go."""
        alarms = self._alarms is not None and bool(self._alarms.support.kinds)
        return self.enabled and (alarms or self.records is not None)

    @property
    def extra_sap(self) -> bool:
        """The extra SAP of alarms is open."""
        return self.enabled and self._alarms is not None and self._alarms.support.extra_sap

    def close(self) -> None:
        """Data exchange is over."""
        self._alarm_answer = None
        self._drop()
        if self._asker is not None:
            self._asker.open = False
            self._asker = None

    def serve(self, octets: bytes, sa: int, now: int) -> Reply:
        """A request, or a poll (no octets)."""
        if not octets:
            return _reply(self._answer if self._ticket is None else self._ticket.take(self._report, now))
        self._drop()
        if self._asker is None or self._asker.master != sa:
            self._asker = Asker(sa, SAP_MS1)
        if octets[0] == Function.ALARM_ACK and self._alarms is not None:
            self._answer = self._acknowledge(self._alarms, octets, sa, now).build()
            return SC_REPLY
        try:
            request = parse_request(octets)
        except UnacceptableError as error:
            self._answer = error.negative.build()
            self._report.refused("MS1", sa, str(error), now)
            return SC_REPLY
        self._ticket = Ticket(request, self._asker, now)
        put(self._ticket, self.records)
        return SC_REPLY

    def serve_alarm(self, octets: bytes, sa: int, now: int) -> Reply:
        """A request at the extra SAP of alarms, or a poll."""
        if self._alarms is not None and octets:
            self._alarm_answer = self._acknowledge(self._alarms, octets, sa, now).build()
            return SC_REPLY
        return _reply(self._alarm_answer)

    def _acknowledge(self, alarms: AlarmServer, octets: bytes, sa: int, now: int) -> AlarmAck | Negative:
        if octets[0] != Function.ALARM_ACK:
            self._report.refused("Alarm_Ack", sa, f"octet 1: no service 0x{octets[0]:02X} at SAP 50", now)
            return Negative(octets[0], Code.NOT_SUPPORTED)
        done = alarms.acknowledge(octets)
        if done.reason is not None:
            self._report.refused("Alarm_Ack", sa, done.reason, now)
        if done.alarm is not None:
            self._report.acknowledged(done.alarm, sa, now)
        return done.answer

    def _drop(self) -> None:
        self._answer = None
        ticket, self._ticket = self._ticket, None
        if ticket is not None:
            ticket.drop()


def _reply(answer: bytes | None) -> Reply:
    return SC_REPLY if answer is None else Reply(Resp.DL, answer)
