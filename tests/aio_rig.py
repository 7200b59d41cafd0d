"""A machine that does as a test tells it, under the asyncio driver on a memory line."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from time import monotonic_ns
from typing import Any

from dpstack.drivers.aio import AsyncioRuntime
from dpstack.drivers.echo import Echo
from dpstack.ports import memory_pair
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS

TOKEN = bytes.fromhex("DC 02 02")
REQUEST = bytes.fromhex("10 02 63 49 AE 16")
BACKOFF = (NS_PER_MS, 4 * NS_PER_MS)


class Script:
    """A machine with one deadline and one transmission to be made, set by the test; it writes down what happens."""

    def __init__(self) -> None:
        self.baud = 500_000
        self.deadline = NEVER
        self.tx: list[bytes] = []
        self.events: list[Event] = []
        self.log: list[tuple[Any, ...]] = []
        self.on_receive: Callable[[bytes, int], None] = lambda _chunk, _now: None
        self.on_wake: Callable[[int], None] = lambda _now: None

    def receive(self, chunk: bytes, now: int) -> None:
        self.log.append(("receive", chunk, now))
        self.on_receive(chunk, now)

    def sent(self, at: int) -> None:
        self.log.append(("sent", at, monotonic_ns()))

    def wake(self, now: int) -> None:
        if now < self.deadline:
            return
        self.log.append(("wake", self.deadline, now))
        self.deadline = NEVER
        self.on_wake(now)

    def take_tx(self, now: int) -> bytes | None:
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


class Rig:
    """A driver on one end of a memory line, the test on the other."""

    def __init__(self, **options: Any) -> None:
        self.port, self.far = memory_pair(500_000)
        self.machine = Script()
        self.events: list[Event] = []
        self.calls = 0
        self.failures: list[Exception] = []
        chosen: dict[str, Any] = {"echo": Echo.OFF, "on_failure": self.failures.append, "backoff_ns": BACKOFF}
        chosen.update(options)
        self.driver = AsyncioRuntime(self.port, self.machine, self.told, **chosen)

    def told(self, events: list[Event]) -> None:
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
