"""``bus.live()``: the stream says what the simulated devices know, costs the bus nothing, and ends with it."""

from __future__ import annotations

import asyncio
import json
import sys
from collections import Counter
from types import FrameType
from typing import Any

import pytest
from api_kit import FAN, HOIST, RAW, begun, bench_of, bus_of, in_virtual_time, operating

import dpstack
from dpstack.api.bus import live
from dpstack.api.bus.bus import core_of
from dpstack.errors import UsageError
from dpstack.plant.state import LiveState
from dpstack.plant.tree import Born, Died, PlantTree
from dpstack.plant.verdicts import Judge

VALVES: dict[str, object] = {
    "name": "valves",
    "address": 8,
    "ident": 0x4321,
    "config": "21 11",
    "inputs": {"level": {"at": "i16@0", "scale": 0.5, "unit": "bar"}},
    "outputs": {"lamp": "bool@0.1", "speed": "u8@1"},
}


async def follow(stream: live.LiveStream, state: LiveState, seconds: float) -> list[dict[str, Any]]:
    """Apply the items of so many seconds of bus time; return them."""
    items: list[dict[str, Any]] = []

    async def read() -> None:
        async for item in stream:
            state.apply(json.loads(json.dumps(item)))
            items.append(item)

    task = await begun(read(), seconds)
    task.cancel()
    await asyncio.wait([task])
    return items


@in_virtual_time
async def test_the_picture_is_that_of_the_devices() -> None:
    state = LiveState()
    async with operating(FAN, VALVES) as bus:
        valves, stream = bus.slave("valves"), bus.live(0.05)
        valves["speed"] = 7
        valves["lamp"] = True
        drive = bus.drive("fan")
        await drive.start()
        drive.speed = 0.25
        await drive.reached()
        items = await follow(stream, state, 0.5)
        assert list(items[0]) == ["plant"]
        shown = state.slaves["8"]  # it mirrors its outputs: these inputs say that it has got them
        assert shown.outputs == shown.inputs == "0207"
        assert shown.fields == {"level": 0x0207 * 0.5, "lamp": True, "speed": 7}
        assert (shown.state, shown.inputs_valid, shown.held, shown.fault) == (
            "data_exchange",
            True,
            None,
            None,
        )
        assert shown.exchanges == pytest.approx(valves.exchanges, abs=60)
        fan = state.slaves["4"].drive
        assert fan is not None
        assert fan.speed == pytest.approx(0.25, abs=0.01)
        assert fan.running is True
        assert state.plant is not None
        described = items[0]["plant"]["slaves"]["8"]
        place = {"type": "i16", "at": "i16@0", "slot": 2, "channel": None}
        assert described["inputs"] == [
            {"name": "level", **place, "scale": 0.5, "offset": 0, "unit": "bar", "dead_band": 0}
        ]
        out = {"outputs": 2, "output_at": 0, "output_width": 1}
        into = {"inputs": 2, "input_at": 0, "input_width": 1}
        none = {"inputs": 0, "input_at": 0, "input_width": 0}, {"outputs": 0, "output_at": 2, "output_width": 0}
        assert described["modules"] == [
            {"slot": 1, "name": "", "config": "21", **none[0], **out},
            {"slot": 2, "name": "", "config": "11", **into, **none[1]},
        ]
        summary = bus.stats.summary()
        bodies = [item["snapshot"]["bus"] for item in items if "snapshot" in item]
        assert set(summary) - {"slaves"} <= {key for body in bodies for key in body}
        assert sum(count for _, count in state.bus.histogram or []) == pytest.approx(state.bus.rotations, abs=3)
        await bus.clear()
        await follow(stream, state, 0.2)
        assert state.bus.mode == "clear"
        assert (state.slaves["8"].outputs, state.slaves["8"].held) == ("0000", "0207")
        assert (state.slaves["8"].fields or {})["speed"] == 0
        assert state.slaves["8"].held_fields == {"lamp": True, "speed": 7}
        bench_of(bus).power(8, False)
        await follow(stream, state, 1.0)
        assert state.slaves["8"].inputs_valid is False
        assert state.slaves["8"].state != "data_exchange"
    await follow(stream, state, 0.01)
    assert state.end == "the bus is closed"
    assert {slave.state for slave in state.slaves.values()} == {"offline"}
    assert not any(slave.inputs_valid for slave in state.slaves.values())


