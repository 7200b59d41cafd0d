"""History of values for OPC UA: those of the last hour, with one bound over all values."""

from __future__ import annotations

from collections import deque
from datetime import datetime, timedelta
from typing import Any, Final

from asyncua import ua
from asyncua.server.history import HistoryStorageInterface

#: values in one answer
MOST_IN_ANSWER: Final = 1000


class BoundedHistory(HistoryStorageInterface):
    """Keeps what :meth:`keep` gives, for ``seconds`` and ``most`` values at most; the oldest of all nodes goes first.

    ``dropped``: values that were younger than ``seconds`` when they went.
    """

    def __init__(self, seconds: float, most: int) -> None:
        super().__init__(MOST_IN_ANSWER)
        self.dropped = 0
        self._period = timedelta(seconds=seconds)
        self._most = most
        self._of: dict[ua.NodeId, deque[tuple[datetime, ua.DataValue]]] = {}
        #: time and node of each value, oldest first
        self._order: deque[tuple[datetime, ua.NodeId]] = deque()

    def __len__(self) -> int:
        return len(self._order)

    def keep(self, node: ua.NodeId, value: ua.DataValue, now: datetime) -> None:
        if self._most <= 0:
            return
        self._of.setdefault(node, deque()).append((value.SourceTimestamp or now, value))
        self._order.append((now, node))
        while self._order and self._order[0][0] < now - self._period:
            self._drop()
        while len(self._order) > self._most:
            self._drop()
            self.dropped += 1

    def clear(self) -> None:
        """Forget all, where the clock was set: times before and after do not fit together."""
        self._of.clear()
        self._order.clear()

    def _drop(self) -> None:
        _, node = self._order.popleft()
        values = self._of[node]
        values.popleft()
        if not values:
            del self._of[node]

    # --- of asyncua -----------------------------------------------------------------------------------------------

    async def init(self) -> None:
        """Nothing to do: the store is in memory."""

    async def stop(self) -> None:
        """Nothing to do: the store is in memory."""

    async def read_node_history(
        self, node_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int
    ) -> tuple[list[ua.DataValue], datetime | None]:
        """Raw values between ``start`` and ``end``, both of them included (Part 11, 6.4.3): backwards where ``start``
        is behind ``end`` or is not given. The second result is the time at which to go on, None where all was read."""
        first, last = (None if time in (None, ua.get_win_epoch()) else time for time in (start, end))
        backwards = first is None or (last is not None and first > last)
        low, high = (last, first) if backwards and first is not None else (first, last)
        found = [
            (time, value)
            for time, value in self._of.get(node_id, ())
            if (low is None or low <= time) and (high is None or time <= high)
        ]
        if backwards:
            found.reverse()
        most = min(nb_values or MOST_IN_ANSWER, MOST_IN_ANSWER)
        if len(found) <= most:
            return [value for _, value in found], None
        # values of one time are not torn apart, as the continuation is a time
        while most < len(found) and found[most][0] == found[most - 1][0]:
            most += 1
        # a continuation takes the place of `start`, so one that is backwards without a start cannot go on
        rest = found[most][0] if most < len(found) and first is not None else None
        return [value for _, value in found[:most]], rest

    async def new_historized_node(self, node_id: ua.NodeId, period: timedelta | None, count: int = 0) -> None:
        raise NotImplementedError("values come by keep()")

    async def save_node_value(self, node_id: ua.NodeId, datavalue: ua.DataValue) -> None:
        raise NotImplementedError("values come by keep()")

    async def new_historized_event(
        self, source_id: ua.NodeId, evtypes: list[Any], period: timedelta | None, count: int = 0
    ) -> None:
        raise NotImplementedError("events have no history")

    async def save_event(self, event: Any) -> None:
        raise NotImplementedError("events have no history")

    async def read_event_history(
        self, source_id: ua.NodeId, start: datetime | None, end: datetime | None, nb_values: int, evfilter: Any
    ) -> tuple[list[Any], datetime | None]:
        return [], None
