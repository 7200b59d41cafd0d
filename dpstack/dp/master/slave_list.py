"""The slaves of a master while the bus runs: added, removed, taken out of service, parameterised anew.

A slave that is given up gets safe values as at the end, comes out of SYNC, then Unlock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final

from dpstack.dp.master.commands import ActivateSlave, AddSlave, DeactivateSlave, RemoveSlave, ReparameteriseSlave
from dpstack.dp.master.diag_reader import DiagObserver
from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.dp.master.global_control import Controls
from dpstack.dp.master.poll_order import Turns
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.services import unlock_prm
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SAP_SET_PRM, SSAP_MS0, Req
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

#: Safe values stand at least so long, because drives look at their outputs only every 4 to 32 ms, and Clear's zeros
#: mean nothing to some of them: docs/decisions/master.md#safe-values-on-the-way-out
SAFE_HOLD: Final = 50 * NS_PER_MS


@dataclass(slots=True)
class Leaving:
    """Who is leaving; the tag of its requests."""

    handler: SlaveHandler
    until: int  # safe values until then
    held: bool  # it is in SYNC or FREEZE: safe values are to reach its outputs
    safe: bool = False  # it was sent safe values


class Farewells:
    """Who is leaving: one request a round to each until it is unlocked."""

    __slots__ = ("_leaving", "_turns")

    def __init__(self) -> None:
        self._leaving: deque[Leaving] = deque()
        self._turns = 0

    def __bool__(self) -> bool:
        return bool(self._leaving)

    def add(self, handler: SlaveHandler, now: int, *, exchanging: bool, held: bool) -> None:
        """Begin with the next round; a slave that was parameterised only has no outputs to make safe.

        ``exchanging``: it has outputs. ``held``: in SYNC or FREEZE by our order.
        """
        if handler.owned and not self.awaits(handler.setup.address):
            self._leaving.append(Leaving(handler, now + SAFE_HOLD if exchanging else now, held and exchanging))

    def awaits(self, address: int) -> bool:
        """Whether the slave at ``address`` is not unlocked yet."""
        return any(leaving.handler.setup.address == address for leaving in self._leaving)

    def clear(self) -> None:
        """Nothing can be sent any more: the slaves' watchdogs do the rest."""
        self._leaving.clear()
        self._turns = 0

    def begin_round(self) -> None:
        """One request to each follows."""
        self._turns = len(self._leaving)

    def request(self, now: int, spaced: Mapping[int, int], *, clear: bool) -> Request | None:
        """The next request of this round, or None. ``clear``: the master is in Clear; ``spaced``: by address, no
        Data_Exchange before this time.
        """
        while self._turns:
            self._turns -= 1
            leaving = self._leaving.popleft()
            request = self._next(leaving, now, spaced, clear)
            if request is not None:
                return request
        return None

    def _next(self, leaving: Leaving, now: int, spaced: Mapping[int, int], clear: bool) -> Request | None:
        setup = leaving.handler.setup
        if leaving.held and leaving.safe:
            leaving.held = False
            self._leaving.append(leaving)
            data = GlobalControl(clear=clear, unsync=True, unfreeze=True).build()
            return Request(setup.address, Req.SDN_HIGH, data, SAP_GLOBAL_CONTROL, SSAP_MS0)
        if now < leaving.until or leaving.held:
            self._leaving.append(leaving)
            if now < spaced.get(setup.address, 0):
                return None
            leaving.safe = True
            safe = leaving.handler.unit.safe_outputs()
            return Request(setup.address, Req.SRD_HIGH, safe, patient=True, tag=leaving)
        leaving.handler.owned = False
        data = unlock_prm(setup, leaving.handler.ident)
        return Request(setup.address, Req.SRD_HIGH, data, SAP_SET_PRM, SSAP_MS0, patient=True)


Change = AddSlave | RemoveSlave | DeactivateSlave | ActivateSlave | ReparameteriseSlave