@in_virtual_time
async def test_a_slave_that_is_lost_is_shown_right_behind_its_event() -> None:
    """Also where an interval is long; the tree of the bridge lets it die then, once, and its return does not hurry."""
    loop, tree, lives, items = asyncio.get_running_loop(), PlantTree(), list[tuple[float, Born | Died]](), list[Any]()
    judge = Judge(tree)

    async def read(stream: live.LiveStream) -> None:
        async for item in stream:
            items.append((loop.time(), item))
            changes = tree.apply(item, loop.time())
            judge.take(changes)
            lives.extend((loop.time(), one) for one in changes if isinstance(one, (Born, Died)))

    async with operating(RAW, VALVES) as bus:
        task = await begun(read(bus.live(1.0)), 3.5)
        bench_of(bus).power(8, False)
        await asyncio.sleep(0.3)
        bench_of(bus).power(8, True)
        await asyncio.sleep(3)
        await bus.stop()
        await asyncio.sleep(1.5)
        # those that left it by order are no losses
        assert [len(judge._past[at].losses) for at in (8, 9)] == [1, 0]
        task.cancel()
        await asyncio.wait([task])
    lost_at, at = next(
        (when, at)
        for at, (when, item) in enumerate(items)
        if item.get("event", {}).get("event") == "slave" and item["event"].get("address") == 8 and when > 3
    )
    shown_at, item = next((when, item) for when, item in items[at:] if "snapshot" in item)
    assert shown_at == lost_at
    assert item["snapshot"]["slaves"].keys() == {"8"}
    assert item["snapshot"]["slaves"]["8"]["state"] != "data_exchange"
    assert item["snapshot"]["slaves"]["8"]["inputs_valid"] is False
    ends = [(when, one) for when, one in lives if one.slave == 8]
    assert [type(one) for _, one in ends] == [Born, Died, Born]
    assert ends[1][0] == lost_at


@in_virtual_time
async def test_later_snapshots_have_only_changes_and_a_late_reader_gets_all() -> None:
    async with operating(RAW) as bus:
        first = LiveState()
        stream = bus.live(0.1)
        items = await follow(stream, first, 1.0)
        snapshots = [item["snapshot"] for item in items if "snapshot" in item]
        assert [snapshot["whole"] for snapshot in snapshots] == [True] + [False] * (len(snapshots) - 1)
        assert len(snapshots) in range(9, 12)
        assert {"state", "inputs", "exchanges"} <= set(snapshots[0]["slaves"]["9"])
        assert snapshots[0]["bus"]["mode"] == "operate"
        assert all("state" not in snapshot["slaves"].get("9", {}) for snapshot in snapshots[1:])
        late, second = LiveState(), bus.live(0.1)
        await asyncio.sleep(5)  # it does not read
        read = await follow(second, late, 0.3)
        assert [key for item in read for key in item][:1] == ["plant"]
        assert sum("snapshot" in item for item in read) <= 5
        await follow(stream, first, 0.3)
        assert late.slaves["9"].state == first.slaves["9"].state == "data_exchange"
        assert [event["text"] for event in late.events] == [event["text"] for event in first.events]
        stream.close()
        second.close()
        assert [item async for item in second] == []


@in_virtual_time
async def test_a_slave_added_and_removed_brings_a_new_plant() -> None:
    state = LiveState()
    async with operating(RAW) as bus:
        stream = bus.live(0.05)
        await follow(stream, state, 0.2)
        fan = await bus.add_slave(FAN)
        await fan.ready()
        await follow(stream, state, 0.3)
        assert state.plant is not None
        assert list(state.plant.slaves) == list(state.slaves) == ["4", "9"]
        await bus.slave("raw").reparameterise(groups=[2])
        await bus.remove(fan)
        await follow(stream, state, 0.3)
        assert list(state.plant.slaves) == list(state.slaves) == ["9"]
        assert state.plant.slaves["9"].groups == [2]
        assert state.slaves["9"].state == "data_exchange"


