"""Programs in virtual time: exact, deterministic, and nothing real is lost: signals, sockets, threads, and time itself
where the loop is paced."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
import time
from collections.abc import Callable

import pytest
from virtual_kit import attach, here

from dpstack.drivers.virtual.loop import StandstillError, run
from dpstack.sim.world import World
from dpstack.units import NEVER

S = 1_000_000_000


# --- time ---
def test_sleeping_takes_exactly_its_time_and_none() -> None:
    async def main() -> list[int]:
        times = []
        for pause in (1.0, 0.001, 3600.0, 1e-9, 86_400 * 30):
            await asyncio.sleep(pause)
            times.append(here().time_ns())
        return times

    began = time.monotonic()
    expected = [S, S + 10**6, 3601 * S + 10**6, 3601 * S + 10**6 + 1, (3601 + 86_400 * 30) * S + 10**6 + 1]
    assert run(main()) == expected
    assert time.monotonic() - began < 5


def test_a_thousand_short_sleeps_do_not_drift() -> None:
    async def main() -> int:
        for _ in range(1_000):
            await asyncio.sleep(0.0012345)
        return here().time_ns()

    assert run(main()) == 1_234_500_000


def test_timeouts_queues_and_tasks_are_those_of_asyncio() -> None:
    async def main() -> list[tuple[str, float]]:
        said: list[tuple[str, float]] = []
        queue: asyncio.Queue[int] = asyncio.Queue(1)

        def say(what: str) -> None:
            said.append((what, round(here().time(), 9)))

        async def producer() -> None:
            for number in range(3):
                await asyncio.sleep(2)
                await queue.put(number)

        async with asyncio.TaskGroup() as group:
            group.create_task(producer())
            for _ in range(3):
                say(f"got {await queue.get()}")
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(queue.get(), 0.25)
        say("nothing more")
        async with asyncio.timeout(10):
            await asyncio.sleep(9.5)
        say("in time")
        return said

    assert run(main()) == [("got 0", 2), ("got 1", 4), ("got 2", 6), ("nothing more", 6.25), ("in time", 15.75)]


def test_waiting_for_ever_raises() -> None:
    async def main() -> None:
        await asyncio.Event().wait()

    with pytest.raises(StandstillError, match="waits for ever"):
        run(main())
    with pytest.raises(StandstillError, match="waits for ever"):
        run(main(), paced=True)


def test_waiting_for_a_world_without_events_raises() -> None:
    async def main() -> None:
        attach(World())
        await asyncio.Event().wait()

    with pytest.raises(StandstillError, match="nothing will happen on the simulated bus"):
        run(main())


def test_polling_without_waiting_does_not_stop_the_time() -> None:
    async def main() -> int:
        world = attach(World())
        done: list[int] = []
        world.call_at(500_000, lambda: done.append(1))
        turns = 0
        while not done:
            await asyncio.sleep(0)
            turns += 1
        return turns

    assert 2_000 < run(main()) < 20_000


def test_an_exception_comes_through() -> None:
    async def main() -> None:
        await asyncio.sleep(1)
        raise KeyError("x")

    with pytest.raises(KeyError):
        run(main(), debug=True)


def test_an_exception_in_a_world_comes_through() -> None:
    async def main() -> None:
        world = attach(World())
        world.call_at(5, _fail)
        await asyncio.sleep(1)

    with pytest.raises(ZeroDivisionError):
        run(main())


def _fail() -> None:
    raise ZeroDivisionError


# --- worlds ---
def test_a_future_set_by_a_world_is_seen_at_that_very_time() -> None:
    async def main() -> tuple[int, int]:
        world = attach(World())
        future: asyncio.Future[int] = here().create_future()
        world.call_at(123_456_789, lambda: future.set_result(world.now))
        world.call_at(123_456_790, lambda: None)
        return await future, here().time_ns()

    assert run(main()) == (123_456_789, 123_456_789)


def test_a_timer_set_by_a_world_is_on_time() -> None:
    async def main() -> list[int]:
        world = attach(World())
        times: list[int] = []
        loop = here()

        def later() -> None:
            loop.call_later(0.001, lambda: times.append(loop.time_ns()))

        world.call_at(1_000_000, later)
        for at in range(0, 5_000_000, 100_000):
            world.call_at(at, lambda: None)
        await asyncio.sleep(1)
        return times

    assert run(main()) == [2_000_000]


def test_the_world_has_the_loops_time_when_the_program_runs() -> None:
    async def main() -> None:
        world = attach(World(start_ns=77))
        await asyncio.sleep(0.5)
        assert world.now == 77 + S // 2
        second = attach(World())
        await asyncio.sleep(0.25)
        assert (world.now, second.now) == (77 + 3 * S // 4, S // 4)
        here().detach(world)
        here().detach(world)  # a second time changes nothing
        await asyncio.sleep(1)
        assert (world.now, second.now) == (77 + 3 * S // 4, 5 * S // 4)

    run(main())


def test_two_worlds_and_their_programs_keep_in_step() -> None:
    async def main() -> list[str]:
        worlds = [attach(World()), attach(World())]
        done: list[str] = []

        def say(what: str) -> Callable[[], None]:
            return lambda: done.append(
                f"{what}{here().time_ns() if what == 'p' else worlds[0 if what == 'a' else 1].now}"
            )

        for at in (10, 30, 50):
            worlds[0].call_at(at * 1_000, say("a"))
            worlds[1].call_at(at * 1_000 + 10_000, say("b"))
        await asyncio.sleep(35e-6)
        say("p")()
        assert [world.now for world in worlds] == [35_000, 35_000]
        await asyncio.sleep(1)
        return done

    assert run(main()) == ["a10000", "b20000", "a30000", "p35000", "b40000", "a50000", "b60000"]


def test_two_worlds_in_which_nothing_happens_any_more() -> None:
    async def main() -> None:
        for world in (attach(World()), attach(World())):
            world.call_at(10, lambda: None)
        await asyncio.Event().wait()

    with pytest.raises(StandstillError):
        run(main())


def test_two_worlds_stop_when_a_callback_becomes_ready() -> None:
    async def main() -> int:
        worlds = attach(World()), attach(World())
        event = asyncio.Event()
        worlds[1].call_at(700, event.set)
        for number in range(100):
            worlds[0].call_at(number * 50, lambda: None)
        await event.wait()
        return here().time_ns()

    assert run(main()) == 700


def test_the_same_program_takes_the_same_course_paced_and_not() -> None:
    async def main() -> list[int]:
        world = attach(World())
        times: list[int] = []
        queue: asyncio.Queue[int] = asyncio.Queue()
        for at in (3_000_017, 9_999_999, 20_000_001):
            world.call_at(at, lambda: queue.put_nowait(world.now))
        for _ in range(3):
            times.append(await queue.get())
            await asyncio.sleep(0.0011)
            times.append(here().time_ns())
        return times

    expected = [3_000_017, 4_100_017, 9_999_999, 11_099_999, 20_000_001, 21_100_001]
    assert run(main()) == expected
    began = time.monotonic()
    assert run(main(), paced=True) == expected
    assert time.monotonic() - began >= 0.021


# --- what is real ---
def goes_on(world: World, every_ns: int = 10_000) -> None:
    """Events in ``world`` without end."""
    world.call_at(world.now + every_ns, lambda: goes_on(world, every_ns))


@pytest.mark.parametrize("paced", [False, True])
@pytest.mark.parametrize("endless", [False, True], ids=["nothing else happens", "a world goes on for ever"])
def test_a_signal_ends_a_program_that_waits_for_it(endless: bool, paced: bool) -> None:
    async def main() -> str:
        if endless:
            goes_on(attach(World()))
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGUSR1, stop.set)
        timer = threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGUSR1))
        timer.start()
        await stop.wait()
        timer.join()
        assert loop.remove_signal_handler(signal.SIGUSR1)
        return "stopped"

    assert run(main(), paced=paced) == "stopped"


@pytest.mark.parametrize("paced", [False, True])
def test_ctrl_c_is_a_keyboard_interrupt(paced: bool) -> None:
    cancelled = []

    async def main() -> None:
        goes_on(attach(World()))
        threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT)).start()
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.append(True)

    with pytest.raises(KeyboardInterrupt):
        run(main(), paced=paced)
    assert cancelled == [True]


@pytest.mark.parametrize("paced", [False, True])
def test_real_sockets_are_polled(paced: bool) -> None:
    async def main() -> bytes:
        ours, theirs = socket.socketpair()
        with ours, theirs:
            reader, writer = await asyncio.open_connection(sock=ours)
            threading.Timer(0.02, theirs.send, (b"hello",)).start()
            got = await reader.readexactly(5)
            writer.close()
            await writer.wait_closed()
            return got

    assert run(main(), paced=paced) == b"hello"


def test_a_reader_is_called_while_a_world_goes_on() -> None:
    async def main() -> bytes:
        goes_on(attach(World()), every_ns=1_000)
        ours, theirs = socket.socketpair()
        got: asyncio.Future[bytes] = here().create_future()
        with ours, theirs:
            here().add_reader(ours, lambda: got.set_result(ours.recv(10)))
            threading.Timer(0.01, theirs.send, (b"x",)).start()
            try:
                return await got
            finally:
                here().remove_reader(ours)

    assert run(main()) == b"x"


@pytest.mark.parametrize("paced", [False, True])
def test_threads_may_take_their_time(paced: bool) -> None:
    async def main() -> tuple[str, bool]:
        # a hundred virtual seconds would be over at once if the thread did not hold them back
        async with asyncio.timeout(100):
            got = await asyncio.to_thread(_slow)
        return got, here().time() < 50

    assert run(main(), paced=paced) == ("done", True)


def _slow() -> str:
    compute(0.02)
    return "done"


def compute(seconds: float) -> None:
    time.sleep(seconds)


def test_a_paced_loop_sees_real_time_after_a_real_wait() -> None:
    async def main() -> float:
        ours, theirs = socket.socketpair()
        with ours, theirs:
            reader, writer = await asyncio.open_connection(sock=ours)
            waited = 0.0
            for _ in range(100):  # it may have been there before a busy computer came to wait for it
                before = here().time()
                threading.Timer(0.05, theirs.send, (b"x",)).start()
                async with asyncio.timeout(60):
                    await reader.readexactly(1)
                waited = here().time() - before
                if waited > 0.04:
                    break
            writer.close()
            await writer.wait_closed()
        return waited

    assert 0.04 < run(main(), paced=True) < 30


def test_a_paced_loop_falls_behind_and_does_not_skip() -> None:
    async def main() -> tuple[float, float]:
        began = time.monotonic()
        compute(0.3)  # the machine cannot keep up
        await asyncio.sleep(0.2)
        return here().time(), time.monotonic() - began

    virtual, real = run(main(), paced=True)
    assert virtual == 0.2
    assert real >= 0.3 + 0.2 - 0.06


def test_nothing_is_next_in_an_empty_world() -> None:
    assert World().next_at() == NEVER
