"""A device with DP-V1: its records, alarms and class 2 connections, beside what every device has.

MS1 of a slave: the master sends a request, a record answers now or later, the master polls for the answer.

Decisions on points that the sources leave open: docs/reference/decisions/services.md#ms1-at-the-slave.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.events import Report, SlaveAppEvent
from dpstack.dp.slave.extension import Handler, SlaveService
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import AlarmAck, Function, Negative, UnacceptableError, parse_request
from dpstack.dpv1.slave.alarms import AlarmServer
from dpstack.dpv1.slave.clock_receiver import ClockReceiver
from dpstack.dpv1.slave.record_requests import AcyclicDevice, Asker, RecordRequest, Records, ask_records
from dpstack.dpv1.slave.resource_manager import Ms2Server, check_ms2
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import SAP_MS1, SAP_MS1_ALARM, Resp, Telegram
from dpstack.params import DPV1_STATUS_LEN

if TYPE_CHECKING:
    from dpstack.dpv1.slave.dxb_links import DxbSupport


class AlarmAcknowledged(SlaveAppEvent):
    """``master`` acknowledged ``alarm``, which is over with it."""

    #: the alarm, which is over
    alarm: Alarm
    #: address of the master that acknowledged it
    master: int

    TEMPLATE = "{e.who}: {e.alarm.text}: acknowledged by master {e.master}"


class Ms1Server(SlaveService):
    """MS1 of one slave application: ``records`` and ``alarms``, None if the device has none; without both the SAP is
    closed."""

    def __init__(self, records: Records | None, report: Report, alarms: AlarmServer | None = None) -> None:
        self.records = records
        self._alarm_answer: bytes | None = None  # at the extra SAP
        #: its alarms and status messages, which stand in the diagnosis
        self.messages: AlarmServer | None = alarms
        #: the master has set DPV1_Enable
        self.enabled = False
        self._report = report
        self._request: RecordRequest | None = None
        self._answer: bytes | None = None  # of requests that no application gets
        self._asker: Asker | None = None

    def handlers(self) -> dict[int | None, Handler]:
        """SAP 51, and the extra one of alarms."""
        return {SAP_MS1: self._serve, SAP_MS1_ALARM: self._serve_alarm}

    def parameterised(self, prm: SetPrm) -> None:
        """DPV1_Enable opens it; DPV1_Status_2 and 3 have the alarms that the master takes, and how many at a time
        (docs/reference/protocol.md#dpv1_status)."""
        status = prm.user_prm[:DPV1_STATUS_LEN].ljust(DPV1_STATUS_LEN, b"\0")
        self.enabled = bool(status[0] & DPV1_ENABLE)
        if self.messages is not None:
            self.messages.agree(*(status[1:] if self.enabled else b"\0\0"))

    def entered(self) -> None:
        """Alarms are possible with DPV1_Enable."""
        if self.enabled and self.messages is not None:
            self.messages.open()

    def left(self) -> None:
        """Alarms, and what is asked, end with data exchange."""
        if self.messages is not None:
            self.messages.close()
        self._alarm_answer = None
        self._drop()
        if self._asker is not None:
            self._asker.open = False
            self._asker = None

    def _serve(self, request: Telegram, now: int) -> Reply | None:
        """A request, or a poll (no octets)."""
        if not self.enabled or (self.records is None and not (self.messages and self.messages.support.kinds)):
            return None
        octets, sa = request.data, request.sa
        if not octets:
            return _reply(self._answer if self._request is None else self._request.octets(self._report, now))
        self._drop()
        if self._asker is None or self._asker.master != sa:
            self._asker = Asker(sa, SAP_MS1)
        if octets[0] == Function.ALARM_ACK and self.messages is not None:
            self._answer = self._acknowledge(self.messages, octets, sa, now).build()
            return SC_REPLY
        try:
            wanted = parse_request(octets)
        except UnacceptableError as error:
            self._answer = error.negative.build()
            self._report.refused("MS1", sa, str(error), now)
            return SC_REPLY
        self._request = RecordRequest(wanted, self._asker, now)
        ask_records(self._request, self.records)
        return SC_REPLY

    def _serve_alarm(self, request: Telegram, now: int) -> Reply | None:
        """A request at the extra SAP of alarms, or a poll."""
        if not self.enabled or self.messages is None or not self.messages.support.extra_sap:
            return None
        if request.data:
            self._alarm_answer = self._acknowledge(self.messages, request.data, request.sa, now).build()
            return SC_REPLY
        return _reply(self._alarm_answer)

    def _acknowledge(self, alarms: AlarmServer, octets: bytes, sa: int, now: int) -> AlarmAck | Negative:
        if octets[0] != Function.ALARM_ACK:
            self._report.refused("Alarm_Ack", sa, f"octet 1: no service 0x{octets[0]:02X} at SAP 50", now)
            return Negative(octets[0], Code.FEATURE_NOT_SUPPORTED)
        done = alarms.acknowledge(octets)
        if done.reason is not None:
            self._report.refused("Alarm_Ack", sa, done.reason, now)
        if done.alarm is not None:
            self._report.emit(AlarmAcknowledged, now, alarm=done.alarm, master=sa)
        return done.answer

    def _drop(self) -> None:
        self._answer = None
        request, self._request = self._request, None
        if request is not None:
            request.drop()


def _reply(answer: bytes | None) -> Reply:
    return SC_REPLY if answer is None else Reply(Resp.DL, answer)


class Device(AcyclicDevice):
    """A device as its author writes it: subclass it, override what differs."""

    #: alarms of the device; None without any
    alarm_server: AlarmServer | None = None
    #: data exchange broadcast of the device; None without it
    dxb: DxbSupport | None = None

    def services(self, report: Report) -> tuple[SlaveService, ...]:
        """MS1, MS2, the clock, data exchange broadcast."""
        check_ms2(f"device {self.name}", self.ms2, self.ms2_max_len, self.ms2_max_initiate)
        own = Ms1Server(self.records, report, self.alarm_server), Ms2Server(self, report), ClockReceiver(report)
        if self.dxb is None:
            return own
        from dpstack.dpv1.slave.dxb_links import DxbServer  # here, as few devices have it

        return *own, DxbServer(self, self.dxb, report, self.alarm_server)
