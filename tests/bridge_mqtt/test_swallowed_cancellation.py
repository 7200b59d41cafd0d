"""The face ends although a library has swallowed the cancellation of its task."""

from __future__ import annotations

import asyncio
import contextlib

import pytest

from dpstack.bridge.mqtt.connection import cancellations, end_if_cancelled


async def test_a_swallowed_cancellation_ends_the_task_after_all() -> None:
    async def work() -> None:
        before = cancellations()
        with contextlib.suppress(asyncio.CancelledError):  # as asyncio.wait_for of Python 3.11 now and then
            await asyncio.Event().wait()
        end_if_cancelled(before)
        raise AssertionError("it goes on")

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_the_farewell_of_a_cancelled_task_goes_on() -> None:
    """It begins when the task is being cancelled already."""

    async def work() -> str:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.Event().wait()
        before = cancellations()
        await asyncio.sleep(0)
        end_if_cancelled(before)
        return "said"

    task = asyncio.create_task(work())
    await asyncio.sleep(0)
    task.cancel()
    assert await task == "said"
