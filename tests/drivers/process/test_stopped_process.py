"""No call of the application waits for its bus process: every public one is made while that is stopped."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import select
import socket
import subprocess
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import Future
from typing import Any

import pytest
from api_kit import FAN, bus_of, in_virtual_time
from far_ends import until
from process_kit import VALVES, process_of, ready_bus, runtime_of, stopped

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.fdl.fdl import Fdl
from dpstack.api.slave.class2 import Class2
from dpstack.dpv1.pdu.im import Im1
from dpstack.drivers.process.channel import LIMIT_NS
from dpstack.errors import DpError, DriveError, UsageError

RIG = VALVES | {"address": 5, "dpv1": True, "user_prm": "00 00 00"}

#: what begins the end of a bus, or is its own call to a drive
NOT_CALLED: dict[type, set[str]] = {
    dpstack.Bus: {"open", "close", "hurry"},
    dpstack.Drive: {"end", "on_payload", "on_refused"},
    dpstack.Slave: set(),
    Class2: set(),
    Fdl: set(),
}


class Level(dpstack.Inputs):
    level: dpstack.Int = dpstack.at()


class Target(dpstack.Outputs):
    target: dpstack.Int = dpstack.at()


def arguments(bus: dpstack.Bus) -> dict[type, dict[str, tuple[Any, ...]]]:
    """Of the methods that need some; who adds a public method adds its arguments here."""
    rig, saved = bus.slave("valves"), "/nowhere/saved.toml"
    return {
        dpstack.Bus: {
            "add_slave": (RIG | {"name": "more", "address": 6},),
            "cpu": (2,),
            "drive": ("fan",),
            "record": ("/nowhere/kept.csv",),
            "remove": ("valves",),
            "rotated": (None,),
            "slave": ("fan",),
            "until": (lambda: False,),
            "wait_state": (dpstack.Mode.STOP,),
            "why": ("valves",),
        },
        dpstack.Slave: {
            "changes": ("level",),
            "check_outputs": (bytes(2),),
            "conspicuous_text": (rig.diagnosis,),
            "follow": ("target", int),
            "inputs_as": (Level,),
            "order": ("preset",),
            "output_field": ("target",),
            "outputs_as": (Target,),
            "quality": ("target",),
            "read": (1, 2),
            "read_time_stamps": (100,),
            "readings": ("level",),
            "send": (Target(target=7),),
            "until": (lambda _: False,),
            "update": ({"target": 7},),
            "value": ("target", int),
            "write": (1, 2, b"\x01"),
            "write_im": (Im1(),),
            "hart": (0,),
        },
        dpstack.Drive: {
            "compare": (saved,),
            "order": ("settled",),
            "parameter": (480,),
            "read": (480,),
            "read_array": (480, 2),
            "read_many": ([480],),
            "write": (480, 1.0),
        },
        Class2: {
            "config": (5,),
            "connect": (5,),
            "diagnosis": (5,),
            "inputs": (5,),
            "outputs": (5,),
            "set_address": (5, 9),
        },
        Fdl: {
            "fdl_status": (5,),
            "ident": (5,),
            "lsap_status": (5, 20),
            "msrd": (9,),
            "sap": (20,),
            "sda": (9, b"\x01"),
            "sdn": (9, b"\x01"),
            "srd": (9,),
        },
    }


KEYWORDS: dict[str, dict[str, object]] = {"conspicuous_text": {"exchanging": True}}
ASSIGNED: dict[str, object] = {"outputs": b"\x01\x02", "speed": 0.25, "frequency": 10.0}


@contextlib.contextmanager
def nothing_blocks() -> Iterator[None]:
    """In this thread whatever would wait for another process, or a thread, raises; also where that is caught."""
    thread = threading.get_ident()
    blocked: list[str] = []

    def guarded(name: str, real: Callable[..., Any], waits: Callable[..., bool]) -> Callable[..., Any]:
        def call(*args: Any, **more: Any) -> Any:
            if threading.get_ident() == thread and waits(*args):
                blocked.append(name)
                raise AssertionError(f"{name} blocks the event loop")
            return real(*args, **more)

        return call

    waiting = (select, "select"), (time, "sleep"), (subprocess.Popen, "wait"), (threading.Condition, "wait")
    with pytest.MonkeyPatch.context() as patch:
        for owner, name in (*waiting, (Future, "result")):
            patch.setattr(owner, name, guarded(name, getattr(owner, name), lambda *_: True))
        for name in ("recv", "recv_into", "send", "sendall", "accept", "connect"):
            real = getattr(socket.socket, name)
            patch.setattr(socket.socket, name, guarded(name, real, lambda sock, *_: sock.gettimeout() != 0))
        yield
    assert blocked == []


def public(kind: type) -> Iterator[tuple[str, object]]:
    for name in dir(kind):
        if not name.startswith("_"):
            yield name, inspect.getattr_static(kind, name)


async def use_everything(bus: dpstack.Bus) -> set[str]:
    """Read every public property, assign what can be, call every public method; what they are all called."""
    used: set[str] = set()
    tasks: list[asyncio.Future[object]] = []
    given = arguments(bus)
    objects: tuple[object, ...] = (bus, *bus.slaves, *bus.drives, bus.class2, bus.fdl)
    for one in objects:
        kind = type(one)
        assert set(given[kind]) | NOT_CALLED[kind] <= {name for name, _ in public(kind)} | {
            "at_exit",
            "release_after_fork",
        }
        for name, member in public(kind):
            if name in NOT_CALLED[kind]:
                continue
            used.add(f"{kind.__name__}.{name}")
            with contextlib.suppress(DpError):
                if isinstance(member, property):
                    getattr(one, name)
                    if member.fset is not None:
                        setattr(one, name, ASSIGNED[name])
                elif callable(member):
                    result = getattr(one, name)(*given[kind].get(name, ()), **KEYWORDS.get(name, {}))
                    if isinstance(result, AsyncIterator):
                        result = anext(result)
                    if isinstance(result, Awaitable):
                        tasks.append(asyncio.ensure_future(result))
                        await asyncio.sleep(0)
    for _ in range(5):
        await asyncio.sleep(0)
    for task in tasks:
        task.cancel()
    for end in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(end, BaseException) and not isinstance(end, (DpError, asyncio.CancelledError)):
            raise end
    return used


async def silence(bus: dpstack.Bus) -> None:
    """The bus process is known to be silent, and the time limit of all that was given up to now is over."""
    over = time.monotonic_ns() + LIMIT_NS
    await until(lambda: runtime_of(bus).not_running is not None and time.monotonic_ns() > over, "the silence")


def fan_octets() -> str:
    """A drive that knows only octets, and so never says that it runs."""
    fan = make_config("/dev/null", 1_500_000, slaves=[FAN]).slaves[0].params
    return f"{fan.address}:{fan.ident:04x}:{fan.config.hex()}:{fan.input_len}:{fan.output_len}"


async def test_no_public_call_waits_for_a_stopped_bus_process() -> None:
    unwatched: dict[str, object] = {"watchdog_ms": 30_000}
    specs = (fan_octets(), "5:1234:2111:2:2,records=1")
    async with ready_bus(FAN | unwatched, RIG | unwatched, specs=specs) as (bus, _there):
        await bus.why("fan", ask=False)  # the first one has its modules loaded in a thread, and waits for its start
        with stopped(process_of(bus)):
            with nothing_blocks():
                used = await use_everything(bus)
            await silence(bus)
            with nothing_blocks():
                assert await use_everything(bus) == used
        assert {"Bus.stats", "Slave.inputs", "Drive.speed", "Drive.start", "Class2.connect"} <= used
        # all that was ordered was dropped: nothing old happens when it goes on
        await bus.ready(60)
        assert bus.mode is dpstack.Mode.CLEAR
        assert [slave.name for slave in bus.slaves] == ["fan", "valves"]
        await until(lambda: bus.drive("fan").speed == 0, "the set point is the one from before")


async def test_a_set_point_is_read_back_at_once_and_one_that_was_not_taken_is_raised() -> None:
    told: list[str] = []
    slave = FAN | {"watchdog_ms": 30_000}
    async with ready_bus(slave, specs=(fan_octets(),), on_event=lambda event: told.append(event.text)) as (bus, _there):
        fan = bus.drive("fan")
        fan.speed = 0.5
        assert (fan.speed, fan.status.setpoint) == (0.5, 0.5)
        await until(lambda: not fan._setpoints, "the plugin has it")
        assert (fan.speed, fan.status.setpoint) == (0.5, 0.5)
        with pytest.raises(UsageError, match="drive fan"):
            fan.speed = 99
        with stopped(process_of(bus)):
            fan.speed = 0.75
            assert fan.speed == 0.75
            await silence(bus)
        await until(lambda: fan.speed == 0.5, "it was not taken")
        assert any("DriveCommand was not carried out: the bus process took the order" in text for text in told)
        with pytest.raises(dpstack.OrderDropped, match="too late and dropped it"):
            await fan.start(60)


@in_virtual_time
async def test_a_refused_set_point_keeps_no_order_from_stopping_the_drive() -> None:
    async with bus_of(FAN) as bus:
        await bus.operate()
        fan = bus.drive("fan")
        await fan.start()
        for stop in (fan.stop, fan.quick_stop, fan.coast):
            fan._refused = DriveError("fan", "not taken")
            with pytest.raises(DriveError, match="not taken"):
                await stop()
            assert not fan.status.running
            fan._refused = DriveError("fan", "not taken")
            with pytest.raises(DriveError, match="not taken"):
                await fan.start()
            assert not fan.status.running
            await fan.start()
