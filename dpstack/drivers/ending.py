"""The ordered end of a bus: safe values, Clear twice, class 2 connections given back, out of the ring, the last bit out
of the port.

:class:`EndSteps` is the rule, for every driver; :class:`Ending` is who carries it out in a bus process whose
application cannot (an application does it itself, :mod:`dpstack.api.ending`).
"""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns

from dpstack.dp.commands import Shutdown
from dpstack.dp.events import MasterStopped
from dpstack.dp.v1.ms2_orders import CloseConnections, ConnectionsClosed
from dpstack.drivers.base import END_LIMIT, last_bits_ns
from dpstack.drivers.plain import PlainRuntime
from dpstack.drivers.plain_loop import Alarm, PlainLoop
from dpstack.drivers.seen import StationSeen
from dpstack.drivers.stack import Stack
from dpstack.errors import DpError
from dpstack.fdl.commands import GoOffline
from dpstack.fdl.events import RingLeft
from dpstack.trace import Event

EndOrder = Shutdown | CloseConnections | GoOffline


class EndSteps:
    """The orders of the end of ``station``'s bus, one by one, and whether the last one given was carried out.

    Who gives them waits for each no longer than :data:`~dpstack.drivers.base.END_LIMIT` and ten rotations: a bus that
    can no longer do a step is taken to the next.
    """

    def __init__(self, station: StationSeen) -> None:
        self._station = station
        self._orders: list[EndOrder] = [GoOffline(), CloseConnections(), Shutdown()]
        self._at_ns = 0
        #: the last order was carried out
        self.done = False

    def next_order(self) -> EndOrder | None:
        """The next order; None when there is only :meth:`over_at` to be waited for."""
        if not self._orders:
            return None
        order = self._orders.pop()
        # who has no token has nothing to hand on; it may have left and come back before
        self.done = isinstance(order, GoOffline) and not self._station.in_ring
        return order

    def on_event(self, event: Event) -> None:
        """The master has stopped, the connections are given back, the ring was left."""
        match event:
            case MasterStopped() if len(self._orders) == 2:
                self.done = True
            case ConnectionsClosed() if len(self._orders) == 1:
                self.done = True
            case RingLeft() if not self._orders:
                self.done = True
            case _:
                return
        self._at_ns = event.t_ns

    def over_at(self, now: int) -> int:
        """When the last bit of the last telegram is out and the port may be closed (ns)."""
        return max(self._at_ns, now) + last_bits_ns(self._station.params)


class Ending:
    """Begun once; ``finished`` is called with the reason when it is through, or took too long."""

    def __init__(self, loop: PlainLoop, runtime: PlainRuntime, stack: Stack, finished: Callable[[str], None]) -> None:
        self._loop = loop
        self._runtime = runtime
        self._master = stack.master
        self._steps = EndSteps(stack.station)
        self._finished = finished
        self._why: str | None = None
        self._limit: Alarm | None = None

    def begin(self, why: str) -> None:
        """Begin, because of ``why``. Further calls change nothing."""
        if self._why is None:
            self._why = why
            self._advance()

    def on_event(self, event: Event) -> None:
        """How far it is."""
        if self._why is not None:
            self._steps.on_event(event)
            self._go_on()

    def _go_on(self) -> None:
        """Once a step: not from within the machine that told of it."""
        if self._steps.done and self._limit is not None:
            self._limit.close()
            self._limit = None
            self._loop.call_soon(self._advance)

    def _advance(self) -> None:
        order = self._steps.next_order()
        now = monotonic_ns()
        if order is None:
            self._limit = None
            self._loop.call_at(self._steps.over_at(now), self._finish)
            return
        self._limit = self._loop.call_at(now + END_LIMIT + 10 * self._master.rotation.max_ns, self._advance)
        try:
            self._runtime.command(order)
        except DpError:  # the driver is down: nothing can be sent any more
            self._steps.done = True
        self._go_on()

    def _finish(self) -> None:
        assert self._why is not None
        self._finished(self._why)
