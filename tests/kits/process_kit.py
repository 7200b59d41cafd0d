"""Kit of the bus process: slaves of octets at the other end of a pty, a bus on it, the state of its process."""

from __future__ import annotations

import contextlib
import os
import signal
import tty
from collections.abc import AsyncIterator, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from far_ends import eventually
from support_responder import Responder

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.drivers.process.channel import Channel
from dpstack.drivers.process.client import ProcessRuntime

if TYPE_CHECKING:
    import pytest

#: [bus] of tests in which nobody may be lost: the other end may have to wait 16 times 50 ms for a busy computer, and a
#: pause of a busy computer, or of a test that blocks, shall not end in Clear
UNHURRIED: dict[str, Any] = {"gap": 0, "max_retry": 15, "after_stall": "resume"}

#: s in which each answer of a slave comes that is a task of the test's own program (1 and 2 s where nothing is said)
ANSWER_S = 20


def unhurried(table: dict[str, object]) -> dict[str, object]:
    """The ``table`` of a DP-V1 slave whose services may take ``ANSWER_S``."""
    dpv1 = table["dpv1"]
    more = dpv1 if isinstance(dpv1, dict) else {}
    return table | {"dpv1": {**more, "response_timeout_ms": ANSWER_S * 1000}}


Driver = Literal["asyncio", "process"]
DRIVERS: tuple[Driver, ...] = ("asyncio", "process")

VALVES: dict[str, object] = {
    "name": "valves",
    "address": 4,
    "ident": 0x1234,
    "config": "21 11",
    "safe": "A5 5A",
    "sync": True,
    "freeze": True,
    "groups": [1],
    "inputs": {"level": "i16@0"},
    "outputs": {"target": "i16@0"},
}
SPEC = "4:1234:2111:2:2"
LAMPS: dict[str, object] = {
    "name": "lamps", "address": 5, "ident": 0x1234, "config": "20 10", "sync": True, "freeze": True, "groups": [1]
}  # fmt: skip
LAMPS_SPEC = "5:1234:2010:1:1"


@contextlib.contextmanager
def octet_slaves(*specs: str) -> Iterator[tuple[str, Responder]]:
    """The path of a pty, and the slaves of ``specs`` (see ``support_responder``) at its other end."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        path = os.ttyname(slave)
        responder = Responder(path, specs)
        os.dup2(master, responder.fd)
        with responder:
            yield path, responder
    finally:
        os.close(master)
        os.close(slave)


def bus_on(path: str, driver: Driver, *slaves: dict[str, object], **more: Any) -> dpstack.Bus:
    return dpstack.open_bus(port=path, baud=1_500_000, slaves=slaves, driver=driver, **UNHURRIED | more)


@contextlib.asynccontextmanager
async def ready_bus(
    *slaves: dict[str, object], specs: Sequence[str] = (SPEC,), driver: Driver = "process", **more: Any
) -> AsyncIterator[tuple[dpstack.Bus, Responder]]:
    """A bus on a pty whose slaves are in data exchange, and at the other end the slaves of ``specs``."""
    with octet_slaves(*specs) as (path, there):
        async with bus_on(path, driver, *slaves, **more) as bus:
            await bus.ready(60)
            yield bus, there


@contextlib.asynccontextmanager
async def operating_octets(
    driver: Driver, *slaves: dict[str, object], **more: Any
) -> AsyncIterator[tuple[dpstack.Bus, Responder]]:
    """A bus in Operate with ``slaves``, which exchange data; at the other end of its pty are VALVES and LAMPS."""
    async with ready_bus(*slaves, specs=(SPEC, LAMPS_SPEC), driver=driver, **more) as (bus, there):
        await bus.operate()
        yield bus, there


def runtime_of(bus: dpstack.Bus) -> ProcessRuntime:
    runtime = core_of(bus).runtime
    assert isinstance(runtime, ProcessRuntime)
    return runtime


def begun(bus: dpstack.Bus) -> int:
    """The fixed cycles that its books have."""
    book = bus.stats.cycles
    assert book is not None
    return book.begun


def process_of(bus: dpstack.Bus) -> int:
    """The process id of its bus process."""
    pid = runtime_of(bus).pid
    assert pid is not None
    return pid


def runs(pid: int) -> bool:
    """Not ended, or not taken notice of by its parent."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    """The process ``pid`` does not run inside the block."""
    os.kill(pid, signal.SIGSTOP)
    eventually(lambda: state_of(pid) == "T", "the process is stopped")
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def stop_for_good(monkeypatch: pytest.MonkeyPatch, bus_process: int) -> None:
    """The process ``bus_process`` hangs: it is stopped, and the end of the bus does not continue it."""
    monkeypatch.setattr(Channel, "_continue_stopped", lambda _channel: None)
    os.kill(bus_process, signal.SIGSTOP)


def state_of(pid: int) -> str:
    with open(f"/proc/{pid}/stat", encoding="ascii") as file:
        return file.read().rpartition(")")[2].split()[0]
