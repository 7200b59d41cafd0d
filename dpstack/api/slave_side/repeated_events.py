"""Events of simulated slaves that repeat themselves: counted, and written at longer and longer intervals.

A master that tries a refused configuration again and again would fill screen and log with the same lines.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final

from msgspec import Struct

from dpstack.dp.slave.events import SlaveAppEvent
from dpstack.trace import Event
from dpstack.units import NS_PER_S

#: an event is passed on this many times before it is counted
_AT_ONCE: Final = 3
#: an event that did not come for this long is a new one, in ns
_FORGET_NS: Final = 10 * NS_PER_S
#: the first and the longest interval of reports, in s
_FIRST_S: Final = 1.0
_LONGEST_S: Final = 60.0


#: takes an event, and how many equal ones it stands for
PassOn = Callable[[Event, int], None]


def times_text(times: int) -> str:
    """The end of a line that stands for ``times`` lines."""
    return f" ({times} times since this line was written)" if times > 1 else ""


class _Seen(Struct):
    """``passed``: events passed on; ``held``: those that wait for the report, ``newest`` the last of them."""

    newest: Event
    passed: int = 0
    held: int = 0


class RepeatedEvents:
    """Passes events on; of equal ones of a slave only the first at once. The others are counted for a report.

    Reports come after 1, 2, 4 ... 60 s, after a pause from 1 s on again. They have the events in the order in which
    they came last. Events of scenarios and commands are always passed on. In a running event loop.
    """

    def __init__(self, pass_on: PassOn) -> None:
        self._pass_on = pass_on
        self._seen: dict[str, _Seen] = {}
        self._interval_s = _FIRST_S
        self._reported_ns = 0
        self._report: asyncio.TimerHandle | None = None

    def publish(self, event: Event) -> None:
        """Pass ``event`` on, or count it."""
        if not isinstance(event, SlaveAppEvent):
            self._pass_on(event, 1)
            return
        seen = self._seen.pop(event.text, None)
        if seen is None or (not seen.held and event.t_ns - seen.newest.t_ns > _FORGET_NS):
            seen = _Seen(event)
        self._seen[event.text] = seen  # in the order of the newest ones
        seen.newest = event
        if seen.passed < _AT_ONCE:
            seen.passed += 1
            self._pass_on(event, 1)
            return
        seen.held += 1
        if self._report is None:
            if event.t_ns - self._reported_ns > _FORGET_NS:
                self._interval_s = _FIRST_S
            self._report = asyncio.get_running_loop().call_later(self._interval_s, self.report)

    def report(self) -> None:
        """Pass on what was counted."""
        if self._report is None:
            return
        self._report.cancel()
        self._report = None
        held = [seen for seen in self._seen.values() if seen.held]
        self._reported_ns = newest_ns = max(seen.newest.t_ns for seen in held)
        for seen in held:
            self._pass_on(seen.newest, seen.held)
            seen.held = 0
        self._seen = {text: seen for text, seen in self._seen.items() if newest_ns - seen.newest.t_ns <= _FORGET_NS}
        self._interval_s = min(2 * self._interval_s, _LONGEST_S)
