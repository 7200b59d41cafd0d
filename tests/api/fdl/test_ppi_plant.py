"""An S7-200 of the plant file: its values in the program, the live stream, the tree and recordings, with quality."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import dpstack
from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.live import described_slaves
from dpstack.api.config.config import parse_config
from dpstack.api.connectors.outside import OutsideOrders
from dpstack.api.connectors.publishing import Publishing
from dpstack.api.control.handlers import _why, run_status, set_values
from dpstack.api.control.orders import carry_out
from dpstack.api.slave_side.simulated_cpu import SimulatedPlantCpu
from dpstack.bridge.connector import RemarkReporter
from dpstack.bridge.orders import Orders
from dpstack.dp.master.events import SlaveStateChanged
from dpstack.errors import ConfigError, CpuRefused, SlaveError, UsageError
from dpstack.plant.orders import SetCpuValues
from dpstack.plant.quality import Quality
from dpstack.plant.state import LiveState
from dpstack.plant.tree import PlantTree
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

PRESS: dict[str, object] = {
    "address": 2,
    "name": "press",
    "values": {
        "level": "VW100",
        "speed": {"at": "VD8:real", "unit": "m/s"},
        "on": "M0.3",
        "cool": {"at": "VW102:int", "scale": 0.1, "unit": "degC"},
    },
    "allow_commands": ["on", "cool"],
    "poll_ms": 100,
}
VALVES = {"name": "valves", "address": 8, "ident": 1, "config": "20 10"}


def plant(*slaves: Mapping[str, object], values: Mapping[str, object] | None = None, **more: Any) -> Bus:
    press = PRESS if values is None else {**PRESS, "values": values, "allow_commands": []}
    return dpstack.open_bus(port="virtual", baud=187_500, slaves=slaves, ppi=[press], **more)


def simulated(bus: Bus) -> SimulatedPlantCpu:
    bench = core_of(bus).bench
    assert bench is not None
    return bench.cpus[2]


async def test_values_come_with_their_names() -> None:
    async with plant(VALVES) as bus:
        press = bus.cpu("press")
        assert press["level"] is None
        assert press.value("level").quality.value == "bad"
        simulated(bus).set_values({"level": 250, "speed": 2.5, "on": True, "cool": "-1.5"})
        await core_of(bus).until(lambda: press.polls > 1, 2)
        assert press.values == {"level": 250, "speed": 2.5, "on": True, "cool": -1.5}
        assert press.value("cool").good
        assert bus.cpus == (press,)
        with pytest.raises(UsageError, match="no value is called 'levle'; did you mean level"):
            press["levle"]
        with pytest.raises(UsageError, match=r"no CPU 'pres' on this bus; there are: press \(2\)"):
            bus.cpu("pres")
        await press.write("level", 7)  # a program may write each
        assert simulated(bus).responder.cpu["VW100"] == 7
        assert await press.cpu.read("VW100") == 7
        assert bus.stats.slaves[2].fields["cool"] == -1.5


async def test_a_cpu_that_does_not_answer_has_no_good_values() -> None:
    events: list[object] = []
    async with plant(VALVES, on_event=events.append) as bus:
        press, tree, loop = bus.cpu("press"), PlantTree(), asyncio.get_running_loop()
        stream = bus.live(0.05)

        def readings() -> dict[str, tuple[Quality, object]]:
            items = []
            while (item := stream.take()) is not None:
                items.append(json.loads(json.dumps(item)))
            tree.apply_all(items, loop.time())
            return {node.path[-1]: (one.quality, one.value) for node, one in tree.readings(2) if node.path[0] in GROUPS}

        await core_of(bus).until(lambda: press.polls > 0, 2)
        await asyncio.sleep(0.2)
        assert readings()["level"] == (Quality.GOOD, 0)
        # an order for a CPU is one from the beginning: nobody asks later which kind of station it goes to
        [order] = [one for one in tree.orders.values() if one.output == "on"]
        assert (order.name, order.typed(True)) == ("press.on", SetCpuValues(2, {"on": True}))
        assert order == described_slaves(bus.config)[2].orders[0]
        bench = core_of(bus).bench
        assert bench is not None
        bench.power("press", False)
        await core_of(bus).until(lambda: not press.ready_now, 2)
        await asyncio.sleep(0.06)  # a live stream shows a loss at once
        assert {quality for quality, _ in readings().values()} == {Quality.STALE}
        assert not press.value("level").good
        assert "CPU 2 does not answer" in press.value("level").text
        assert press.fault is not None
        bench.power("press", True)
        await core_of(bus).until(lambda: press.ready_now, 3)
        await asyncio.sleep(0.2)
        assert readings()["level"] == (Quality.GOOD, 0)
        await bus.slave("valves").ready(1)  # nothing of this mattered to it
    states = [event.state.value for event in events if isinstance(event, SlaveStateChanged) and event.address == 2]
    assert states == ["data_exchange", "offline", "data_exchange"]
    assert not press.value("level").good  # nor after the end of the bus


GROUPS = ("Inputs", "Outputs")


async def test_a_cpu_that_says_not_yet_for_long_is_bad_and_comes_back() -> None:
    async with plant() as bus:
        press = bus.cpu("press")
        await core_of(bus).until(lambda: press.polls > 0, 2)
        simulated(bus).responder.mute = True
        await asyncio.sleep(1.5)
        assert press.ready_now  # it acknowledges still
        assert press.value("level").quality.value == "stale"
        await core_of(bus).until(lambda: not press.ready_now, 5)
        assert press.fault == "CPU 2: no answer to the request within 3 s: is it in use elsewhere?"
        with pytest.raises(UsageError, match=r"CPU 2 \(press\) is an S7-200, no DP slave .*: CPU 2: no answer"):
            bus.slave("press")
        simulated(bus).responder.mute = False
        await core_of(bus).until(lambda: press.ready_now, 5)
        assert press.value("level").good
        with pytest.raises(UsageError, match=r"\(bus.cpu\(\) has it\): it answers"):
            _why(bus, ["press"])  # `dpstack ctl PORT why press`


async def test_a_slow_cpu_is_good() -> None:
    async with plant() as bus:
        press = bus.cpu("press")
        simulated(bus).responder.answer_ns = 800 * NS_PER_MS
        await core_of(bus).until(lambda: press.polls > 1, 5)
        await asyncio.sleep(0.7)
        assert press.value("level").good


async def test_a_value_that_the_cpu_refuses_is_bad_and_the_others_go_on() -> None:
    values = {"level": "VW100", "out": "AQW0", "far": "VB10300", "real": "VD0:real"}
    async with plant(values=values) as bus:
        press = bus.cpu("press")
        simulated(bus).responder.cpu["VD0"] = 0x7FC0_0000  # not a number
        await core_of(bus).until(lambda: press.polls > 0, 2)
        assert press.value("level").good
        assert (press["out"], press.value("out").quality.value) == (None, "bad")
        assert "CPU 2 refuses read AQW0: access is not allowed" in press.value("out").text
        assert "beyond this CPU's memory" in press.value("far").text
        assert press.value("real").quality.value == "bad"
        state = LiveState()
        stream = bus.live(0.02)
        await asyncio.sleep(0.1)
        while (item := stream.take()) is not None:
            state.apply(json.loads(json.dumps(item)))
        shown = state.slaves["2"]
        assert shown.fields == {"level": 0, "out": None, "far": None, "real": None}
        assert (shown.state, shown.alive, shown.level, shown.quality) == ("data_exchange", True, "error", None)
        assert shown.qualities is not None
        assert sorted(shown.qualities) == ["far", "out", "real"]
        status: Any = run_status(bus)
        assert status["slaves"]["2"]["fields"]["level"] == 0
        assert sorted(status["slaves"]["2"]["qualities"]) == ["far", "out", "real"]
        since, polls = press.value("out").since_ns, press.polls
        await core_of(bus).until(lambda: press.polls > polls + 1, 3)
        assert press.value("out").since_ns == since


async def test_orders_from_outside_need_allow_commands() -> None:
    async with plant(VALVES) as bus:
        press, cpu = bus.cpu("press"), simulated(bus).responder.cpu
        await bus.operate()
        await core_of(bus).until(lambda: press.polls > 0, 2)
        await carry_out(bus, SetCpuValues(2, {"on": True, "cool": 3.5}), now=True)
        assert (cpu["M0.3"], cpu["VW102:int"]) == (True, 35)
        await core_of(bus).until(lambda: press["cool"] == 3.5, 0.09)  # a poll follows at once
        with pytest.raises(UsageError, match=r"CPU 2 \(press\): level is read-only; list it in allow_commands"):
            await carry_out(bus, SetCpuValues(2, {"on": False, "level": 1}), now=True)
        with pytest.raises(UsageError, match="cool = 10000 is outside"):
            await carry_out(bus, SetCpuValues(2, {"on": False, "cool": 10_000}), now=True)
        assert cpu["M0.3"] is True  # all were checked before the first was written
        await set_values(bus, ["press.on=off", "press.cool=1 degC"])
        assert (cpu["M0.3"], cpu["VW102:int"]) == (False, 10)
        await set_values(bus, ["press.level=9"])  # of a simulated CPU: what its program would do
        assert cpu["VW100"] == 9
        outside = OutsideOrders(bus, lambda *_: None)
        await outside.carry_out("mqtt", SetCpuValues(2, {"on": True}))
        assert not outside.in_effect
        simulated(bus).power(False)
        await core_of(bus).until(lambda: not press.ready_now, 2)
        with pytest.raises(SlaveError, match="does not answer: nothing was written"):
            await carry_out(bus, SetCpuValues(2, {"on": True}))


async def test_a_cpu_that_refuses_a_write_says_so() -> None:
    values = {"far": "VW10300"}
    press = {**PRESS, "values": values, "allow_commands": ["far"]}
    async with dpstack.open_bus(port="virtual", baud=187_500, ppi=[press]) as bus:
        await core_of(bus).until(lambda: bus.cpu(2).polls > 0, 2)
        with pytest.raises(CpuRefused, match="CPU 2 refuses write VW10300: the address is beyond"):
            await carry_out(bus, SetCpuValues(2, {"far": 1}), now=True)


@pytest.mark.parametrize(("given", "requests"), [({}, 2), ({"cycle_ms": 20.0}, 5)])
async def test_many_values_share_requests_and_the_bus_goes_on(given: dict[str, Any], requests: int) -> None:
    values: dict[str, object] = {f"v{at}": f"VW{at}" for at in range(0, 60, 2)}
    async with plant(VALVES, values=values, **given) as bus:
        await bus.operate()
        await core_of(bus).until(lambda: bus.cpu(2).polls >= 3, 5)
        assert simulated(bus).responder.requests // bus.cpu(2).polls == requests
        cycles = bus.stats.cycles
        assert cycles is None or cycles.missed == 0


async def test_a_read_only_bus_asks_no_cpu() -> None:
    async with plant(VALVES, read_only=True) as bus:
        await asyncio.sleep(1)
        assert "read-only" in (bus.cpu(2).fault or "")
        assert simulated(bus).responder.requests == 0


@pytest.mark.parametrize("quality", [False, True])
@pytest.mark.parametrize("slaves", [(), (VALVES,)])
async def test_a_recording_has_them(tmp_path: Path, slaves: tuple[Any, ...], quality: bool) -> None:
    path = tmp_path / "run.csv"
    async with plant(*slaves, values={"level": "VW100", "out": "AQW0"}) as bus:
        await bus.operate()
        async with bus.record(path, quality=quality):
            simulated(bus).set_values({"level": 5})
            await core_of(bus).until(lambda: bus.cpu(2)["level"] == 5, 2)
            await asyncio.sleep(0.5)
            simulated(bus).power(False)
            await asyncio.sleep(1.2)
    head, *rows = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]
    at = {name: head.index(name) for name in head}
    found = [(row[at["press.state"]], row[at["press.level"]], row[at["press.out"]]) for row in rows]
    assert ("data_exchange", "5", "") in found
    assert found[-2:] == [("offline", "", ""), ("", "", "")]  # the last row is a remark
    assert {values for values in found if values[0] == "offline"} == {("offline", "", "")}
    if quality:
        qualities = {row[at["press.out quality"]] for row in rows if row[at["press.level"]] == "5"}
        assert qualities == {"bad"}


async def test_connectors_give_the_orders_that_both_lists_have() -> None:
    async with plant(VALVES) as bus:
        await bus.operate()
        await core_of(bus).until(lambda: bus.cpu(2).polls > 0, 2)
        tree, stream, loop = PlantTree(), bus.live(0.02), asyncio.get_running_loop()
        await asyncio.sleep(0.1)
        while (item := stream.take()) is not None:
            tree.apply(item, loop.time())
        assert sorted(tree.orders) == ["press.cool", "press.on"]
        outside = OutsideOrders(bus, lambda *_: None)
        orders = Orders(tree, lambda order: outside.carry_out("mqtt", order), ["press.on", "press.level"])
        results = [await orders.give(name, True, made_at=None) for name in ("press.on", "press.cool", "press.level")]
        assert [(one.result, one.reason) for one in results] == [
            ("done", ""),
            ("refused", "it is not in allow_commands"),
            ("refused", "the plant has no such order"),
        ]
        assert simulated(bus).responder.cpu["M0.3"] is True


def test_a_list_of_a_connector_alone_is_not_enough() -> None:
    text = """