@in_virtual_time
async def test_a_stream_from_before_the_opening_follows_the_search_for_the_rate() -> None:
    world = dpstack.World(referee=False)
    dpstack.simulate(world, [RAW], baud=500_000)
    async with dpstack.open_bus(world=world, baud=500_000, slaves=[RAW]) as master:
        await master.operate()
        searching = dpstack.open_bus(
            world=world, baud="auto", address=5, read_only=True, slaves=[RAW], t_tr=master.params.t_tr
        )
        state, stream = LiveState(), searching.live(0.1)
        items = await follow(stream, state, 0.2)
        assert items[0]["plant"]["baud"] is None
        async with searching:
            items = await follow(stream, state, 3.0)
    assert state.plant is not None
    assert (state.plant.baud, state.plant.read_only) == (500_000, True)
    assert state.slaves["9"].master == 2


def test_the_clock_of_the_computer_may_be_set(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([1_000_000.0] + [9.0] * 100)
    monkeypatch.setattr(live, "time", lambda: next(times))

    @in_virtual_time
    async def run() -> None:
        state = LiveState()
        async with operating(RAW) as bus:
            stream = bus.live(0.05)
            await follow(stream, state, 0.2)
            core_of(bus).notice("test", "later")
            await follow(stream, state, 0.2)
        stamps = [event["time"] for event in state.events]
        assert stamps == sorted(stamps)
        assert all(stamp.startswith("1970-01-12T13:46:") for stamp in stamps)

    run()


@pytest.mark.usefixtures("no_collection")
@in_virtual_time
async def test_a_reader_costs_calls_a_snapshot_and_none_a_telegram() -> None:
    calls: Counter[str] = Counter()
    live_file = live.__file__

    def count(frame: FrameType, event: str, _arg: object) -> None:
        if event == "call":
            calls["live" if frame.f_code.co_filename == live_file else "all"] += 1

    async def counted(bus: dpstack.Bus, seconds: float) -> tuple[int, int, int]:
        calls.clear()
        before = bus.stats.rotations
        sys.setprofile(count)
        try:
            await asyncio.sleep(seconds)
        finally:
            sys.setprofile(None)
        return calls["live"], calls["all"], bus.stats.rotations - before

    async with operating(RAW, HOIST) as bus:
        in_live, without, rotations = await counted(bus, 0.5)
        assert in_live == 0
        stream = bus.live(0.1)
        await follow(stream, LiveState(), 0.11)
        in_live, with_reader, again = await counted(bus, 0.5)
        assert abs(again - rotations) <= 2
        snapshots, slaves = 5, 2
        assert in_live <= (snapshots + 1) * (12 + 8 * slaves)
        # all calls that a snapshot makes, in whatever module: about 110 a slave with a drive, figures of the bus beside
        assert with_reader - without <= (snapshots + 1) * (150 + 130 * slaves) + 1500
        stream.close()
        await asyncio.sleep(0.01)
        in_live, _, _ = await counted(bus, 0.2)
        assert in_live == 0


@pytest.mark.parametrize("interval", [0, -1, 0.001, float("nan"), float("inf"), "0.1", None])
def test_an_impossible_interval_is_refused(interval: Any) -> None:
    with pytest.raises(UsageError, match=r"give the seconds between two snapshots, 0\.02 or more"):
        bus_of(RAW).live(interval)


@in_virtual_time
async def test_an_ident_number_that_was_asked_for_is_in_the_plant() -> None:
    state = LiveState()
    async with bus_of({**RAW, "ident": "ask"}) as bus:
        stream = bus.live(0.05)
        first = await anext(stream)
        assert first["plant"]["slaves"]["9"]["ident"] is None
        await follow(stream, state, 1.0)
        assert state.plant is not None
        device = bench_of(bus).device(9)
        assert state.plant.slaves["9"].ident == f"0x{device.ident:04X}"
        assert state.slaves["9"].state == "data_exchange"
