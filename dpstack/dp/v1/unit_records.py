"""Read and Write of a cyclic unit (a drive plugin) to its own slave: it puts orders into a queue, the station carries

them out by MS1 between the services of the application, one at a time for a slave.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from dpstack.dp.acyclic_job import Outcome, ServiceFailure
from dpstack.dp.events import SlaveState
from dpstack.dp.v1.records import ReadReq, RecordReq, WriteReq

if TYPE_CHECKING:
    from dpstack.dp.slave_handler import SlaveHandler

__all__ = ["Outcome", "PendingRecord", "ReadReq", "RecordQueue", "RecordReq", "ServiceFailure", "WriteReq", "queue_of"]


class PendingRecord:
    """A Read or Write under way; ``outcome`` is None until it is over."""

    __slots__ = ("outcome", "request")

    def __init__(self, request: RecordReq) -> None:
        self.request = request
        self.outcome: Outcome | None = None


class RecordQueue:
    """What a unit asks its slave, oldest first. It stands in the unit's attribute ``records``."""

    __slots__ = ("_waiting",)

    def __init__(self) -> None:
        self._waiting: deque[PendingRecord] = deque()

    def submit(self, request: RecordReq) -> PendingRecord:
        """Queue a service; poll its ``outcome``."""
        pending = PendingRecord(request)
        self._waiting.append(pending)
        return pending

    def cancel(self, pending: PendingRecord) -> None:
        """Give one up; one that was taken goes on, and nobody looks at what comes of it."""
        if pending in self._waiting:
            self._waiting.remove(pending)

    def take(self) -> PendingRecord | None:
        """The next one, for whoever carries it out."""
        return self._waiting.popleft() if self._waiting else None

    def clear(self) -> None:
        """The slave left data exchange."""
        self._waiting.clear()

    def __bool__(self) -> bool:
        """Something waits."""
        return bool(self._waiting)


def queue_of(handler: SlaveHandler) -> RecordQueue | None:
    """The queue of a slave with DP-V1 whose unit wants something now; before data exchange it waits."""
    if handler.setup.dpv1 is None or handler.state is not SlaveState.DATA_EXCHANGE:
        return None
    queue = getattr(handler.image.unit, "records", None)
    return queue if isinstance(queue, RecordQueue) and queue else None
