"""History of values for OPC UA: those of the last hour, with one bound over all values."""

from __future__ import annotations

import struct
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any, Final, NamedTuple

from asyncua import ua
from asyncua.server.history import HistoryManager
from asyncua.server.internal_server import InternalServer

#: values in one answer
MOST_IN_ANSWER: Final = 1000
#: number of the value with which a client goes on
_POINT: Final = struct.Struct("<q")
_S: Final = ua.StatusCodes


class _Kept(NamedTuple):
    number: int
    time: datetime
    value: ua.DataValue


class BoundedHistory:
    """Keeps what :meth:`keep` gives, for ``seconds`` and ``most`` values at most; the oldest of all nodes goes first.

    ``dropped``: values that were younger than ``seconds`` when they went.
    """

    def __init__(self, seconds: float, most: int) -> None:
        self.dropped = 0
        self._period = timedelta(seconds=seconds)
        self._most = most
        self._number = 0
        self._of: dict[ua.NodeId, deque[_Kept]] = {}
        #: time and node of each value, oldest first
        self._order: deque[tuple[datetime, ua.NodeId]] = deque()

    def __len__(self) -> int:
        return len(self._order)

    def keep(self, node: ua.NodeId, value: ua.DataValue, now: datetime, *, is_old: bool = False) -> None:
        """Keep a value with its source time. One that has become stale (``is_old``) is kept with the time at which that
        was found, ``now``. The same value comes once."""
        if self._most <= 0:
            return
        values = self._of.get(node)
        good = value.StatusCode is None or value.StatusCode.value == _S.Good
        time = now if is_old or value.SourceTimestamp is None else value.SourceTimestamp
        if values:
            last = values[-1].value
            same = last.Value == value.Value and last.StatusCode == value.StatusCode
            if same and (not good or last.SourceTimestamp == time):
                return
            time = max(time, values[-1].time)
        else:
            values = self._of[node] = deque()
        self._number += 1
        kept = ua.DataValue(value.Value, value.StatusCode, time, value.ServerTimestamp)
        values.append(_Kept(self._number, time, kept))
        self._order.append((now, node))
        while self._order and self._order[0][0] < now - self._period:
            self._drop()
        while len(self._order) > self._most:
            self._drop()
            self.dropped += 1

    def clear(self) -> None:
        """Forget all, if the clock was set: times before and after do not fit together."""
        self._of.clear()
        self._order.clear()

    def _drop(self) -> None:
        _, node = self._order.popleft()
        values = self._of[node]
        values.popleft()
        if not values:
            del self._of[node]

    def read(
        self, node: ua.NodeId, start: datetime | None, end: datetime | None, most: int = 0, *,
        bounds: bool = False, point: int | None = None,
    ) -> tuple[list[ua.DataValue], int | None]:  # fmt: skip
        """Raw values between ``start`` and ``end``, both of them included (Part 11, 6.4.3): backwards if ``start``
        is behind ``end`` or is not given. ``most``: 0: as many as fit in an answer. ``bounds``: the values right before
        and behind, too. The second result is the ``point`` at which to go on, None if all was read."""
        backwards = start is None or (end is not None and start > end)
        low, high = (end, start) if backwards and start is not None else (start, end)
        values: Sequence[_Kept] = self._of.get(node) or ()
        # found by halves: a walk through all of them would hold up the loop for 40 ms
        first = 0 if low is None else bisect_left(values, low, key=_time)
        last = len(values) if high is None else bisect_right(values, high, key=_time)
        before: list[_Kept] = []
        behind: list[_Kept] = []
        if bounds and low is not None and not (first < last and values[first].time == low):
            before = [values[first - 1] if first else _no_bound(-1, low)]
        if bounds and high is not None and not (first < last and values[last - 1].time == high):
            behind = [values[last] if last < len(values) else _no_bound((1 << 63) - 1, high)]
        if point is not None and backwards:
            last, behind = min(last, bisect_right(values, point, key=_number)), []
        elif point is not None:
            first, before = max(first, bisect_left(values, point, key=_number)), []
        most = min(most or MOST_IN_ANSWER, MOST_IN_ANSWER)
        places = range(last - 1, first - 1, -1) if backwards else range(first, last)
        within = [values[at] for at in places[: most + 1]]
        found = [*behind, *within, *before] if backwards else [*before, *within, *behind]
        rest = found[most].number if most < len(found) else None
        return [one.value for one in found[:most]], rest


def _time(kept: _Kept) -> datetime:
    return kept.time


def _number(kept: _Kept) -> int:
    return kept.number


def _no_bound(number: int, time: datetime) -> _Kept:
    value = ua.DataValue(ua.Variant(), ua.StatusCode(_S.BadBoundNotFound), time, time)
    return _Kept(number, time, value)


class PlantHistory(HistoryManager):
    """HistoryRead of raw values. asyncua ignores bounds, and goes on by a time, which several values may have."""

    def __init__(self, server: InternalServer, values: BoundedHistory) -> None:
        super().__init__(server)
        self.values = values

    async def init(self) -> None:
        """Nothing to do: the store is in memory."""

    async def stop(self) -> None:
        """Nothing to do: the store is in memory."""

    async def read_history(self, params: ua.HistoryReadParameters) -> list[ua.HistoryReadResult]:
        if params.ReleaseContinuationPoints:
            return [ua.HistoryReadResult() for _ in params.NodesToRead]
        return [self._read_one(params.HistoryReadDetails, one) for one in params.NodesToRead]

    def _read_one(self, details: Any, wanted: ua.HistoryReadValueId) -> ua.HistoryReadResult:
        result = ua.HistoryReadResult()
        result.HistoryData = ua.HistoryData()
        if wanted.NodeId not in self.iserver.aspace:
            result.StatusCode = ua.StatusCode(_S.BadNodeIdUnknown)
            return result
        access = self.iserver.aspace.read_attribute_value(wanted.NodeId, ua.AttributeIds.Historizing)
        has_history = access.Value is not None and access.Value.Value is True
        raw = isinstance(details, ua.ReadRawModifiedDetails) and not details.IsReadModified
        if not (has_history and raw) or wanted.IndexRange:
            result.StatusCode = ua.StatusCode(_S.BadHistoryOperationUnsupported)
            return result
        start, end = _given(details.StartTime), _given(details.EndTime)
        most, point = details.NumValuesPerNode, None
        if wanted.ContinuationPoint:
            if len(wanted.ContinuationPoint) != _POINT.size:
                result.StatusCode = ua.StatusCode(_S.BadContinuationPointInvalid)
                return result
            (point,) = _POINT.unpack(wanted.ContinuationPoint)
        found, rest = self.values.read(wanted.NodeId, start, end, most, bounds=details.ReturnBounds, point=point)
        result.HistoryData.DataValues = found
        result.ContinuationPoint = None if rest is None else _POINT.pack(rest)
        if not found:
            result.StatusCode = ua.StatusCode(_S.GoodNoData)
        return result


def _given(time: datetime | None) -> datetime | None:
    return None if time is None or time == ua.get_win_epoch() else time
