"""The class 1 master: modes and the ordered end.

A user of the active station's link layer. When a round over the slaves begins is :mod:`dpstack.dp.master.fixed_cycle`
(free running, or a fixed cycle), what it consists of :mod:`dpstack.dp.master.cycle`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from dpstack.dp.master.commands import Alive, DriveCommand, Mode, SendControl, SetMode, Shutdown
from dpstack.dp.master.cycle import Round
from dpstack.dp.master.events import ForcedClear, MasterStopped, ModeChanged, OperateWaits, SlaveState
from dpstack.dp.master.fixed_cycle import Cadence, CycleData, CycleStats
from dpstack.dp.master.global_control import Controls
from dpstack.dp.master.outputs_watch import AutoClear, OutputsWatch, TokenAge
from dpstack.dp.master.poll_order import Turns
from dpstack.dp.master.settings import DEFAULTS, MasterContext, MasterSettings
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.slave_list import SAFE_HOLD, Roster
from dpstack.dp.process_image import SlaveImage
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import BusError, UsageError
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, LinkUser, Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, Telegram
from dpstack.machine import HeldUp, InDoubt, LineDown
from dpstack.params import BusParams
from dpstack.stats import Histogram
from dpstack.trace import Event

# asked in every exchange: an enum's member costs ten times a name of the module
_ABANDONED: Final = Failure.ABANDONED
_HELD_BACK: Final = Failure.HELD_BACK
_STOP: Final = Mode.STOP


class Master(LinkUser):
    """A DP class 1 master of ``slaves``. It starts in Clear, or in Stop if the bus is read-only.

    It calls ``on_round(now)`` at the end of every round with data exchange, when ``cycle`` is up to date. With a fixed
    cycle give ``window`` to the station. Raises ConfigError.
    """

    def __init__(
        self,
        params: BusParams,
        slaves: Iterable[SlaveParams] = (),
        settings: MasterSettings = DEFAULTS,
    ) -> None:
        self.context = context = MasterContext(params, settings)
        self.events = context.events
        self.handlers: dict[int, SlaveHandler] = {}
        self.rotation = Histogram()
        self.rounds = 0
        self.on_round: Callable[[int], None] | None = None
        #: the last round with data exchange, while ``on_round`` is set
        self.cycle: CycleData | None = None
        self.controls = Controls(context, self.handlers)
        self._turns = Turns(context, self.handlers)
        self._watch = OutputsWatch(settings, self.handlers, self._force_clear)
        self._held_in_clear = False  # without an order, until Operate is ordered
        self._auto_clear = AutoClear(settings, self.handlers)
        self._token = TokenAge(params)
        self._cadence = Cadence(context)
        self.roster = Roster(context, self.handlers, self._turns, self.controls, self._cadence, self._watch)
        parts = self.roster, self._turns, self.controls, self._cadence, self._watch
        self._round = Round(context, *parts, self._round_ended)
        #: the next request of this token hold, see :class:`LinkUser`: the round's, as it is asked in every exchange
        self.next_request: Callable[[int, bool], Request | None] = self._round.next_request
        self._round_at = 0  # first bit of the last round's first Data_Exchange
        self._safe_until = 0  # safe values stand until then on the way down
        for setup in slaves:
            self.roster.add(setup)

    # --- what the application sees ------------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """The present mode."""
        return self.context.mode

    @property
    def cycles(self) -> CycleStats:
        """Statistics of the fixed cycles."""
        return self._cadence.book

    @property
    def window(self) -> CycleWindow:
        """The time window for acyclic requests: for the station (``ActiveStation(window=...)``)."""
        return self._cadence.window

    @property
    def images(self) -> dict[int, SlaveImage]:
        """The process image of each slave by address."""
        return {address: handler.image for address, handler in self.handlers.items()}

    def command(self, command: object, now: int) -> bool:
        """Carry out an order of :mod:`dpstack.dp.master.commands`. Misuse raises before any change."""
        match command:
            case SetMode(mode):
                self._set_mode(mode, now)
            case Alive(limit_ns):
                self._watch.alive(now, limit_ns)
            case Shutdown():
                self._shutdown(now)
            case SendControl():
                self._writable("no Global_Control can be sent")
                if not self._token.known or self.context.target < self.mode:
                    why = "goes to a lower mode" if self._token.known else "holds no token"
                    raise BusError(f"SYNC and FREEZE cannot be sent: this station {why}; try again when that is over")
                self.controls.order(command)
            case DriveCommand(address, op, args, token):
                self._writable("no drive can be commanded")
                self.roster.find(address).plugin_host.command(op, args, token, now)
            case LineDown(reason):
                self._line_lost(f"the port vanished ({reason})", now, port=True)
                return False
            case StationFound(address=address, kind=kind):
                if kind is not None and address in self.handlers:
                    self.handlers[address].station_found(now)
                return False
            case InDoubt(for_ns):
                for handler in self.handlers.values():
                    handler.doubt_inputs(now - for_ns, now)
                return False
            case HeldUp():
                self._watch.held_up(command, now)
                if not (command.suspended or command.unsent):  # not in `now`, or the station ran
                    self._token.held_up(command.for_ns)
                return not self._watch.still_fresh(now)
            case _:
                return self.roster.command(command, now)
        return True

    def take_events(self) -> list[Event]:
        """Return and clear the events since the last call."""
        events = self.context.events.copy()
        self.context.events.clear()
        return events

    def take_changed(self) -> set[int]:
        """Return and clear the addresses of the slaves whose state, fault, diagnosis or alarm counts have changed since
        the last call: all slaves at the first one. A removed slave is among them."""
        changed = self.context.changed.copy()
        self.context.changed.clear()
        return changed

    def _writable(self, what: str) -> None:
        if self.context.settings.read_only:
            raise UsageError(f"this bus is read-only: {what}; leave read_only out")

    # --- modes and the ordered end ------------------------------------------------------------------------------

    def _set_mode(self, mode: Mode, now: int) -> None:
        if self.context.target is Mode.OFFLINE:
            raise UsageError("the master is being stopped: open the bus anew")
        self._writable("its master stays in Stop")
        if mode is Mode.OFFLINE:
            raise UsageError("a master goes offline by Shutdown, so that outputs become safe first")
        if mode is not self.context.target:
            before = self.mode
            self._head_for(mode, now)
            if mode is before is Mode.OPERATE and self._held_in_clear:  # it was on its way down
                self.context.emit(ModeChanged(t_ns=now, mode=mode))
            self._held_in_clear = False

    def _shutdown(self, now: int) -> None:
        if self.context.target is not Mode.OFFLINE:
            self._head_for(Mode.OFFLINE, now)
            if self._token.known and self.mode is not Mode.OFFLINE:
                self._token.ending(now)

    def _head_for(self, target: Mode, now: int) -> None:
        """Up at once, or when auto-clear permits it. Down from Operate through safe values and Clear, and further down
        when all slaves had them.
        """
        if self.mode is self.context.target is Mode.OPERATE:
            for handler in self.handlers.values():
                handler.interrupted(now)
            self.controls.release_all(f"the master goes to {target.name.capitalize()}", now)
        self.context.head_for(target)
        if target is Mode.OPERATE:
            self._watch.begin(now)
            if self.context.operates:  # it was on its way down
                self._report_withheld(now)
        else:
            self._watch.end()
        if target >= self.mode:
            if target > self.mode:
                self._go_up(now)
        elif self.mode is Mode.STOP or not self._token.known:
            self._reach(target, now, cleared=self.mode is Mode.STOP)
        else:
            self._round.cut(now)  # a whole round follows
            if self.mode is Mode.OPERATE:
                if self._clear_is_safe():
                    self._reach(Mode.CLEAR, now)
                else:
                    self._safe_until = now + SAFE_HOLD
            elif target is Mode.OFFLINE:
                self.controls.change_of_mode()
            elif not self.controls.urgent:
                self._reach(target, now)

    def _force_clear(self, event: ForcedClear, now: int) -> None:
        """Go to Clear; only an order leads back to Operate."""
        self.context.emit(event)
        self._held_in_clear = self._watch.outdated = True
        self._head_for(Mode.CLEAR, now)

    def _go_up(self, now: int) -> None:
        """Operate with auto-clear waits in Clear for all slaves (docs/reference/protocol.md#auto-clear)."""
        missing = self._auto_clear.missing() if self.context.target is Mode.OPERATE else []
        if not missing:
            self._reach(self.context.target, now)
            return
        if self.mode < Mode.CLEAR:
            self._reach(Mode.CLEAR, now)
        slaves = tuple(h.setup.address for h in missing)
        reasons = tuple(f"{h.setup.who}: {h.why_not_exchanging}" for h in missing)
        self.context.emit(OperateWaits(t_ns=now, slaves=slaves, reasons=reasons))

    def _clear_is_safe(self) -> bool:
        """Whether Clear's zeros are the safe values of all slaves in data exchange."""
        exchanging = (h for h in self.handlers.values() if h.state is SlaveState.DATA_EXCHANGE)
        return not any(any(handler.plugin_host.safe_outputs()) for handler in exchanging)

    def _descend(self, now: int) -> None:
        """The end of a round on the way down."""
        if self.mode is Mode.OPERATE:
            if now >= self._safe_until:
                self._reach(Mode.CLEAR, now)
        elif not (self.controls.urgent or self.roster.leaving):
            self._reach(self.context.target, now)

    def _reach(self, mode: Mode, now: int, *, cleared: bool = True) -> None:
        self.context.reach(mode)
        self.controls.change_of_mode()
        self.context.emit(ModeChanged(t_ns=now, mode=mode))
        if mode is Mode.OPERATE:
            self._auto_clear.began(now)
            self._report_withheld(now)
        if mode <= Mode.STOP:
            self._round.cut(now)
            self._round_at = 0
            self.roster.clear_farewells()
            self.controls.release_all(f"the master is in {mode.name.capitalize()}", now)
            for handler in self.handlers.values():
                handler.image.valid = False
        if mode is Mode.OFFLINE:
            self._token.lost()
            self.context.emit(MasterStopped(t_ns=now, cleared=cleared))

    def _report_withheld(self, now: int) -> None:
        for handler in self.handlers.values():
            handler.report_withheld(now)

    def _watch_data(self, now: int) -> None:
        """Auto-clear: down if a slave had no exchange for too long; up if Operate waits and all slaves are there."""
        if self.mode is self.context.target is Mode.OPERATE:
            late = self._auto_clear.late(now)
            if late is not None:
                self._force_clear(late, now)
        elif self.context.target > self.mode and not self._auto_clear.missing():
            self._reach(self.context.target, now)

    # --- link user ----------------------------------------------------------------------------------------------

    def token_received(self, now: int) -> None:
        """A token hold begins, and perhaps a new round with it."""
        self._token.received(now)
        self._watch.token(now)
        if self.context.mode > _STOP:
            self._round.token(now)

    def _round_ended(self, now: int) -> None:
        self.rounds += 1
        if not self._turns.exchanging:
            self._round_at = 0
        elif (on_round := self.on_round) is not None:
            self.cycle = self._round.publish() or self.cycle
            on_round(now)
        if self._auto_clear.enabled:
            self._watch_data(now)
        if self.context.descending:
            self._descend(now)

    def started(self, request: Request, at: int) -> None:
        """Count the rotation from first bit to first bit of the first Data_Exchange of two rounds."""
        self._token.sent_at = at
        cycle = self._round
        handler = request.tag
        if type(handler) is SlaveHandler:
            if self._watch.down:
                self._watch.down.pop(handler, None)
            if request.standing is not None:
                handler.data_started(at)
            else:
                handler.asked_at = at
        cycle.started(request, at)
        if request.dsap is None:
            if cycle.first_data:
                cycle.first_data = False
                if self._round_at:
                    self.rotation.add(at - self._round_at)
                self._round_at = at
        elif request.dsap == SAP_GLOBAL_CONTROL:
            self.controls.started(request, at)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Hand the end of a request to the handler of its slave."""
        if outcome is _HELD_BACK:
            self._round.held_back(request)
            return
        handler = self.handlers.get(request.da)
        if handler is None or handler is not request.tag:
            # the request of no slave, or of one that was removed meanwhile
            if outcome is _ABANDONED and request.dsap == SAP_GLOBAL_CONTROL:
                self.controls.abandoned(request)
        elif request.dsap is None:
            handler.data_result(outcome, now)
        else:
            self._service_ended(handler, request, outcome, now)

    def _service_ended(self, handler: SlaveHandler, request: Request, outcome: Telegram | Failure, now: int) -> None:
        self._turns.count_poll(handler, now - self._token.sent_at, now, long=request.extra_ns > 0)
        handler.service_result(request, outcome, now)

    # --- without a token ----------------------------------------------------------------------------------------

    def wake_at(self) -> int:
        """The end of the longest time without a token, or of the application watchdog."""
        return min(self._token.watch_at, self._watch.alive_until)

    def tick(self, now: int) -> None:
        """After too long without a token: report all slaves lost, and end an ordered end that cannot be sent."""
        if now >= self._watch.alive_until:
            self._watch.look(now)
        if self._token.too_old(now, max((handler.data_at for handler in self.handlers.values()), default=0)):
            self._line_lost("this station holds no token", now, port=False)

    def _line_lost(self, reason: str, now: int, *, port: bool) -> None:
        self._watch.line_lost(reason, port=port)
        self._token.lost()
        self._round.cut(now)
        self._cadence.forget()
        self._round_at = 0
        self.roster.clear_farewells()
        self.controls.fail_all(reason, now)
        for handler in self.handlers.values():
            handler.line_lost(reason, now)
        if self.context.target < self.mode:
            self._reach(self.context.target, now, cleared=False)
