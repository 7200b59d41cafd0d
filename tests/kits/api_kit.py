"""Kit of the public API: configured slaves, a bus of them, a program in virtual time."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any, ParamSpec, TypeVar, Unpack

import pytest
from slave_kit import make_slave

import dpstack
from dpstack.api.bus.bus import SlaveTable, core_of
from dpstack.api.slave_side.slave_server import ServedSlave
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.user_slave import SlaveOptions
from dpstack.drivers.stack import Stack
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.slave import DpSlave, SlaveDescription

T = TypeVar("T")
P = ParamSpec("P")
RAW: dict[str, object] = {"name": "raw", "address": 9, "ident": 0x1234, "config": "20 10"}
HOIST: dict[str, object] = {"name": "hoist", "address": 3, "drive": "demag-dedrive"}
FAN: dict[str, object] = {"name": "fan", "address": 4, "drive": "fuji-frenic", "telegram": "PPO3"}
#: a DP-V1 slave with one octet each way
RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True)


def virtual(program: Coroutine[Any, Any, T]) -> T:
    return dpstack.run_virtual(program)


def in_virtual_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """A test in the event loop of a simulated bus. All of a module: ``pytestmark = pytest.mark.virtual_time``."""

    @functools.wraps(test)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        virtual(test(*args, **kwargs))

    return run


async def begun(program: Coroutine[Any, Any, T], seconds: float) -> asyncio.Task[T]:
    """Its task, which has had this time."""
    task = asyncio.ensure_future(program)
    await asyncio.sleep(seconds)
    return task


async def cancelled(task: asyncio.Task[Any]) -> None:
    """Cancel ``task``, and wait until it has ended by that."""
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


def bus_of(*slaves: SlaveTable, baud: int = 500_000, **more: Any) -> dpstack.Bus:
    return dpstack.open_bus(port="virtual", baud=baud, slaves=slaves, **more)


@contextlib.asynccontextmanager
async def in_operate(bus: dpstack.Bus) -> AsyncIterator[dpstack.Bus]:
    """The bus in Operate, with all slaves in data exchange."""
    async with bus:
        await bus.operate()
        await bus.ready()
        yield bus


def operating(*slaves: SlaveTable, **more: Any) -> AbstractAsyncContextManager[dpstack.Bus]:
    """A bus of these slaves, as :func:`in_operate` has it."""
    return in_operate(bus_of(*slaves, **more))


def bench_of(bus: dpstack.Bus) -> VirtualBench:
    """The simulated slaves of a bus."""
    bench = core_of(bus).bench
    assert bench is not None
    return bench


def slave_in(world: World, device: Device, address: int) -> tuple[PassiveStation, SlaveApp]:
    station = make_slave(address, device, BusParams.preset(500_000))
    world.add(station)
    app = station.responder
    assert isinstance(app, SlaveApp)
    return station, app


def mirror(description: SlaveDescription = RIG, **options: Unpack[SlaveOptions]) -> DpSlave:
    """A slave whose inputs are its outputs."""
    return DpSlave(description, lambda outputs, elapsed: outputs, **options)


@contextlib.asynccontextmanager
async def serving(
    slave: DpSlave,
    world: World | None = None,
    events: list[dpstack.Event] | None = None,
    *,
    baud: int = 500_000,
    **keys: object,
) -> AsyncIterator[tuple[dpstack.Bus, ServedSlave]]:
    """``slave`` at address 9 and a bus in Operate that exchanges data with it.

    ``keys`` of its [[slave]] table; ``events``: the list that gets the events of both.
    """
    world = World() if world is None else world
    table = slave.description.table(9) | keys
    on_event = None if events is None else events.append
    async with (
        dpstack.slave.serve_slave(slave, world=world, address=9, baud=baud, on_event=on_event) as server,
        dpstack.open_bus(world=world, baud=baud, slaves=[table], on_event=on_event) as bus,
    ):
        await bus.operate()
        await bus.ready()
        yield bus, server.slave


@contextlib.asynccontextmanager
async def running(drive: Mapping[str, object], baud: int = 500_000) -> AsyncIterator[tuple[dpstack.Bus, dpstack.Drive]]:
    """A bus in Operate with one ``drive``, in data exchange."""
    async with dpstack.open_bus(port="virtual", baud=baud, slaves=[drive]) as bus:
        await bus.ready()
        await bus.operate()
        yield bus, bus.drive(str(drive["name"]))


def device_of(bus: dpstack.Bus, address: int) -> dpstack.profile.DriveDevice:
    """The simulated drive at ``address``."""
    device = bench_of(bus).device(address)
    assert isinstance(device, dpstack.profile.DriveDevice)
    return device


async def trip(bus: dpstack.Bus, drive: dpstack.Drive, fault: str, text: str) -> None:
    """The simulated ``drive`` trips with ``fault``, and its status says ``text``."""
    device_of(bus, drive.address).trip(fault)
    async for status in drive.statuses():
        if status.fault == text:
            return


async def off_and_on(bus: dpstack.Bus, address: int) -> None:
    """A simulated slave loses its power, which the master notices, and comes back into data exchange."""
    bench = bench_of(bus)
    bench.power(address, False)
    await bus.until(lambda: not bus.slave(address).ready_now, 5)
    bench.power(address, True)
    await bus.slave(address).ready()


def stack_of(bus: dpstack.Bus) -> Stack:
    """The machines of a bus that runs in this process."""
    view = core_of(bus).view
    assert isinstance(view, Stack)
    return view
