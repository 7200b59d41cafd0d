"""The age of inputs as an application sees it, in virtual time and on a bus that a blocked application holds up."""

from __future__ import annotations

import asyncio
import time

import pytest
from api_kit import RAW, bus_of, in_virtual_time, operating, stack_of
from msgspec import structs
from process_kit import VALVES, ready_bus
from support import present

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.statistics import SlaveStats
from dpstack.api.control.handlers import run_status
from dpstack.cli.terminal.report import Reporter

SLOW: dict[str, object] = RAW | {"name": "slow", "address": 10, "every": 60, "watchdog_ms": 2000}


@in_virtual_time
async def test_inputs_carry_their_age() -> None:
    async with bus_of(RAW, cycle_ms=10) as bus:
        raw = bus.slave("raw")
        assert age_of(raw) is None
        assert not is_valid(raw)
        await bus.operate()
        await bus.ready()
        await bus.rotated(5)
        await asyncio.sleep(0.007)
        age = present(age_of(raw))
        assert 0.006 < age < 0.01
        assert is_valid(raw)
        assert raw.inputs_limit == 0.2
        told = bus.stats.slaves[9]
        assert (told.inputs_valid, told.inputs_age) == (True, age)
        assert summary_of(told) == (True, round(age * 1000, 1))
        slaves = run_status(bus)["slaves"]
        assert isinstance(slaves, dict)
        assert slaves["9"]["inputs_valid"] is True
        assert slaves["9"]["inputs_age_ms"] == round(age * 1000, 1)
        await bus.stop()
        await asyncio.sleep(1.1)
        assert not is_valid(raw)
        assert (age_of(raw) or 0) > 1
        assert (bus.stats.age, bus.stats.stale) == (0.0, False)
        assert (bus.stats.summary()["age_ms"], bus.stats.summary()["stale"]) == (0.0, False)


def is_valid(slave: dpstack.Slave) -> bool:
    return slave.inputs_valid


def age_of(slave: dpstack.Slave) -> float | None:
    return slave.inputs_age


def summary_of(slave: SlaveStats) -> tuple[object, object]:
    told = slave.as_dict()
    return told["inputs_valid"], told["inputs_age_ms"]


@in_virtual_time
async def test_inputs_of_every_sixtieth_cycle_are_valid_up_to_two_of_its_polls() -> None:
    """Its watchdog is off, 1 s would be less than two polls: 60 cycles of 10 ms each."""
    async with bus_of(RAW, SLOW | {"watchdog_ms": 0}, cycle_ms=10) as bus:
        slow = bus.slave("slow")
        assert slow.inputs_limit == 1.2
        assert bus.slave("raw").inputs_limit == 0.2
        await bus.operate()
        await bus.ready()
        await asyncio.sleep(0.65)
        ages = []
        for _ in range(13):
            await asyncio.sleep(0.05)
            assert slow.inputs_valid
            ages.append(slow.inputs_age or 0.0)
        assert max(ages) > 0.5


@in_virtual_time
async def test_the_limit_follows_the_slaves_that_are_there() -> None:
    """At 9600 bit/s a slave with 244 octets each way takes more than half a second of each round."""
    big = {"name": "big", "address": 11, "ident": 0x1234, "config": "7F " * 7 + "73", "watchdog_ms": 0}
    async with bus_of(RAW | {"watchdog_ms": 0}, baud=9600, gap=0) as bus:
        raw = bus.slave("raw")
        before = raw.inputs_limit
        assert before == 1
        added = await bus.add_slave(big)
        assert raw.inputs_limit > 1.2
        assert added.inputs_limit == raw.inputs_limit
        await bus.remove("big")
        assert raw.inputs_limit == before


@in_virtual_time
async def test_a_cycle_that_is_handed_over_too_late_has_no_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    async with operating(RAW, cycle_ms=4) as bus:
        cycles = bus.cycles()
        cycle = await anext(cycles)
        assert set(cycle.inputs) == {"raw"}
        assert 0 <= cycle.age < 0.004
        await asyncio.sleep(0.02)
        assert cycle.age > 0.02  # now, not when it was handed over
        late = core_of(bus).runtime.now() + 200_000_000
        monkeypatch.setattr(core_of(bus).runtime, "now", lambda: late)
        cycle = await anext(cycles)
        assert not cycle.inputs
        assert not cycle.fresh
        with pytest.raises(dpstack.DpError, match="raw"):
            cycle.values("raw")


async def test_inputs_of_a_bus_that_its_application_holds_up_are_not_valid() -> None:
    """driver = "asyncio": the application blocks the loop for longer than the watchdog, and looks."""
    async with ready_bus(VALVES | {"watchdog_ms": 100}, driver="asyncio") as (bus, _):
        valves = bus.slave("valves")
        await bus.rotated(bus.stats.rotations + 3, 60)
        limit = valves.inputs_limit
        end = time.monotonic() + limit + 0.05
        while time.monotonic() < end:
            pass  # the program computes
        assert valves.state is dpstack.SlaveState.DATA_EXCHANGE  # nothing was told of yet
        assert not valves.inputs_valid
        assert present(valves.inputs_age) > limit


async def test_a_defect_that_stops_the_bus_leaves_no_slave_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    async with ready_bus(VALVES, driver="asyncio") as (bus, _):
        monkeypatch.setattr(stack_of(bus).master, "result", lambda *_: 1 / 0)
        with pytest.raises(dpstack.BusError, match="defect"):
            await bus.rotated(None, 60)
        assert bus.slave("valves").state is dpstack.SlaveState.OFFLINE
        assert not bus.slave("valves").inputs_valid
        assert bus.stats.stale


@in_virtual_time
async def test_the_tables_at_the_end_mark_what_is_old(capsys: pytest.CaptureFixture[str]) -> None:
    async with operating(RAW) as bus:
        await bus.rotated(5)
        good = bus.stats
        await bus.stop()
        await asyncio.sleep(1)
        reporter, bad = Reporter(bus, json=False), bus.stats
    capsys.readouterr()
    reporter.summary(good)
    out = capsys.readouterr().out
    assert "not valid" not in out
    assert "not sent" not in out
    assert "counters are" not in out
    reporter.summary(structs.replace(bad, age=1.5, stale=True))
    out = capsys.readouterr().out
    assert "00 (not valid)  (not sent: 00)" in out
    assert "the counters are 1.5 s old" in out
