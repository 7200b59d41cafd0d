"""Queue of the Reads and Writes of a drive plugin to its own slave. The station carries them out by MS1
between the services of the application, one at a time for a slave.
"""

from __future__ import annotations

from collections import deque

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dpv1.pdu.read_write import ReadReq, RecordReq, WriteReq

__all__ = ["Outcome", "PendingRecord", "ReadReq", "RecordQueue", "RecordReq", "ServiceFailure", "WriteReq", "queue_at"]


class PendingRecord:
    """A Read or Write; ``outcome`` is None until it is over. ``cancelled``: the plugin does not wait for it."""

    __slots__ = ("cancelled", "outcome", "request")

    def __init__(self, request: RecordReq) -> None:
        self.request = request
        self.outcome: Outcome | None = None
        self.cancelled = False


class RecordQueue:
    """The requests of a unit to its slave, oldest first: the unit's attribute ``records``."""

    __slots__ = ("_waiting",)

    def __init__(self) -> None:
        self._waiting: deque[PendingRecord] = deque()

    def submit(self, request: RecordReq) -> PendingRecord:
        """Queue a service; poll its ``outcome``."""
        pending = PendingRecord(request)
        self._waiting.append(pending)
        return pending

    def cancel(self, pending: PendingRecord) -> None:
        """Give a request up; one that has begun goes on, and its outcome is ignored."""
        pending.cancelled = True
        if pending in self._waiting:
            self._waiting.remove(pending)

    def take(self) -> PendingRecord | None:
        """The next request, for the station."""
        return self._waiting.popleft() if self._waiting else None

    def clear(self) -> None:
        """The slave left data exchange."""
        self._waiting.clear()

    def __bool__(self) -> bool:
        return bool(self._waiting)


def queue_at(unit: object) -> RecordQueue | None:
    """The queue of a cyclic ``unit``, if it holds a request."""
    queue = getattr(unit, "records", None)
    return queue if isinstance(queue, RecordQueue) and queue._waiting else None
