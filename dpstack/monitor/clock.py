"""The time that a class 3 master sends, as it is heard: intervals, jitter, and what its Clock_Values say."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.pdu.clock import BELONGS_NS, JUMP_NS, ClockValue
from dpstack.errors import PduError
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S

#: longer pauses are no intervals: known devices want one a minute at least
_LONGEST_NS: Final = 900 * NS_PER_S


@dataclass(slots=True, eq=False)
class SentTime:
    """The time that one master sends.

    ``interval_ns``: from Time_Event to Time_Event. ``jitter_ns``: by how much the times of two Clock_Values differ
    otherwise than their Time_Events on the wire; a difference beyond a second is a jump: ``jumps`` of them, the last by
    ``jump_ns``. ``values``: Clock_Values with their Time_Event; ``damaged``: others.
    """

    interval_ns: Histogram = field(default_factory=Histogram)
    jitter_ns: Histogram = field(default_factory=Histogram)
    values: int = 0
    damaged: int = 0
    jumps: int = 0
    jump_ns: int = 0
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
        if event_at is None or end - event_at > BELONGS_NS:
            self.damaged += 1
            return
        self.values += 1
        before = self.value
        if before is not None and self._value_at and event_at - self._value_at < _LONGEST_NS:
            moved = value.time_ns - before.time_ns - (event_at - self._value_at)
            if abs(moved) > JUMP_NS:
                self.jumps += 1
                self.jump_ns = moved
            else:
                self.jitter_ns.add(abs(moved))
        self.value, self._value_at = value, event_at

    def forget_times(self) -> None:
        """Something was missed: no interval begins before it."""
        self._event_at = None
        self._value_at = 0
