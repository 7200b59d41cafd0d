"""Orders of programs to the DP-V1 services of a master, and the events that answer them. Plain data; times in ns.

A class 2 connection is named by the token of the order that opened it. The machines that carry the orders out:
:mod:`dpstack.dpv1.master.ms1`, :mod:`dpstack.dpv1.master.ms2`, :mod:`dpstack.dpv1.master.alarm_handler`.
"""

from __future__ import annotations

from typing import Final

from dpstack.dp.acyclic.job import Outcome, ServiceEnd
from dpstack.dp.master.events import SlaveEvent
from dpstack.dp.pdu.alarm_blocks import Alarm, Specifier, Status, full_text
from dpstack.dp.pdu.diag_blocks import FIRST_SLOT
from dpstack.dp.pdu.diag_texts import texts_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import DataTransport, Function, ReadReq, Service, WriteReq
from dpstack.dpv1.timeouts import SERVICE_TIMEOUT, least_send_timeout
from dpstack.errors import UsageError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.machine import Order
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import octets_text
from dpstack.trace import Event, Severity

#: Initiate with the send time-out to ask for by default
_USUAL_REQUEST: Final = InitiateReq(least_send_timeout(500_000))


# --- Read, Write, Data_Transport ---------------------------------------------------------------------------------


class RecordOrder(Order):
    """Read up to ``length`` octets of a record, or send ``data`` by Write or Data_Transport (``function``).

    The order has either the ``address`` of a slave of this master (MS1, without Data_Transport) or the token of a class
    2 ``connection``. Its end is the :class:`RecordDone` with ``token``. ``timeout_ns`` counts from the order; the
    slave's own time-out counts from the request. ``user``: the users of record 47 of a slave take turns; 0 for all
    programs without a number of their own.
    """

    token: int
    function: Function
    slot: int
    index: int
    length: int = MAX_RECORD
    data: bytes = b""
    timeout_ns: int = SERVICE_TIMEOUT
    address: int | None = None
    connection: int | None = None
    user: int = 0

    @property
    def service(self) -> Service:
        match self.function:
            case Function.READ:
                return ReadReq(self.slot, self.index, self.length)
            case Function.WRITE:
                return WriteReq(self.slot, self.index, self.data)
            case _:
                return DataTransport(self.slot, self.index, self.data)


class RecordDone(ServiceEnd):
    """The one end of a RecordOrder; the data that the slave sent are in ``outcome``.

    ``stale``: number of answers to other requests that came before it.
    """

    function: Function
    slot: int
    index: int
    stale: int = 0

    @classmethod
    def of(cls, service: Service, token: int, address: int, outcome: Outcome, stale: int, now: int) -> RecordDone:
        return cls(
            t_ns=now,
            token=token,
            address=address,
            function=service.function,
            slot=service.slot,
            index=service.index,
            outcome=outcome,
            stale=stale,
        )

    @property
    def title(self) -> str:
        return self.function.title

    @property
    def result(self) -> str:
        """The record, and the number of octets that came."""
        where = f"{self.title} of slot {self.slot}, index {self.index}"
        return f"{where} done" if self.function is Function.WRITE else f"{where}, {octets_text(len(self.outcome.data))}"


# --- class 2 connections -----------------------------------------------------------------------------------------


class OpenConnection(Order):
    """Open a connection to the slave at ``address`` by the Initiate ``request``; its end is the InitiateDone with
    ``token``. The slave may have a longer send time-out than that in the request.

    ``response_ns``: the time in which the slave answers a service (C2_Response_Timeout), 0: not known. ``channels``:
    number of connections that the slave has (C2_Max_Count_Channels), 0: not known.
    """

    token: int
    address: int
    request: InitiateReq = _USUAL_REQUEST
    response_ns: int = 0
    channels: int = 0
    timeout_ns: int = SERVICE_TIMEOUT


class CloseConnection(Order):
    """Abort ``connection``, also while it is being opened. Its services end. A connection that is over is no error."""

    ENDS = True

    connection: int


class CloseConnections(Order):
    """Abort all connections, then emit ConnectionsClosed: for the end of a bus."""

    ENDS = True


class InitiateDone(ServiceEnd):
    """The one end of OpenConnection. Without a failure the connection is open: its server SAP in the slave, the send
    time-out that counts, and the slave's answer to Initiate (``max_len``: octets of data in one service)."""

    server_sap: int = 0
    send_timeout_ns: int = 0
    max_len: int = 0
    profile_ident: int = 0

    @property
    def title(self) -> str:
        return Function.INITIATE.title

    @property
    def result(self) -> str:
        return f"class 2 connection open, server SAP {self.server_sap}"


