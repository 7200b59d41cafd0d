"""Real things in virtual time: signals, sockets, threads, and time itself where the loop is paced."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
import time

import pytest
from virtual_kit import attach, here

from dpstack.drivers.virtual.loop import run
from dpstack.sim.world import World
from dpstack.units import NEVER


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
