"""Futures of asyncio as the drivers use them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


async def outlast(future: asyncio.Future[Any]) -> None:
    """Wait until ``future`` is done, through any number of cancellations; then re-raise the cancellation, if any.

    ``future`` itself is not cancelled, what it raises stays in it, and ``task.cancelling()`` counts every request as
    ever. Of several cancellations the one without a message is raised: anyio marks its own by a message, and swallows
    them where its scope ends.
    """
    cancelled: asyncio.CancelledError | None = None
    while not future.done():
        try:
            await asyncio.wait([future])
        except asyncio.CancelledError as error:
            if cancelled is None or cancelled.args:
                cancelled = error
    if cancelled is not None:
        raise cancelled


async def whole(doing: Coroutine[Any, Any, T]) -> T:
    """Do all of ``doing`` in a task of its own, through any number of cancellations; then re-raise the cancellation."""
    task = asyncio.ensure_future(doing)
    await outlast(task)
    return task.result()


def carried_out(act: Callable[[], None]) -> asyncio.Future[object]:
    """What :meth:`dpstack.drivers.runtime.Runtime.order` returns where ``act`` carries the order out at once."""
    done: asyncio.Future[object] = asyncio.get_running_loop().create_future()
    try:
        act()
    except Exception as error:
        done.set_exception(error)
    else:
        done.set_result(None)
    return done
