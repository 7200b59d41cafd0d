"""Search for the baud rate of a bus: listens on a port at one rate after the other and sends nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from time import monotonic_ns

from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.line.rate import settle_ns_of
from dpstack.drivers.runtime import PortLost, Runtime
from dpstack.drivers.virtual.runtime import SimulatedBus, VirtualRuntime
from dpstack.errors import PortError
from dpstack.fdl.baud_search import AutoBaud, BaudFound, BaudNotFound
from dpstack.ports import Port
from dpstack.trace import Event
from dpstack.units import BAUD_RATES, NEVER


async def search_baud(
    port: Port, *, silence_ns: int = NEVER, limit_ns: int = NEVER, rates: Sequence[int] = BAUD_RATES
) -> BaudFound | BaudNotFound:
    """Open ``port``, listen until its rate is found or given up (see :class:`AutoBaud`), and close it.

    Nothing is sent. Rates that the port cannot do are left out. Raises PortError where it cannot be opened, vanishes,
    or is of a kind whose rate cannot be changed; ConfigError where it can do none of ``rates``.
    """
    search = AutoBaud(
        monotonic_ns(),
        rates=rates,
        silence_ns=silence_ns,
        limit_ns=limit_ns,
        slack_ns=patience_of(port).known_ns,
        settle_ns=settle_ns_of(port),
    )
    outcome = _Outcome(port.name)
    runtime = AsyncioRuntime(port, search, outcome.on_events, echo=Echo.OFF, on_failure=outcome.on_failure)
    return await outcome.of(runtime)


async def search_in(world: SimulatedBus, *, silence_ns: int = NEVER, limit_ns: int = NEVER) -> BaudFound | BaudNotFound:
    """As :func:`search_baud`, on a simulated bus."""
    outcome = _Outcome("the simulated bus")
    search = AutoBaud(world.now, silence_ns=silence_ns, limit_ns=limit_ns)
    runtime = VirtualRuntime(world, search, outcome.on_events, on_failure=outcome.on_failure)
    return await outcome.of(runtime)


class _Outcome:
    """Result of a search, from the events of the search and of the port."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._result: asyncio.Future[BaudFound | BaudNotFound] = asyncio.get_running_loop().create_future()

    async def of(self, runtime: Runtime) -> BaudFound | BaudNotFound:
        await runtime.open()
        try:
            return await self._result
        finally:
            await runtime.close()

    def on_events(self, events: list[Event]) -> None:
        for event in events:
            if self._result.done():
                return
            match event:
                case BaudFound() | BaudNotFound():
                    self._result.set_result(event)
                case PortLost(reason=reason):
                    self._result.set_exception(PortError(f"{self._where} vanished while listening: {reason}"))

    def on_failure(self, error: Exception) -> None:
        if not self._result.done():
            self._result.set_exception(error)
