"""The class 3 master: sends the time of this computer to all stations by Time_Event and Clock_Value (DP-V2).

The time of a Time_Event is that of the end of the telegram; decisions: docs/reference/decisions/clock.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.pdu.clock import RESOLUTIONS_MS, ClockValue
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Req, Telegram
from dpstack.params import BROADCAST, BusParams
from dpstack.phy.patience import Patience
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S

#: a Time_Event is SD1
_EVENT_BITS: Final = 6 * BITS_PER_CHAR
#: in virtual time the clock begins here: 2026-01-01 00:00:00 UTC
VIRTUAL_EPOCH_NS: Final = 1_767_225_600 * NS_PER_S


def resolution_for(patience: Patience) -> int:
    """CR in ms: the smallest that holds the lateness of the port in 999 of 1000 cases.

    That is the slack of an address that never answered (:func:`dpstack.phy.patience.measured`).
    """
    late_ms = (patience.unknown_ns + patience.sending_ns) / NS_PER_MS
    return next((resolution for resolution in RESOLUTIONS_MS if resolution >= late_ms), RESOLUTIONS_MS[-1])


class ClockMaster(LinkUser):
    """Sends the time every ``interval_ns``: a Time_Event, then its Clock_Value in the same token hold if there is time.

    ``time_at``: ns since 1970 at a time of the station; ``is_synchronised``: whether that clock is kept right.
    """

    def __init__(
        self,
        params: BusParams,
        patience: Patience,
        interval_ns: int,
        time_at: Callable[[int], int],
        is_synchronised: Callable[[], bool],
    ) -> None:
        self._event_ns = params.ns(_EVENT_BITS)
        self._resolution_ms = resolution_for(patience)
        self._interval_ns = interval_ns
        self._time_at = time_at
        self._is_synchronised = is_synchronised
        self._due_at = 0
        self._event = Request(BROADCAST, Req.TIME_EVENT, answer=0)
        self._event_at: int | None = None  # end of the Time_Event whose Clock_Value is due
        self._previous: int | None = None
        #: Clock_Values sent
        self.sent = 0

    def next_request(self, now: int, high_only: bool) -> Request | None:
        if self._event_at is not None:
            return Request(BROADCAST, Req.CLOCK_VALUE, self._value(self._event_at), answer=0)
        return self._event if now >= self._due_at and not high_only else None

    def _value(self, event_at: int) -> bytes:
        return ClockValue(
            self._time_at(event_at),
            self._previous,
            resolution_ms=self._resolution_ms,
            synchronised=self._is_synchronised(),
        ).build()

    def started(self, request: Request, at: int) -> None:
        if request is self._event:
            self._event_at = at + self._event_ns

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        if isinstance(outcome, Failure):
            if request is self._event:
                self._event_at = None
            return
        event_at = self._event_at
        if request is self._event or event_at is None:
            return
        self._previous = self._time_at(event_at)
        self._event_at = None
        self._due_at = max((self._due_at or event_at) + self._interval_ns, now)
        self.sent += 1
