"""Read and Write that cyclic units ask for, as jobs among those of programs; their ends are told to the units."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from dpstack.dp.acyclic_job import Job, Outcome, ServiceFailure
from dpstack.dp.events import SlaveState
from dpstack.dp.slave_handler import SlaveHandler
from dpstack.dp.v1.ms1 import Ms1, RecordJob
from dpstack.dp.v1.unit_records import PendingRecord, RecordQueue, queue_at
from dpstack.errors import PduError
from dpstack.trace import Event


def asking(handlers: Iterable[SlaveHandler]) -> Iterator[tuple[SlaveHandler, RecordQueue]]:
    """Those whose cyclic units ask them something now."""
    for handler in handlers:
        queue = queue_at(handler.image.unit)
        if queue is not None and handler.state is SlaveState.DATA_EXCHANGE:  # before that it waits
            yield handler, queue


def unit_job(ms1: Ms1, handler: SlaveHandler, queue: RecordQueue) -> Job | None:
    """The next service of a unit; None where it cannot be, which the unit is told."""
    pending = queue.take()
    if pending is None:
        return None
    try:
        return UnitJob(pending, pending.request.build(), handler, ms1)
    except PduError as error:
        pending.outcome = Outcome(failure=ServiceFailure.LENGTH, text=str(error))
        return None


class UnitJob(RecordJob):
    """One that a cyclic unit waits for: its end is not an event."""

    def __init__(self, pending: PendingRecord, octets: bytes, handler: SlaveHandler, ms1: Ms1) -> None:
        super().__init__(pending.request, octets, handler, ms1)
        self._pending = pending

    def ends(self, token: int, outcome: Outcome, now: int) -> list[Event]:
        """Told to the unit."""
        self._pending.outcome = outcome
        return []
