"""Scripts with ``dpstack.blocking`` that end a bus in every way there is.

As a program: ``python -m ends.blocking PATH DRIVER WAY``, as ``ends.faults`` is for applications. WAY is the name of a
method of :class:`Scripts`. The driver "process" is not asked for: it is the default of a script.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

from ends.programs import LIVE, LIVE_LAMPS, LONG_S, SLAVES
from far_ends import eventually
from process_kit import UNHURRIED

import dpstack.blocking
from dpstack.trace import Event, Severity


class MisuseError(Exception):
    """Of the script."""


class Scripts:
    """One method for each way out, by its name; what a script raises at its end is raised."""

    def __init__(self, path: str, driver: str) -> None:
        self.path = path
        self.driver = driver
        self.is_live = False
        self.in_on_event: Callable[[], None] | None = None

    def bus(self) -> dpstack.blocking.Bus:
        return dpstack.blocking.open_bus(
            port=self.path,
            baud=1_500_000,
            driver=None if self.driver == "process" else "asyncio",
            slaves=SLAVES,
            on_event=self.on_event,
            **UNHURRIED | {"after_stall": "safe"},
        )

    def on_event(self, event: Event) -> None:
        if self.is_live and event.severity is not Severity.INFO:
            print(f"event: {type(event).__name__}: {event.text}", flush=True)
        if self.in_on_event is not None:
            then, self.in_on_event = self.in_on_event, None
            then()

    def live(self, bus: dpstack.blocking.Bus) -> None:
        assert bus.driver == self.driver
        bus.ready(LONG_S)
        bus.operate()
        valves, lamps = bus.slaves
        valves.outputs, lamps.outputs = LIVE, LIVE_LAMPS
        eventually(lambda: (valves.inputs, lamps.inputs) == (LIVE, LIVE_LAMPS), "outputs at the slaves")
        self.is_live = True
        print("live", flush=True)

    def run(self, then: Callable[[dpstack.blocking.Bus], object]) -> None:
        with self.bus() as bus:
            self.live(bus)
            then(bus)

    def opened(self) -> dpstack.blocking.Bus:
        bus = self.left = self.bus()
        bus.open()
        self.live(bus)
        return bus

    def goes_on(self, bus: dpstack.blocking.Bus) -> None:
        bus.rotated(bus.stats.rotations + 20, LONG_S)
        print("goes on", flush=True)
        time.sleep(LONG_S)

    # --- ends ---
    def the_block_ends(self) -> None:
        self.run(lambda _: None)

    def waits(self) -> None:
        self.run(lambda bus: bus.rotated(None, LONG_S))

    def an_exception(self) -> None:
        self.run(lambda _: 1 / 0)

    def sys_exit(self) -> None:
        self.run(lambda _: sys.exit(3))

    def the_interpreter_ends(self) -> None:
        """As in a REPL: nobody closes the bus."""
        self.opened()

    def the_main_thread_ends(self) -> None:
        """Another thread of the script waits in a call, and outlives it."""
        bus = self.opened()
        threading.Thread(target=lambda: bus.rotated(bus.stats.rotations + 20, LONG_S)).start()
        raise MisuseError

    def os_exit(self) -> None:
        self.run(lambda _: os._exit(3))

    def os_execv(self) -> None:
        self.run(lambda _: os.execv(sys.executable, [sys.executable, "-c", "raise SystemExit(3)"]))

    def ctrl_c_three_times(self) -> None:
        def interrupted(bus: dpstack.blocking.Bus) -> None:
            self.interrupt(3)
            bus.rotated(None, LONG_S)

        self.run(interrupted)

    def interrupt(self, times: int) -> None:
        def interrupts() -> None:
            for _ in range(times):
                time.sleep(0.02)
                os.kill(os.getpid(), signal.SIGINT)

        threading.Thread(target=interrupts, daemon=True).start()

    def in_a_signal_handler(self) -> None:
        def then(bus: dpstack.blocking.Bus) -> None:
            def handler(*_: object) -> None:
                raise MisuseError

            signal.signal(signal.SIGUSR1, handler)
            threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGUSR1)).start()
            bus.rotated(None, LONG_S)

        self.run(then)

    # --- the bus goes on ---
    def ctrl_c_is_caught(self) -> None:
        def then(bus: dpstack.blocking.Bus) -> None:
            self.interrupt(1)
            try:
                bus.rotated(None, LONG_S)
            except KeyboardInterrupt:
                self.goes_on(bus)

        self.run(then)

    def a_forked_child_ends(self) -> None:
        def forks(bus: dpstack.blocking.Bus) -> None:
            pid = os.fork()
            if not pid:
                with contextlib.suppress(dpstack.UsageError):
                    bus.clear()
                    print("event: the child has given an order to the bus")
                sys.exit(0)  # through the `with` block of the child
            eventually(lambda: os.waitpid(pid, os.WNOHANG)[0] == pid, "the end of the child")
            self.goes_on(bus)

        self.run(forks)

    def sys_exit_in_on_event(self) -> None:
        def then(bus: dpstack.blocking.Bus) -> None:
            self.in_on_event = sys.exit
            bus.clear()
            bus.operate()
            self.goes_on(bus)

        self.run(then)


if __name__ == "__main__":
    getattr(Scripts(sys.argv[1], sys.argv[2]), sys.argv[3])()
