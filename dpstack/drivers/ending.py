"""The ordered end of a bus without an application: safe values, Clear twice, out of the ring, the last bit out."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic_ns

from dpstack.dp.commands import Shutdown
from dpstack.dp.events import MasterStopped
from dpstack.drivers.base import END_LIMIT, last_bits_ns
from dpstack.drivers.plain import PlainRuntime
from dpstack.drivers.plain_loop import PlainLoop
from dpstack.drivers.stack import Stack
from dpstack.errors import DpError
from dpstack.fdl.commands import GoOffline
from dpstack.fdl.events import RingLeft
from dpstack.trace import Event


class Ending:
    """Begun once; ``finished`` is called with the reason when it is through, or took too long."""

    def __init__(self, loop: PlainLoop, runtime: PlainRuntime, stack: Stack, finished: Callable[[str], None]) -> None:
        self._loop = loop
        self._runtime = runtime
        self._stack = stack
        self._finished = finished
        self._why: str | None = None
        self._leaving = False
        self._through = False

    def begin(self, why: str) -> None:
        """Begin, because of ``why``. Further calls change nothing."""
        if self._why is not None:
            return
        self._why = why
        limit = 2 * END_LIMIT + 10 * self._stack.master.rotation.max_ns
        self._loop.call_at(monotonic_ns() + limit, self._finish)
        self._order(Shutdown())

    def on_event(self, event: Event) -> None:
        """How far it is."""
        if self._why is None:
            return
        match event:
            case MasterStopped():
                self._loop.call_soon(self._leave)
            case RingLeft() if self._leaving:
                self._last_bits(event.t_ns)

    def _leave(self) -> None:
        if self._leaving:
            return
        self._leaving = True
        if self._stack.station.in_ring:
            self._order(GoOffline())
        else:
            self._last_bits(monotonic_ns())

    def _last_bits(self, at: int) -> None:
        last = last_bits_ns(self._stack.station.params)
        self._loop.call_at(max(at, monotonic_ns()) + last, self._finish)

    def _order(self, command: object) -> None:
        try:
            self._runtime.command(command)
        except DpError:  # the driver is down: nothing can be sent any more
            self._loop.call_soon(self._finish)

    def _finish(self) -> None:
        if not self._through and self._why is not None:
            self._through = True
            self._finished(self._why)
