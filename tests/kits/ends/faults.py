"""Applications that end, or go on, after exceptions in callbacks and with no handles, no memory and no disk left.

As a program: ``python -m ends.faults PATH DRIVER WAY``, as ``ends.programs``; it has all ways of that, too.
"""

from __future__ import annotations

import asyncio
import os
import resource
import signal
import sys
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path

import probe_connector
from ends import failing_plugins
from ends.programs import LONG_S, Ways
from far_ends import until

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.drivers.process.plugins import AttachPlugin
from dpstack.drivers.stack import Stack
from dpstack.machine import Machine
from dpstack.trace import Event

#: of applications that are stopped; long enough for a busy computer
APPLICATION_WATCHDOG_MS = 2000


class MisuseError(Exception):
    """Raised by the code of a user."""


def no_handles_left() -> None:
    """Every file descriptor that this process may have is open."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 256), hard))
    try:
        while True:
            os.open(os.devnull, os.O_RDONLY)
    except OSError:
        return


class Faults(Ways):
    """More ways; those that are no end print "goes on" while the bus runs, and end the block then."""

    def waits(self) -> None:
        """Something happens to it from outside."""

        async def then(_: dpstack.Bus) -> None:
            await asyncio.sleep(LONG_S)

        self.run(then)

    def waits_alive(self) -> None:
        """As ``waits``; while the program runs it calls ``bus.alive()``."""

        async def main() -> None:
            async with self.bus(application_watchdog_ms=APPLICATION_WATCHDOG_MS) as bus:
                calls = asyncio.ensure_future(self.alive(bus))
                await self.live(bus)
                await calls

        asyncio.run(main())

    async def alive(self, bus: dpstack.Bus) -> None:
        while True:
            bus.alive()
            await asyncio.sleep(0.05)

    # --- exceptions in plugins ---
    async def attach(self, bus: dpstack.Bus, name: str) -> None:
        """The valves get the plugin ``name`` of ``ends.failing_plugins``."""
        if self.driver == "process":
            await core_of(bus).runtime.order(
                AttachPlugin(address=4, place=f"ends.failing_plugins:{name}", name="valves")
            )
        else:
            stack = core_of(bus).view
            assert isinstance(stack, Stack)
            stack.master.handlers[4].image.plugin = getattr(failing_plugins, name).core()

    def in_a_plugin(self) -> None:
        """The outputs of its slave are safe, and the bus goes on."""
        self.plugin_fails("RAISES")

    def sys_exit_in_a_plugin(self) -> None:
        self.plugin_fails("EXITS")

    def plugin_fails(self, name: str) -> None:
        async def then(bus: dpstack.Bus) -> None:
            await self.attach(bus, name)
            await until(lambda: bus.slave("valves").fault is not None, "the fault")
            await self.goes_on(bus)

        self.run(then)

    # --- connectors, which begin before the bus and end after it ---
    def a_connector_raises(self) -> None:
        async def then(bus: dpstack.Bus) -> None:
            probe_connector.ProbeConnector.made[-1].breaks = True
            await until(lambda: not self.publishing.connectors, "the end of the connector")
            await self.goes_on(bus)

        self.publish("no", then)

    def a_connector_never_ends(self) -> None:
        async def nothing(_: dpstack.Bus) -> None:
            pass

        self.publish("end", nothing)

    def a_connector_never_ends_and_an_exception(self) -> None:
        async def fails(_: dpstack.Bus) -> None:
            raise ZeroDivisionError

        self.publish("end", fails)

    def publish(self, fails: str, then: Callable[[dpstack.Bus], Awaitable[object]]) -> None:
        probe_connector.register()

        async def main() -> None:
            bus = self.bus()
            self.publishing = dpstack.publish(bus, probe={"fails": fails})
            async with self.publishing, bus:
                await self.live(bus)
                await then(bus)

        asyncio.run(main())

    # --- exceptions in callbacks of the user: the bus goes on ---
    def in_a_reader(self) -> None:
        """add_reader()."""

        async def then(bus: dpstack.Bus) -> None:
            read, write = os.pipe()
            loop = asyncio.get_running_loop()

            def readable() -> None:
                loop.remove_reader(read)
                raise MisuseError

            loop.add_reader(read, readable)
            os.write(write, b"x")
            await self.goes_on(bus)

        self.run(then)

    def in_a_done_callback(self) -> None:
        """Of a task, and of a future."""

        async def then(bus: dpstack.Bus) -> None:
            def done(_: object) -> None:
                raise MisuseError

            asyncio.ensure_future(asyncio.sleep(0)).add_done_callback(done)
            await self.goes_on(bus)

        self.run(then)

    def in_a_task(self) -> None:
        """A task that nobody awaits."""

        async def then(bus: dpstack.Bus) -> None:
            async def fails() -> None:
                raise MisuseError

            self.task = asyncio.ensure_future(fails())
            await self.goes_on(bus)

        self.run(then)

    def in_on_event(self) -> None:
        self.raises: Callable[[], None] | None = None

        async def then(bus: dpstack.Bus) -> None:
            def misuse() -> None:
                self.raises = None
                raise MisuseError

            self.raises = misuse
            await bus.clear()
            await until(lambda: self.raises is None, "on_event")
            await bus.operate()
            await self.goes_on(bus)

        self.run(then)

    def sys_exit_in_on_event(self) -> None:
        async def then(bus: dpstack.Bus) -> None:
            def leaves() -> None:
                self.raises = None
                sys.exit(3)

            self.raises = leaves
            await bus.clear()
            await asyncio.sleep(LONG_S)

        self.run(then)

    def on_event(self, event: Event) -> None:
        super().on_event(event)
        raises = getattr(self, "raises", None)
        if self.is_live and raises is not None:
            raises()

    def in_a_thread(self) -> None:
        async def then(bus: dpstack.Bus) -> None:
            def fails() -> None:
                raise MisuseError

            threading.Thread(target=fails).start()
            await self.goes_on(bus)

        self.run(then)

    def in_a_signal_handler(self) -> None:
        async def then(bus: dpstack.Bus) -> None:
            def handler(*_: object) -> None:
                raise MisuseError

            signal.signal(signal.SIGUSR1, handler)
            os.kill(os.getpid(), signal.SIGUSR1)
            await asyncio.sleep(LONG_S)

        self.run(then)

    # --- cancellations ---
    def cancelled_once(self) -> None:
        self.cancelled(1)

    def cancelled_many_times(self) -> None:
        self.cancelled(1000)

    def cancelled(self, times: int) -> None:
        async def then(_: dpstack.Bus) -> None:
            task, loop = asyncio.current_task(), asyncio.get_running_loop()
            assert task is not None
            for number in range(times):
                loop.call_later(number * 0.0001, task.cancel)
            await asyncio.sleep(LONG_S)

        try:
            self.run(then)
        except asyncio.CancelledError:
            sys.exit("CancelledError")

    # --- no handles ---
    def no_handles(self) -> None:
        async def then(_: dpstack.Bus) -> None:
            no_handles_left()

        self.run(then)

    def no_handles_in_the_loop(self) -> None:
        async def then(bus: dpstack.Bus) -> None:
            no_handles_left()
            await self.goes_on(bus)

        self.run(then)

    def no_handles_and_the_interpreter_ends(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.loop.run_until_complete(self.opened())
        no_handles_left()

    def no_handles_and_the_loop_is_closed(self) -> None:
        loop = asyncio.new_event_loop()
        try:
            loop.run_until_complete(self.opened())
            no_handles_left()
        finally:
            loop.close()

    def no_handles_and_a_forked_child_ends(self) -> None:
        async def forks(bus: dpstack.Bus) -> None:
            no_handles_left()
            pid = os.fork()
            if not pid:
                sys.exit(0)
            await until(lambda: os.waitpid(pid, os.WNOHANG)[0] == pid, "the end of the child")
            await self.goes_on(bus)

        self.run(forks)

    def no_handles_before_the_start(self) -> None:
        no_handles_left()
        self.the_block_ends()

    # --- no memory ---
    def no_memory_before_the_start(self) -> None:
        """1 MiB of addresses is left as the bus is opened; an open bus keeps 2 MiB for its end."""
        bus = self.bus()
        soft = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + (1 << 20)
        resource.setrlimit(resource.RLIMIT_AS, (soft, soft))

        async def main() -> None:
            async with bus:
                await self.live(bus)

        asyncio.run(main())

    def memory_error_in_the_block(self) -> None:
        async def then(_: dpstack.Bus) -> None:
            raise MemoryError

        self.run(then)

    def no_memory_in_the_block(self) -> None:
        """The program keeps what it has got until there is no more."""

        async def then(_: dpstack.Bus) -> None:
            self.kept: list[bytes] = []
            soft = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + (64 << 20)
            resource.setrlimit(resource.RLIMIT_AS, (soft, soft))
            size = 16 << 20
            while size:
                try:
                    self.kept.append(bytes(size))
                except MemoryError:
                    size //= 2
            raise MemoryError

        self.run(then)

    def no_memory_in_the_machine(self) -> None:
        """An allocation fails while the master handles an answer."""

        async def then(bus: dpstack.Bus) -> None:
            self.fail_in(bus, MemoryError())
            await bus.rotated(bus.stats.rotations + 1000, LONG_S)

        self.run(then)

    def a_defect(self) -> None:
        async def then(bus: dpstack.Bus) -> None:
            self.fail_in(bus, ZeroDivisionError("a defect"))
            await bus.rotated(bus.stats.rotations + 1000, LONG_S)

        self.run(then)

    def fail_in(self, bus: dpstack.Bus, error: Exception) -> None:
        machine: Machine = core_of(bus).runtime._machine  # type: ignore[attr-defined]

        def receive(_chunk: bytes, _now: int) -> None:
            raise error

        machine.receive = receive  # type: ignore[assignment,method-assign]


if __name__ == "__main__":
    getattr(Faults(sys.argv[1], sys.argv[2]), sys.argv[3])()
