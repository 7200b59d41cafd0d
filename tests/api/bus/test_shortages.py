"""No memory, no handles, a defect: where the program can still send the end, it does, and says what stopped the bus."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import socket
from collections.abc import Callable

import pytest
from ends import failing_plugins
from ends.programs import Ways
from ends.telegrams import after_live, heard, is_in_order
from far_ends import eventually, many_files_open, until
from process_kit import DRIVERS, LAMPS_SPEC, SPEC, Driver, octet_slaves
from support import instance

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.dp.master import plugin_host
from dpstack.dp.master.commands import Shutdown
from dpstack.drivers.line import shutdown
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.shutdown import ending_signals
from dpstack.drivers.process import client
from dpstack.drivers.process.shared_image import SIZE, make_memory
from dpstack.drivers.stack import Stack
from dpstack.fdl.active.station import ActiveStation
from dpstack.trace import Event
from dpstack.units import NS_PER_MS

LIVE, SAFE = "1122", "a55a"


class Live(Ways):
    """A bus in Operate on the pty of ``path``; ``then`` is called in its loop, ``told`` has its events."""

    def __init__(self, path: str) -> None:
        super().__init__(path, "asyncio")
        self.told: list[str] = []

    def on_event(self, event: Event) -> None:
        self.told.append(event.text)

    def runtime(self, bus: dpstack.Bus) -> AsyncioRuntime:
        return instance(core_of(bus).runtime, AsyncioRuntime)


def failing(error: Exception) -> Callable[[bytes, int], None]:
    def receive(_chunk: bytes, _now: int) -> None:
        raise error

    return receive


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (ZeroDivisionError("ours"), "a defect in dpstack (ZeroDivisionError: ours); please report it"),
        (MemoryError(), "a lack of memory in its process (MemoryError); find what fills it, or raise its limit"),
    ],
)
def test_a_machine_that_fails_leaves_no_live_outputs(
    error: Exception, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)

        async def then(bus: dpstack.Bus) -> None:
            monkeypatch.setattr(live.runtime(bus)._machine, "receive", failing(error))
            with pytest.raises(dpstack.BusError, match="the bus was stopped by a"):
                await bus.rotated(None)
            assert bus.mode is dpstack.Mode.OFFLINE
            await bus.close()
            assert not bus.end_failed

        live.run(then)
        eventually(lambda: words[-1] == "clear", "Clear")
        assert after_live(words, LIVE) == ([], ["clear", "clear"])
        assert f"{path}: stopped by {why}. Clear was sent before" in live.told
        assert f"bus: the bus was stopped by {why}" in live.told


def test_no_clear_beside_other_masters(monkeypatch: pytest.MonkeyPatch) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)

        async def then(bus: dpstack.Bus) -> None:
            monkeypatch.setattr(ActiveStation, "las", property(lambda _station: frozenset({2, 7})))
            monkeypatch.setattr(live.runtime(bus)._machine, "receive", failing(ZeroDivisionError()))
            with pytest.raises(dpstack.BusError, match="stopped by a defect"):
                await bus.rotated(None)
            await bus.close()
            assert bus.end_failed

        live.run(then)
        assert after_live(words, LIVE) == ([], [])
        why = "Clear was not sent: master 7 may hold the token by now, and without the token nothing may be sent"
        assert any(text.endswith(why) for text in live.told)
        assert any("the end could not be sent" in text for text in live.told)


def test_no_memory_for_the_end_in_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """The end is made without the event loop then."""
    order = AsyncioRuntime.order

    def refuse(runtime: AsyncioRuntime, command: object) -> asyncio.Future[object]:
        if isinstance(command, Shutdown):
            raise MemoryError
        return order(runtime, command)

    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)

        async def then(bus: dpstack.Bus) -> None:
            monkeypatch.setattr(AsyncioRuntime, "order", refuse)
            await bus.close()
            assert not bus.end_failed

        live.run(then)
        eventually(lambda: words[-1] == "clear", "Clear")
        assert is_in_order(words, live=LIVE, safe=SAFE)
        assert "bus: MemoryError at the end, which was made without the event loop" in live.told


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_finaliser_of_a_program_with_a_thousand_open_files(driver: Driver) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words, many_files_open():
        Ways(path, driver).the_loop_is_closed()
        eventually(lambda: words[-1] == "clear", "Clear")
        assert is_in_order(words, live=LIVE, safe=SAFE)


def test_the_finaliser_needs_no_handles(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)
        loop = asyncio.new_event_loop()
        bus = loop.run_until_complete(live.opened())

        def none_left() -> None:
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

        monkeypatch.setattr(socket, "socketpair", none_left)
        assert core_of(bus).runtime.end_without_loop() == ""
        monkeypatch.undo()
        loop.close()
        eventually(lambda: words[-1] == "clear", "Clear")
        assert is_in_order(words, live=LIVE, safe=SAFE)
        assert not [record for record in caplog.records if "could not be sent" in record.getMessage()]


def test_a_timer_that_fails_stops_the_bus_and_not_its_story(monkeypatch: pytest.MonkeyPatch) -> None:
    """A timer is set again by its own call: one that raised would leave the bus silent, and the slaves live."""
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)

        async def then(bus: dpstack.Bus) -> None:
            runtime = live.runtime(bus)
            there.slaves.clear()  # nobody answers: only the timer wakes the bus up
            monkeypatch.setattr(runtime, "_echo", Full())
            await until(lambda: runtime.failed is not None, "the failure")

        live.run(then)
        assert after_live(words, LIVE)[0] == []
        assert any("stopped by a lack of memory" in text for text in live.told)


class Full:
    """An echo filter without memory."""

    state = None

    def release(self) -> bytes:
        raise MemoryError

    def strip(self, chunk: bytes) -> bytes:
        return chunk

    def sent(self, _octets: bytes) -> None: ...


def test_all_of_the_shared_memory_exists() -> None:
    fd = make_memory()
    try:
        assert os.fstat(fd).st_blocks * 512 >= SIZE
    finally:
        os.close(fd)


@pytest.mark.parametrize("number", [errno.EMFILE, errno.EFBIG, errno.ENOMEM])
@pytest.mark.parametrize("step", ["make_memory", "SharedImage"])
async def test_a_bus_process_for_which_nothing_is_left(step: str, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(client, step, refuse)
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, _), pytest.raises(dpstack.BusError) as raised:
        await Ways(path, "process").bus().open()
    assert str(raised.value) == (
        f'the bus process cannot be started ({os.strerror(number)}): raise that limit, or take driver = "asyncio"'
    )


def test_the_signals_that_end_a_program() -> None:
    """All that there are, but those that a program raises by its own fault, that do not end it, and SIGKILL."""
    out = {signal.Signals(number).name for number in signal.valid_signals() - set(ending_signals())}
    assert out == {
        *("SIGABRT", "SIGBUS", "SIGFPE", "SIGILL", "SIGSEGV", "SIGSYS", "SIGTRAP"),
        *("SIGCHLD", "SIGCONT", "SIGPIPE", "SIGURG", "SIGWINCH", "SIGXFSZ"),
        *("SIGKILL", "SIGSTOP", "SIGTSTP", "SIGTTIN", "SIGTTOU"),
    }


def test_a_token_that_was_lost_on_the_way_out_costs_no_clear(monkeypatch: pytest.MonkeyPatch) -> None:
    """An exception that is none of Exception (Ctrl-C, sys.exit()) in the middle of a token hold loses the token."""
    monkeypatch.setattr(plugin_host, "FAILURES", Exception)
    monkeypatch.setattr(shutdown, "END_LIMIT", 200 * NS_PER_MS)  # without a token each step takes as long as it may
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)
        loop = asyncio.new_event_loop()
        bus = loop.run_until_complete(live.opened())
        stack = instance(core_of(bus).view, Stack)
        stack.master.handlers[4].image.plugin = failing_plugins.EXITS.core()
        waiting = loop.create_task(bus.rotated(None))
        with pytest.raises(SystemExit):
            loop.run_until_complete(waiting)
        loop.run_until_complete(asyncio.sleep(0.1))  # many T_TO: the machine does not claim the token it believes in
        loop.run_until_complete(bus.close())
        with pytest.raises(dpstack.UsageError, match="closed"):
            waiting.result()
        loop.close()
        assert not bus.end_failed
        eventually(lambda: words[-1] == "clear", "Clear")
        assert after_live(words, LIVE)[1]


@pytest.mark.parametrize("name", ["RAISES", "EXITS"])
def test_a_plugin_that_fails_ends_neither_bus_nor_program(name: str) -> None:
    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there), heard(there) as words:
        live = Live(path)

        async def then(bus: dpstack.Bus) -> None:
            stack = instance(core_of(bus).view, Stack)
            stack.master.handlers[4].image.plugin = getattr(failing_plugins, name).core()
            await until(lambda: bus.slave("valves").fault is not None, "the fault")
            await bus.rotated(bus.stats.rotations + 20, 60)
            assert words[-1] in (SAFE, "operate")

        live.run(then)
