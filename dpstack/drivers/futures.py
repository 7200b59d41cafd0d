"""Waiting for futures of asyncio through cancellations; orders that take effect at once."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


async def wait_through_cancellation(future: asyncio.Future[Any]) -> None:
    """Wait until ``future`` is done, through any number of cancellations; then re-raise the cancellation, if any.

    ``future`` itself is not cancelled and keeps its exception. ``task.cancelling()`` counts every request as usual. Of
    several cancellations the one without a message is raised: anyio marks its own cancellations by a message, and
    swallows them at the end of their scope.
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


async def run_through_cancellation(doing: Coroutine[Any, Any, T]) -> T:
    """Do all of ``doing`` in a task of its own, through any number of cancellations; then re-raise the cancellation.

    An error of ``doing`` is then the cause of the cancellation.
    """
    task = asyncio.ensure_future(doing)
    try:
        await wait_through_cancellation(task)
    except asyncio.CancelledError as cancelled:
        if not task.cancelled() and (error := task.exception()) is not None:  # asyncio logs one that nobody looks at
            raise cancelled from error
        raise
    return task.result()


class ActsAtOnce:
    """Orders and outputs of a driver whose machine runs in the application's process: they take effect at once."""

    def command(self, command: object) -> None:
        raise NotImplementedError

    async def hand_over_outputs(self) -> None:
        """The machine has the outputs as soon as they are set."""

    def order(self, command: object) -> asyncio.Future[object]:
        """:meth:`command` with its outcome in a future that is done."""
        done: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        try:
            self.command(command)
        except Exception as error:
            done.set_exception(error)
        else:
            done.set_result(None)
        return done