class Roster:
    """Who is handled, in ``handlers`` by address. ``sending``: whether anything may be sent to slaves now.

    ``check`` raises ConfigError for a slave that does not go with the cycle. ``still``: whether outputs may still be
    sent; ``look_soon()`` is called when a slave came into data exchange or left it.

    Every change is checked as a whole before anything happens.
    """

    def __init__(
        self,
        params: BusParams,
        handlers: dict[int, SlaveHandler],
        *,
        watchdog_ms: int,
        turns: Turns,
        farewells: Farewells,
        controls: Controls,
        sending: Callable[[], bool],
        emit: Callable[[Event], None],
        check: Callable[[SlaveParams], None],
        masters: Callable[[], Collection[int] | None],
        still: Callable[[int], bool],
        look_soon: Callable[[], None],
    ) -> None:
        self._params = params
        self._handlers = handlers
        self._watchdog_ms = watchdog_ms
        self._turns = turns
        self._farewells = farewells
        self._controls = controls
        self._sending = sending
        self._emit = emit
        self._check = check
        self._masters = masters
        self._still = still
        self._look_soon = look_soon
        #: gives the observer of the diagnoses of a slave; ``before``: its handling under other parameters
        self.observer: Callable[[SlaveHandler, SlaveHandler | None], DiagObserver | None] = lambda _, before: None

    def find(self, address: int) -> SlaveHandler:
        """The handling of the slave at ``address``. Raises UsageError naming those there are."""
        handler = self._handlers.get(address)
        if handler is None:
            known = ", ".join(map(str, sorted(self._handlers))) or "none"
            raise UsageError(f"no slave with address {address} is configured (configured: {known})")
        return handler

    def command(self, command: Change, now: int) -> None:
        """Carry out one change. Raises UsageError or ConfigError before anything is changed."""
        match command:
            case AddSlave(setup):
                self.add(setup)
            case RemoveSlave(address):
                self._remove(self.find(address), now)
            case DeactivateSlave(address):
                handler = self.find(address)
                self._bid_farewell(handler, now, exchanging=handler.state is SlaveState.DATA_EXCHANGE)
                handler.deactivate(now)
            case ActivateSlave(address):
                self.find(address).activate(now)
            case ReparameteriseSlave(setup):
                before = self.find(setup.address)
                handler = self._make(setup, before)
                self._remove(before, now)
                self._handlers[setup.address] = handler
                self._emit(SlaveStateChanged(t_ns=now, address=setup.address, name=setup.name, state=handler.state))

    def add(self, setup: SlaveParams) -> None:
        """Take up one more. Raises ConfigError."""
        if setup.address in self._handlers:
            other = self._handlers[setup.address].setup.name
            raise ConfigError(f"slaves {other} and {setup.name} both have address {setup.address}")
        if setup.address == self._params.address:
            raise ConfigError(f"slave {setup.name} has the master's own address {setup.address}")
        self._handlers[setup.address] = self._make(setup)
        self._turns.changed()

    def _make(self, setup: SlaveParams, before: SlaveHandler | None = None) -> SlaveHandler:
        self._check(setup)
        handler = SlaveHandler(
            setup,
            own=self._params.address,
            baud=self._params.baud,
            watchdog_ms=self._watchdog_ms,
            emit=self._emit,
            changed=self._changed,
            masters=self._masters,
            before=before,
            still=self._still,
        )
        handler.diagnoses.observer = self.observer(handler, before)
        return handler

    def _remove(self, handler: SlaveHandler, now: int) -> None:
        """Safe values as at the end, then Unlock, then it is forgotten."""
        self._bid_farewell(handler, now, exchanging=handler.state is SlaveState.DATA_EXCHANGE)
        del self._handlers[handler.setup.address]
        self._turns.forget(handler)
        handler.unit.lost(now)
        handler.diagnoses.closed(now)
        handler.image.valid = False
        handler.state = SlaveState.OFFLINE  # nothing more for it in this round

    def _bid_farewell(self, handler: SlaveHandler, now: int, *, exchanging: bool) -> None:
        address = handler.setup.address
        if self._sending():
            self._farewells.add(handler, now, exchanging=exchanging, held=self._controls.holds(address))
        self._controls.forget(address)

    def _changed(self, handler: SlaveHandler, now: int) -> None:
        """It reached another state: what comes into data exchange is told the mode, what ends there ill is given up."""
        self._turns.changed()
        self._look_soon()
        was_exchanging = handler in self._turns.exchanging
        if handler.state is SlaveState.DATA_EXCHANGE and not was_exchanging:
            self._controls.entered(handler)
        elif handler.state is SlaveState.FAULT and was_exchanging and handler.owned:
            self._bid_farewell(handler, now, exchanging=True)  # or it keeps its last outputs until its watchdog
