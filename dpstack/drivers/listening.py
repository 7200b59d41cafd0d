"""Finding the baud rate at a port: the search listens, the driver lets the port follow it from rate to rate."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from time import monotonic_ns

from dpstack.drivers.aio import AsyncioRuntime, patience_of, settle_ns_of
from dpstack.drivers.base import PortLost
from dpstack.drivers.echo import Echo
from dpstack.errors import PortError
from dpstack.fdl.autobaud import AutoBaud, BaudFound, BaudNotFound
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
    result: asyncio.Future[BaudFound | BaudNotFound] = asyncio.get_running_loop().create_future()

    def told(events: list[Event]) -> None:
        for event in events:
            if result.done():
                return
            match event:
                case BaudFound() | BaudNotFound():
                    result.set_result(event)
                case PortLost(reason=reason):
                    result.set_exception(PortError(f"{port.name} vanished while listening: {reason}"))

    def failed(error: Exception) -> None:
        if not result.done():
            result.set_exception(error)

    search = AutoBaud(
        monotonic_ns(),
        rates=rates,
        silence_ns=silence_ns,
        limit_ns=limit_ns,
        slack_ns=patience_of(port).known_ns,
        settle_ns=settle_ns_of(port),
    )
    runtime = AsyncioRuntime(port, search, told, echo=Echo.OFF, on_failure=failed)
    await runtime.open()
    try:
        return await result
    finally:
        await runtime.close()
