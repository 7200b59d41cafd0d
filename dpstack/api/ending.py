"""The ordered end of a bus: safe values, Clear twice, out of the ring, the last bit out of the port."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING

from dpstack.dp.commands import Shutdown
from dpstack.dp.events import MasterStopped
from dpstack.drivers.base import END_LIMIT, last_bits_ns
from dpstack.errors import DpError
from dpstack.fdl.commands import GoOffline
from dpstack.fdl.events import RingLeft
from dpstack.trace import Event
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.bus import Bus


class OrderedEnd:
    """How far the end of ``bus`` is, by its events."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._stopped = False
        self._left = False
        self._at_ns = 0

    def on_event(self, event: Event) -> None:
        """The master has stopped, the ring was left."""
        match event:
            case MasterStopped():
                self._stopped = True
                self._at_ns = event.t_ns
            case RingLeft():
                self._left = True
                self._at_ns = event.t_ns

    async def carry_out(self) -> None:
        """All of it, as far as the bus still can."""
        bus = self._bus
        limit = ns_to_s(END_LIMIT) + 10 * bus.rotation_limit_s
        await self._ordered(Shutdown(), lambda: self._stopped, limit)
        self._left = not bus.station.in_ring  # it may have left and come back before
        await self._ordered(GoOffline(), lambda: self._left, limit)
        await asyncio.sleep(ns_to_s(max(0, self._at_ns - bus.runtime.now()) + last_bits_ns(bus.params)))

    async def _ordered(self, command: object, done: Callable[[], bool], limit: float) -> None:
        """One step of the end; a bus that can no longer do it does not hold the program up."""
        with contextlib.suppress(TimeoutError, DpError):
            self._bus.command(command)
            await self._bus.until(done, limit)
