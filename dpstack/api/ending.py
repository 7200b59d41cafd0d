"""The ordered end of a bus by its application: the steps are :class:`dpstack.drivers.ending.EndSteps`."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from dpstack.drivers.base import END_LIMIT
from dpstack.drivers.ending import EndSteps
from dpstack.errors import DpError
from dpstack.trace import Event
from dpstack.units import ns_to_s

if TYPE_CHECKING:
    from dpstack.api.bus import Bus


class OrderedEnd:
    """How far the end of ``bus`` is, by its events."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._steps: EndSteps | None = None

    def on_event(self, event: Event) -> None:
        """The master has stopped, the ring was left."""
        if self._steps is not None:
            self._steps.on_event(event)

    async def carry_out(self) -> None:
        """All of it, as far as the bus still can."""
        bus = self._bus
        steps = self._steps = EndSteps(bus.station)
        limit = ns_to_s(END_LIMIT) + 10 * bus.rotation_limit_s
        while (order := steps.next_order()) is not None:
            # a bus that can no longer do it does not hold the program up
            with contextlib.suppress(TimeoutError, DpError):
                bus.command(order)
                await bus.until(lambda: steps.done, limit)
        now = bus.runtime.now()
        # no event: no port tells when the last bit is on the wire, only time does
        await asyncio.sleep(ns_to_s(steps.over_at(now) - now))
