"""The tree of a simulated bus: it says of the slaves what was done to them, also from a recorded stream."""

from __future__ import annotations

import asyncio
import itertools
import json
from typing import Any

from api_kit import HOIST, in_virtual_time, off_and_on, operating, trip
from rack_kit import LINE_BREAK, device, rack

import dpstack
from dpstack.plant.conditions import Condition
from dpstack.plant.quality import Quality, Reading, Reason
from dpstack.plant.tree import Born, Change, Changed, Died, PlantTree
from dpstack.plant.verdicts import Judge
from dpstack.slave import UserDiag, identifier_block
from dpstack.trace import Severity

VALVES: dict[str, object] = {
    "name": "valves",
    "address": 8,
    "ident": 0x4321,
    "config": "21 11",
    "inputs": {"level": {"at": "i16@0", "scale": 0.5, "unit": "bar", "dead_band": 2}},
    "outputs": {"lamp": "bool@0.1", "speed": "u8@1"},
}


PUMP: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO1"}


class Follower:
    """Feeds the stream of ``bus`` into a tree, and keeps items and changes."""

    def __init__(self, bus: dpstack.Bus) -> None:
        self.tree = PlantTree()
        self.changes: list[Change] = []
        self.recorded: list[tuple[float, Any]] = []
        self.task = asyncio.ensure_future(self._follow(bus))

    async def _follow(self, bus: dpstack.Bus) -> None:
        loop = asyncio.get_running_loop()
        async for item in bus.live(0.05):
            self.recorded.append((loop.time(), json.loads(json.dumps(item))))
            self.changes += self.tree.apply(item, loop.time())

    def lives(self) -> list[Change]:
        return [one for one in self.changes if isinstance(one, (Born, Died))]

    def reading(self, id_: str) -> Reading:
        return next(one for node, one in self.tree.readings(int(id_.split("/")[1])) if node.id == id_)


@in_virtual_time
async def test_a_slave_that_loses_its_power_dies_and_is_born_again() -> None:
    async with operating(HOIST, VALVES) as bus:
        valves = bus.slave("valves")
        valves["speed"] = 7
        follower = Follower(bus)
        await asyncio.sleep(0.5)
        assert {Born(None), Born(3), Born(8)} == set(follower.lives())
        assert follower.reading("slave/8/output/speed")[:2] == (7, Reason.GOOD)
        # a slave of simulation mirrors its outputs
        assert follower.reading("slave/8/input/level").value == valves.input_values["level"]
        await off_and_on(bus, 8)
        await asyncio.sleep(0.2)
        [died, born] = follower.lives()[3:]
        assert isinstance(died, Died)
        assert died.slave == 8
        assert "not in data exchange" in died.why
        assert born == Born(8)
        [begun, *_, ended] = [
            one for one in follower.changes if isinstance(one, Condition) and one.id == "slave/8/fault"
        ]
        assert (begun.active, ended.active, ended.retain) == (True, False, True)
        after = follower.changes[follower.changes.index(died) :]
        speeds = [one.reading for one in after if isinstance(one, Changed) and one.node.id == "slave/8/output/speed"]
        assert (speeds[0].value, speeds[0].quality, speeds[0].reason) == (7, Quality.STALE, Reason.NOT_EXCHANGING)
        assert speeds[-1][:2] == (7, Reason.GOOD)
    await follower.task


@in_virtual_time
async def test_a_drive_trips_and_its_bus_ends() -> None:
    async with operating(PUMP) as bus:
        follower, drive = Follower(bus), bus.drive("pump")
        await asyncio.sleep(0.3)
        await trip(bus, drive, "LV", "34 LV")
        await asyncio.sleep(0.2)
        assert [(one.id, one.active) for one in follower.tree.conditions] == [("slave/6/drive/faults/34 LV", True)]
        assert follower.reading("slave/6/drive/state")[:2] == ("fault", Reason.GOOD)
    await follower.task
    assert [one.slave for one in follower.lives() if isinstance(one, Died)] == [6, None]
    assert follower.reading("slave/6/drive/state").reason is Reason.ENDED
    # the same from the recorded stream
    tree, changes = PlantTree(), []
    for now, item in follower.recorded:
        changes += tree.apply(item, now)
    # one pair after the other: the picture of a difference between thousands of changes takes pytest minutes
    for ours, theirs in itertools.zip_longest(changes, follower.changes):
        assert ours == theirs


@in_virtual_time
async def test_a_bus_that_nobody_drives_any_more_has_no_good_value() -> None:
    """The program that has the bus is stopped: nothing comes, not even an end."""
    async with operating(VALVES) as bus:
        follower = Follower(bus)
        await asyncio.sleep(0.3)
        follower.task.cancel()
        now = asyncio.get_running_loop().time()
        found = follower.tree.tick(now + 2.5)
        assert [one.slave for one in found if isinstance(one, Died)] == [8, None]
        assert all(one.quality is not Quality.GOOD for slave in (None, 8) for _, one in follower.tree.readings(slave))


@in_virtual_time
async def test_a_broken_wire_is_an_error_while_its_value_is_bad_and_the_old_value_is_the_last_good_one() -> None:
    async with rack() as (bus, slave, served):
        follower = Follower(bus)
        judge = Judge(follower.tree)

        def diagnosis() -> Condition | None:
            return follower.tree.conditions.get("slave/9/diagnosis")

        slave["setpoint"] = 77  # its inputs mirror the outputs: the level
        await asyncio.sleep(0.3)
        assert follower.reading("slave/9/input/level")[:2] == (77, Reason.GOOD)
        assert diagnosis() is None
        device(served).diag = UserDiag.of(identifier_block([2], 5), LINE_BREAK)
        await asyncio.sleep(0.3)
        slave["setpoint"] = 3276
        await asyncio.sleep(0.3)
        level = follower.reading("slave/9/input/level")
        assert (level.value, level.quality, level.plain) == (3276, Quality.BAD, None)
        found = diagnosis()
        assert found is not None
        assert (found.level, found.active, found.count) == (Severity.ERROR, True, 1)
        assert found.text.startswith("line break: slot 3, input channel 0; ext_diag; slots with a diagnosis: 3; ")
        reason = "it has a diagnosis: line break: slot 3, input channel 0"
        judge.take(())
        assert judge.judge()[1][9] == ("warning", (reason,))
        # a module without a channel: uncertain
        device(served).diag = UserDiag.of(identifier_block([2], 5))
        await asyncio.sleep(0.3)
        found = diagnosis()
        assert found is not None
        assert (found.level, found.active) == (Severity.WARNING, True)
        assert found.text.startswith("has a diagnosis: slot 3; ext_diag")
        # bad again, and lost: the old value is not the one of the broken wire
        slave["setpoint"] = 78
        await asyncio.sleep(0.3)
        device(served).diag = UserDiag.of(LINE_BREAK)
        slave["setpoint"] = 3277
        await asyncio.sleep(0.3)
        assert follower.reading("slave/9/input/level")[:2] == (3277, Reason.CHANNEL_FAULT)
        await slave.deactivate()
        await asyncio.sleep(0.3)
        level = follower.reading("slave/9/input/level")
        assert (level.value, level.quality, level.reason) == (78, Quality.STALE, Reason.NOT_EXCHANGING)
        assert follower.reading("slave/9/output/setpoint")[:2] == (3277, Reason.NOT_EXCHANGING)
    await follower.task
