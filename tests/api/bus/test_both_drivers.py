"""The public API on ptys, with the bus in this process's loop and with the bus in a process of its own: the same."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest
from api_kit import FAN, RAW
from far_ends import until
from process_kit import DRIVERS, LAMPS, LAMPS_SPEC, SPEC, VALVES, Driver, begun, bus_on, octet_slaves, operating_octets
from support import present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import make_config
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.dp.master.commands import DriveCommand, Mode, SetMode
from dpstack.dp.master.events import SlaveStateChanged
from dpstack.errors import ConfigError, DriveError, DriveFault, SlaveFault, SlaveTimeout, UsageError
from dpstack.profile.record47 import Address, Values
from dpstack.trace import Event

pytestmark = pytest.mark.parametrize("driver", DRIVERS)


async def test_process_data_events_and_the_end(driver: Driver) -> None:
    told: list[str] = []
    bus: dpstack.Bus

    def on_event(event: Event) -> None:
        if isinstance(event, SlaveStateChanged):
            told.append(event.state.value)
            assert bus.slave(event.address).state is event.state

    with octet_slaves(SPEC, LAMPS_SPEC) as (path, there):
        bus = bus_on(path, driver, VALVES | {"watchdog_ms": 3000}, LAMPS, on_event=on_event)
        async with bus:
            bus.slave("lamps").outputs = b"\x0f"  # before there is anybody to get it
            assert bus.driver == driver
            assert core_of(bus).runtime.port_name == path
            await bus.ready(60)
            valves = bus.slave("valves")
            assert mode_of(bus) == Mode.CLEAR
            await bus.operate()
            assert mode_of(bus) == Mode.OPERATE
            valves["target"] = -1234
            await until(lambda: valves["level"] == -1234, "its mirror")
            assert valves.inputs_valid
            assert there.slaves[4].outputs == (-1234).to_bytes(2, "big", signed=True)
            await until(lambda: there.slaves[5].outputs == b"\x0f", "the outputs that were set before")
            rotations = bus.stats.rotations
            await bus.rotated(rotations + 3, 10)
            stats = bus.stats
            assert stats.rotations >= rotations + 3
            assert stats.slaves[4].exchanges > 3
            assert stats.slaves[4].outputs == valves.outputs
            assert stats.rotation_us["p50"] > 0
            assert stats.stations[4].answers > 5
            assert stats.host_us is not None
            assert present(valves.diagnosis).ident == 0x1234
            assert valves.watchdog_ms == 3000
            assert there.slaves[4].watchdog_factors in (bytes((2, 150)), bytes((150, 2)))
            assert bus.snapshot.in_ring
            assert bus.snapshot.las == {2}
            story = await bus.why("valves")
            # a busy computer may leave a request without an answer
            steps = [(step["asked"], step["answered"]) for step in story.steps if step["answered"] != "nothing"]
            assert steps[:3] == [("Slave_Diag", "DL"), ("Set_Prm", "SC"), ("Chk_Cfg", "SC")]
            assert steps[-1] == ("Data_Exchange", "DL")
            assert story.state == "data_exchange"
        # safe values, then Clear's zeros; Clear_Data to all
        await until(lambda: there.slaves[4].outputs in (b"\xa5\x5a", bytes(2)), "safe values")
        await until(lambda: there.slaves[4].control == b"\x02\x00", "Clear")
        assert not bus.slave(4).inputs_valid
        assert bus.stats.rotations >= stats.rotations
    assert told.count("data_exchange") == 2


def mode_of(bus: dpstack.Bus) -> Mode:
    """The mode, which mypy shall not keep from an earlier comparison."""
    return bus.mode


async def test_misuse_raises_at_once_and_changes_nothing(driver: Driver) -> None:
    async with operating_octets(driver, VALVES) as (bus, _):
        valves = bus.slave(4)
        with pytest.raises(UsageError, match="1 octet of outputs given"):
            valves.outputs = b"\x01"
        with pytest.raises(UsageError, match="goes offline by Shutdown"):
            await core_of(bus).order(SetMode(Mode.OFFLINE))
        with pytest.raises(UsageError, match="no slave with address 77"):
            await core_of(bus).order(DriveCommand(77, "start", {}, 1))
        with pytest.raises(ConfigError, match="already"):
            await bus.add_slave(VALVES)
        with pytest.raises(ConfigError, match="both have address 4"):
            await bus.add_slave(VALVES | {"name": "others"})
        with pytest.raises(ConfigError, match="master's own address 2"):
            await bus.add_slave(LAMPS | {"address": 2})
        with pytest.raises(ConfigError):
            await valves.reparameterise(watchdog_ms=1_000_000)
        with pytest.raises(UsageError, match=r"group"):
            await bus.sync(9)
        assert valves.ready_now
        assert [slave.address for slave in bus.slaves] == [4]
    with pytest.raises(UsageError, match="not open"):
        await bus.operate()


async def test_slaves_come_and_go(driver: Driver) -> None:
    async with operating_octets(driver, VALVES) as (bus, there):
        lamps = await bus.add_slave(LAMPS)
        await lamps.ready()
        lamps.outputs = b"\x77"
        await until(lambda: lamps.inputs == b"\x77", "its mirror")
        await lamps.deactivate()
        assert lamps.deactivated
        assert lamps.state is dpstack.SlaveState.DEACTIVATED
        await lamps.activate()
        await lamps.ready()
        await bus.remove(lamps)
        assert [slave.name for slave in bus.slaves] == ["valves"]
        there.slaves[5].identifiers, there.slaves[5].output_count, there.slaves[5].answer_count = b"\x21\x11", 2, 2
        again = await bus.add_slave(LAMPS | {"name": "again", "config": "21 11"})
        await again.ready()
        assert again.outputs == bytes(2)  # not those of the one before
        await bus.slave("valves").reparameterise(user_prm=b"\x01\x02")
        await until(lambda: there.slaves[4].user_prm == b"\x01\x02", "its parameters")
        assert bus.slave("valves").ready_now


async def test_groups(driver: Driver) -> None:
    async with operating_octets(driver, VALVES, LAMPS) as (bus, there):
        async with bus.group(1) as group:
            await group.write({"valves": b"\x01\x02", "lamps": b"\x03"})
            # the settling exchange had them: they cannot be older
            assert (there.slaves[4].outputs, there.slaves[5].outputs) == (b"\x01\x02", b"\x03")
            assert bus.slave("valves").synced
            assert await group.read() == {"valves": b"\x01\x02", "lamps": b"\x03"}
            assert bus.slave("lamps").frozen
        assert not bus.slave("valves").synced


async def test_cycles(driver: Driver) -> None:
    async with operating_octets(driver, VALVES, LAMPS, cycle_ms=150.0) as (bus, _):
        numbers, skipped = [], 0
        async for cycle in bus.cycles():
            numbers.append(cycle.number)
            skipped += cycle.skipped
            if cycle.inputs.get("lamps") == b"\x05" and {"valves", "lamps"} <= cycle.fresh:
                assert cycle["valves"] == {"level": 5}  # outputs of one cycle, inputs of one cycle
                break
            bus.slave("valves")["target"] = 5
            bus.slave("lamps").outputs = b"\x05"
        assert numbers == sorted(set(numbers))
        await until(lambda: begun(bus) >= len(numbers) + skipped, "the books of a bus process follow the cycles")
        book = present(bus.stats.cycles)
        assert book.cycle_ns == 150_000_000
        assert book.late.count == book.begun
        with pytest.raises(ConfigError, match="cycle"):
            await bus.add_slave(RAW | {"min_slave_interval": 5000})


async def test_outputs_set_in_one_go_leave_in_one(driver: Driver) -> None:
    async with operating_octets(driver, VALVES, LAMPS) as (bus, there):
        bus.slave("valves").outputs = b"\x11\x22"
        end = time.monotonic() + 0.05
        while time.monotonic() < end:  # the program computes; meanwhile a bus of its own goes on
            assert there.slaves[4].outputs != b"\x11\x22"
        bus.slave("lamps").outputs = b"\x33"
        await until(lambda: there.slaves[5].outputs == b"\x33", "the outputs")
        await until(lambda: there.slaves[4].outputs == b"\x11\x22", "the outputs")


async def test_class_2_and_scan(driver: Driver) -> None:
    with octet_slaves(SPEC, "7:0696:f3f1:12:12,owner=1") as (path, _there):
        # of a busy computer nobody is given less than a slave in data exchange
        async with bus_on(path, driver, VALVES, host_slack_ms=50) as bus:
            await bus.ready(60)
            assert (await bus.class2.config(4)).octets == b"\x21\x11"
            assert (await bus.class2.diagnosis(7)).master == 1
            with pytest.raises(SlaveTimeout, match="slave 9 does not answer"):
                await bus.class2.inputs(9)
            with pytest.raises(SlaveFault, match="locked by master 1"):
                await bus.class2.set_address(7, 8)
            found = await bus.scan(addresses=range(3, 9), configs=True)
            assert [(f.address, f.ident, f.master, f.config) for f in found] == [
                (4, 0x1234, 2, b"\x21\x11"),
                (7, 0x0696, 1, b"\xf3\xf1"),
            ]
            assert not core_of(bus).unreadable


async def test_a_drive_over_record_47(driver: Driver, tmp_path: Path) -> None:
    """By its plugin, wherever that works, and by a program; ST1 has no parameter channel."""
    pump: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "ST1"}
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[pump])
        async with Simulation(plant, segment.paths[1], 1_500_000), bus_on(segment.paths[0], driver, pump) as bus:
            await bus.operate()
            await bus.ready(20)
            assert await bus.drive("pump").read(965, timeout=20) == 0x0328
            assert (await bus.drive("pump").write("dr-03", 2.5, timeout=20)).unit == "s"
            several = await bus.drive("pump").read_many([965, dpstack.ParameterPlace(964, index=6)], timeout=20)
            assert [one.value for one in several if not isinstance(one, dpstack.ParameterError)] == [0x0328, 0x0A6C]
            await bus.slave("pump").reparameterise(dpv1={"alarm_mode": 2, "response_timeout_ms": 2000}, timeout=20)
            assert await bus.slave("pump").parameters().read([Address(918)]) == [Values(6, (6,))]


async def test_a_drive(driver: Driver, tmp_path: Path) -> None:
    async with Segment(2, tmp_path / "bus", baud=1_500_000) as segment:
        plant = make_config(segment.paths[1], 1_500_000, slaves=[FAN])
        async with Simulation(plant, segment.paths[1], 1_500_000) as simulation:
            async with bus_on(segment.paths[0], driver) as bus:
                await bus.operate()
                await bus.add_slave(FAN)
                await bus.ready(20)
                fan = bus.drive("fan")
                with pytest.raises(UsageError, match="drive fan"):
                    fan.speed = 99
                with pytest.raises(UsageError, match="no order 'dance'"):
                    await fan.order("dance")
                with pytest.raises(UsageError, match="must be a number"):
                    await fan.order("reached", tolerance=float("nan"))
                await fan.start(20)
                fan.speed = 0.25
                assert fan.speed == 0.25
                await fan.reached(20)
                assert fan.status.running
                async for status in fan.statuses():
                    if status.speed is not None and abs(status.speed - 0.25) < 0.01:
                        break
                assert bus.slave("fan").outputs != bytes(12)
                with pytest.raises(UsageError, match="drive plugin makes the outputs"):
                    bus.slave("fan").outputs = bytes(12)
                fan.speed = 1.0
                simulation.power(4, False)
                with pytest.raises((DriveError, DriveFault)):
                    await fan.reached(20)
            assert fan.status.state == dpstack.profile.State.OFFLINE


async def test_a_read_only_bus(driver: Driver) -> None:
    with octet_slaves(SPEC + ",owner=1") as (path, _there):
        async with bus_on(path, driver, VALVES, read_only=True) as bus:
            valves = bus.slave("valves")
            await valves.ready(20)
            assert valves.found is not None
            assert (valves.found.master, valves.found.ident) == (1, 0x1234)
            assert valves.diagnosis is not None
            with pytest.raises(UsageError, match="read-only"):
                await bus.operate()
            with pytest.raises(UsageError, match="read-only"):
                valves.outputs = bytes(2)


async def test_two_masters_of_one_program_and_one_that_searches_the_rate(driver: Driver, tmp_path: Path) -> None:
    async with Segment(3, tmp_path / "bus", baud=500_000) as segment:
        plant = make_config(segment.paths[2], 500_000, slaves=[FAN])
        async with Simulation(plant, segment.paths[2], 500_000):
            first = dpstack.open_bus(port=segment.paths[0], baud=500_000, address=1, hsa=4, driver=driver)
            async with first:
                await first.add_slave(FAN)
                await first.operate()
                await first.ready(20)
                second = dpstack.open_bus(port=segment.paths[1], baud="auto", address=2, hsa=4, driver=driver)
                async with second:
                    assert second.params.baud == 500_000
                    await asyncio.wait_for(second.until(lambda: second.snapshot.las == {1, 2}), 10)
                    await asyncio.wait_for(first.until(lambda: first.snapshot.las == {1, 2}), 10)
                await asyncio.wait_for(first.until(lambda: first.snapshot.las == {1}), 10)
                await first.ready(20)  # a simulation that stood still for longer than its patience is taken up again
