"""Read and Write of a class 1 master to its slaves (MS1): DSAP 51, SSAP 51, open while the slave is in data exchange.

The request is one SRD. The slave answers in it at once, or acknowledges and is polled with empty SRDs; both are legal
(docs/protocol.md#ms1). One service per slave is outstanding, others wait. What is to be asked when is
:mod:`dpstack.dp.acyclic.queue`'s.

A Read without any answer is repeated, a Write is not: it may have been carried out, which is said. The course of a
service, with what was decided about answers, is :mod:`dpstack.dpv1.master.ms1_job`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.acyclic.job import Job, Outcome, Provider, ServiceEnd
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.master.ms1_job import Ms1Access, Ms1Job
from dpstack.dpv1.master.response_check import service_outcome
from dpstack.dpv1.pdu.ms2 import title_of
from dpstack.dpv1.pdu.read_write import Function, ReadReq, RecordReq, WriteReq
from dpstack.dpv1.timeouts import SERVICE_TIMEOUT
from dpstack.errors import PduError, UsageError
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


class Ms1(Provider):
    """Read and Write of the slaves in ``ms1``, as programs order them."""

    def __init__(self, ms1: Ms1Access) -> None:
        self._ms1 = ms1

    def job_of(self, order: object) -> tuple[int, Job, int] | None:
        """ReadRecord and WriteRecord."""
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
