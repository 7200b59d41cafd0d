"""Read and Write of a class 1 master to its slaves (MS1): DSAP 51, SSAP 51, open while the slave is in data exchange.

The request is one SRD. The slave answers in it at once, or acknowledges and is polled with empty SRDs; both are legal
(docs/protocol.md#ms1). One service per slave is outstanding, others wait. What is to be asked when is
:mod:`dpstack.dp.acyclic.queue`'s.

A Read without any answer is repeated, a Write is not: it may have been carried out, which is said. The course of a
service, with what was decided about answers, is :mod:`dpstack.dpv1.master.ms1_job`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.acyclic.job import Job, Outcome, ServiceEnd
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.alarm_events import AcknowledgeAlarm, HoldAlarms
from dpstack.dpv1.master.ms1_job import Ms1Job, Owed
from dpstack.dpv1.master.plugin_queue import queue_at
from dpstack.dpv1.master.response_check import service_outcome
from dpstack.dpv1.pdu.ms2 import title_of
from dpstack.dpv1.pdu.read_write import Function, ReadReq, RecordReq, WriteReq
from dpstack.dpv1.timeouts import SERVICE_TIMEOUT
from dpstack.errors import PduError, UsageError
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Telegram
from dpstack.trace import Event

_HEAD: Final = 4
_MAYBE: Final = "it may have been carried out: read it back"


@dataclass(frozen=True, slots=True)
class ReadRecord:
    """Read up to ``length`` octets of a record of the slave at ``address``; the end is the RecordDone with ``token``.

    ``timeout_ns`` counts from the order, the slave's own time-out from the request.
    """

    token: int
    address: int
    slot: int
    index: int
    length: int = MAX_RECORD
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True)
class WriteRecord:
    """Write ``data``, otherwise as :class:`ReadRecord`."""

    token: int
    address: int
    slot: int
    index: int
    data: bytes
    timeout_ns: int = SERVICE_TIMEOUT


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordDone(ServiceEnd):
    """The one end of the Read or Write with ``token``; the data read are in ``outcome``.

    ``stale``: answers to other requests that came before it.
    """

    write: bool
    slot: int
    index: int
    stale: int = 0

    @classmethod
    def of(cls, request: RecordReq, token: int, address: int, outcome: Outcome, stale: int, now: int) -> RecordDone:
        """The end of ``request``, whichever way it went."""
        return cls(
            t_ns=now,
            token=token,
            address=address,
            write=isinstance(request, WriteReq),
            slot=request.slot,
            index=request.index,
            outcome=outcome,
            stale=stale,
        )

    @property
    def title(self) -> str:
        """Read or Write."""
        return (Function.WRITE if self.write else Function.READ).title

    @property
    def result(self) -> str:
        """How many octets of which record."""
        where = f"{self.title} of slot {self.slot}, index {self.index}"
        return f"{where} done" if self.write else f"{where}, {len(self.outcome.data)} octets"


def need_dpv1(setup: SlaveParams, *, read_only: bool) -> None:
    """Raises UsageError for a slave that has no Read, Write and alarms of this master."""
    if read_only:
        raise UsageError("this bus is read-only: its slaves are not in data exchange with it; leave read_only out")
    if setup.dpv1 is None:
        raise UsageError(
            f"slave {setup.address} ({setup.name}) is not parameterised for DP-V1: no Read, Write, alarms; "
            f"if it has them put dpv1 = true into its [[slave]] table"
        )


@dataclass(slots=True)
class Ms1:
    """MS1 of the station ``own``: jobs of orders, the alarms. ``master``: whose slaves they are for."""

    own: int
    master: Master | None
    #: answers to services which are over, by lane
    owed: dict[int, Owed] = field(default_factory=dict)

    def command(self, order: object, now: int) -> bool:
        """HoldAlarms and AcknowledgeAlarm. Raises UsageError as for a service."""
        match order:
            case HoldAlarms(address, on):
                self._hold(address, on, now)
            case AcknowledgeAlarm(address, number):
                self._acknowledge(address, number, now)
            case _:
                return False
        return True

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        """Token, job and time-out in ns of ``order``; None when it is none for MS1. Raises UsageError."""
        match order:
            case ReadRecord(token, address, slot, index, length, timeout_ns):
                request: RecordReq = ReadReq(slot, index, length)
            case WriteRecord(token, address, slot, index, data, timeout_ns):
                request = WriteReq(slot, index, data)
            case _:
                return None
        try:
            octets = request.build()
        except PduError as error:
            raise UsageError(str(error)) from None
        return token, RecordJob(request, octets, self.handler(address), self), timeout_ns

    def asking(self) -> list[SlaveHandler]:
        """Slaves with DP-V1 that have alarms, or whose cyclic unit wants something. Asked in every token hold."""
        if self.master is None:
            return []
        return [
            handler
            for handler in self.master.handlers.values()
            if handler.alarms is not None and (handler.alarms.busy or queue_at(handler.image.unit))
        ]

    def slave(self, address: int) -> SlaveHandler:
        """The slave's, whatever it is parameterised for. Raises UsageError."""
        handlers = {} if self.master is None else self.master.handlers
        if address not in handlers:
            raise UsageError(f"station {address} is no slave of this master: MS1 is between a slave and its own master")
        return handlers[address]

    def handler(self, address: int) -> SlaveHandler:
        """The slave's, where it is parameterised for DP-V1. Raises UsageError."""
        handler = self.slave(address)
        need_dpv1(handler.setup, read_only=self.master is not None and self.master.read_only)
        return handler

    def heard(self, request: Request, outcome: Telegram | Failure) -> None:
        """The end of a request to any station."""
        if not isinstance(outcome, Telegram) and outcome not in (Failure.ABANDONED, Failure.HELD_BACK, Failure.REFUSED):
            handler = None if self.master is None else self.master.handlers.get(request.da)
            if handler is not None and handler.alarms is not None:
                handler.alarms.missed(handler.exchanges)

    def _hold(self, address: int, on: bool, now: int) -> None:
        """Who acknowledges the slave's alarms. Raises UsageError, ``on`` also as for a service."""
        handler = self.handler(address) if on else self.slave(address)
        handler.alarm_book.hold = on
        if not on:
            handler.alarm_book.untaken.clear()
            if handler.alarms is not None:
                handler.alarms.release(now)

    def _acknowledge(self, address: int, number: int, now: int) -> None:
        """An alarm of the slave; one that is over is no error. Raises UsageError."""
        handler = self.slave(address)
        handler.alarm_book.untaken.discard(number)
        if handler.alarms is not None:
            handler.alarms.acknowledge(number, now)

    def bar(self, handler: SlaveHandler, since: int) -> str:
        """Why no service to the slave of ``handler``, in data exchange ``since`` then, can end: MS1 closes on leaving
        data exchange (docs/protocol.md#ms1), and in Stop nothing is sent to slaves. Empty while it can.
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


class RecordJob(Ms1Job):
    """One Read or Write, to the slave that ``handler`` handles."""

    why_closed = (
        "it was switched off and on just now, has no Read and Write (C1_Read_Write_supp of its GSD file), "
        "or takes them only with other parameters"
    )

    def __init__(self, request: RecordReq, octets: bytes, handler: SlaveHandler, ms1: Ms1) -> None:
        super().__init__(handler, ms1, octets, _HEAD if isinstance(request, WriteReq) else _HEAD + request.length)
        self._request = request
        self._write = isinstance(request, WriteReq)
        self.repeats = not self._write
        if self._write:
            self.hint = f"; {_MAYBE}"

    @property
    def aftermath(self) -> str:
        """A Write whose response is missing, whatever cut it short."""
        return _MAYBE if self._write and self._sent else ""

    @property
    def title(self) -> str:
        """With slot and index: they are what a reader looks for."""
        return title_of(self._request)

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """One event."""
        return [RecordDone.of(self._request, token, self.address, outcome, self.stale, now)]

    def judged(self, octets: bytes) -> Outcome | None:
        """See :func:`~dpstack.dpv1.master.response_check.service_outcome`; a response to Alarm_Ack is one to an earlier
        request."""
        if octets[0] == Function.ALARM_ACK:
            return None
        return service_outcome(self.address, self._request, octets)
