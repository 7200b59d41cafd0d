"""The ordered end of a bus: safe values, Clear twice, class 2 connections given back, out of the ring, the last bit out
of the port.

:class:`EndSteps` is the rule, for every driver. An application carries it out in its event loop
(:mod:`dpstack.api.bus.shutdown`). :class:`Ending` carries it out in a :class:`SelectLoop`: in a bus process without its
application, and in :func:`dpstack.drivers.line.asyncio_runtime.end_on_port`, where the application's event loop can
run no more.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from time import monotonic_ns
from typing import TYPE_CHECKING, Final

from dpstack.dp.master.commands import Shutdown
from dpstack.dp.master.events import MasterStopped
from dpstack.dpv1.master.alarm_orders import CloseConnections, ConnectionsClosed
from dpstack.drivers.runtime import END_LIMIT, last_bits_ns
from dpstack.errors import DpError
from dpstack.fdl.commands import GoOffline
from dpstack.fdl.events import RingLeft
from dpstack.params import BusParams
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

if TYPE_CHECKING:  # the application of a bus process has no machines
    from dpstack.drivers.line.select_loop import Alarm, SelectLoop
    from dpstack.fdl.active.station import ActiveStation

EndOrder = Shutdown | CloseConnections | GoOffline

#: Longest time of a hurried end, whose callers promise to end the program within a second.
HURRY_NS: Final = 800 * NS_PER_MS
_STEPS: Final = 3
#: Signals that a fault of the program raises: a handler in Python would be called for ever.
_OF_FAULTS: Final = frozenset({"SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP"})
#: Signals that do not end a program without a handler, and SIGKILL; Python ignores SIGPIPE and SIGXFSZ.
_NO_END: Final = frozenset(
    {
        *("SIGCHLD", "SIGCONT", "SIGKILL", "SIGPIPE", "SIGSTOP", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGURG"),
        *("SIGWINCH", "SIGXFSZ"),
    }
)
_ROTATIONS: Final = 10


def ending_signals() -> list[int]:
    """Signals that end a program without a handler and may come from outside; real-time signals are among them."""
    out = {getattr(signal, name) for name in _OF_FAULTS | _NO_END if hasattr(signal, name)}
    return sorted(int(number) for number in signal.valid_signals() if number not in out)


def signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def end_limit_ns(params: BusParams, rotation_ns: int) -> int:
    """The longest time the end of a bus takes in ns, whatever the port and other masters do: END_LIMIT and ten
    rotations of ``rotation_ns`` for each of its three steps, and the last telegram's time."""
    return _STEPS * step_limit_ns(rotation_ns) + last_bits_ns(params)


def step_limit_ns(rotation_ns: int) -> int:
    """Time limit of one step of the end in ns."""
    return END_LIMIT + _ROTATIONS * rotation_ns


class EndSteps:
    """The orders of the end of a bus, one by one, and whether the bus has carried out the last one.

    The caller waits for each order at most :func:`step_limit_ns`, then gives the next one even if the bus did not carry
    it out. After :meth:`hurry` class 2 connections are not closed, and the end takes at most :data:`HURRY_NS`.
    """

    def __init__(self, params: BusParams, in_ring: Callable[[], bool]) -> None:
        self._params = params
        self._in_ring = in_ring
        self._orders: list[EndOrder] = [GoOffline(), CloseConnections(), Shutdown()]
        self._order: EndOrder | None = None
        self._at_ns = 0
        self._hurried_at: int | None = None
        #: the last order was carried out
        self.done = False
        #: the master has sent safe values and Clear; None while it has not reported either result
        self.cleared: bool | None = None

    def hurry(self, now: int) -> None:
        """Skip what is not needed to make outputs safe. Further calls change nothing."""
        if self._hurried_at is None:
            self._hurried_at = now
            self._orders = [order for order in self._orders if not isinstance(order, CloseConnections)]
            self.done |= isinstance(self._order, CloseConnections)

    def next_order(self) -> EndOrder | None:
        """The next order; None after the last one: then wait until :meth:`over_at`."""
        if not self._orders:
            return None
        order = self._order = self._orders.pop()
        # a station outside the ring has no token to pass on; it may have left the ring and come back before
        self.done = isinstance(order, GoOffline) and not self._in_ring()
        return order

    def wait_until(self, begun: int, rotation_ns: int) -> int:
        """End (ns) of the wait for the order given at ``begun``."""
        limit = begun + step_limit_ns(rotation_ns)
        return limit if self._hurried_at is None else min(limit, self._hurried_at + HURRY_NS)

    def on_event(self, event: Event) -> None:
        """Note events that complete an order: master stopped, connections closed, ring left."""
        if isinstance(event, MasterStopped):
            self.cleared = event.cleared
        match event, self._order:
            case (MasterStopped(), Shutdown()) | (ConnectionsClosed(), CloseConnections()) | (RingLeft(), GoOffline()):
                self.done = True
                self._at_ns = event.t_ns

    def over_at(self, now: int) -> int:
        """Time (ns) of the last bit of the last telegram: the port may be closed then."""
        return max(self._at_ns, now) + last_bits_ns(self._params)


class Ending:
    """Carries out the end in ``loop``. ``give`` hands each order to the driver and raises DpError if that is down.

    The end begins only once. ``finished`` is called with the reason at its end or after its time limit.
    """

    def __init__(
        self,
        loop: SelectLoop,
        give: Callable[[EndOrder], None],
        station: ActiveStation,
        longest_rotation: Callable[[], int],
        finished: Callable[[str], None],
    ) -> None:
        self._loop = loop
        self._give = give
        self._longest_rotation = longest_rotation
        self.steps = EndSteps(station.params, lambda: station.in_ring)
        self._finished = finished
        self._why: str | None = None
        self._limit: Alarm | None = None

    def begin(self, why: str) -> None:
        """Begin, because of ``why``. Further calls change nothing."""
        if self._why is None:
            self._why = why
            self._advance()

    def on_events(self, events: list[Event]) -> None:
        if self._why is not None:
            for event in events:
                self.steps.on_event(event)
            self._go_on()

    def _go_on(self) -> None:
        """Go on in the next turn of the loop, not within the machine that reported the event."""
        if self.steps.done and self._limit is not None:
            self._limit.close()
            self._limit = None
            self._loop.call_soon(self._advance)

    def _advance(self) -> None:
        steps = self.steps
        order = steps.next_order()
        now = monotonic_ns()
        if order is None:
            self._limit = None
            self._loop.call_at(steps.over_at(now), self._finish)
            return
        self._limit = self._loop.call_at(steps.wait_until(now, self._longest_rotation()), self._advance)
        try:
            self._give(order)
        except DpError:  # the driver is down: nothing can be sent any more
            steps.done = True
        self._go_on()

    def _finish(self) -> None:
        assert self._why is not None
        self._finished(self._why)


def at_slaves(watchdogs: Mapping[str, int]) -> str:
    """Text about the reaction of slaves to a master that has fallen silent. ``watchdogs``: in ns by name, 0 is off."""
    if not watchdogs:
        return "No slave was in data exchange"
    off = sorted(name for name, ns in watchdogs.items() if not ns)
    longest = max(watchdogs.values()) // NS_PER_MS
    words = [f"The slaves' watchdogs make their outputs safe within {longest} ms"] if longest else []
    if off:
        words.append(f"{', '.join(off)} without watchdog keep{'s' if len(off) == 1 else ''} the last outputs")
    return "; ".join(words)
