"""The past of each station, second by second and minute by minute, in a few numbers: bursts, failures at once, T_SDR.

Memory does not grow with time: counts of seconds by their number of failures, and the histogram of the running minute.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Final

from dpstack.monitor.counters import Counters, State, Station
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S

#: seconds with more failures count as seconds with this many
_MOST_FAILURES: Final = 100
#: answers in a minute that make a median
_ENOUGH_ANSWERS: Final = 100
_WINDOW_NS: Final = 60 * NS_PER_S


@dataclass(slots=True)
class Past:
    """One station. ``seconds``: in which it was asked; ``failing``: number of seconds by their failures; ``at_once``:
    failing seconds in which other stations failed too. ``first_tsdr``, ``last_tsdr``: medians in ns of the first and
    the last whole minute, None before. ``state_since``: ns since 1970."""

    seconds: int = 0
    failing: Counter[int] = field(default_factory=Counter)
    at_once: int = 0
    first_tsdr: int | None = None
    last_tsdr: int | None = None
    state: str = State.UNKNOWN
    state_since: int = 0
    _requests: int = 0
    _failures: int = 0
    _answers: int = 0
    _minute: dict[int, int] = field(default_factory=dict)

    @property
    def failing_seconds(self) -> int:
        return sum(self.failing.values())

    def in_bursts(self, share: float) -> bool:
        """Whether half of the failures fell into ``share`` of the seconds, or less; False for fewer than 4 failures."""
        wanted = sum(failures * count for failures, count in self.failing.items()) / 2
        if wanted < 2:
            return False
        seconds = 0.0
        for failures in sorted(self.failing, reverse=True):
            take = min(self.failing[failures], wanted / failures)
            seconds += take
            wanted -= take * failures
            if wanted <= 0:
                break
        return seconds <= share * self.seconds

    def failed(self, station: Station) -> int:
        """The failures since the last call; the second counts if the station was asked."""
        failures = station.damaged + station.no_answer
        new, self._failures = failures - self._failures, failures
        if station.requests != self._requests:
            self._requests = station.requests
            self.seconds += 1
        if new and station.state == State.DATA_EXCHANGE:
            self.failing[min(new, _MOST_FAILURES)] += 1
            return new
        return 0

    def end_minute(self, tsdr: Histogram) -> None:
        """Take the median of the answers since the last call."""
        count = tsdr.count - self._answers
        if count >= _ENOUGH_ANSWERS:
            before = self._minute
            buckets = {key: number - before.get(key, 0) for key, number in tsdr.buckets.items()}
            median = Histogram(count, tsdr.min_ns, tsdr.max_ns, buckets).quantile_ns(0.5)
            self.last_tsdr = median
            if self.first_tsdr is None:
                self.first_tsdr = median
        self._answers = tsdr.count
        self._minute = dict(tsdr.buckets)

    def forget_durations(self) -> None:
        """The minutes begin anew, with an empty histogram."""
        self.first_tsdr = self.last_tsdr = None
        self._answers = 0
        self._minute = {}


class History:
    """The past of the stations of ``counters``; :meth:`look` is called once in a second of bus time."""

    def __init__(self) -> None:
        self.stations: dict[int, Past] = {}
        #: seconds in which several stations failed, by their number
        self.at_once: Counter[int] = Counter()
        self._minute_at: int | None = None

    def of(self, address: int) -> Past:
        """The past of a station; an empty one for a station that was never asked."""
        return self.stations.get(address) or Past()

    def forget_durations(self) -> None:
        """The rate has changed: the first minute begins now."""
        self._minute_at = None
        for past in self.stations.values():
            past.forget_durations()

    def look(self, counters: Counters, now: int) -> list[Station]:
        """Take the counters at ``now`` (ns). Returns the stations whose state changed since the last time."""
        changed, failing = [], []
        for address, station in counters.stations.items():
            past = self.stations.get(address)
            if past is None:
                past = self.stations[address] = Past(state_since=now)
            if past.failed(station):
                failing.append(past)
            if past.state != station.state:
                past.state, past.state_since = station.state, now
                changed.append(station)
        if len(failing) > 1:
            self.at_once[len(failing)] += 1
            for past in failing:
                past.at_once += 1
        if self._minute_at is None:
            self._minute_at = now + _WINDOW_NS
        elif now >= self._minute_at:
            self._minute_at = now + _WINDOW_NS
            for address, past in self.stations.items():
                past.end_minute(counters.stations[address].answer_ns)
        return changed
