"""The slaves of a master while the bus runs: added, removed, taken out of service, parameterised anew.

A slave that is removed gets its farewell: safe values, then UNSYNC and UNFREEZE if necessary, then Unlock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Final

from msgspec import Struct, field

from dpstack.dp.master.commands import ActivateSlave, AddSlave, DeactivateSlave, Mode, RemoveSlave, ReparameteriseSlave
from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.dp.master.fixed_cycle import Cadence
from dpstack.dp.master.global_control import Controls
from dpstack.dp.master.outputs_watch import OutputsWatch
from dpstack.dp.master.poll_order import Turns
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.master.slave_reports import NO_ALARMS, DiagObserver
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.services import unlock_prm
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SAP_SET_PRM, SSAP_MS0, Req
from dpstack.units import NS_PER_MS

#: Safe values stand at least this long, because drives look at their outputs only every 4 to 32 ms, and Clear's zeros
#: mean nothing to some of them: docs/reference/decisions/master.md#safe-values-on-the-way-out
SAFE_HOLD: Final = 50 * NS_PER_MS


class Leaving(Struct):
    """A slave that is being removed. Its instance tags the requests of its farewell."""

    handler: SlaveHandler
    until: int  # safe values are sent until this time in ns
    held: bool  # the slave is in SYNC or FREEZE and must be released so that safe values reach its outputs
    safe: bool = False  # safe values were sent to the slave


#: returns the observer of the diagnoses of a slave; arguments: its handler, and its handler under the parameters before
ObserverOf = Callable[[SlaveHandler, SlaveHandler | None], DiagObserver]


class Roster(Struct, eq=False):
    """The slaves in ``handlers`` by address, and those ``leaving``: one request a round to each until it is unlocked.

    Every change is checked as a whole before anything happens.
    """

    _context: MasterContext
    _handlers: dict[int, SlaveHandler]
    _turns: Turns
    _controls: Controls
    _cadence: Cadence
    _watch: OutputsWatch
    leaving: deque[Leaving] = field(default_factory=deque)
    _farewells: int = 0  # still to be sent in this round
    _observer: ObserverOf = lambda _handler, _before: NO_ALARMS

    def observe(self, observer: ObserverOf) -> None:
        """Set the function that returns the observer of each slave's diagnoses."""
        self._observer = observer
        for handler in self._handlers.values():
            handler.reports.observer = observer(handler, None)

    def find(self, address: int) -> SlaveHandler:
        """The handler of the slave at ``address``. Raises UsageError with the list of configured addresses."""
        handler = self._handlers.get(address)
        if handler is None:
            known = ", ".join(map(str, sorted(self._handlers))) or "none"
            raise UsageError(f"no slave with address {address} is configured (configured: {known})")
        return handler

    def command(self, command: object, now: int) -> bool:
        """Carry out one change; False for another command. Raises UsageError or ConfigError before any change."""
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
                handler.reports.event(SlaveStateChanged, now, state=handler.state)
            case _:
                return False
        return True

    def add(self, setup: SlaveParams) -> None:
        """Add one slave. Raises ConfigError."""
        if setup.address in self._handlers:
            other = self._handlers[setup.address].setup.name
            raise ConfigError(f"slaves {other} and {setup.name} both have address {setup.address}")
        if setup.address == self._context.params.address:
            raise ConfigError(f"slave {setup.name} has the master's own address {setup.address}")
        self._handlers[setup.address] = self._make(setup)
        self._turns.request_sort()

    def _make(self, setup: SlaveParams, before: SlaveHandler | None = None) -> SlaveHandler:
        self._cadence.check(setup)
        self._controls.check(setup)
        handler = SlaveHandler(setup, self._context, self._changed, self._watch.still_fresh, before)
        handler.reports.observer = self._observer(handler, before)
        return handler

    def _remove(self, handler: SlaveHandler, now: int) -> None:
        """Begin the farewell of the slave and forget its handler."""
        self._bid_farewell(handler, now, exchanging=handler.state is SlaveState.DATA_EXCHANGE)
        del self._handlers[handler.setup.address]
        handler.reports.mark_changed()
        self._turns.forget(handler)
        handler.interrupted(now)
        handler.reports.observer.closed(now)
        handler.image.valid = False
        handler.state = SlaveState.OFFLINE  # nothing more for it in this round

    def _changed(self, handler: SlaveHandler, now: int) -> None:
        """A slave reached another state: send the mode to one that entered data exchange, bid farewell to one that left
        it by a fault."""
        self._turns.request_sort()
        self._watch.look_soon()
        was_exchanging = handler in self._turns.exchanging
        if handler.state is SlaveState.DATA_EXCHANGE and not was_exchanging:
            self._controls.entered(handler)
        elif handler.state is SlaveState.FAULT and was_exchanging and handler.owned:
            self._bid_farewell(handler, now, exchanging=True)  # else it keeps its last outputs

    # --- farewells ----------------------------------------------------------------------------------------------

    def _bid_farewell(self, handler: SlaveHandler, now: int, *, exchanging: bool) -> None:
        """Begin the farewell with the next round. ``exchanging``: the slave has outputs that must become safe first."""
        address = handler.setup.address
        if self._context.mode > Mode.STOP and handler.owned and not self.is_leaving(address):
            held = exchanging and self._controls.holds(address)
            self.leaving.append(Leaving(handler, now + SAFE_HOLD if exchanging else now, held))
        self._controls.forget(address)

    def is_leaving(self, address: int) -> bool:
        """Whether the slave at ``address`` is not unlocked yet."""
        return any(leaving.handler.setup.address == address for leaving in self.leaving)

    def clear_farewells(self) -> None:
        """Drop all farewells, because nothing can be sent any more. The slaves' watchdogs make their outputs safe."""
        self.leaving.clear()
        self._farewells = 0

    def begin_round(self) -> None:
        """Allow one request to each leaving slave in this round."""
        self._farewells = len(self.leaving)

    def farewell(self, now: int, spaced: Mapping[int, int]) -> Request | None:
        """The next request of this round to a slave that leaves, or None.

        ``spaced``: by address, no Data_Exchange before this time.
        """
        while self._farewells:
            self._farewells -= 1
            leaving = self.leaving.popleft()
            request = self._next(leaving, now, spaced)
            if request is not None:
                return request
        return None

    def _next(self, leaving: Leaving, now: int, spaced: Mapping[int, int]) -> Request | None:
        setup = leaving.handler.setup
        if leaving.held and leaving.safe:
            leaving.held = False
            self.leaving.append(leaving)
            data = GlobalControl(clear=self._context.mode is Mode.CLEAR, unsync=True, unfreeze=True).build()
            return Request(setup.address, Req.SDN_HIGH, data, SAP_GLOBAL_CONTROL, SSAP_MS0, cyclic=True)
        if now < leaving.until or leaving.held:
            self.leaving.append(leaving)
            if now < spaced.get(setup.address, 0):
                return None
            leaving.safe = True
            safe = leaving.handler.plugin_host.safe_outputs()
            return Request(setup.address, Req.SRD_HIGH, safe, patient=True, tag=leaving, cyclic=True)
        leaving.handler.owned = False
        data = unlock_prm(setup, leaving.handler.ident)
        return Request(setup.address, Req.SRD_HIGH, data, SAP_SET_PRM, SSAP_MS0, patient=True, cyclic=True)
