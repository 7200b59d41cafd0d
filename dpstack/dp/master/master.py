"""The class 1 master: modes and the ordered end.

A user of the active station's link layer. When a round over the slaves begins is :mod:`dpstack.dp.master.fixed_cycle`
(free running, or a fixed cycle), what it consists of :mod:`dpstack.dp.master.cycle`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Final

from dpstack.dp.master.commands import (
    ActivateSlave,
    AddSlave,
    Alive,
    DeactivateSlave,
    DriveCommand,
    Mode,
    RemoveSlave,
    ReparameteriseSlave,
    SendControl,
    SetMode,
    Shutdown,
)
from dpstack.dp.master.cycle import ModeTransition, Round
from dpstack.dp.master.diag_reader import DiagObserver
from dpstack.dp.master.events import AutoCleared, ForcedClear, MasterStopped, ModeChanged, OperateWaits, SlaveState
from dpstack.dp.master.fixed_cycle import Cadence, CycleData, CycleStats
from dpstack.dp.master.global_control import Controls
from dpstack.dp.master.outputs_watch import DataControl, OutputsWatch, missing_reasons
from dpstack.dp.master.poll_order import Turns
from dpstack.dp.master.settings import DEFAULTS, MasterSettings
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.slave_list import SAFE_HOLD, Farewells, Roster
from dpstack.dp.master.token_watch import TokenAge
from dpstack.dp.process_image import SlaveImage
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import BusError, UsageError
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, Telegram
from dpstack.machine import HeldUp, LineDown, LineUp
from dpstack.params import BusParams
from dpstack.stats import Histogram
from dpstack.trace import Event

# asked in every exchange: an enum's member costs ten times a name of the module
_STOP: Final = Mode.STOP
_ABANDONED: Final = Failure.ABANDONED
_HELD_BACK: Final = Failure.HELD_BACK


class Master:
    """A DP class 1 master over ``slaves``. Starts in Clear, or in Stop where the bus is read-only.

    ``on_round(now)`` is called at the end of every round with data exchange, after :attr:`cycle` was published,
    ``on_begin()`` as a round begins: what it puts into the process image goes out in that one. With a fixed cycle give
    :attr:`budget` to the station. Raises ConfigError.
    """

    def __init__(
        self,
        params: BusParams,
        slaves: Iterable[SlaveParams] = (),
        settings: MasterSettings = DEFAULTS,
    ) -> None:
        self.params = params
        self.settings = settings
        self._course = ModeTransition(Mode.STOP if settings.read_only else Mode.CLEAR, Mode.CLEAR)
        self.handlers: dict[int, SlaveHandler] = {}
        self.rotation = Histogram()
        self.rounds = 0
        self.on_round: Callable[[int], None] | None = None
        self.on_begin: Callable[[], None] | None = None
        #: the masters in the token ring, for texts of faults; whoever makes the station sets it
        self.ring: Callable[[], Collection[int]] | None = None
        #: the last round with data exchange, while ``on_round`` is set
        self.cycle: CycleData | None = None
        self.controls = Controls(params, self.handlers, self._emit, settings)
        self._events: list[Event] = []
        self._turns = Turns(settings.absent_share, params)
        self._farewells = Farewells()
        self._watch = OutputsWatch(self.handlers, settings)
        self._held_in_clear = False  # by itself, until Operate is ordered
        self._outdated = False  # the request made last is from before that
        self._roster = Roster(
            params,
            self.handlers,
            watchdog_ms=settings.watchdog_ms,
            turns=self._turns,
            farewells=self._farewells,
            controls=self.controls,
            sending=lambda: self._course.mode > Mode.STOP,
            emit=self._emit,
            check=self._check,
            masters=lambda: None if self.ring is None else self.ring(),
            still=self._still_fresh,
            look_soon=self._watch.look_soon,
        )
        self._control = DataControl(settings)
        self._token = TokenAge(params)
        self._cadence = Cadence(settings.cycle_ns, self._emit)
        self._round = Round(
            self._course,
            self.handlers,
            self._turns,
            self.controls,
            self._farewells,
            self._cadence,
            self._round_begins,
            self._round_ended,
        )
        self._round_at = 0  # first bit of the last round's first Data_Exchange
        self._safe_until = 0  # so long safe values stand on the way down
        for setup in slaves:
            self._roster.add(setup)

    def observe(self, observer: Callable[[SlaveHandler, SlaveHandler | None], DiagObserver | None]) -> None:
        """``observer`` gives who reads alarms and status messages in the diagnoses of a slave, None for nobody.

        It is called with the slave's handling, and with the one before it was parameterised anew.
        """
        self._roster.observer = observer
        for handler in self.handlers.values():
            handler.diagnoses.observer = observer(handler, None)

    # --- what the application sees ------------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """The mode it is in."""
        return self._course.mode

    @property
    def cycles(self) -> CycleStats:
        """The books over the fixed cycles."""
        return self._cadence.book

    @property
    def budget(self) -> CycleWindow:
        """What keeps everything else out of the cycles: for the station (``ActiveStation(budget=...)``)."""
        return self._cadence.budget

    @property
    def images(self) -> dict[int, SlaveImage]:
        """The process image of each slave by address."""
        return {address: handler.image for address, handler in self.handlers.items()}

    @property
    def rotation_count(self) -> int:
        return self.rotation.count

    def command(self, command: object, now: int) -> bool:
        """Take the orders of :mod:`dpstack.dp.master.commands`. Misuse raises before anything is changed."""
        match command:
            case SetMode(mode):
                self._set_mode(mode, now)
            case Alive():
                self._watch.alive(now)
            case Shutdown():
                self._shutdown(now)
            case AddSlave() | RemoveSlave() | DeactivateSlave() | ActivateSlave() | ReparameteriseSlave():
                self._roster.command(command, now)
            case SendControl():
                self._writable("no Global_Control can be sent")
                if not self._token.known or self._course.target < self.mode:
                    why = "goes to a lower mode" if self._token.known else "holds no token"
                    raise BusError(f"SYNC and FREEZE cannot be sent: this station {why}; try again when that is over")
                self.controls.order(command, self.mode)
            case DriveCommand(address, op, args, token):
                self._writable("no drive can be commanded")
                self._roster.find(address).unit.command(op, args, token, now)
            case LineDown(reason):
                self._line_lost(f"the port vanished ({reason})", now, port=True)
                return False
            case StationFound(address=address, kind=kind):
                if kind is not None and address in self.handlers:
                    self.handlers[address].station_found(now)
                return False
            case LineUp():
                return False
            case HeldUp():
                self._watch.held_up(command)
                if not command.suspended:  # that time is not in `now`
                    self._token.held_up(command.for_ns)
                return not self._still_fresh(now)
            case _:
                return False
        return True

    def take_events(self) -> list[Event]:
        """What happened since the last call."""
        events, self._events = self._events, []
        return events

    def _check(self, setup: SlaveParams) -> None:
        self._cadence.check(setup)
        self.controls.cycle_freeze.check(setup)
        self.controls.cycle_sync.check(setup)

    def _emit(self, event: Event) -> None:
        self._events.append(event)

    def _writable(self, what: str) -> None:
        if self.settings.read_only:
            raise UsageError(f"this bus is read-only: {what}; leave read_only out")

    # --- modes and the ordered end ------------------------------------------------------------------------------

    def _set_mode(self, mode: Mode, now: int) -> None:
        if self._course.target is Mode.OFFLINE:
            raise UsageError("the master is being stopped: open the bus anew")
        self._writable("its master stays in Stop")
        if mode is Mode.OFFLINE:
            raise UsageError("a master goes offline by Shutdown, so that outputs become safe first")
        if mode is not self._course.target:
            before = self.mode
            self._head_for(mode, now)
            if mode is before is Mode.OPERATE and self._held_in_clear:  # it was on its way down
                self._events.append(ModeChanged(t_ns=now, mode=mode))
            self._held_in_clear = False

    def _shutdown(self, now: int) -> None:
        if self._course.target is not Mode.OFFLINE:
            self._head_for(Mode.OFFLINE, now)
            if self._token.known and self.mode is not Mode.OFFLINE:
                self._token.ending(now)

    def _head_for(self, target: Mode, now: int) -> None:
        """Up at once, or when auto-clear lets it. Down from Operate over safe values and Clear, and further down when
        everybody had that.
        """
        if self.mode is self._course.target is Mode.OPERATE:
            for handler in self.handlers.values():
                handler.unit.lost(now)
            self.controls.let_go(f"the master goes to {target.name.capitalize()}", now)
        self._course.target = target
        if target is Mode.OPERATE:
            self._watch.begin(now)
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
        """Down to Clear, and no way back but by order."""
        self._emit(event)
        self._held_in_clear = self._outdated = True
        self._head_for(Mode.CLEAR, now)

    def _look(self, now: int) -> None:
        """Judge whether the outputs are too old to be sent."""
        found = self._watch.judge(now)
        if found is not None:
            self._force_clear(found, now)

    def _still_fresh(self, now: int) -> bool:
        """Whether the request made last may still be sent, or sent again."""
        if now >= self._watch.look_at:
            self._look(now)
        return not self._outdated

    def _go_up(self, now: int) -> None:
        """Operate with auto-clear waits in Clear for everybody (docs/protocol.md#auto-clear)."""
        missing = self._control.missing(self.handlers.values()) if self._course.target is Mode.OPERATE else []
        if not missing:
            self._reach(self._course.target, now)
            return
        if self.mode < Mode.CLEAR:
            self._reach(Mode.CLEAR, now)
        who = tuple(h.setup.address for h in missing)
        self._emit(OperateWaits(t_ns=now, slaves=who, reasons=missing_reasons(missing)))

    def _clear_is_safe(self) -> bool:
        """Whether Clear's zeros are the safe values of all slaves in data exchange."""
        exchanging = (h for h in self.handlers.values() if h.state is SlaveState.DATA_EXCHANGE)
        return not any(any(handler.unit.safe_outputs()) for handler in exchanging)

    def _descend(self, now: int) -> None:
        """A round on the way down is through."""
        if self.mode is Mode.OPERATE:
            if now >= self._safe_until:
                self._reach(Mode.CLEAR, now)
        elif not (self.controls.urgent or self._farewells):
            self._reach(self._course.target, now)

    def _reach(self, mode: Mode, now: int, *, cleared: bool = True) -> None:
        self._course.mode = mode
        self.controls.change_of_mode()
        self._events.append(ModeChanged(t_ns=now, mode=mode))
        if mode is Mode.OPERATE:
            self._control.began(now)
        if mode <= Mode.STOP:
            self._round.cut(now)
            self._round_at = 0
            self._farewells.clear()
            self.controls.let_go(f"the master is in {mode.name.capitalize()}", now)
            for handler in self.handlers.values():
                handler.image.valid = False
        if mode is Mode.OFFLINE:
            self._token.lost()
            self._events.append(MasterStopped(t_ns=now, cleared=cleared))

    def _watch_data(self, now: int) -> None:
        """Auto-clear: down when somebody had no exchange for too long, up when Operate waits and all are there."""
        if self.mode is self._course.target is Mode.OPERATE:
            late = self._control.late(self.handlers.values(), now)
            if late:
                who = tuple(h.setup.address for h in late)
                self._force_clear(AutoCleared(t_ns=now, slaves=who, reasons=self._control.late_reasons(late)), now)
        elif self._course.target > self.mode and not self._control.missing(self.handlers.values()):
            self._reach(self._course.target, now)

    # --- link user ----------------------------------------------------------------------------------------------

    def token_received(self, now: int) -> None:
        """A hold begins, and with it perhaps a new round."""
        self._token.received(now)
        self._watch.token(now)
        if self._course.mode > Mode.STOP:
            self._round.token(now)

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """Everything a master sends to its slaves is high priority, so ``high_only`` changes nothing."""
        if now >= self._watch.look_at:
            self._look(now)
        self._outdated = False
        return self._round.next_request(now) if self._course.mode > _STOP else None

    def _round_begins(self) -> None:
        if self.on_begin is not None:
            self.on_begin()

    def _round_ended(self, now: int) -> None:
        self.rounds += 1
        if not self._turns.exchanging:
            self._round_at = 0
        elif self.on_round is not None:
            self.cycle = self._round.publish() or self.cycle
            self.on_round(now)
        if self._control.enabled:
            self._watch_data(now)
        if self._course.descending:
            self._descend(now)

    def started(self, request: Request, at: int) -> None:
        """The rotation is taken from first bit to first bit of a round's first Data_Exchange."""
        self._token.sent_at = at
        handler = request.tag
        if isinstance(handler, SlaveHandler):
            handler.asked_at = at
            if self._watch.down:
                self._watch.down.pop(handler, None)
        self._round.started(request, at)
        if request.dsap is None:
            if self._round.first_data:
                self._round.first_data = False
                if self._round_at:
                    self.rotation.add(at - self._round_at)
                self._round_at = at
        elif request.dsap == SAP_GLOBAL_CONTROL:
            self.controls.started(request, at)

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Hand the end of a request to the handling of its slave."""
        handler = request.tag
        if outcome is _HELD_BACK:
            self._round.held_back(request)
            return
        if outcome is _ABANDONED and request.dsap == SAP_GLOBAL_CONTROL:
            self.controls.abandoned(request)
        if not isinstance(handler, SlaveHandler) or self.handlers.get(handler.setup.address) is not handler:
            return  # of nobody, or of a slave that was removed meanwhile
        if request.dsap is None:
            handler.data_result(outcome, now)
            return
        self._turns.polled(handler, now - self._token.sent_at, now, long=request.extra_ns > 0)
        handler.service_result(request, outcome, now)

    # --- without a token ----------------------------------------------------------------------------------------

    def wake_at(self) -> int:
        """The watch over the token: without one for long nobody is in data exchange any more. The application's."""
        return min(self._token.watch_at, self._watch.alive_until)

    def tick(self, now: int) -> None:
        """No token for long: say so, or end an end that cannot be sent any more. (The watch is moved on only here.)"""
        if now >= self._watch.alive_until:
            self._look(now)
        if self._token.too_old(now):
            self._line_lost("this station holds no token", now, port=False)

    def _line_lost(self, reason: str, now: int, *, port: bool) -> None:
        self._watch.line_lost(reason, port=port)
        self._token.lost()
        self._round.cut(now)
        self._cadence.forget()
        self._round_at = 0
        self._farewells.clear()
        self.controls.fail_all(reason, now)
        for handler in self.handlers.values():
            handler.line_lost(reason, now)
        if self._course.target < self.mode:
            self._reach(self._course.target, now, cleared=False)
