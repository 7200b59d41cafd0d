"""The transmissions of the bus that this program itself runs, from the tap of its own runtime.

The entries wait in a bounded queue and are cut in short steps, so that no cycle of the bus waits for them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from time import monotonic_ns
from typing import Final

from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.listen.tap_cutter import TapCutter
from dpstack.capture.listener import OnTransmission
from dpstack.capture.timing import TAP, LineTiming, timing_of
from dpstack.drivers.tap import CAPACITY, Tapped
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NS_PER_MS, NS_PER_US, ns_to_s

#: a step may delay the event loop by this time ...
_STEP_NS: Final = 200 * NS_PER_US
#: ... the next one comes after this one ...
_PAUSE_NS: Final = NS_PER_MS
#: ... and after this one if nothing waits
_IDLE_NS: Final = 20 * NS_PER_MS


class OwnTap:
    """Listens to the line of ``feed`` from :meth:`begin` to :meth:`end`.

    ``on_transmission`` gets each transmission, ``on_event`` :class:`~dpstack.api.listen.tap_cutter.OctetsLost` and what
    happens to the port. ``lost``: entries that were lost in all.
    """

    def __init__(
        self, feed: TapFeed, port: str, on_transmission: OnTransmission, on_event: Callable[[Event], None]
    ) -> None:
        self.lost = 0
        self.timing = LineTiming(TAP, None)
        self._feed = feed
        self._cutter = TapCutter(port, on_transmission, on_event)
        self._waiting: deque[Tapped | int | Callable[[], None]] = deque()  # entries, numbers of lost ones, descriptions
        self._missed = 0  # entries that found the queue full
        self._timer: asyncio.TimerHandle | None = None

    def begin(self) -> None:
        """Listen from now on."""
        self._feed.add_listener(self)
        self._set_timer(_IDLE_NS)

    def end(self) -> None:
        """Listen no longer; :meth:`rest` has the entries that wait."""
        if self._timer is None:
            return
        self._timer.cancel()
        self._timer = None
        self._feed.remove_listener(self)
        self._note_missed()

    def rest(self) -> None:
        """Cut everything that waits."""
        while self._waiting:
            self._take()
        self._cutter.give_up()

    # --- of the feed ---
    def describe(self, epoch_ns: int, about: Mapping[str, object]) -> None:
        baud = about["baud"]
        self.timing = timing_of(TAP, baud if isinstance(baud, int) else BAUD_RATES[0], exact=bool(about.get("exact")))
        self._waiting.append(lambda: self._cutter.begin(epoch_ns, "run"))

    def put(self, lost: int, entries: list[Tapped]) -> None:
        if len(self._waiting) + len(entries) > CAPACITY:
            self._missed += lost + len(entries)
            return
        self._missed += lost
        self._note_missed()
        self._waiting.extend(entries)

    # --- steps ---
    def _note_missed(self) -> None:
        if self._missed:
            self._waiting.append(self._missed)
            self._missed = 0

    def _set_timer(self, pause_ns: int) -> None:
        self._timer = asyncio.get_running_loop().call_later(ns_to_s(pause_ns), self._step)

    def _step(self) -> None:
        until = monotonic_ns() + _STEP_NS
        while self._waiting and monotonic_ns() < until:
            self._take()
        self._set_timer(_PAUSE_NS if self._waiting else _IDLE_NS)

    def _take(self) -> None:
        entry = self._waiting.popleft()
        if isinstance(entry, tuple):
            self._cutter.add(*entry)
        elif isinstance(entry, int):
            self.lost += entry
            self._cutter.lose(entry)
        else:
            entry()
