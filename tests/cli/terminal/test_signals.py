"""The first signal ends in order, a later one without waiting, a third at once; wrappers send each of them twice."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from ends.telegrams import heard, is_in_order
from far_ends import HANG_S
from plant_files import plant_file
from process_kit import SPEC, octet_slaves
from programs import Starter

import dpstack
from dpstack.api.bus.shutdown import ENDING_SIGNALS, OrderedEnd
from dpstack.cli.main import main
from dpstack.cli.terminal import signals
from dpstack.cli.terminal.signals import StopSignal

VALVES = {"name": "valves", "address": 4, "ident": 0x1234, "config": "21 11", "safe": "A5 5A"}
BUS: dict[str, Any] = {"baud": 1_500_000, "gap": 0, "max_retry": 15}


class Clock:
    """Seconds, as the test sets them."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The exit codes with which the program was left at once."""
    codes: list[int] = []
    monkeypatch.setattr(os, "_exit", codes.append)
    return codes


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Each order to end without waiting."""
    orders: list[str] = []
    monkeypatch.setattr(signals, "hurry_all", lambda: orders.append("hurry"))
    return orders


@contextlib.contextmanager
def old_handlers() -> Iterator[None]:
    """Signal handlers as they were before."""
    numbers = (signal.SIGINT, *ENDING_SIGNALS)
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)


async def caught(number: int, times: int = 1) -> None:
    for _ in range(times):
        os.kill(os.getpid(), number)
    await asyncio.sleep(0)
    await asyncio.sleep(0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGRTMAX])
@pytest.mark.parametrize("virtual", [False, True])
def test_the_first_ends_the_work(left: list[int], number: signal.Signals, virtual: bool) -> None:
    before = signal.getsignal(number)
    clock = Clock()

    async def program() -> None:
        with StopSignal(clock) as stop:
            assert await stop.or_done(asyncio.sleep(0))
            asyncio.get_running_loop().call_later(0.01, os.kill, os.getpid(), number)
            assert not await stop.or_done(asyncio.sleep(1000))
            assert stop.received
            assert not stop.hurried
            clock.now += 2
        assert left == []

    (dpstack.run_virtual if virtual else asyncio.run)(program())
    assert signal.getsignal(number) is before


def test_a_command_after_one_that_a_signal_ended_has_all_signals(left: list[int]) -> None:
    """The first one keeps its handlers for a second, as the second copy of its signal may still come."""
    first, second = Clock(), Clock()

    async def program() -> None:
        with StopSignal(first):
            await caught(signal.SIGTERM)
        first.now += 2
        with StopSignal(second) as stop:
            await caught(signal.SIGUSR1)
            assert stop.received
            second.now += 2
        assert left == []

    with old_handlers():
        asyncio.run(program())


def test_first_same_second_and_third(left: list[int], hurried: list[str]) -> None:
    clock = Clock()

    async def program() -> None:
        with StopSignal(clock) as stop:
            await caught(signal.SIGTERM)
            clock.now += 0.0005
            await caught(signal.SIGTERM)  # GNU timeout
            clock.now += 0.99
            await caught(signal.SIGINT, 3)
            assert (left, hurried, stop.hurried) == ([], [], False)
            clock.now += 0.1
            await caught(signal.SIGINT)
            clock.now += 0.0005
            await caught(signal.SIGINT)  # the second one, sent twice
            assert (left, hurried, stop.hurried) == ([], ["hurry"], True)
            clock.now += 0.2
            await caught(signal.SIGINT)
            assert left == [130]

    with old_handlers():
        asyncio.run(program())


def test_the_double_that_comes_when_all_is_over_does_nothing(left: list[int]) -> None:
    clock = Clock()
    others: list[int] = []

    async def program() -> None:
        with StopSignal(clock):
            await caught(signal.SIGTERM)
        await caught(signal.SIGTERM)
        assert others == []
        clock.now += 1.5
        await caught(signal.SIGTERM)  # from now on they are whose they were before

    with old_handlers():
        signal.signal(signal.SIGTERM, lambda number, _frame: others.append(number))
        asyncio.run(program())
    assert (left, others) == ([], [signal.SIGTERM])


def test_the_double_that_comes_as_the_interpreter_ends_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interpreter that ends gives the signals it handled back to the system, whose default kills the process."""
    at_exit: list[Callable[[], None]] = []
    monkeypatch.setattr("atexit.register", at_exit.append)

    async def program() -> None:
        with StopSignal(Clock()):
            await caught(signal.SIGTERM)

    with old_handlers():
        asyncio.run(program())
        assert signal.getsignal(signal.SIGTERM) is not signal.SIG_IGN
        for function in at_exit:
            function()
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN


def test_run_ends_with_1_where_the_end_could_not_be_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = plant_file(tmp_path, VALVES, **BUS)
    assert main(["run", str(plant), "--rotations", "5"]) == 0, capsys.readouterr().err
    monkeypatch.setattr(OrderedEnd, "failed", property(lambda _: True, lambda *_: None), raising=False)
    assert main(["run", str(plant), "--rotations", "5"]) == 1


def test_a_hurried_end_that_hangs_is_left(
    left: list[int], hurried: list[str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Also where the event loop is held up: an alarm of the system ends it."""
    monkeypatch.setattr(signals, "_HURRIED_S", 0.01)
    clock = Clock()

    async def program() -> None:
        with StopSignal(clock):
            await caught(signal.SIGTERM)
            clock.now += 2
            os.kill(os.getpid(), signal.SIGTERM)
            signal.sigtimedwait([], 0.1)  # blocks, as a call of the system does
            assert left == [130]

    with old_handlers():
        asyncio.run(program())
    assert "not over within a second after the second signal" in capfd.readouterr().err


def test_an_exception_of_the_work_is_raised() -> None:
    async def fails() -> None:
        raise ZeroDivisionError

    async def program() -> None:
        with StopSignal() as stop:
            await stop.or_done(fails())

    with pytest.raises(ZeroDivisionError):
        asyncio.run(program())


@pytest.mark.usefixtures("alone")
def test_run_under_a_wrapper_that_sends_its_signal_twice(start: Starter, tmp_path: Path) -> None:
    with octet_slaves(SPEC) as (path, there):
        plant = plant_file(tmp_path, VALVES, port=path, **BUS)
        run = start("run", str(plant), "--outputs", "4=1122", "--json")
        run.wait_for_slaves(1)
        with heard(there) as words:
            while "1122" not in words:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    run.process.wait(0.01)
            for _ in range(2):
                run.process.send_signal(signal.SIGTERM)
            assert run.process.wait(HANG_S) == 0, run.err
        assert is_in_order(words, live="1122", safe="a55a")
        assert run.lines[-1]["event"] == "summary"
        assert run.err == ""
