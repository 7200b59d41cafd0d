"""Read and Write that cyclic units ask for, as jobs among those of programs; their ends are told to the units.

No record is longer than C1_Max_Data_Len: a longer Write is refused here, less is read.
"""

from __future__ import annotations

import dataclasses

from dpstack.dp.acyclic.job import Outcome, Provider, ServiceFailure
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dpv1.master.ms1 import RecordJob
from dpstack.dpv1.master.ms1_job import Ms1Access
from dpstack.dpv1.master.plugin_queue import PendingRecord, RecordQueue, queue_at
from dpstack.dpv1.master.response_check import negative_outcome
from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.ms2 import title_of
from dpstack.dpv1.pdu.read_write import Function, Negative, ReadReq, RecordReq, WriteReq
from dpstack.errors import PduError
from dpstack.trace import Event


class UnitJob(RecordJob):
    """One that a cyclic unit waits for: its end is not an event."""

    def __init__(
        self, pending: PendingRecord, request: RecordReq, octets: bytes, handler: SlaveHandler, ms1: Ms1Access
    ) -> None:
        super().__init__(request, octets, handler, ms1)
        self._pending = pending

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """Told to the unit."""
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
            refusal = Negative(Function.WRITE, Code.WRITE_LENGTH)
            pending.outcome = negative_outcome(f"slave {handler.setup.address}", title_of(request), refusal)
            return None
        if isinstance(request, ReadReq):
            request = dataclasses.replace(request, length=min(request.length, longest))
        try:
            return UnitJob(pending, request, request.build(), handler, self._ms1)
        except PduError as error:
            pending.outcome = Outcome(failure=ServiceFailure.LENGTH, text=str(error))
            return None
