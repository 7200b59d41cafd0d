"""Applications that end a bus in every way there is.

As a program: ``python -m ends.faults PATH DRIVER WAY``. Each brings slaves 4 (with a watchdog) and 5 (without) on
PATH up, sends them 11 22 and 77, says "live", and then ends as WAY says, which is the name of a method of
:class:`Ways`. Each event that is a warning or an error is a line "event: CLASS: TEXT".
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import Awaitable, Callable

from far_ends import until
from process_kit import LAMPS, VALVES, Driver, bus_on

import dpstack
from dpstack.api.bus.events_json import Severity
from dpstack.dp.master.commands import Mode
from dpstack.trace import Event

LIVE = b"\x11\x22"
LIVE_LAMPS = b"\x77"
#: of slave 4; long enough for a busy computer
WATCHDOG_MS = 1000
SLAVES = (VALVES | {"watchdog_ms": WATCHDOG_MS}, LAMPS | {"watchdog_ms": 0})
#: for who is not ended by itself
LONG_S = 60.0


async def outputs(bus: dpstack.Bus, octets: bytes) -> None:
    """``octets`` are at the slave, which mirrors them."""
    valves = bus.slave("valves")
    valves.outputs = octets
    await until(lambda: valves.inputs == octets, "outputs at the slave")


class Ways:
    """One method for each way out, by its name; what an application raises at its end is raised."""

    def __init__(self, path: str, driver: str) -> None:
        self.path = path
        self.driver = driver
        #: of ways after which the bus is looked at
        self.bus_left: dpstack.Bus | None = None
        self.is_live = False

    def bus(self, **more: object) -> dpstack.Bus:
        driver: Driver = "process" if self.driver == "process" else "asyncio"
        return bus_on(self.path, driver, *SLAVES, on_event=self.on_event, after_stall="safe", **more)

    def on_event(self, event: Event) -> None:
        if self.is_live and event.severity is not Severity.INFO:
            print(f"event: {type(event).__name__}: {event.text}", flush=True)

    async def live(self, bus: dpstack.Bus) -> None:
        await bus.ready(LONG_S)
        await bus.operate()
        bus.slave("lamps").outputs = LIVE_LAMPS
        await outputs(bus, LIVE)
        await until(lambda: bus.slave("lamps").inputs == LIVE_LAMPS, "outputs at the lamps")
        self.is_live = True
        print("live", flush=True)

    def run(self, then: Callable[[dpstack.Bus], Awaitable[object]]) -> None:
        """asyncio.run() with the bus in an ``async with`` block."""

        async def main() -> None:
            async with self.bus() as bus:
                await self.live(bus)
                await then(bus)

        asyncio.run(main())

    async def goes_on(self, bus: dpstack.Bus) -> None:
        """The bus exchanges data after this moment, until the test ends this program."""
        await bus.rotated(bus.stats.rotations + 20, LONG_S)
        print("goes on", flush=True)
        await asyncio.sleep(LONG_S)

    async def opened(self) -> dpstack.Bus:
        bus = self.bus_left = self.bus()
        await bus.open()
        await self.live(bus)
        return bus

    # --- in order ---
    def the_block_ends(self) -> None:
        async def nothing(_: dpstack.Bus) -> None:
            pass

        self.run(nothing)

    def an_exception(self) -> None:
        async def fails(_: dpstack.Bus) -> None:
            raise ZeroDivisionError

        self.run(fails)

    def ctrl_c_three_times(self) -> None:
        async def interrupted(_: dpstack.Bus) -> None:
            loop = asyncio.get_running_loop()

            def interrupt(left: int) -> None:
                if left:  # in a later turn of the loop, however busy the computer is; the end takes 0.05 s and more
                    loop.call_later(0.01, interrupt, left - 1)
                signal.raise_signal(signal.SIGINT)

            loop.call_later(0.01, interrupt, 2)
            await asyncio.sleep(LONG_S)

        self.run(interrupted)

    def anyio_scope(self) -> None:
        """A cancel scope of anyio cancels anew in every turn of the loop."""
        import anyio

        async def main() -> None:
            with anyio.move_on_after(LONG_S) as scope:
                async with self.bus() as bus:
                    await self.live(bus)
                    scope.deadline = anyio.current_time() + 0.01
                    await asyncio.sleep(LONG_S)
            assert scope.cancelled_caught

        asyncio.run(main())

    def sys_exit_in_a_callback(self) -> None:
        async def leaves(_: dpstack.Bus) -> None:
            asyncio.get_running_loop().call_soon(sys.exit, 3)
            await asyncio.sleep(LONG_S)

        self.run(leaves)

    def nobody_closes_it(self) -> None:
        async def main() -> None:
            await self.opened()

        asyncio.run(main())

    def closed_in_another_loop(self) -> None:
        loop = asyncio.new_event_loop()
        bus = loop.run_until_complete(self.opened())
        asyncio.run(bus.close())
        loop.run_until_complete(bus.close())  # nothing is left to be closed
        loop.close()

    # --- by the finaliser ---
    def ctrl_c_without_asyncio_run(self) -> None:
        """A thread's own signal reaches the main thread whatever signals that one blocks."""
        live = threading.Event()

        def interrupts() -> None:
            live.wait(LONG_S)
            for _ in range(12):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.004)

        async def main() -> None:
            async with self.bus() as bus:
                await self.live(bus)
                live.set()
                await asyncio.sleep(LONG_S)

        threading.Thread(target=interrupts, daemon=True).start()
        loop = asyncio.new_event_loop()
        try:
            loop.run_until_complete(main())
        finally:
            loop.close()

    def the_loop_is_closed(self) -> None:
        loop = asyncio.new_event_loop()
        try:
            loop.run_until_complete(self.opened())
        finally:
            loop.close()
        print("closed", flush=True)

    def the_interpreter_ends(self) -> None:
        """The loop stands still, neither closed nor run."""
        self.loop = asyncio.new_event_loop()
        self.loop.run_until_complete(self.opened())

    def in_a_daemon_thread(self) -> None:
        live = threading.Event()

        async def goes_on(_: dpstack.Bus) -> None:
            live.set()
            await asyncio.sleep(LONG_S)

        threading.Thread(target=self.run, args=(goes_on,), daemon=True).start()
        live.wait(LONG_S)

    # --- without any end by the application ---
    def os_exit(self) -> None:
        async def exits(_: dpstack.Bus) -> None:
            os._exit(3)

        self.run(exits)

    def os_execv(self) -> None:
        async def makes_room(_: dpstack.Bus) -> None:
            os.execv(sys.executable, [sys.executable, "-c", "raise SystemExit(3)"])

        self.run(makes_room)

    # --- not an end ---
    def a_forked_child_ends(self) -> None:
        async def forks(bus: dpstack.Bus) -> None:
            pid = os.fork()
            if not pid:
                valves = bus.slave("valves")
                assert not valves.inputs_valid
                assert (bus.mode, valves.state) == (Mode.OFFLINE, dpstack.SlaveState.OFFLINE)
                sys.exit(0)  # through asyncio.run() and the `async with` block of the child
            await until(lambda: os.waitpid(pid, os.WNOHANG)[0] == pid, "the end of the child")
            await asyncio.to_thread(time.sleep, 0.01)  # a thread still wakes the loop up
            await outputs(bus, b"\x33\x44")
            await outputs(bus, LIVE)
            await self.goes_on(bus)

        self.run(forks)