[bus]
port = "virtual"
baud = 187500
[[ppi]]
address = 2
values = { level = "VW100" }
[metrics]
[epics]
prefix = "A:"
allow_commands = ["cpu2.level"]
"""
    bus = dpstack.open_bus(parse_config(text, "plant.toml"))
    publishing = Publishing(bus, bus.config.connectors)
    with pytest.raises(
        ConfigError, match=r"'cpu2\.level': values of an S7-200 are read-only; list it in allow_commands"
    ):
        publishing._orders("epics", RemarkReporter("epics", lambda *_: None), ("cpu2.level",), 2.0)


async def test_a_plant_in_a_world_of_its_own() -> None:
    world = dpstack.World()
    bench = dpstack.simulate(world, [VALVES], baud=187_500, ppi=[PRESS])
    async with dpstack.open_bus(world=world, baud=187_500, slaves=[VALVES], ppi=[PRESS]) as bus:
        bench.set("press", level=3)
        await core_of(bus).until(lambda: bus.cpu("press")["level"] == 3, 2)
        bench.silence("press", 300 * NS_PER_MS)
        await core_of(bus).until(lambda: not bus.cpu("press").ready_now, 2)
        await core_of(bus).until(lambda: bus.cpu("press").ready_now, 2)
    assert world.referee is not None
    world.referee.check()
    with pytest.raises(UsageError, match=r"CPU 2 \(press\) is no DP slave: it takes set, silence"):
        bench.outputs("press")
