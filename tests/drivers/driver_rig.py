"""A scripted machine under each real-time driver, on a line in memory.

Tests are written for asyncio. The plain loop runs beside it, a slice of a millisecond at a time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from time import monotonic_ns
from typing import Any

from memory_port import memory_pair
from support import KeepsEvents

from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.select_runtime import SelectRuntime
from dpstack.drivers.runtime import OnEvents
from dpstack.machine import Machine
from dpstack.ports import Port
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS

TOKEN = bytes.fromhex("DC 02 02")
REQUEST = bytes.fromhex("10 02 63 49 AE 16")
BACKOFF = (NS_PER_MS, 4 * NS_PER_MS)

#: The driver that is tested, one of DRIVERS; the fixture ``each_driver`` sets it.
kind = "asyncio"
DRIVERS = ("asyncio", "plain")
_SLICE_NS = 300_000


class PlainBeside:
    """A plain driver whose loop runs in slices within the test's asyncio loop; looks like the asyncio driver."""

    def __init__(self, port: Port, machine: Machine, on_events: OnEvents, **options: Any) -> None:
        self.loop = SelectLoop(report=self._report)
        self.plain = SelectRuntime(port, machine, on_events, **options)
        self._running: asyncio.Task[None] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plain, name)

    async def open(self) -> None:
        self.plain.open(self.loop)
        self._running = asyncio.create_task(self._run())

    async def close(self) -> None:
        self.plain.close()
        if self._running is not None:
            self._running.cancel()
            await asyncio.wait([self._running])
        if not self.loop.is_closed():
            self.loop.close()

    async def _run(self) -> None:
        while True:
            self.loop.call_at(monotonic_ns() + _SLICE_NS, self.loop.stop)
            self.loop.run()
            await asyncio.sleep(0)

    @staticmethod
    def _report(message: str, error: Exception) -> None:
        asyncio.get_running_loop().call_exception_handler({"message": message, "exception": error})


def driver_on(port: Port, machine: Machine, on_events: OnEvents, **options: Any) -> Any:
    """The driver that is tested, on ``port``."""
    return {"asyncio": AsyncioRuntime, "plain": PlainBeside}[kind](port, machine, on_events, **options)


class Script:
    """A machine with one deadline and one transmission to be made, set by the test; it writes down what happens."""

    held_up: Any = None

    def __init__(self) -> None:
        self.baud = 500_000
        self.deadline = NEVER
        self.tx: list[bytes] = []
        self.events: list[Event] = []
        self.log: list[tuple[Any, ...]] = []
        self.on_receive: Callable[[bytes, int], None] = lambda _chunk, _now: None
        self.on_wake: Callable[[int], None] = lambda _now: None

    def receive(self, chunk: bytes, now: int) -> int:
        self.log.append(("receive", chunk, now))
        self.on_receive(chunk, now)
        return self.wake_at()

    def sent(self, at: int) -> int:
        self.log.append(("sent", at, monotonic_ns()))
        return self.wake_at()

    def take_tx(self, now: int) -> bytes | None:
        if now >= self.deadline:
            self.log.append(("wake", self.deadline, now))
            self.deadline = NEVER
            self.on_wake(now)
        return self.tx.pop(0) if self.tx else None

    def wake_at(self) -> int:
        return 0 if self.tx else self.deadline

    def take_events(self) -> list[Event]:
        events, self.events = self.events, []
        return events

    def command(self, command: object, now: int) -> None:
        self.log.append(("command", command))
        if isinstance(command, bytes):
            self.tx.append(command)
        elif isinstance(command, int):
            self.deadline = now + command
        elif isinstance(command, Exception):
            raise command

    def did(self, what: str) -> list[tuple[Any, ...]]:
        return [entry for entry in self.log if entry[0] == what]

    @property
    def received(self) -> list[bytes]:
        """The octets of all calls of ``receive``."""
        return [octets for _, octets, _ in self.did("receive")]

    @property
    def commands(self) -> list[Any]:
        return [command for _, command in self.did("command")]


def defect(*_arguments: object) -> None:
    """A callback of the machine that fails."""
    raise ZeroDivisionError("a defect")


class Rig(KeepsEvents):
    """A driver on one end of a memory line, the test on the other."""

    def __init__(self, **options: Any) -> None:
        self.port, self.far = memory_pair(500_000)
        self.machine = Script()
        self.events: list[Event] = []
        self.calls = 0
        self.failures: list[Exception] = []
        chosen: dict[str, Any] = {"echo": Echo.OFF, "on_failure": self.failures.append, "backoff_ns": BACKOFF}
        chosen.update(options)
        self.driver = driver_on(self.port, self.machine, self.on_events, **chosen)

    def on_events(self, events: list[Event]) -> None:
        assert events
        self.calls += 1
        self.events += events

    async def __aenter__(self) -> Rig:
        await self.far.open()
        await self.driver.open()
        return self

    async def __aexit__(self, *_exc: object) -> None:
        await self.driver.close()
        self.far.close()

    async def settle(self) -> None:
        for _ in range(3):
            await asyncio.sleep(0)
