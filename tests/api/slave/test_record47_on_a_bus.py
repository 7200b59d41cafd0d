"""Record 47 over MS1 on a bus: a drive by name, a whole list, both at the same time; times on the wire."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest
from api_kit import begun, bench_of, running
from support import WorldFactory, instance

import dpstack
from bench.parameters import MIXER, mixer, read_out
from dpstack.profile.record47 import Address, ErrorValue, Values
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

PUMP: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "ST1"}


@pytest.mark.parametrize(
    ("baud", "described", "seconds", "services", "octets"),
    [
        (500_000, False, 0.58, 82, 12_720),
        (1_500_000, False, 0.195, 82, 12_720),
        pytest.param(500_000, True, 3.76, 590, 69_456, marks=pytest.mark.soak),
        pytest.param(1_500_000, True, 1.06, 590, 69_456, marks=pytest.mark.soak),
    ],
)
def test_the_time_of_1000_parameters(baud: int, described: bool, seconds: float, services: int, octets: int) -> None:
    """``described``: with 1000 descriptions and whole arrays; else the first values alone."""
    seen = read_out(baud, described=described)
    assert seen.parameters == 1000
    assert seen.seconds == pytest.approx(seconds, rel=0.05)
    counters = seen.counters
    assert (counters.services, counters.octets) == (services, octets)
    assert counters.busy == counters.strays == counters.repeated == 0


@contextlib.asynccontextmanager
async def mixing(bench: World) -> AsyncIterator[dpstack.Bus]:
    """A bus with the mixer at 9, in data exchange."""
    async with (
        dpstack.slave.serve_slave(mixer(), world=bench, address=9, baud=1_500_000),
        dpstack.open_bus(port="virtual", baud=1_500_000, slaves=[MIXER.table(9)], world=bench) as bus,
    ):
        await bus.operate()
        await bus.slave(9).ready()
        yield bus


async def test_1000_parameters_with_progress(world: WorldFactory) -> None:
    """With the referee on the wire."""
    bench = world()
    async with mixing(bench) as bus:
        told: list[tuple[int, int]] = []
        found = await bus.slave(9).parameters().read_out(described=False, progress=lambda *one: told.append(one))
        assert len(found) == 1000
        assert found[-1].values == (7,)
        assert told[-1] == (1000, 1000)
        assert bus.slave(9).retries == bus.slave(9).timeouts == 0


async def test_a_lost_request_is_written_again(world: WorldFactory) -> None:
    bench = world()
    async with mixing(bench) as bus:
        parameters = bus.slave(9).parameters()
        bench.faults.drop(lambda tx: b"\x33\x33\x5f" in tx.octets, times=2)  # and its repetition
        assert await parameters.read([Address(1)]) == [Values(6, (1,))]
        assert parameters.counters.repeated == 1
        bench.faults.drop(lambda tx: b"\x33\x33\x5f" in tx.octets, times=2)
        with pytest.raises(dpstack.DriveTimeout, match="it may have been carried out: read it back"):
            await parameters.change([(Address(1), Values(6, (2,)))])


async def test_a_drive_by_name_in_a_telegram_without_a_channel() -> None:
    async with running(PUMP) as (bus, pump):
        assert await pump.read(965) == 0x0328
        assert await pump.read(918) == 6
        written = await pump.write("dr-03", 2.5)
        assert (written.value, written.unit, written.raw) == (2.5, "s", 25)
        assert await pump.read(964, index=6) == 0x0A6C
        with pytest.raises(dpstack.ParameterError, match="drive pump: dr-99: error 0, illegal parameter number"):
            await pump.read("dr-99")
        im0 = instance(await bus.slave("pump").im(), dpstack.Im0)
        assert (im0.manufacturer_id, im0.order_id, im0.supported) == (0x0351, "CPDP-S100", 1)
        several = await bus.slave("pump").parameters().read([Address(n) for n in (918, 922, 930, 1, 963)])
        assert several == [Values(6, (6,)), Values(6, (1,)), Values(6, (1,)), ErrorValue(0), Values(6, (4,))]


async def test_plugin_and_programs_that_ask_at_the_same_time_take_turns() -> None:
    async with running(PUMP) as (bus, pump):
        first, second = bus.slave("pump").parameters(), bus.slave("pump").parameters()
        for _ in range(5):
            by_name = asyncio.gather(pump.read(965), pump.read("dr-20"))
            by_number = asyncio.gather(*(one.read([Address(pnu)]) for one in (first, second) for pnu in (918, 930)))
            assert list(await by_name) == [0x0328, 60.0]
            assert list(await by_number) == [[Values(6, (6,))], [Values(6, (1,))]] * 2
        assert first.counters.strays == second.counters.strays == 0
        assert first.counters.requests == second.counters.requests == 10


async def test_without_dp_v1_it_goes_by_pkw_or_says_what_to_do() -> None:
    slaves = [PUMP | {"telegram": "PPO1", "dpv1": False}, PUMP | {"name": "old", "address": 7, "dpv1": False}]
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves) as bus:
        await bus.operate()
        assert await bus.drive("pump").read(965) == 0x0328
        with pytest.raises(dpstack.UsageError, match="ST1 of ls-s100 has no parameter channel"):
            await bus.drive("old").read(965)


async def test_the_drive_goes_and_comes_in_between() -> None:
    async with running(PUMP) as (bus, pump):
        reading = await begun(pump.read(965), 0.002)
        bench_of(bus).power(6, False)
        with pytest.raises(dpstack.DriveError):
            await reading
        await bus.until(lambda: not bus.slave(6).ready_now, 5)
        bench_of(bus).power(6, True)
        await bus.slave(6).ready()
        assert await pump.read(965) == 0x0328
