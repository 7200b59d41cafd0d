"""Work that goes on through cancellations: nothing of its outcome is lost, and nothing is reported as lost."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest
from lost_errors import no_lost_errors

from dpstack.drivers.futures import run_through_cancellation


async def test_an_error_under_a_cancellation_is_its_cause_and_not_reported_as_lost() -> None:
    reported: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context))
    released = asyncio.Event()

    async def order() -> None:
        await released.wait()
        raise OSError("the order was dropped")

    caller = asyncio.ensure_future(run_through_cancellation(order()))
    await asyncio.sleep(0)
    caller.cancel()
    await asyncio.sleep(0)
    assert not caller.done()
    released.set()
    with pytest.raises(asyncio.CancelledError) as caught:
        await caller
    assert caller.cancelled()
    causes = [caught.value, caught.value.__context__]
    assert any(isinstance(one.__cause__, OSError) for one in causes if one is not None)
    del caller, caught, causes
    gc.collect()
    assert reported == []


async def test_a_run_of_tests_fails_with_the_errors_that_nobody_asked_for() -> None:
    async def fails() -> None:
        raise OSError("nobody asks for it")

    guard = no_lost_errors()
    guard.__enter__()
    await asyncio.wait([asyncio.ensure_future(fails())])
    with pytest.raises(AssertionError, match=r"exception was never retrieved\n.*OSError\('nobody asks for it'\)"):
        guard.__exit__(None, None, None)
    with no_lost_errors():
        await asyncio.gather(fails(), return_exceptions=True)
