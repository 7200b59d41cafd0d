"""When outputs are too old to be sent: the stall rule (``after_stall``) and the application watchdog.

A stall is a time in which a slave was not asked for longer than its watchdog: the slave has taken its outputs back, and
must not be given the old ones again without an order. The master asks :meth:`OutputsWatch.judge` before it sends
anything; the answer is the event that takes it to Clear.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from dpstack.dp.master.events import ApplicationSilent, Blocked, ForcedClear, SlaveState, Stalled
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.machine import HeldUp
from dpstack.units import NEVER, NS_PER_MS, ms_text

# docs/protocol.md#auto-clear (Error_Action_Flag, Data_Control_Time, Ignore_Aclr of each slave).


class DataControl:
    """Auto-clear: without it no slave is ever late or missing. ``time_ns`` is the Data_Control_Time."""

    __slots__ = ("_began", "_due", "enabled", "time_ns")

    def __init__(self, settings: MasterSettings) -> None:
        self.enabled = settings.auto_clear
        self.time_ns = settings.data_control_ns
        self._began = 0
        self._due = 0

    def began(self, now: int) -> None:
        """Operate was reached: the time runs from here."""
        self._began = now
        self._due = now + self.time_ns

    def late(self, handlers: Iterable[SlaveHandler], now: int) -> list[SlaveHandler]:
        """The slaves without a good exchange for the Data_Control_Time; looked at again when one can be late."""
        if not self.enabled or now < self._due:
            return []
        ages = [(max(h.image.input_time, self._began), h) for h in handlers if _counts(h)]
        self._due = min((at for at, _ in ages), default=now) + self.time_ns
        return [h for at, h in ages if now - at >= self.time_ns]

    def missing(self, handlers: Iterable[SlaveHandler]) -> list[SlaveHandler]:
        """The slaves that keep the master from Operate: not in data exchange."""
        if not self.enabled:
            return []
        return [h for h in handlers if _counts(h) and h.state is not SlaveState.DATA_EXCHANGE]

    def late_reasons(self, late: Sequence[SlaveHandler]) -> tuple[str, ...]:
        """One line for each of ``late``."""
        return tuple(
            f"slave {h.setup.address} ({h.setup.name}) had no data exchange for {self.time_ns // NS_PER_MS} ms "
            f"({_why(h)})"
            for h in late
        )


def missing_reasons(missing: Sequence[SlaveHandler]) -> tuple[str, ...]:
    """One line for each of ``missing``."""
    return tuple(f"slave {h.setup.address} ({h.setup.name}): {_why(h)}" for h in missing)


def _counts(handler: SlaveHandler) -> bool:
    return handler.state is not SlaveState.DEACTIVATED and not handler.setup.ignore_auto_clear


def _why(handler: SlaveHandler) -> str:
    fault = handler.fault
    return fault.message if fault is not None else f"it is in {handler.state.value}"


#: slaves that are in no state to have outputs, and do not count among those that want parameters at once
_AWAY: Final = (SlaveState.OFFLINE, SlaveState.FAULT, SlaveState.DEACTIVATED)
#: so many slaves at least are "all": one alone may have been switched off and on
_ALL: Final = 2


class Block(NamedTuple):
    """What kept the master from asking, and that for people."""

    kind: Blocked
    text: str


class OutputsWatch:
    """Watches ``handlers`` while the master is in Operate, or on its way there.

    ``look_at``: before this time (ns) :meth:`judge` has nothing to say.
    """

    __slots__ = (
        "_handlers", "_held", "_settings", "_token_at", "_token_gap", "_watching", "alive_until", "down", "look_at",
    )  # fmt: skip

    def __init__(self, handlers: Mapping[int, SlaveHandler], settings: MasterSettings) -> None:
        self.look_at = NEVER
        #: when the application watchdog runs out in ns, NEVER while it is off
        self.alive_until = NEVER
        self._handlers = handlers
        self._settings = settings
        self._watching = False
        self._held: HeldUp | None = None  # the longest the driver told of since the last judgement
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
        """Something changed: judge before the next request."""
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
            block = Block(Blocked.PORT if port else Blocked.TOKEN, reason)
            for handler in self._handlers.values():
                if handler.state is SlaveState.DATA_EXCHANGE:
                    self.down.setdefault(handler, block)
            self.look_soon()

    # --- judging ------------------------------------------------------------------------------------------------

    def judge(self, now: int) -> ForcedClear | None:
        """Why the outputs are too old to be sent, or None; moves :attr:`look_at`."""
        self.look_at = self.alive_until
        if not self._watching:
            return None
        found = self._stalled(now) if self._settings.safe_after_stall else None
        if found is not None or not self.down:
            self._held = None
        if found is None and now >= self.alive_until:
            return ApplicationSilent(t_ns=now, limit_ns=self._settings.application_watchdog_ns)
        return found

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
            block = self._block(worst, gap)
            slaves = tuple(sorted(handler.setup.address for handler in overdue))
            why = (
                f"slave {worst.setup.address} ({worst.setup.name}) was not asked for {ms_text(gap)}, "
                f"longer than its watchdog of {ms_text(worst.watchdog_effective_ns)}"
            )
            if block is None:
                return Stalled(t_ns=now, gap_ns=gap, slaves=slaves, blocked=None, reason=why)
            return Stalled(t_ns=now, gap_ns=gap, slaves=slaves, blocked=block.kind, reason=f"{why}: {block.text}")
        return self._all_want_parameters(now)

    def _block(self, handler: SlaveHandler, gap: int) -> Block | None:
        """What took most of the time ``gap`` in which ``handler`` was not asked."""
        held = self._held
        if held is not None and 2 * held.for_ns >= gap:
            return Block(Blocked.SUSPENDED if held.suspended else Blocked.PROGRAM, held.what)
        if handler in self.down:
            return self.down[handler]
        if 2 * self._token_gap >= gap:
            return Block(Blocked.TOKEN, f"the token did not come for {ms_text(self._token_gap)}")
        return None

    def _all_want_parameters(self, now: int) -> Stalled | None:
        """No gap was seen, but the watchdogs of all slaves ran out in the same moment: a clock that stood still.

        One slave alone is its own restart.
        """
        present = [h for h in self._handlers.values() if h.watchdog_effective_ns and h.state not in _AWAY]
        times = [handler.prm_req_at for handler in present]
        if len(present) < _ALL or NEVER in times:
            return None
        if max(times) - min(times) > min(handler.watchdog_effective_ns for handler in present):
            return None
        slaves = tuple(sorted(handler.setup.address for handler in present))
        why = "all slaves with a watchdog want parameters (Prm_Req) at once, as after a time in which nobody asked them"
        return Stalled(t_ns=now, gap_ns=None, slaves=slaves, blocked=None, reason=why)
