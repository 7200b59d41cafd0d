"""Read and Write of a class 1 master to its slaves (MS1): DSAP 51, SSAP 51, open while the slave is in data exchange.

The request is one SRD. The slave answers in it at once, or acknowledges and is polled with empty SRDs; both are legal
(docs/protocol.md#ms1). One service per slave is outstanding, others wait. What is to be asked when is
:mod:`dpstack.dp.acyclic.queue`'s.

A Read without any answer is repeated, a Write is not: it may have been carried out, which is said. The course of a
service, with what was decided about answers, is :mod:`dpstack.dpv1.master.ms1_job`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

from dpstack.dp.acyclic.job import Job, Outcome, Provider, ServiceEnd, ServiceFailure
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.master.ms1_job import Ms1Access, Ms1Job
from dpstack.dpv1.master.plugin_queue import PendingRecord, RecordQueue, queue_at
from dpstack.dpv1.master.response_check import negative_outcome, service_outcome
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import Function, Negative, ReadReq, RecordReq, WriteReq
from dpstack.dpv1.timeouts import SERVICE_TIMEOUT
from dpstack.errors import PduError, UsageError
from dpstack.machine import Order
from dpstack.trace import Event

_HEAD: Final = 4
_MAYBE: Final = "it may have been carried out: read it back"


@dataclass(frozen=True, slots=True)
class ReadRecord(Order):
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
class WriteRecord(Order):
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
        return (Function.WRITE if self.write else Function.READ).title

    @property
    def result(self) -> str:
        """How many octets of which record."""
        where = f"{self.title} of slot {self.slot}, index {self.index}"
        return f"{where} done" if self.write else f"{where}, {len(self.outcome.data)} octets"


class RecordJob(Ms1Job):
    """One Read or Write, to the slave that ``handler`` handles."""

    why_closed = (
        "it was switched off and on just now, has no Read and Write (C1_Read_Write_supp of its GSD file), "
        "or takes them only with other parameters"
    )

    def __init__(self, request: RecordReq, octets: bytes, handler: SlaveHandler, ms1: Ms1Access) -> None:
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
        return self._request.title

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        return [RecordDone.of(self._request, token, self.address, outcome, self.stale, now)]

    def judged(self, octets: bytes) -> Outcome | None:
        """See :func:`~dpstack.dpv1.master.response_check.service_outcome`; a response to Alarm_Ack is one to an earlier
        request."""
        if octets[0] == Function.ALARM_ACK:
            return None
        return service_outcome(self.address, self._request, octets)


class Ms1(Provider):
    """Read and Write of the slaves in ``ms1``, as programs order them."""

    def __init__(self, ms1: Ms1Access) -> None:
        self._ms1 = ms1

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
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
        return token, RecordJob(request, octets, self._ms1.handler(address), self._ms1), timeout_ns


# No record is longer than C1_Max_Data_Len: a longer Write is refused here, less is read.


class UnitJob(RecordJob):
    """One that a cyclic unit waits for: its end is not an event."""

    def __init__(
        self, pending: PendingRecord, request: RecordReq, octets: bytes, handler: SlaveHandler, ms1: Ms1Access
    ) -> None:
        super().__init__(request, octets, handler, ms1)
        self._pending = pending

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        self._pending.outcome = outcome
        return []


class PluginJobs(Provider):
    """Services that the cyclic units of the slaves in ``ms1`` want."""

    def __init__(self, ms1: Ms1Access) -> None:
        self._ms1 = ms1

    def ask(self, now: int) -> None:
        """What a unit wants since the Data_Exchange of this hold goes out in the same one."""
        master = self._ms1.master
        if master is None:
            return
        for handler in master.handlers.values():
            queue = None if handler.setup.dpv1 is None else queue_at(handler.image.unit)
            if queue is None or handler.state is not SlaveState.DATA_EXCHANGE:  # before that it waits
                continue
            job = self._next(handler, queue) if self.queue.room(handler.setup.address) else None
            if job is not None:
                self.queue.put(job, job.timeout_ns, now)

    def _next(self, handler: SlaveHandler, queue: RecordQueue) -> UnitJob | None:
        """The next service of a unit; None where it cannot be, which the unit is told."""
        pending = queue.take()
        if pending is None:
            return None
        dpv1 = handler.setup.dpv1
        longest = MAX_RECORD if dpv1 is None else dpv1.c1_max_data_len
        request = pending.request
        if isinstance(request, WriteReq) and longest < len(request.data) <= MAX_RECORD:
            # as the slave would, if it can answer what does not fit its buffer: whoever asks may do with less
            refusal = Negative(Function.WRITE, Code.WRITE_LENGTH_ERROR)
            pending.outcome = negative_outcome(f"slave {handler.setup.address}", request.title, refusal)
            return None
        if isinstance(request, ReadReq):
            request = dataclasses.replace(request, length=min(request.length, longest))
        try:
            return UnitJob(pending, request, request.build(), handler, self._ms1)
        except PduError as error:
            pending.outcome = Outcome(failure=ServiceFailure.LENGTH, text=str(error))
            return None
