"""The plant of a program: simulated slaves, values that are followed, rounds as objects, names that do not exist."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime
from typing import Any

import pytest
from api_kit import FAN, bus_of, operating

import dpstack
from dpstack import Int, at
from dpstack.events import Severity

pytestmark = pytest.mark.virtual_time

TANK: dict[str, object] = {
    "name": "tank", "address": 8, "ident": 0x1234, "config": "10 21",
    "inputs": {"level": "u8@0"}, "outputs": {"valve": "bool@0.3", "order": "u8@1"},
}  # fmt: skip


class Tank(dpstack.Inputs):
    level: Int = at()


class Other(dpstack.Outputs):
    order: Int = at()


async def test_a_program_sets_inputs_of_its_simulated_slaves_and_switches_them() -> None:
    world = dpstack.World()
    bench = dpstack.simulate(world, [TANK, FAN], baud=500_000)
    assert isinstance(bench, dpstack.VirtualBench)
    async with operating(TANK, FAN, world=world) as bus:
        tank = bus.slave("tank")
        bench.set("tank", level=60)
        tank.update({"valve": True, "order": 7})
        await tank.until(lambda v: v["level"] == 60, 1)
        assert bench.outputs("tank") == bench.outputs(8) == {"valve": True, "order": 7}
        bench.power("tank", False)
        await tank.wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
        assert bench.outputs("tank") == {"valve": False, "order": 0}
        bench.power(8, True)
        await tank.ready()
        assert tank["level"] == 60  # it was set, and stays
        bench.mirror("tank")
        await tank.until(lambda v: v["level"] == 8, 1)
        bench.silence("tank")
        await tank.wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
        bench.resume("tank")
        await tank.ready()
        wrongs: list[tuple[Callable[[], None], str]] = [
            (
                lambda: bench.power("tnak", False),
                r"no slave 'tnak' is simulated here; there are: tank \(8\), f",
            ),
            (lambda: bench.set("tank", levle=1), "no input is called 'levle'; did you mean level?"),
            (lambda: bench.set("tank", level=300), r"slave 8 \(tank\): level = 300 is outside 0..255"),
            (lambda: bench.set("tank", order=3), "order is an output, which its master sets"),
            (lambda: bench.set("fan", level=3), "the simulated drive makes its inputs"),
        ]
        for wrong, says in wrongs:
            with pytest.raises(dpstack.UsageError, match=says):
                wrong()


async def test_the_key_simulate_without_an_effect_is_reported() -> None:
    table = {**TANK, "simulate": {"function": "tank:inputs"}}
    async with bus_of(table) as bus:
        found = [event async for event in _until_ready(bus) if "simulate" in event.text]
    assert [event.severity for event in found] == [Severity.WARNING]
    assert found[0].text.startswith("simulation: slave 8 (tank): its key simulate has an effect in `dpstack run`")


async def _until_ready(bus: dpstack.Bus) -> AsyncIterator[dpstack.Event]:
    await bus.ready()
    events = bus.events()
    asyncio.get_running_loop().call_later(0.1, events.close)
    async for event in events:
        yield event


async def test_a_followed_value_begins_with_the_present_one() -> None:
    world = dpstack.World()
    bench = dpstack.simulate(world, [TANK], baud=500_000)
    seen: list[tuple[int, int]] = []
    async with asyncio.TaskGroup() as tasks, dpstack.open_bus(world=world, baud=500_000, slaves=[TANK]) as bus:

        async def follow(number: int) -> None:
            async for level in bus.slave("tank").follow("level", int):
                seen.append((number, level))  # noqa: PERF401 - it is looked at meanwhile

        bench.set("tank", level=90)
        tasks.create_task(follow(1))  # before the slave is there
        await asyncio.sleep(0)
        assert seen == []
        await bus.ready()
        await asyncio.sleep(0.1)
        tasks.create_task(follow(2))
        await asyncio.sleep(0.1)
        assert seen == [(1, 90), (2, 90)]
        bench.set("tank", level=10)
        await asyncio.sleep(0.1)
        bench.power("tank", False)
        await asyncio.sleep(1)
        bench.power("tank", True)
        bench.set("tank", level=20)
        await bus.ready()
        await asyncio.sleep(0.1)
        assert sorted(seen[2:]) == [(1, 10), (1, 20), (2, 10), (2, 20)]
        for name, kind, says in (
            ("levle", int, "no input is called 'levle'; did you mean level?"),
            ("order", int, "order is an output: give the name of an input"),
            ("level", float, ""),
            ("level", bytes, "level is int, not bytes"),
        ):
            following = bus.slave("tank").follow(name, kind)  # type: ignore[type-var]
            if not says:
                assert await anext(following) == 20.0
                continue
            with pytest.raises(dpstack.UsageError, match=says):
                await anext(following)
    # the tasks end with the bus, and so does the group around it


async def test_a_round_has_names_classes_and_a_wall_clock() -> None:
    async with operating(TANK, FAN) as bus:
        before = datetime.now(UTC)
        bus.slave("tank")["valve"] = True
        await asyncio.sleep(0.1)
        cycles = bus.cycles()
        cycle = await anext(cycles)
        assert cycle.inputs_as("tank", Tank) == Tank(level=8)
        assert ("tank" in cycle, "tnak" in cycle, 0 in cycle, list(cycle)) == (True, False, False, ["fan", "tank"])
        assert abs((cycle.time - before).total_seconds()) < 60
        assert (await anext(cycles)).time > cycle.time
        with pytest.raises(dpstack.UsageError, match="no slave 'tnak' on this bus; there are: fan, tank"):
            cycle.inputs_as("tnak", Tank)
        with pytest.raises(dpstack.UsageError, match="is no class of inputs"):
            cycle.inputs_as("tank", Other)  # type: ignore[type-var]
        with pytest.raises(dpstack.UsageError, match="no input is called 'levle'; did you mean level"):
            cycle["tank"]["levle"]
        await bus.slave("tank").deactivate()
        await asyncio.sleep(0.2)
        cycle = await anext(cycles)
        assert "tank" not in cycle
        with pytest.raises(dpstack.NoInputs, match="it is not in data exchange"):
            cycle.inputs_as("tank", Tank)


READ = [
    ("bus.tank", "'Bus' object has no attribute 'tank': write bus.slave('tank')"),
    ("bus.fan", "'Bus' object has no attribute 'fan': write bus.drive('fan')"),
    ("bus.opperate", "'Bus' object has no attribute 'opperate'; did you mean operate?"),
    ("bus.zzz", "'Bus' object has no attribute 'zzz'"),
    ("tank.level", "'Slave' object has no attribute 'level': write slave['level']"),
    ("tank.valve", "'Slave' object has no attribute 'valve': write slave['valve']"),
    ("tank.input", "'Slave' object has no attribute 'input'; did you mean inputs?"),
    ("fan.freqency", "'Drive' object has no attribute 'freqency'; did you mean frequency?"),
]


async def test_an_attribute_that_is_read_and_does_not_exist() -> None:
    async with operating(TANK, FAN) as bus:
        names = {"bus": bus, "tank": bus.slave("tank"), "fan": bus.drive("fan")}
        for expression, says in READ:
            thing, name = expression.split(".")
            with pytest.raises(AttributeError) as raised:
                getattr(names[thing], name)
            assert str(raised.value) == says
        assert not hasattr(bus, "_nothing")
        with pytest.raises(dpstack.ConfigError, match="add_slave: slave x: no address"):
            await bus.add_slave({"name": "x"})


def test_plain_with_says_what_to_write() -> None:
    bus: Any = bus_of(TANK)
    with pytest.raises(dpstack.UsageError, match="entered by `async with`; for plain `with` take dpstack"), bus:
        pass
