"""``dpstack.ppi`` on a simulated line: our master asks a simulated S7-200, and octets of libnodave do."""

from __future__ import annotations

import asyncio
import datetime
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

import dpstack
from dpstack.errors import CpuRefused, SlaveTimeout, UsageError
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.ppi import Cpu, CpuStation, open_ppi
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

PARAMS = BusParams.preset(9600, address=2)


@asynccontextmanager
async def line(station: CpuStation, **options: object) -> AsyncIterator[tuple[Cpu, dpstack.World]]:
    world = dpstack.World()
    world.add(PassiveStation(2, station, PARAMS), name="CPU")
    async with open_ppi(2, world=world, **options) as cpu:  # type: ignore[arg-type]
        yield cpu, world
    assert world.referee is not None
    world.referee.check()


async def test_values_mode_and_clock() -> None:
    station = CpuStation()
    station.cpu["VW100"] = 1234
    async with line(station) as (cpu, _):
        assert await cpu.connect() == 240
        assert await cpu.read("VW100") == 1234
        await cpu.write("VD8:real", 2.5)
        await cpu.write("M0.3", True)
        assert await cpu.read_all(["VD8:real", "M0.3", "VB0[4]"]) == [2.5, True, bytes(4)]
        modes = []
        for change in (cpu.stop, cpu.run):
            await change()
            modes.append(station.cpu.running)
        assert modes == [False, True]
        await cpu.set_clock(datetime.datetime(2026, 11, 28, 12, 0, 0))
        assert await cpu.clock() - datetime.datetime(2026, 11, 28, 12, 0, 0) < datetime.timedelta(seconds=1)


async def test_many_values_need_few_requests() -> None:
    station = CpuStation(answer_ns=0)
    for at in range(0, 60, 2):
        station.cpu[f"VW{at}"] = at
    async with line(station) as (cpu, _):
        assert await cpu.read_all([f"VW{at}" for at in range(0, 60, 2)]) == list(range(0, 60, 2))
    assert station.requests == 2


async def test_a_cpu_that_says_not_yet_for_long_is_asked_again() -> None:
    station = CpuStation(answer_ns=900 * NS_PER_MS)
    async with line(station) as (cpu, _):
        assert await cpu.read("VB0") == 0
    assert station.requests == 1


async def test_a_cpu_that_never_answers_has_a_bound() -> None:
    station = CpuStation()
    station.mute = True
    async with line(station, timeout=1.0) as (cpu, _):
        with pytest.raises(SlaveTimeout, match="no answer to the request within 1 s"):
            await cpu.read("VB0")
        station.mute = False
        assert await cpu.read("VB1") == 0  # the answer to the earlier request is not taken for this one


async def test_nobody_at_that_address() -> None:
    world = dpstack.World()
    async with open_ppi(5, world=world) as cpu:
        with pytest.raises(SlaveTimeout, match="CPU 5 does not answer: check address, rate, cable and supply"):
            await cpu.read("VB0")


@pytest.mark.parametrize(
    ("act", "message"),
    [
        ("read AQW0", r"CPU 2 refuses read AQW0: access is not allowed .code 03h"),
        ("write AIW0", r"CPU 2 refuses write AIW0: access is not allowed .code 03h"),
        ("read VB10240", r"beyond this CPU's memory"),
        ("stop", r"CPU 2 refuses STOP: not allowed in the present mode of the CPU .error 8001h"),
    ],
)
async def test_errors_of_the_cpu_in_words(act: str, message: str) -> None:
    station = CpuStation()
    station.cpu.locked = True
    async with line(station) as (cpu, _):
        what, _, where = act.partition(" ")
        calls = {"read": lambda: cpu.read(where), "write": lambda: cpu.write(where, 1), "stop": cpu.stop}
        with pytest.raises(CpuRefused, match=message):
            await calls[what]()


async def test_two_programs_share_one_cpu() -> None:
    async with line(CpuStation()) as (cpu, _):
        async with asyncio.TaskGroup() as tasks:
            writes = [tasks.create_task(cpu.write(f"VB{at}", at)) for at in range(4)]
        assert all(write.done() for write in writes)
        assert await cpu.read("VB0[4]") == bytes(range(4))


async def test_impossible_arguments() -> None:
    async with line(CpuStation()) as (cpu, _):
        with pytest.raises(UsageError, match="no address of an S7-200"):
            await cpu.read("DB1.DBW0")
        with pytest.raises(UsageError, match="a list of addresses"):
            await cpu.read_all("VB0")
        with pytest.raises(UsageError, match="1990 to 2089"):
            await cpu.set_clock(datetime.datetime(1980, 1, 1))


async def test_two_masters_on_one_wire_ask_one_cpu() -> None:
    """PPI advanced: they share the token ring."""
    async with line(CpuStation(), hsa=5) as (cpu, world), open_ppi(2, own=1, world=world, hsa=5) as other:
        await cpu.write("VW0", 5)
        assert await other.read("VW0") == 5
        async with asyncio.TaskGroup() as tasks:
            reads = [tasks.create_task(one.read("VW0")) for one in (cpu, other) for _ in range(3)]
        assert [read.result() for read in reads] == [5] * 6
        assert other.station.snapshot.las == {0, 1}


async def test_beside_a_dp_master_on_the_same_station() -> None:
    world = dpstack.World()
    world.add(PassiveStation(7, CpuStation(), BusParams.preset(187_500, address=7)), name="CPU")
    async with dpstack.open_bus(world=world, baud=187_500) as bus:
        cpu = Cpu(bus.fdl, 7)
        await cpu.write("VW0", 77)
        assert await cpu.read("VW0") == 77
