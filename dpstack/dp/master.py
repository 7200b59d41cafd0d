"""The class 1 master: modes, the round over the slaves, Global_Control, and the ordered end.

A user of the active station's link layer. One round in each token hold where T_TH allows: Data_Exchange with every
slave that is in it, from the process image; then Global_Control when due; then services (bring-up, diagnosis): one a
round while any slave is in data exchange, so that a bring-up never breaks the others' rhythm, else one for each slave.
The order is that of the Siemens S120 and Heidenhain manuals (protocol facts, B6).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final

from dpstack.dp.commands import AddSlave, DriveCommand, Mode, RemoveSlave, SetMode, Shutdown
from dpstack.dp.events import MasterStopped, ModeChanged, SlaveState
from dpstack.dp.farewell import SAFE_HOLD, Farewells
from dpstack.dp.image import SlaveImage
from dpstack.dp.pdu import GlobalControl
from dpstack.dp.setup import SlaveSetup
from dpstack.dp.slave_handler import SlaveHandler
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SSAP_MS0, Req, Telegram
from dpstack.fdl.user import Failure, Request
from dpstack.machine import LineDown, LineUp
from dpstack.params import BROADCAST, BusParams
from dpstack.stats import Histogram
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S

#: Global_Control is repeated this often (sources disagree between each Data_Control_Time and 'cyclically') ...
_GC_PERIOD: Final = 200 * NS_PER_MS
#: ... but takes no more than 1 % of the bus: 13 octets and T_ID2.
_GC_SHARE: Final = 100
_GC_OCTETS: Final = 13
#: Global_Control after a change of mode, and at the end, is sent this often
_GC_URGENT: Final = 2
#: without a token for T_TR and so long nobody can be in data exchange any more; an ordered end waits only so long
_SILENCE: Final = NS_PER_S


class Master:
    """A DP class 1 master over ``slaves``. Starts in Clear; ``watchdog_ms`` is the default of slaves without their own.

    ``absent_share``: while any slave is in data exchange, silent polls of absent ones take at most 1/absent_share of
    the bus time; 0 = no limit. ``on_round(now)`` is called at the end of every round with data exchange.
    """

    def __init__(
        self,
        params: BusParams,
        slaves: Iterable[SlaveSetup] = (),
        *,
        watchdog_ms: int = 200,
        absent_share: int = 0,
        on_round: Callable[[int], None] | None = None,
    ) -> None:
        self.params = params
        self.mode = Mode.CLEAR
        self.handlers: dict[int, SlaveHandler] = {}
        self.rotation = Histogram()
        self.rounds = 0
        self.on_round = on_round
        self._watchdog_ms = watchdog_ms
        self._absent_share = absent_share
        self._events: list[Event] = []
        gc_bits = _GC_OCTETS * 11 + params.t_id2
        self._gc_period = max(_GC_PERIOD, _GC_SHARE * params.ns(gc_bits))
        self._gc_due = 0
        self._gc_urgent = 0
        # the round
        self._exchanging: list[SlaveHandler] = []
        self._services: deque[SlaveHandler] = deque()
        self._stale = True
        self._open = False
        self._cursor = 0
        self._service_left = 0
        self._farewells = Farewells()
        self._mark = False
        self._round_at = 0
        self._not_before = 0
        self._interval = 0
        self._poll_from = 0
        self._poll_at = 0
        # the way down: where the modes lead, until when safe values stand, when the end was ordered
        self._target = Mode.CLEAR
        self._safe_until = 0
        self._end_at = 0
        self._token_at = NEVER
        self._watch_at = NEVER
        # at 9.6 kbit/s one rotation may rightly take T_TR = 5 s
        self._silence = _SILENCE + params.ns(params.t_tr)
        for setup in slaves:
            self._add(setup)

    # --- what the application sees ------------------------------------------------------------------------------

    @property
    def images(self) -> dict[int, SlaveImage]:
        """The process image of each slave by address."""
        return {address: handler.image for address, handler in self.handlers.items()}

    def command(self, command: object, now: int) -> bool:
        """Take SetMode, Shutdown, AddSlave, RemoveSlave and DriveCommand; see :mod:`dpstack.dp.commands`."""
        match command:
            case SetMode(mode):
                self._set_mode(mode, now)
            case Shutdown():
                self._shutdown(now)
            case AddSlave(setup):
                self._add(setup)
            case RemoveSlave(address):
                self._remove(address, now)
            case DriveCommand(address, op, args, token):
                self._handler(address).unit.command(op, args, token, now)
            case LineDown(reason):
                self._line_lost(f"the port vanished ({reason})", now)
                return False
            case LineUp():
                return False
            case _:
                return False
        return True

    def take_events(self) -> list[Event]:
        """What happened since the last call."""
        events, self._events = self._events, []
        return events

    def _emit(self, event: Event) -> None:
        self._events.append(event)

    def _handler(self, address: int) -> SlaveHandler:
        handler = self.handlers.get(address)
        if handler is None:
            known = ", ".join(map(str, sorted(self.handlers))) or "none"
            raise UsageError(f"no slave with address {address} is configured (configured: {known})")
        return handler

    def _add(self, setup: SlaveSetup) -> None:
        if setup.address in self.handlers:
            other = self.handlers[setup.address].setup.name
            raise ConfigError(f"slaves {other} and {setup.name} both have address {setup.address}")
        if setup.address == self.params.address:
            raise ConfigError(f"slave {setup.name} has the master's own address {setup.address}")
        self.handlers[setup.address] = SlaveHandler(
            setup,
            own=self.params.address,
            baud=self.params.baud,
            watchdog_ms=self._watchdog_ms,
            emit=self._emit,
            changed=self._slave_changed,
        )
        self._stale = True

    def _remove(self, address: int, now: int) -> None:
        """Safe values as at the end, then Unlock, then it is forgotten."""
        handler = self._handler(address)
        del self.handlers[address]
        self._stale = True
        if handler in self._services:
            self._services.remove(handler)
        if self.mode > Mode.STOP:
            self._farewells.add(handler, now)
        handler.unit.lost(now)
        handler.state = SlaveState.OFFLINE  # nothing more for it in this round

    # --- modes and the ordered end ------------------------------------------------------------------------------

    def _set_mode(self, mode: Mode, now: int) -> None:
        if self._target is Mode.OFFLINE:
            raise UsageError("the master is being stopped: open the bus anew")
        if mode is Mode.OFFLINE:
            raise UsageError("a master goes offline by Shutdown, so that outputs become safe first")
        if mode is not self._target:
            self._head_for(mode, now)

    def _shutdown(self, now: int) -> None:
        if self._target is not Mode.OFFLINE:
            self._end_at = now
            self._head_for(Mode.OFFLINE, now)
            self._watch_at = self._quiet_at()

    def _head_for(self, target: Mode, now: int) -> None:
        """Up at once. Down from Operate over safe values and Clear, and further down when everybody had that."""
        if self._target is Mode.OPERATE:
            for handler in self.handlers.values():
                handler.unit.lost(now)
        self._target = target
        if target >= self.mode:
            if target > self.mode:
                self._reach(target, now)
        elif self.mode is Mode.STOP or self._token_at == NEVER:
            self._reach(target, now)
        else:
            self._open = False  # a whole round follows
            if self.mode is Mode.OPERATE:
                if self._clear_is_safe():
                    self._reach(Mode.CLEAR, now)
                else:
                    self._safe_until = now + SAFE_HOLD
            elif target is Mode.OFFLINE:
                self._gc_urgent = _GC_URGENT
            elif not self._gc_urgent:
                self._reach(target, now)

    def _clear_is_safe(self) -> bool:
        """Whether Clear's zeros are the safe values of all slaves in data exchange."""
        exchanging = (h for h in self.handlers.values() if h.state is SlaveState.DATA_EXCHANGE)
        return not any(any(handler.setup.safe_outputs) for handler in exchanging)

    def _descend(self, now: int) -> None:
        """A round on the way down is through."""
        if self.mode is Mode.OPERATE:
            if now >= self._safe_until:
                self._reach(Mode.CLEAR, now)
        elif not (self._gc_urgent or self._farewells):
            self._reach(self._target, now)

    def _reach(self, mode: Mode, now: int) -> None:
        self.mode = mode
        self._gc_urgent = _GC_URGENT
        self._events.append(ModeChanged(t_ns=now, mode=mode))
        if mode <= Mode.STOP:
            self._open = False
            self._round_at = 0
            self._farewells.clear()
            for handler in self.handlers.values():
                handler.image.valid = False
        if mode is Mode.OFFLINE:
            self._events.append(MasterStopped(t_ns=now))

    # --- link user ----------------------------------------------------------------------------------------------

    def token_received(self, now: int) -> None:
        """A hold begins; so does a new round when the last one is through and the next one may."""
        self._token_at = now
        if self._watch_at == NEVER:
            self._watch_at = self._quiet_at()
        if not self._open and now >= self._not_before and self.mode > Mode.STOP:
            self._begin_round(now)

    def _begin_round(self, now: int) -> None:
        if self._stale:
            self._sort()
        self._open = True
        self._cursor = 0
        self._mark = bool(self._exchanging)
        self._farewells.begin_round()
        self._service_left = 1 if self._exchanging else len(self._services)
        if self._target is Mode.OFFLINE:
            self._service_left = 0
        if not self._mark:
            self._round_at = 0
        self._not_before = now + self._interval

    def next_request(self, now: int, high_only: bool) -> Request | None:
        """Everything a master sends to its slaves is high priority, so ``high_only`` changes nothing."""
        if not self._open:
            return None
        exchanging = self._exchanging
        while self._cursor < len(exchanging):
            handler = exchanging[self._cursor]
            self._cursor += 1
            if handler.state is not SlaveState.DATA_EXCHANGE:
                continue
            if self.rounds % handler.setup.every and self._target is self.mode:
                continue  # on the way down nobody is left out
            return handler.data_request(self._outputs(handler, now))
        if self._farewells and (request := self._farewells.request(now)) is not None:
            return request
        if self._gc_urgent or (now >= self._gc_due and exchanging):
            return self._global_control(now)
        while self._service_left:
            self._service_left -= 1
            request = self._next_service(now)
            if request is not None:
                return request
        self._end_round(now)
        return None

    def _outputs(self, handler: SlaveHandler, now: int) -> bytes:
        if self.mode is Mode.OPERATE:
            return handler.unit.outputs(now) if self._target is Mode.OPERATE else handler.setup.safe_outputs
        # Clear: a Fail_Safe slave gets an empty frame, the others zeros (section J, Siemens CP5613)
        return b"" if handler.setup.fail_safe else bytes(handler.image.output_len)

    def _global_control(self, now: int) -> Request:
        self._gc_due = now + self._gc_period
        if self._gc_urgent:
            self._gc_urgent -= 1
        data = GlobalControl(clear=self.mode is Mode.CLEAR).build()
        return Request(BROADCAST, Req.SDN_HIGH, data, SAP_GLOBAL_CONTROL, SSAP_MS0)

    def _next_service(self, now: int) -> Request | None:
        """The next slave that wants a service, fairly in turn; with one a round a bring-up under way goes first."""
        chosen: SlaveHandler | None = None
        for handler in self._services:
            if self._may_serve(handler, now):
                if handler.under_way and self._exchanging:
                    chosen = handler
                    break
                chosen = chosen or handler
        if chosen is None:
            return None
        self._services.remove(chosen)
        self._services.append(chosen)
        return chosen.service_request(now)

    def _may_serve(self, handler: SlaveHandler, now: int) -> bool:
        """Absent ones within their share of the bus; nobody before the one removed at its address is unlocked."""
        if not handler.wants_service(now) or (handler.state is SlaveState.OFFLINE and now < self._poll_from):
            return False
        return not (self._farewells and self._farewells.awaits(handler.setup.address))

    def _end_round(self, now: int) -> None:
        self._open = False
        self.rounds += 1
        if self._exchanging and self.on_round is not None:
            self.on_round(now)
        if self._target < self.mode:
            self._descend(now)

    def started(self, request: Request, at: int) -> None:
        """The rotation is taken from first bit to first bit of a round's first Data_Exchange."""
        self._poll_at = at
        if self._mark and request.dsap is None:
            self._mark = False
            if self._round_at:
                self.rotation.add(at - self._round_at)
            self._round_at = at

    def result(self, request: Request, outcome: Telegram | Failure, now: int) -> None:
        """Hand the end of a request to the handling of its slave."""
        handler = request.tag
        if not isinstance(handler, SlaveHandler) or self.handlers.get(handler.setup.address) is not handler:
            return  # of nobody, or of a slave that was removed meanwhile
        if request.dsap is None:
            handler.data_result(outcome, now)
            return
        if handler.state is SlaveState.OFFLINE and self._absent_share and self._exchanging:
            self._poll_from = now + (now - self._poll_at) * self._absent_share
        handler.service_result(request, outcome, now)

    # --- slaves come and go -------------------------------------------------------------------------------------

    def _slave_changed(self, handler: SlaveHandler) -> None:
        self._stale = True
        if handler.state is SlaveState.DATA_EXCHANGE and handler not in self._exchanging:
            self._gc_urgent = max(self._gc_urgent, 1)  # Operate after every re-entry (section I)

    def _sort(self) -> None:
        self._stale = False
        handlers = [self.handlers[address] for address in sorted(self.handlers)]
        self._exchanging = [h for h in handlers if h.state is SlaveState.DATA_EXCHANGE]
        wanting = {h for h in handlers if h.state is not SlaveState.DATA_EXCHANGE or h.diag_due}
        kept = [h for h in self._services if h in wanting]
        self._services = deque(kept + [h for h in handlers if h in wanting and h not in kept])
        self._interval = max((h.setup.min_slave_interval_ns for h in self._exchanging), default=0)

    # --- without a token ----------------------------------------------------------------------------------------

    def wake_at(self) -> int:
        """The watch over the token: without one for long nobody is in data exchange any more."""
        return self._watch_at

    def _quiet_at(self) -> int:
        """When the present silence is too long; what was sent since the token came counts as its sign of life."""
        if self.mode is Mode.OFFLINE or self._token_at == NEVER:
            return NEVER
        if self._target is Mode.OFFLINE:
            return max(self._token_at, self._poll_at, self._end_at) + _SILENCE
        return max(self._token_at, self._poll_at) + self._silence

    def tick(self, now: int) -> None:
        """No token for long: say so, or end an end that cannot be sent any more. (The watch is moved on only here.)"""
        quiet_at = self._quiet_at()
        if now < quiet_at:
            self._watch_at = quiet_at
            return
        self._line_lost("this station holds no token", now)

    def _line_lost(self, reason: str, now: int) -> None:
        self._token_at = self._watch_at = NEVER
        self._open = False
        self._round_at = 0
        self._not_before = 0
        self._farewells.clear()
        for handler in self.handlers.values():
            handler.line_lost(reason, now)
        if self._target < self.mode:
            self._reach(self._target, now)
