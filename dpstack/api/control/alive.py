"""Orders that take their time: their client is told that they go on, and one that hangs up ends them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable, Coroutine
from typing import Any, Final

from dpstack.api.control.server import Result

#: how often the client of an order is told that it goes on, in s: without its answer it would take us for dead
_SIGN_OF_LIFE_S: Final = 0.5


async def kept_alive(work: Coroutine[Any, Any, object], sign: Callable[[], object]) -> AsyncGenerator[object, None]:
    """``sign()`` as items until ``work`` is done, then its result."""
    order = asyncio.ensure_future(work)
    try:
        while not (await asyncio.wait({order}, timeout=_SIGN_OF_LIFE_S))[0]:
            yield sign()
        yield Result(order.result())
    finally:
        order.cancel()
        with contextlib.suppress(asyncio.CancelledError, Exception):
            await order