class ConnectionOver(Event):
    """The one end of a connection that was open, emitted when the slave has it back: ``reason`` says who ended it and
    why.

    ``abort``: subnet, instance and reason of the Abort that either end sent; None without any. ``ordered``: the program
    that opened it ended it.
    """

    #: number of the connection on this bus
    connection: int
    #: station address of the slave, 0..126
    address: int
    #: SAP of the slave for the connection, 0..48
    server_sap: int
    #: who ended it, and why
    reason: str
    abort: tuple[int, int, int] | None = None
    ordered: bool = False

    MUST_ARRIVE = True

    TEMPLATE = "slave {e.address}: class 2 connection (server SAP {e.server_sap}) is over: {e.reason}"

    @property
    def severity(self) -> Severity:
        """INFO for an end that the program ordered, else WARNING."""
        return Severity.INFO if self.ordered else Severity.WARNING


class ConnectionsClosed(Event):
    """The end of CloseConnections: no slave holds anything for this master any more, as far as could be done."""

    MUST_ARRIVE = True
    TEMPLATE = "no class 2 connection is open any more"


# --- alarms ------------------------------------------------------------------------------------------------------


class HoldAlarms(Order):
    """``on``: from now on only AcknowledgeAlarm acknowledges alarms of the slave at ``address``; otherwise the station
    does it again, and begins with those that wait."""

    address: int
    on: bool


class AcknowledgeAlarm(Order):
    """Acknowledge the alarm ``number`` (of AlarmRaised) of the slave at ``address``; its end is AlarmDone."""

    address: int
    number: int


class AlarmRaised(SlaveEvent):
    """The slave raised ``alarm``; ``number`` counts the alarms of this slave. ``diagnosis`` is the one with the alarm.

    ``held``: it waits for AcknowledgeAlarm. ``texts``: the other blocks of that diagnosis (channels, modules), and the
    texts of the GSD file for the alarm, one line each.
    """

    #: number of the alarm, counted for each slave
    number: int
    #: the alarm
    alarm: Alarm
    #: the diagnosis that carried the alarm
    diagnosis: Diagnosis
    held: bool = False
    texts: tuple[str, ...] = ()

    @property
    def must_arrive(self) -> bool:
        """The slave waits for its acknowledgement."""
        return self.held

    @property
    def severity(self) -> Severity:
        """WARNING for an alarm about an error that appears."""
        return Severity.WARNING if self.alarm.specifier == Specifier.APPEARS else Severity.INFO

    def _text(self) -> str:
        return "; ".join((f"{self.who}: {self.alarm.full_text}", *self.texts))


class AlarmDone(SlaveEvent):
    """The one end of the alarm ``number``: the slave took its acknowledgement, or why it got none."""

    MUST_ARRIVE = True

    number: int
    outcome: Outcome

    def _text(self) -> str:
        """The outcome names the slave too: once is enough."""
        failed = self.outcome.text.removeprefix(f"{self.who} ").removeprefix(f"slave {self.address} ")
        return f"{self.who}: " + (failed or f"took the acknowledgement of alarm {self.number}")


class StatusTold(SlaveEvent):
    """The slave's diagnosis holds a new ``status``. Nobody acknowledges it."""

    #: the new status
    status: Status
    #: slot of the first module of a module status
    first_slot: int = FIRST_SLOT

    def _text(self) -> str:
        return f"{self.who}: {full_text(self.status, self.first_slot)}"


def texts_beside(diagnosis: Diagnosis, alarm: Alarm, texts: DiagTexts | None) -> tuple[str, ...]:
    """The texts of the GSD file for ``alarm``, and the texts of the other blocks of ``diagnosis``."""
    block = alarm.build()
    own = () if texts is None else tuple(found.text for found in texts.unit_diag_texts(block[1:]))
    others = tuple(other for other in diagnosis.blocks if other.octets != block)
    return own + texts_of(others, texts, dpv1=True)


def need_dpv1(setup: SlaveParams, lacks: str = "no Read, Write, alarms", *, read_only: bool = False) -> None:
    """Raises UsageError for a slave that this master has not parameterised for DP-V1; ``lacks``: for the message."""
    if read_only:
        raise UsageError("this bus is read-only: its slaves are not in data exchange with it; leave read_only out")
    if setup.dpv1 is None:
        keys = "dpv1 = true"
        if len(setup.user_prm) < DPV1_STATUS_LEN:
            keys = f'user_prm = "{bytes(DPV1_STATUS_LEN).hex(" ")}" and {keys}'
        raise UsageError(
            f"{setup.who} is not parameterised for DP-V1: {lacks}; if it has them put {keys} into its [[slave]] table"
        )
