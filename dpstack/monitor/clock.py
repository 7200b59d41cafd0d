"""The time that a class 3 master sends, as it is heard: intervals, jitter, and what its Clock_Values say."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.pdu.clock import ClockValue
from dpstack.errors import PduError
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S

#: a Clock_Value belongs to a Time_Event that is not older than this
_BELONGS_NS: Final = NS_PER_S
#: longer pauses are no intervals: known devices want one a minute at least
_LONGEST_NS: Final = 900 * NS_PER_S


@dataclass(slots=True, eq=False)
class SentTime:
    """The time that one master sends.

    ``interval_ns``: from Time_Event to Time_Event. ``jitter_ns``: by how much the times of two Clock_Values differ
    otherwise than their Time_Events on the wire. ``values``: Clock_Values with their Time_Event; ``damaged``: others.
    """

    interval_ns: Histogram = field(default_factory=Histogram)
    jitter_ns: Histogram = field(default_factory=Histogram)
    values: int = 0
    damaged: int = 0
    value: ClockValue | None = None
    _event_at: int | None = None
    _value_at: int = 0  # end of the Time_Event of ``value``

    def event(self, end: int) -> None:
        """A Time_Event ended at ``end``."""
        before, self._event_at = self._event_at, end
        last = self._value_at if before is None else before
        if last and end - last < _LONGEST_NS:
            self.interval_ns.add(end - last)

    def clock_value(self, octets: bytes, end: int) -> None:
        """A Clock_Value ended at ``end``."""
        event_at, self._event_at = self._event_at, None
        try:
            value = ClockValue.parse(octets)
        except PduError:
            self.damaged += 1
            return
        if event_at is None or end - event_at > _BELONGS_NS:
            self.damaged += 1
            return
        self.values += 1
        before = self.value
        if before is not None and self._value_at and event_at - self._value_at < _LONGEST_NS:
            moved = value.time_ns - before.time_ns
            self.jitter_ns.add(abs(moved - (event_at - self._value_at)))
        self.value, self._value_at = value, event_at

    def forget_times(self) -> None:
        """Something was missed: no interval begins before it."""
        self._event_at = None
        self._value_at = 0
