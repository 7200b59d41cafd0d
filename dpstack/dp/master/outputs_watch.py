"""When the master goes to Clear by itself: auto-clear, the stall rule (``after_stall``), the application watchdog; and
when it takes its slaves for lost, because it has no token.

A stall is a time in which a slave was not asked for longer than its watchdog: the slave has taken its outputs back, and
must not be given the old ones again without an order. The master calls :meth:`OutputsWatch.look` before it sends
anything.
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
    """Auto-clear (docs/protocol.md#auto-clear): Error_Action_Flag, Data_Control_Time, Ignore_Aclr of each slave.

    Without it no slave is ever late or missing.
    """

    def __init__(self, settings: MasterSettings, handlers: Mapping[int, SlaveHandler]) -> None:
        self.enabled = settings.auto_clear
        #: the Data_Control_Time
        self.time_ns = settings.data_control_ns
        self._handlers = handlers
        self._began = 0
        self._due = 0

    def began(self, now: int) -> None:
        """Operate was reached: the time runs from here."""
        self._began = now
        self._due = now + self.time_ns

    def late(self, now: int) -> AutoCleared | None:
        """The end of Operate where slaves had no good exchange for the Data_Control_Time.

        The slaves are looked at again when one of them can be late.
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


#: so many slaves at least are "all": one alone may have been switched off and on
_ALL: Final = 2


#: what kept the master from asking, and that for people; None and "" where it is not known
Block = tuple[Blocked | None, str]


class OutputsWatch:
    """Watches ``handlers`` while the master is in Operate, or on its way there. ``force_clear`` takes it to Clear.

    ``look_at``: before this time (ns) :meth:`look` finds nothing.
    """

    def __init__(
        self,
        settings: MasterSettings,
        handlers: Mapping[int, SlaveHandler],
        force_clear: Callable[[ForcedClear, int], None],
    ) -> None:
        self.look_at = NEVER
        #: the request made last is from before the master was taken to Clear
        self.outdated = False
        self._force_clear = force_clear
        #: when the application watchdog runs out in ns, NEVER while it is off
        self.alive_until = NEVER
        self._handlers = handlers
        self._settings = settings
        self._watching = False
        self._held: HeldUp | None = None  # the longest that the driver reported since the last look
        #: slaves that lost data exchange with the line; the master takes each out at its next request to it
        self.down: dict[SlaveHandler, Block] = {}
        self._token_at = 0
        self._token_gap = 0

    # --- what happens -------------------------------------------------------------------------------------------

    def begin(self, now: int) -> None:
        """Operate was ordered: the times count from here."""
        for handler in self._handlers.values():
            handler.asked_at = max(handler.asked_at, now)
        self.down.clear()
        self._watching = True
        limit_ns = self._settings.application_watchdog_ns
        self.alive_until = now + limit_ns if limit_ns else NEVER
        self.look_soon()

    def end(self) -> None:
        """Another mode was ordered: there are no outputs to watch."""
        self._watching = False
        self.alive_until = self.look_at = NEVER
        self.down.clear()

    def alive(self, now: int) -> None:
        """The application is alive. Changes nothing where the watchdog has run out, or is off."""
        if now < self.alive_until != NEVER:
            self.alive_until = now + self._settings.application_watchdog_ns

    def look_soon(self) -> None:
        """Something changed: look before the next request."""
        if self._watching:
            self.look_at = 0

    def token(self, now: int) -> None:
        """A token hold begins."""
        self._token_gap = now - self._token_at
        self._token_at = now

    def held_up(self, gap: HeldUp) -> None:
        """The driver did not run the machine for a while."""
        if gap.suspended:  # the clock does not show it
            for handler in self._handlers.values():
                handler.asked_at -= gap.for_ns
            if self.alive_until != NEVER:
                self.alive_until -= gap.for_ns
        if self._held is None or gap.for_ns > self._held.for_ns:
            self._held = gap
        self.look_soon()

    def line_lost(self, reason: str, *, port: bool) -> None:
        """Nothing can be sent any more: the port (``port``) or the token is lost. To be called before the handlers
        are told, because they leave data exchange by it."""
        if self._watching:
            for handler in self._handlers.values():
                if handler.state is SlaveState.DATA_EXCHANGE:
                    self.down.setdefault(handler, (Blocked.PORT if port else Blocked.TOKEN, reason))
            self.look_soon()

    def still_fresh(self, now: int) -> bool:
        """Whether the request made last may still be sent, or sent again."""
        if now >= self.look_at:
            self.look(now)
        return not self.outdated

    # --- judging ------------------------------------------------------------------------------------------------

    def look(self, now: int) -> None:
        """Force the master to Clear where the outputs are too old to be sent; moves :attr:`look_at`."""
        self.look_at = self.alive_until
        if not self._watching:
            return
        found: ForcedClear | None = self._stalled(now) if self._settings.safe_after_stall else None
        if found is not None or not self.down:
            self._held = None
        if found is None and now >= self.alive_until:
            found = ApplicationSilent(t_ns=now, limit_ns=self._settings.application_watchdog_ns)
        if found is not None:
            self._force_clear(found, now)

    def _stalled(self, now: int) -> Stalled | None:
        overdue = []
        for handler in self._handlers.values():
            watchdog = handler.watchdog_effective_ns
            if watchdog and (handler.state is SlaveState.DATA_EXCHANGE or handler in self.down):
                if now - handler.asked_at > watchdog:
                    overdue.append(handler)
                else:
                    self.look_at = min(self.look_at, handler.asked_at + watchdog + 1)
        if overdue:
            worst = max(overdue, key=lambda handler: now - handler.asked_at)
            gap = now - worst.asked_at
            blocked, text = self._find_block(worst, gap)
            slaves = tuple(sorted(handler.setup.address for handler in overdue))
            why = (
                f"{worst.setup.who} was not asked for {ms_text(gap)}, "
                f"longer than its watchdog of {ms_text(worst.watchdog_effective_ns)}"
            )
            reason = f"{why}: {text}" if text else why
            return Stalled(t_ns=now, gap_ns=gap, slaves=slaves, blocked=blocked, reason=reason)
        return self._all_want_parameters(now)

    def _find_block(self, handler: SlaveHandler, gap: int) -> Block:
        """What took most of the time ``gap`` in which ``handler`` was not asked."""
        held = self._held
        if held is not None and 2 * held.for_ns >= gap:
            return Blocked.SUSPENDED if held.suspended else Blocked.PROGRAM, held.what
        if handler in self.down:
            return self.down[handler]
        if 2 * self._token_gap >= gap:
            return Blocked.TOKEN, f"the token did not come for {ms_text(self._token_gap)}"
        return None, ""

    def _all_want_parameters(self, now: int) -> Stalled | None:
        """No gap was seen, but the watchdogs of all slaves ran out in the same moment: a clock that stood still.

        One slave alone is its own restart.
        """
        present = [h for h in self._handlers.values() if h.watchdog_effective_ns and h.state not in AWAY]
        times = [handler.prm_req_at for handler in present]
        if len(present) < _ALL or NEVER in times:
            return None
        if max(times) - min(times) > min(handler.watchdog_effective_ns for handler in present):
            return None
        slaves = tuple(sorted(handler.setup.address for handler in present))
        why = "all slaves with a watchdog want parameters (Prm_Req) at once, as after a time in which nobody asked them"
        return Stalled(t_ns=now, gap_ns=None, slaves=slaves, blocked=None, reason=why)


#: without a token for T_TR and so long nobody can be in data exchange any more; an ordered end waits only so long
_SILENCE: Final = NS_PER_S


class TokenAge:
    """``watch_at``: when :meth:`too_old` is to be asked, in ns, or NEVER. It is moved on only there."""

    def __init__(self, params: BusParams) -> None:
        #: first bit of the last request: what is sent after a token is its sign of life
        self.sent_at = 0
        self.watch_at = NEVER
        self._at = NEVER
        self._since = 0
        self._held_ns = 0  # nobody ran this station for so long since the last token
        # at 9.6 kbit/s one rotation may rightly take T_TR = 5 s
        self._limit = _SILENCE + params.ns(params.t_tr)

    @property
    def known(self) -> bool:
        """There was a token, and it is not known to be lost."""
        return self._at != NEVER

    def received(self, now: int) -> None:
        """A token hold begins."""
        self._at = now
        self._held_ns = 0
        if self.watch_at == NEVER:
            self.watch_at = self._quiet_at()

    def ending(self, now: int) -> None:
        """The end was ordered: it is not waited for as long as otherwise."""
        self._limit = _SILENCE
        self._since = now
        self.watch_at = self._quiet_at()

    def held_up(self, for_ns: int) -> None:
        """Nobody ran this station for so long: it could take no token in that time, which does not count therefore."""
        self._held_ns += for_ns

    def lost(self) -> None:
        """No token, or none is needed any more."""
        self._at = self.watch_at = NEVER

    def too_old(self, now: int) -> bool:
        """Whether the present silence is too long."""
        quiet_at = self._quiet_at()
        if now < quiet_at:
            self.watch_at = quiet_at
            return False
        return True

    def _quiet_at(self) -> int:
        if self._at == NEVER:
            return NEVER
        return max(self._at, self.sent_at, self._since) + self._held_ns + self._limit
