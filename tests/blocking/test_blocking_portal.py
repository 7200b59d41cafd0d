"""The portal: calls in the loop's thread, Ctrl-C in a waiting call, callers that must not wait."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import sys
import threading
import traceback

import pytest
from api_kit import RAW
from far_ends import eventually

from dpstack import blocking
from dpstack.blocking import portal as portals
from dpstack.blocking.portal import the_portal
from dpstack.errors import UsageError
from tests.blocking.blocking_kit import interrupted


class WorkError(Exception):
    """Of a call."""


class Stubborn:
    """A call that notes its cancellations, and ends ``after`` so many of them."""

    def __init__(self, after: int) -> None:
        self.begun = threading.Event()
        self.cancelled = 0
        self.over = False
        self._after = after

    async def work(self) -> None:
        try:
            while self.cancelled < self._after:
                self.begun.set()
                try:
                    await asyncio.sleep(60)
                except asyncio.CancelledError:
                    self.cancelled += 1
            raise asyncio.CancelledError
        finally:
            self.over = True


def test_results_and_errors() -> None:
    async def double(value: int) -> int:
        return 2 * value

    async def fails() -> None:
        raise WorkError

    assert the_portal().run(double, 4) == 8
    assert the_portal().run(threading.get_ident) != threading.get_ident()
    with pytest.raises(WorkError):
        the_portal().run(fails)


def test_ctrl_c_cancels_the_call_and_waits_for_its_end() -> None:
    call = Stubborn(after=1)
    with interrupted(until=call.begun.is_set):
        the_portal().run(call.work)
    assert (call.cancelled, call.over) == (1, True)
    assert the_portal().run(lambda: "still there") == "still there"


def test_a_later_ctrl_c_leaves_the_call_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """One within a second counts as the first."""
    monkeypatch.setattr(portals, "_SAME_SIGNAL_S", 0)
    call = Stubborn(after=2)

    def second() -> None:
        eventually(lambda: call.cancelled == 1, "the cancellation")
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=second)
    thread.start()
    with interrupted(until=call.begun.is_set):
        the_portal().run(call.work)
    thread.join()
    assert (call.cancelled, call.over) == (1, False)
    for task in asyncio.all_tasks(the_portal()._loop):
        the_portal()._loop.call_soon_threadsafe(task.cancel)
    eventually(lambda: call.over, "the end of the call")


def test_sys_exit_in_a_callback_ends_nothing(caplog: pytest.LogCaptureFixture) -> None:
    the_portal()._loop.call_soon_threadsafe(sys.exit)
    assert the_portal().run(lambda: "still there") == "still there"
    (record,) = caplog.records
    assert (record.levelno, record.getMessage()) == (
        logging.ERROR,
        "SystemExit in the thread of the bus does not end the program",
    )


async def test_a_coroutine_is_sent_to_the_asynchronous_names() -> None:
    with pytest.raises(UsageError, match=r"use the asynchronous names there \(async with dpstack.open_bus"):
        the_portal().run(int)
    assert await asyncio.to_thread(the_portal().run, int) == 0
    told: list[object] = []

    def callback() -> None:
        try:
            told.append(the_portal().run(int))
        except UsageError as error:
            told.append(type(error))

    asyncio.get_running_loop().call_soon(callback)
    await asyncio.sleep(0)
    assert told == [UsageError]


async def test_a_cell_of_a_kernel_may_wait() -> None:
    """Its code, a module, runs in the event loop of the kernel, and so do callbacks of widgets."""
    cell: dict[str, object] = {"run": the_portal().run}
    exec("def helper():\n    return run(int)\nfound = helper()", cell)
    assert cell["found"] == 0
    kernel = {"__name__": "ipykernel.kernelbase"}
    exec("async def dispatch(function, *args):\n    return function(*args)", kernel)
    dispatch = kernel["dispatch"]
    assert await dispatch(the_portal().run, int) == 0  # type: ignore[operator]


def test_the_loops_own_thread_does_not_wait_for_itself() -> None:
    async def never() -> None:
        raise AssertionError

    def within() -> object:
        assert the_portal().run(int) == 0  # what does not wait is carried out at once
        return the_portal().run(never)

    with pytest.raises(UsageError, match="never was called in the thread of the bus"):
        the_portal().run(within)


def _shown(error: BaseException) -> list[str]:
    """The functions in the traceback of ``error`` as IPython and pytest show them."""
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    assert not any(frame.f_globals["__name__"].startswith("concurrent") for frame in frames)
    return [frame.f_code.co_name for frame in frames if not frame.f_locals.get("__tracebackhide__")]


def test_tracebacks_show_the_caller_and_the_bus_alone() -> None:
    with blocking.open_bus(port="virtual", baud=500_000, slaves=[{**RAW, "inputs": {"level": "u8@0"}}]) as bus:
        bus.ready()
        slave = bus.slave("raw")
        with pytest.raises(UsageError) as raised:
            slave["flap"] = True
        name = "test_tracebacks_show_the_caller_and_the_bus_alone"
        assert _shown(raised.value) == [name, "__setitem__", "update", "put_values", "output_field"]
        with pytest.raises(AttributeError) as missing:
            _ = slave.nothing  # type: ignore[attr-defined]
        assert _shown(missing.value) == [name, "__getattr__"]
        with pytest.raises(UsageError) as wrong:
            slave.outputs = 3  # type: ignore[assignment]
        assert _shown(wrong.value) == [name, "__setattr__", "outputs", "octets"]
        level = slave.changes("level", timeout=0.05)
        with pytest.raises(TimeoutError, match=r"nothing came within 0\.05 s; the iteration can go on"):
            next(level)
