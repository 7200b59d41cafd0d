"""``open_bus(baud="auto")`` and slaves that search, on simulated buses and over ptys."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path

import pytest
from api_kit import FAN, HOIST, RAW, begun, in_operate, in_virtual_time, operating
from far_ends import until

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.errors import BusError, ConfigError, UsageError
from dpstack.sim.world import World

#: a watchdog as short as a pty lets it be, for there is nothing but to wait for it
QUICK = {**RAW, "watchdog_ms": 200}


def searching(bus: dpstack.Bus) -> bool:
    return bus.searching


def make_world() -> World:
    return dpstack.World(referee=False)


@pytest.fixture
def plant() -> World:
    """A simulated bus whose slaves HOIST and RAW search the baud rate."""
    world = dpstack.World(referee=False)
    dpstack.simulate(world, [HOIST, RAW])
    return world


@in_virtual_time
async def test_slaves_that_search_follow_the_master_from_rate_to_rate(plant: World) -> None:
    for baud in (1_500_000, 187_500):
        async with dpstack.open_bus(world=plant, baud=baud, slaves=[HOIST, RAW]) as bus:
            await bus.operate()
            await bus.ready(10)
            bus.slave("raw").outputs = b"\x5a"
            await bus.rotated(5, 1)
            assert bus.slave("raw").inputs == b"\x5a"
            assert bus.params.baud == baud
        await asyncio.sleep(2)  # virtual seconds: the watchdogs, then the silence


@in_virtual_time
async def test_slaves_that_search_are_switched_off_and_on() -> None:
    world = make_world()
    bench = dpstack.simulate(world, [RAW], baud="auto")
    async with operating(RAW, world=world) as bus:
        bench.power(9, False)
        await bus.until(lambda: not bus.slave("raw").ready_now, 2)
        bench.power(9, True)
        await bus.ready()
        bench.silence(9, 300_000_000)
        await bus.until(lambda: not bus.slave("raw").ready_now, 2)
        await bus.ready()


@in_virtual_time
async def test_slaves_at_a_given_rate_do_not_search() -> None:
    world = make_world()
    dpstack.simulate(world, [RAW], baud=500_000)
    async with dpstack.open_bus(world=world, baud=187_500, slaves=[RAW]) as bus:
        with pytest.raises(dpstack.SlaveTimeout, match="no answer from address 9"):
            await bus.ready(2)


@in_virtual_time
async def test_a_second_master_finds_the_rate_of_a_simulated_bus() -> None:
    world = make_world()
    dpstack.simulate(world, [RAW, FAN], baud=93_750)
    async with in_operate(dpstack.open_bus(world=world, baud=93_750, slaves=[RAW])) as first:
        second = dpstack.open_bus(world=world, baud="auto", address=5, slaves=[FAN], t_tr=first.params.t_tr)
        assert searching(second)
        assert (second.slaves, second.drives) == ((), ())
        with pytest.raises(UsageError, match="searching for the baud rate"):
            _ = second.params
        with pytest.raises(UsageError, match="not open"):
            await second.operate()
        async with second:
            assert not searching(second)
            assert second.params.baud == second.config.baud == second.plan.params.baud == 93_750
            await second.operate()
            await second.drive("fan").slave.ready(10)
            told = await anext(second.events())
        assert told.text == "bus: the bus runs at 93.75 kbit/s, recognised by telegrams with check sum"


@in_virtual_time
async def test_a_silent_bus_needs_a_master_that_gives_the_rate(plant: World) -> None:
    bus = dpstack.open_bus(world=plant, baud="auto", slaves=[RAW])
    with pytest.raises(BusError) as caught:
        await bus.open()
    await bus.close()
    text = str(caught.value)
    assert text.startswith("the simulated bus: the baud rate was not found: silence: no octet in 5.0 s; is a master")
    assert text.endswith("; a master that is alone on its bus must give the rate, for instance baud = 500000")
    assert plant.now / 1e9 == pytest.approx(5.0)


@in_virtual_time
async def test_closed_while_it_searches() -> None:
    world = make_world()
    bus = dpstack.open_bus(world=world, baud="auto")
    opening = await begun(bus.open(), 1)
    await bus.close()
    with pytest.raises(BusError, match="not found"):  # what it waited for came to its end
        await opening
    with pytest.raises(UsageError, match="opened before"):
        await bus.open()


@pytest.mark.parametrize("port", ["virtual", "pty"])
def test_a_port_that_is_made_here_has_nobody_to_listen_to(port: str) -> None:
    with pytest.raises(ConfigError, match="nobody else is on it who could be listened to; give the rate"):
        dpstack.open_bus(port=port, baud="auto")


async def test_over_ptys(tmp_path: Path) -> None:
    """Slaves that search, a master that gives the rate, later another rate, and a second one that finds that."""
    path = tmp_path / "second.toml"
    async with Segment(3, tmp_path / "bus") as segment:
        path.write_text(f'[bus]\nport = "{segment.paths[2]}"\nbaud = "auto"\naddress = 3\n', encoding="utf-8")
        config = dpstack.load_config(path).with_slaves([QUICK])
        async with Simulation(config, segment.paths[0], "auto") as simulation:
            assert simulation.status()["baud"] is None
            assert simulation.status()["search"] == "baud_search"
            assert str(simulation.never_found).startswith("silence")
            for baud in (187_500, 500_000):
                async with dpstack.open_bus(port=segment.paths[1], baud=baud, slaves=[QUICK]) as first:
                    await first.operate()
                    await first.ready(20)
                    assert simulation.baud == baud
                    assert simulation.status()["search"] == "dp_mode"
                    if baud == 500_000:
                        second = dpstack.open_bus(path, join_timeout=0.1)
                        with contextlib.suppress(BusError):  # the first one may not ask for it so soon
                            await second.open()
                        await second.close()
                        assert second.params.baud == 500_000
                await until(lambda: simulation.baud is None, "back to the search")
            assert simulation.never_found is None


async def test_over_a_pty_made_here_what_counts_is_the_rate_its_opener_set() -> None:
    config = make_config("pty", 500_000, slaves=[QUICK])
    async with Simulation(config, "pty", "auto") as simulation:
        for baud in (187_500, 1_500_000):
            async with dpstack.open_bus(port=simulation.port_name, baud=baud, slaves=[QUICK]) as bus:
                await bus.operate()
                await bus.ready(20)
                assert simulation.baud == baud
            await until(lambda: simulation.baud is None, "back to the search")
