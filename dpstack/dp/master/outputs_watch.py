"""Reasons for Clear without an order: auto-clear, the stall rule (``after_stall``), the application watchdog; and the
time without a token after which all slaves count as lost.

A stall is a time without requests to a slave that is longer than its watchdog. The slave has made its outputs safe, and
the master must not send the old outputs again without an order. The master calls :meth:`OutputsWatch.look` before each
request.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dpstack.dp.master.events import ApplicationSilent, AutoCleared, Blocked, ForcedClear, SlaveState, Stalled
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.master.slave_handler import AWAY, SlaveHandler
from dpstack.machine import HeldUp
from dpstack.params import BusParams
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, ms_text


class AutoClear:
    """Auto-clear (docs/reference/protocol.md#auto-clear): Error_Action_Flag, Data_Control_Time, Ignore_Aclr of each
    slave.

    If it is not enabled, no slave is late or missing.
    """

    def __init__(self, settings: MasterSettings, handlers: Mapping[int, SlaveHandler]) -> None:
        self.enabled = settings.auto_clear
        #: the Data_Control_Time
        self.time_ns = settings.data_control_ns
        self._handlers = handlers
        self._began = 0
        self._due = 0

    def began(self, now: int) -> None:
        """Start the time, because the master reached Operate."""
        self._began = now
        self._due = now + self.time_ns

    def late(self, now: int) -> AutoCleared | None:
        """The event that ends Operate, if slaves had no good exchange for the Data_Control_Time.

        After each check, the next one comes when the first slave can be late.
        """
        if not self.enabled or now < self._due:
            return None
        ages = [(max(h.image.input_time, self._began), h) for h in self._counted()]
        self._due = min((at for at, _ in ages), default=now) + self.time_ns
        late = [h for at, h in ages if now - at >= self.time_ns]
        if not late:
            return None
        reasons = tuple(
            f"{h.setup.who} had no data exchange for {self.time_ns // NS_PER_MS} ms ({h.why_not_exchanging})"
            for h in late
        )
        return AutoCleared(t_ns=now, slaves=tuple(h.setup.address for h in late), reasons=reasons)

    def missing(self) -> list[SlaveHandler]:
        """The slaves that keep the master from Operate, because they are not in data exchange."""
        return [h for h in self._counted() if h.state is not SlaveState.DATA_EXCHANGE] if self.enabled else []

    def _counted(self) -> list[SlaveHandler]:
        handlers = self._handlers.values()
        return [h for h in handlers if h.state is not SlaveState.DEACTIVATED and not h.setup.ignore_auto_clear]


#: number of slaves from which on "all slaves" is no coincidence: a single one may have been switched off and on
_ALL: Final = 2


#: the obstacle that kept the master from asking, and its text; None and "" if it is not known
Obstacle = tuple[Blocked | None, str]


class OutputsWatch:
    """Watches ``handlers`` while the master is in Operate, or on its way there; ``force_clear`` ends that."""

    def __init__(
        self,
        settings: MasterSettings,
        handlers: Mapping[int, SlaveHandler],
        force_clear: Callable[[ForcedClear, int], None],
    ) -> None:
        self._settings = settings
        self._handlers = handlers
        self._force_clear = force_clear
        #: before this time (ns) :meth:`look` finds nothing
        self.look_at = NEVER
        #: the last request was made before the master went to Clear
        self.outdated = False
        #: when the application watchdog runs out in ns, NEVER while it is off
        self.alive_until = NEVER
        self._limit_ns = 0
        self._watching = False
        self._held: HeldUp | None = None  # the longest one since the last look
        #: slaves that lost data exchange with the line; the master takes each out at its next request to it
        self.down: dict[SlaveHandler, Obstacle] = {}
        self._token_at = self._token_gap = 0

    # --- what happens -------------------------------------------------------------------------------------------

    def begin(self, now: int) -> None:
        """Begin to watch, because Operate was ordered."""
        for handler in self._handlers.values():
            handler.operate_ordered(now)
        self.down.clear()
        self._watching = True
        self._limit_ns = self._settings.application_watchdog_ns
        self.alive_until = now + self._limit_ns if self._limit_ns else NEVER
        self.look_soon()

    def end(self) -> None:
        """Stop watching, because another mode was ordered."""
        self._watching = False
        self.alive_until = self.look_at = NEVER
        self.down.clear()

    def alive(self, now: int, limit_ns: int | None = None) -> None:
        """Restart the application watchdog, unless it has run out or is off. ``limit_ns``: as of ``Alive``."""
        if limit_ns is None:
            if now < self.alive_until != NEVER:
                self.alive_until = now + self._limit_ns
        elif self._watching and not self._settings.application_watchdog_ns:
            self._limit_ns = limit_ns
            self.alive_until = now + limit_ns if limit_ns else NEVER
            self.look_at = min(self.look_at, self.alive_until)

    def look_soon(self) -> None:
        """Look before the next request, because the state of a slave changed."""
        if self._watching:
            self.look_at = 0

    def token(self, now: int) -> None:
        """A token hold begins."""
        self._token_gap = now - self._token_at
        self._token_at = now

    def held_up(self, gap: HeldUp, now: int) -> None:
        """The driver reports a time in which it did not run the master."""
        for handler in self._handlers.values():
            if gap.suspended:  # the clock does not show it
                handler.asked_at -= gap.for_ns
            elif gap.unsent:
                self._unsent(handler, gap, now)
            handler.not_asked(now)
        if gap.suspended and self.alive_until != NEVER:
            self.alive_until -= gap.for_ns
        if self._held is None or gap.for_ns > self._held.for_ns:
            self._held = gap
        self.look_soon()

    def _unsent(self, handler: SlaveHandler, gap: HeldUp, now: int) -> None:
        """No request to the slave left the port. It counts as lost with the line if it was lost meanwhile."""
        begin = now - gap.for_ns
        exchanged = handler.state is SlaveState.DATA_EXCHANGE
        lost = handler.state is SlaveState.OFFLINE and handler.since >= begin and handler.image.input_time
        if self._watching and (exchanged or lost):
            handler.asked_at = min(handler.asked_at, begin)
            if lost:
                self.down.setdefault(handler, (Blocked.PORT, gap.what))

    def line_lost(self, reason: str, *, port: bool) -> None:
        """The port (``port``) or the token is lost. Call this before :meth:`SlaveHandler.line_lost`, by which
        the slaves leave data exchange."""
        if self._watching:
            for handler in self._handlers.values():
                if handler.state is SlaveState.DATA_EXCHANGE:
                    self.down.setdefault(handler, (Blocked.PORT if port else Blocked.TOKEN, reason))
            self.look_soon()

    def still_fresh(self, now: int) -> bool:
        """Whether the last request may still be sent, or repeated."""
        if now >= self.look_at:
            self.look(now)
        return not self.outdated

    # --- judging ------------------------------------------------------------------------------------------------

    def look(self, now: int) -> None:
        """Force the master to Clear if the outputs are too old to be sent; moves :attr:`look_at`."""
        self.look_at = self.alive_until
        if not self._watching:
            return
        asking = self._all_want_parameters(now)
        for handler in asking:
            handler.not_asked(now)
        found: ForcedClear | None = self._stalled(asking, now) if self._settings.safe_after_stall else None
        if found is not None or not self.down:
            self._held = None
        if found is None and now >= self.alive_until:
            found = ApplicationSilent(t_ns=now, limit_ns=self._limit_ns)
        if found is not None:
            self._force_clear(found, now)

    def _stalled(self, asking: list[SlaveHandler], now: int) -> Stalled | None:
        overdue = []
        for handler in self._handlers.values():
            watchdog = handler.watchdog_effective_ns
            if watchdog and (handler.state is SlaveState.DATA_EXCHANGE or handler in self.down):
                if now - handler.asked_at > watchdog:
                    overdue.append(handler)
                    handler.not_asked(now)
                else:
                    self.look_at = min(self.look_at, handler.asked_at + watchdog + 1)
        if overdue:
            worst = max(overdue, key=lambda handler: now - handler.asked_at)
            gap = now - worst.asked_at
            blocked, text = self._find_obstacle(worst, gap)
            slaves = tuple(sorted(handler.setup.address for handler in overdue))
            why = (
                f"{worst.setup.who} was not asked for {ms_text(gap)}, "
                f"longer than its watchdog of {ms_text(worst.watchdog_effective_ns)}"
            )
            reason = f"{why}: {text}" if text else why
            return Stalled(t_ns=now, gap_ns=gap, slaves=slaves, blocked=blocked, reason=reason)
        if not asking:
            return None
        slaves = tuple(sorted(handler.setup.address for handler in asking))
        why = "all slaves with a watchdog want parameters (Prm_Req) at once, as after a time in which nobody asked them"
        return Stalled(t_ns=now, gap_ns=None, slaves=slaves, blocked=None, reason=why)

    def _find_obstacle(self, handler: SlaveHandler, gap: int) -> Obstacle:
        """The cause of most of the time ``gap`` without requests to the slave of ``handler``."""
        held = self._held
        if held is not None and 2 * held.for_ns >= gap:
            running = Blocked.PORT if held.unsent else Blocked.PROGRAM
            return Blocked.SUSPENDED if held.suspended else running, held.what
        if handler in self.down:
            return self.down[handler]
        if 2 * self._token_gap >= gap:
            return Blocked.TOKEN, f"the token did not come for {ms_text(self._token_gap)}"
        return None, ""

    def _all_want_parameters(self, now: int) -> list[SlaveHandler]:
        """All slaves, after a stall that no clock shows: their watchdogs ran out at the same moment. Else none.

        A single slave may have been restarted.
        """
        present = [h for h in self._handlers.values() if h.watchdog_effective_ns and h.state not in AWAY]
        times = [handler.prm_req_at for handler in present]
        if len(present) < _ALL or NEVER in times:
            return []
        if max(times) - min(times) > min(handler.watchdog_effective_ns for handler in present):
            return []
        return present


#: after T_TR and this time without a token no slave can be in data exchange; an ordered end waits for this time only
_SILENCE: Final = NS_PER_S


class TokenAge:
    """Time since the last token. ``watch_at``: the next time in ns for :meth:`too_old`, which moves it on; or NEVER."""

    def __init__(self, params: BusParams) -> None:
        #: first bit of the last request in ns: a request shows that the station holds the token
        self.sent_at = 0
        self.watch_at = NEVER
        self._at = NEVER
        self._since = 0
        self._held_ns = 0  # times without a run of this station since the last token
        # at 9.6 kbit/s one rotation may rightly take T_TR = 5 s
        self._limit = _SILENCE + params.ns(params.t_tr)

    @property
    def known(self) -> bool:
        """Whether there was a token that is not lost."""
        return self._at != NEVER

    def received(self, now: int) -> None:
        """A token hold begins."""
        self._at = now
        self._held_ns = 0
        if self.watch_at == NEVER:
            self.watch_at = self._quiet_at()

    def ending(self, now: int) -> None:
        """Shorten the limit, because the end of the master was ordered."""
        self._limit = _SILENCE
        self._since = now
        self.watch_at = self._quiet_at()

    def held_up(self, for_ns: int) -> None:
        """Leave out ``for_ns``, in which the driver did not run this station: it could receive no token."""
        self._held_ns += for_ns

    def lost(self) -> None:
        """The token is lost, or the master needs none any more."""
        self._at = self.watch_at = NEVER

    def too_old(self, now: int, asked_at: int) -> bool:
        """Whether the present silence is too long. ``asked_at``: first bit of the last
        Data_Exchange."""
        self.sent_at = max(self.sent_at, asked_at)
        quiet_at = self._quiet_at()
        if now < quiet_at:
            self.watch_at = quiet_at
            return False
        return True

    def _quiet_at(self) -> int:
        if self._at == NEVER:
            return NEVER
        return max(self._at, self.sent_at, self._since) + self._held_ns + self._limit
