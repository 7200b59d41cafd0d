"""The class 3 master, and other ones: the time of this computer for all stations by Time_Event and Clock_Value (DP-V2).

The time of a Time_Event is that of the end of the telegram; decisions: docs/reference/decisions/clock.md.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.clock import JUMP_NS, RESOLUTIONS_MS, ClockValue, Pairing, several_clocks
from dpstack.errors import PduError
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import Req, Telegram
from dpstack.params import BROADCAST, BusParams
from dpstack.phy.patience import Lateness
from dpstack.trace import Event, Notice, Severity
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S

#: a Time_Event is SD1
_EVENT_BITS: Final = 6 * BITS_PER_CHAR
#: in virtual time the clock begins here: 2026-01-01 00:00:00 UTC
VIRTUAL_EPOCH_NS: Final = 1_767_225_600 * NS_PER_S
#: layer of the notices
_SOURCE: Final = "clock"
#: a master that sent no time for longer than this sends none any more: known devices want it each 10 min at least
_SILENT_NS: Final = 900 * NS_PER_S


def resolution_for(lateness: Lateness) -> int:
    """CR in ms: the smallest that holds the lateness of the port in 999 of 1000 cases."""
    late_ms = lateness.p999_ns / NS_PER_MS
    return next((resolution for resolution in RESOLUTIONS_MS if resolution >= late_ms), RESOLUTIONS_MS[-1])


class ClockMaster(LinkUser):
    """Sends the time every ``interval_ns``: a Time_Event, then its Clock_Value in the same token hold if there is time.

    ``time_at``: ns since 1970 at a time of the station; ``is_synchronised``: whether that clock is kept right;
    ``lateness``: that of the port, which the resolution holds. While the clock has a year that a Clock_Value cannot
    say, nothing is sent.
    """

    def __init__(
        self,
        params: BusParams,
        interval_ns: int,
        time_at: Callable[[int], int],
        is_synchronised: Callable[[], bool],
        lateness: Callable[[], Lateness],
    ) -> None:
        self._event_ns = params.ns(_EVENT_BITS)
        #: interval in ns in which the time is sent
        self.interval_ns = interval_ns
        self._time_at = time_at
        self._is_synchronised = is_synchronised
        self._lateness = lateness
        self._due_at = 0
        self._event = Request(BROADCAST, Req.TIME_EVENT, answer=0)
        self._event_at: int | None = None  # end of the Time_Event whose Clock_Value is due
        self._value: ClockValue | None = None  # in the Clock_Value that is sent now
        #: lateness of the port that the resolution in the last Clock_Value holds
        self.held = Lateness()
        #: the last Clock_Value sent, and the end of its Time_Event
        self.last: tuple[ClockValue, int] | None = None
        #: Clock_Values sent
        self.sent = 0
        #: why no time is sent although it is due; empty: it is sent
        self.trouble = ""
        self.events: list[Event] = []

    def next_request(self, now: int, high_only: bool) -> Request | None:
        event_at = self._event_at
        if event_at is not None:
            octets = self._octets(event_at)
            if octets is not None:
                return Request(BROADCAST, Req.CLOCK_VALUE, octets, answer=0)
            self._event_at = None
        if now < self._due_at or high_only:
            return None
        if self._octets(now) is None:
            self._due_at = now + self.interval_ns
            return None
        return self._event

    def _octets(self, event_at: int) -> bytes | None:
        """The Clock_Value of a Time_Event that ended at ``event_at``; None if it cannot say that year."""
        held = self._lateness()
        value = ClockValue(
            self._time_at(event_at),
            None if self.last is None else self.last[0].time_ns,
            resolution_ms=resolution_for(held),
            synchronised=self._is_synchronised(),
        )
        try:
            octets = value.build()
        except PduError as error:
            self._refuse(str(error), event_at)
            return None
        self._value, self.held, self.trouble = value, held, ""
        return octets

    def _refuse(self, why: str, now: int) -> None:
        if not self.trouble:
            self.trouble = f"the time is not sent while the clock of this computer is wrong: {why}; set it"
            self.events.append(Notice(t_ns=now, source=_SOURCE, message=self.trouble, severity=Severity.WARNING))

    def started(self, request: Request, at: int) -> None:
        if request is self._event:
            self._event_at = at + self._event_ns

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        if isinstance(outcome, Failure):
            if request is self._event:
                self._event_at = None
            return
        event_at, value = self._event_at, self._value
        if request is self._event or event_at is None or value is None:
            return
        self._watch_jumps(value, event_at, now)
        self.last = value, event_at
        self._event_at = None
        due_at = self._due_at or event_at
        # times that were missed, as during a stall, are left out: devices accept certain intervals only
        self._due_at = due_at + (max(0, now - due_at) // self.interval_ns + 1) * self.interval_ns
        self.sent += 1

    def _watch_jumps(self, value: ClockValue, event_at: int, now: int) -> None:
        if self.last is None:
            return
        before, before_at = self.last
        moved = value.time_ns - before.time_ns - (event_at - before_at)
        if abs(moved) > JUMP_NS:
            message = (
                f"the clock of this computer was set by {moved / NS_PER_S:+.3f} s, and all devices that follow it with "
                "it: their time stamps before and after that do not fit together"
            )
            self.events.append(Notice(t_ns=now, source=_SOURCE, message=message, severity=Severity.WARNING))

    def take_events(self) -> list[Event]:
        taken = self.events.copy()
        self.events.clear()
        return taken


class HeardClock(Struct):
    """The time that another master sends: its last Clock_Value, its end (time of the station), their number."""

    value: ClockValue
    heard_at: int
    values: int = 1


class HeardClocks:
    """The other class 3 masters of the bus, by address. ``emit`` gets an event for each new one; ``sends``: whether
    this master sends the time, too.

    A master that sent no time for a quarter of an hour is forgotten.
    """

    def __init__(self, emit: Callable[[Event], None], *, sends: bool) -> None:
        self._emit = emit
        self._sends = sends
        self._pairing = Pairing()
        self.masters: dict[int, HeardClock] = {}

    def hear(self, telegram: Telegram, now: int) -> None:
        """A Time_Event or Clock_Value of another master; its last bit was on the line at ``now``."""
        sender = telegram.sa
        if not telegram.is_clock_value:
            self._pairing.event(sender, now)
            return
        if self._pairing.event_of(sender, now) is None:
            return
        try:
            value = ClockValue.parse(telegram.data)
        except PduError:
            return
        self.forget_silent(now)
        before = self.masters.get(sender)
        self.masters[sender] = HeardClock(value, now, 1 if before is None else before.values + 1)
        if before is None:
            self._report(sender, now)

    def forget_silent(self, now: int) -> None:
        """Forget masters that send no time any more."""
        for address in [one for one, heard in self.masters.items() if now - heard.heard_at > _SILENT_NS]:
            del self.masters[address]

    def _report(self, sender: int, now: int) -> None:
        others = [f"master {one}" for one in sorted(self.masters) if one != sender] + ["this master"] * self._sends
        name, severity = f"master {sender}", Severity.WARNING if others else Severity.INFO
        message = several_clocks([name, *others]) if others else f"{name} sends the time"
        self._emit(Notice(t_ns=now, source=_SOURCE, message=message, severity=severity))
