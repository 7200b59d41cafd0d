"""The cycles of a bus as a program reads them: whole, the latest, and what it sets goes out in the next."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import pytest
from api_kit import FAN, HOIST, RAW, begun, bench_of, bus_of, in_operate, operating, slave_in, stack_of
from support import instance, present

import dpstack
from dpstack.api.config.config import parse_config
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

A: dict[str, object] = {
    "name": "a", "address": 5, "ident": 0x1234, "config": "23 13", "inputs": {"limit": "bool@0.3", "level": "i16@2"},
}  # fmt: skip
B: dict[str, object] = {**A, "name": "b", "address": 6}
MS = 1_000_000


def word(n: int) -> bytes:
    return bytes([n]) * 4


async def test_one_cycle_for_each_round_and_outputs_come_back_in_the_one_after_next() -> None:
    """The slaves mirror: set in the body of cycle n, on the wire in n + 1, which gives them back."""
    async with operating(A, B, cycle_ms=4) as bus:
        cycles: list[dpstack.Cycle] = []
        async for cycle in bus.cycles():
            assert cycle.skipped == 0
            cycles.append(cycle)
            n = len(cycles)
            bus.slave("a").outputs = bus.slave("b").outputs = word(n)
            if n == 20:
                break
        for n, cycle in enumerate(cycles[5:], 5):
            assert cycle.inputs == {"a": word(n), "b": word(n)}
            assert cycle.fresh == {"a", "b"}
            assert cycle["b"] == {"limit": bool(n & 8), "level": n * 0x0101}
        assert {b.number - a.number for a, b in itertools.pairwise(cycles)} == {1}
        assert {b.t_ns - a.t_ns for a, b in itertools.pairwise(cycles[2:])} == {4 * MS}
        assert {(cycle.late_ns, cycle.late_ms, cycle.missed) for cycle in cycles} == {(0, 0.0, 0)}
        with pytest.raises(dpstack.UsageError, match=r"no slave 'c' on this bus; there are: a, b"):
            cycle.values("c")


async def test_a_slow_reader_gets_the_latest_and_how_many_it_missed() -> None:
    async with operating(A, cycle_ms=4) as bus:
        got: list[dpstack.Cycle] = []
        async for cycle in bus.cycles():
            got.append(cycle)
            await asyncio.sleep(0.0201)  # five cycles and a little
            if len(got) == 6:
                break
        assert {cycle.skipped for cycle in got[1:]} <= {4, 5}
        for before, after in itertools.pairwise(got):
            assert after.number - before.number == after.skipped + 1
        assert bus.stats.summary()["missed"] == 0  # the bus did not wait for it


async def test_several_readers_and_one_that_leaves() -> None:
    async with bus_of(A, cycle_ms=4) as bus:
        await bus.ready()

        async def read(count: int) -> list[int]:
            numbers = []
            async for cycle in bus.cycles():
                numbers.append(cycle.number)
                if len(numbers) == count:
                    break
            return numbers

        few, many = await asyncio.gather(read(3), read(10))
        assert few == many[:3] == list(range(few[0], few[0] + 3))
        assert stack_of(bus).master.on_round is None  # nobody reads any more: nothing is made


async def test_the_stream_ends_with_the_bus() -> None:
    async with bus_of(A, cycle_ms=4) as bus:
        await bus.ready()

        async def read() -> int:
            return len([cycle async for cycle in bus.cycles()])

        reading = await begun(read(), 0.1)
        await bus.stop()
        await asyncio.sleep(0.1)
        assert not reading.done()  # there may be more, after operate()
    assert 20 <= await reading <= 30
    assert [cycle async for cycle in bus.cycles()] == []


async def test_free_running_rounds_are_cycles_too() -> None:
    async with operating(A, gap=0) as bus:
        got = []
        async for cycle in bus.cycles():
            got.append(cycle)
            if len(got) == 10:
                break
        assert {b.number - a.number for a, b in itertools.pairwise(got)} == {1}
        assert {cycle.late_ns for cycle in got} == {0}
        summary = bus.stats.summary()
        assert "cycle_us" not in summary
        assert bus.stats.cycles is None


async def test_a_loop_goes_on_while_a_slave_is_away() -> None:
    async with operating(A, B, cycle_ms=8) as bus:
        seen: list[tuple[bool, bool, bool]] = []
        async for cycle in bus.cycles():
            bus.slave("a").outputs = word(len(seen) % 100)
            a, b = cycle.get("a"), cycle.get("b")
            assert a is not None
            if b is None:
                with pytest.raises(dpstack.NoInputs, match=r"slave 6 \(b\) has no inputs in cycle \d+") as raised:
                    cycle["b"]
                assert raised.value.address == 6
                assert not isinstance(instance(raised.value, dpstack.SlaveError), dpstack.UsageError)
            else:
                assert b == cycle["b"]
            assert cycle.fresh | cycle.stale == set(cycle.inputs)
            assert not cycle.fresh & cycle.stale
            state = (b is not None, "b" in cycle.fresh, "b" in cycle.stale)
            if not seen or seen[-1] != state:
                seen.append(state)
                if len(seen) == 1:
                    bench_of(bus).power(6, False)
            if state == (False, False, False):
                bench_of(bus).power(6, True)
            if len(seen) > 2 and state == (True, True, False):
                break
        # there and fresh; not there; there again (in the round in which it comes back nothing of it is fresh)
        assert [state[0] for state in seen if state[1] or not state[0]] == [True, False, True]


async def test_inputs_of_an_earlier_round_are_marked() -> None:
    async with bus_of(A, {**B, "every": 3}, cycle_ms=8) as bus:
        await bus.ready()
        stale = []
        async for cycle in bus.cycles():
            assert cycle.get("b") is not None
            stale.append(cycle.stale)
            if len(stale) == 6:
                break
        assert sorted(map(len, stale)) == [0, 0, 1, 1, 1, 1]
        assert set().union(*stale) == {"b"}


async def test_a_slave_added_and_removed_between_two_cycles() -> None:
    async with bus_of(A, cycle_ms=8) as bus:
        await bus.ready()
        stream = bus.cycles()
        assert set((await anext(stream)).inputs) == {"a"}
        await bus.add_slave(B)
        await bus.ready()
        await asyncio.sleep(0.02)
        assert set((await anext(stream)).inputs) == {"a", "b"}
        await anext(stream)
        await asyncio.sleep(0.01)
        await bus.remove("b")  # with a cycle waiting to be read that had it
        assert set((await anext(stream)).inputs) == {"a"}


async def test_the_summary_says_how_it_went() -> None:
    async with operating(A, cycle_ms=2.5) as bus:
        await asyncio.sleep(1)
        summary: Any = bus.stats.summary()
        assert summary["cycle_us"] == 2500
        assert 395 <= summary["cycles"] <= 405
        assert summary["late_us"] == dict.fromkeys(("min", "p50", "p99", "p999", "max"), 0)
        assert (summary["missed"], summary["left_out"], summary["missed_by"]) == (0, 0, {})
        assert summary["rotation_us"]["p50"] == 2500
        before = present(bus.stats.cycles)
        begun = before.begun
        await asyncio.sleep(0.1)
        assert before.begun == begun  # a picture does not change


def test_groups_of_a_cycle_are_checked_with_the_configuration() -> None:
    text = '[bus]\nport = "virtual"\nbaud = 500000\ncycle_freeze = [9]\n'
    with pytest.raises(dpstack.ConfigError, match=r"c.toml:4: \[bus\]: cycle_freeze holds 9, outside 1..8"):
        parse_config(text, "c.toml")
    with pytest.raises(dpstack.ConfigError, match=r"slave 9 \(raw\) is in a group of cycle_sync and not parameterised"):
        bus_of({**RAW, "groups": [2]}, cycle_sync=[2])
    made = parse_config(text.replace("[9]", "[1, 2]") + "cycle_sync = [3]\n", "c.toml").with_bus(address=4)
    assert (made.bus.cycle_freeze, made.bus.cycle_sync) == ((1, 2), (3,))


async def test_drives_a_scan_and_class_2_beside_a_cycle() -> None:
    """A motor is started and its parameter read, everybody is asked who he is; no cycle begins late."""
    bus = bus_of(HOIST, FAN, A, baud=1_500_000, cycle_ms=5)
    async with in_operate(bus):
        fan = bus.drive("fan")
        await fan.start(timeout=5)
        fan.speed = 0.5
        found, number, _ = await asyncio.gather(bus.scan(configs=True), bus.drive("hoist").read(412), fan.reached())
        assert {station.address for station in found} == {3, 4, 5}
        assert number == 44
        assert (await bus.class2.diagnosis(4)).master == 2
        stats = bus.stats
        assert stats.cycles is not None
        assert (stats.cycles.missed, stats.cycles.late.max_ns) == (0, 0)
        await fan.stop()


class Ailing(MirrorDevice):
    """Its diagnosis says something while ``said`` is not empty."""

    said = b""

    def ext_diag(self) -> bytes:
        return self.said


async def test_a_diagnosis_is_fetched_in_the_gap_after_it_was_announced(w: World) -> None:
    """A high-priority answer (DH), Slave_Diag before the next cycle, which begins in time."""
    device = Ailing(0x1234, bytes.fromhex("23 13"))
    slave_in(w, device, 5)
    async with operating(A, world=w, cycle_ms=8) as bus:
        stream = bus.cycles()
        await anext(stream)
        device.said = b"\x04\x11\x22\x33"
        before = await anext(stream)
        await asyncio.sleep(0.006)
        diagnosis = present(bus.slave("a").diagnosis)
        assert diagnosis.ext == b"\x04\x11\x22\x33"
        assert (await anext(stream)).t_ns - before.t_ns == 8 * MS


async def test_a_group_of_a_cycle_without_a_slave_is_remarked() -> None:
    grouped = {**A, "groups": [1], "sync": True, "freeze": True}
    events: list[dpstack.Event] = []
    bus = bus_of(grouped, cycle_ms=5, cycle_freeze=[1], cycle_sync=[3, 1], on_event=events.append)
    texts = [
        "cycle_sync = [1, 3]: no slave is in group 3, so its telegrams have no effect there; give groups = [...] to "
        "the slaves that are meant, or leave the group out (groups of this bus: 1)"
    ]
    assert [note for note in bus.plan.notes if "no slave is in group" in note] == texts
    async with bus:
        pass
    assert [event.text for event in events if "no slave is in group" in event.text] == [f"plan: {texts[0]}"]
