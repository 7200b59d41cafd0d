"""The command ``rounds`` of a run: values of each round out of a bounded ring, for the oscilloscope of the page."""

from __future__ import annotations

import asyncio
import functools
from itertools import pairwise
from typing import Any

import pytest
from api_kit import HOIST, RAW, bench_of, operating

from dpstack.api.bus.bus import core_of
from dpstack.api.control import round_traces
from dpstack.api.control.commands import KINDS
from dpstack.api.control.handlers import control_run
from dpstack.api.control.round_traces import RoundTraces
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.errors import UsageError

pytestmark = pytest.mark.virtual_time

TANK: dict[str, Any] = {**RAW, "inputs": {"level": "u8@0"}, "outputs": {"lamp": "bool@0.3"}}


async def _rows(read: Any, *values: str, seconds: float) -> list[list[Any]]:
    """All rows that came in this time, asked for every 50 ms."""
    first = read(["0", *values])
    rows, after = first["rounds"], 0
    for _ in range(round(seconds / 0.05)):
        await asyncio.sleep(0.05)
        found = read([str(after), *values])
        assert found["lost"] == 0
        assert found["more"] is False
        rows += found["rounds"]
        after = rows[-1][0]
    return list(rows)


async def test_each_round_has_its_values() -> None:
    """Two inputs that stand for one snapshot only, between those that a page sees."""
    async with operating(TANK, HOIST) as bus:
        bench = bench_of(bus)
        read = RoundTraces(core_of(bus)).read
        loop = asyncio.get_running_loop()
        for delay, level in ((0.0, 7), (0.1, 200), (0.11, 8)):
            loop.call_later(delay, functools.partial(bench.set, "raw", level=level))
        rows = await _rows(read, "9.level", "raw.lamp", "3:speed", seconds=0.2)
        assert [row[0] for row in rows] == list(range(rows[0][0], rows[0][0] + len(rows)))
        times = [row[1] for row in rows]
        assert all(0 < after - before < 0.005 for before, after in pairwise(times))
        assert 0.15 < times[-1] - times[0] < 0.21
        levels = [row[2] for row in rows]
        assert [level for n, level in enumerate(levels) if level and level != levels[n - 1]] == [7, 200, 8]
        assert 2 <= levels.count(200) <= 8  # 10 ms of rounds
        assert {row[3] for row in rows} == {False}
        assert rows[-1][4] == 0.0


async def test_a_bad_value_is_none() -> None:
    async with operating({**TANK, "inputs": {"number": "f32@0"}, "config": "20 13"}) as bus:
        bench = bench_of(bus)
        read = RoundTraces(core_of(bus)).read
        read(["0", "9.number"])
        bench.set("raw", number=1.5)
        await asyncio.sleep(0.02)
        bench.units[9].set_inputs(bytes.fromhex("7fc00000"))
        await asyncio.sleep(0.02)
        values = [row[2] for row in read(["0", "9.number"])["rounds"]]
        assert values[-1] is None
        assert 1.5 in values


async def test_a_broken_wire_is_none() -> None:
    """0x7FFF comes from the wire; the other channel of the module goes on."""
    io = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["2 AI"]}
    async with operating({**io, "inputs": {"broken": "i16@0", "other": "u8@3"}}) as bus:
        bench, read = bench_of(bus), RoundTraces(core_of(bus)).read
        read(["0", "8.broken", "8.other"])
        bench.set("io", broken=5, other=3)
        await asyncio.sleep(0.1)
        values = [row[2:] for row in read(["0", "8.broken", "8.other"])["rounds"]]
        assert values[-1] == [5, 3]
        slave_handlers(bench)["wire-break"](["8", "1", "0", "on"])
        await asyncio.sleep(0.1)
        values = [row[2:] for row in read(["0", "8.broken", "8.other"])["rounds"]]
        assert values[-1] == [None, 3]
        assert values.count([0x7FFF, 3]) <= 2  # only while the diagnosis is announced, and not read yet


async def test_rounds_that_a_slow_client_misses_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(round_traces, "KEPT", 10)
    monkeypatch.setattr(round_traces, "_MOST_IN_ANSWER", 4)
    async with operating(TANK) as bus:
        read = RoundTraces(core_of(bus)).read
        read(["0", "9.level"])
        await asyncio.sleep(0.01)
        after = read(["0", "9.level"])["rounds"][0][0]
        await asyncio.sleep(0.5)
        found = read([str(after), "9.level"])
        numbers = [row[0] for row in found["rounds"]]
        assert (len(numbers), found["more"]) == (4, True)
        assert found["lost"] == numbers[0] - after - 1 > 50
        then = read([str(numbers[-1]), "9.level"])
        assert (then["rounds"][0][0], then["lost"]) == (numbers[-1] + 1, 0)
        assert read(["999999999", "9.level"])["lost"] == 0  # of another run


async def test_nothing_is_followed_that_nobody_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(round_traces, "_FORGOTTEN_NS", 50_000_000)
    async with operating(TANK) as bus:
        core = core_of(bus)
        read = RoundTraces(core).read
        for n in range(round_traces.MOST_SETS + 3):
            read(["0", *("9.level", "9.lamp", "9.level")[: n % 3 + 1], *("9.lamp",) * (n // 3)])
        assert len(core.rounds._watchers) <= round_traces.MOST_SETS
        await asyncio.sleep(0.06)
        assert core.rounds._watchers == []
        assert read(["0", "9.level"])["rounds"] == []  # begins again
        assert len(core.rounds._watchers) == 1


async def test_what_is_no_value_is_refused() -> None:
    async with operating({**TANK, "inputs": {"all": "bytes@0:1"}}, HOIST) as bus:
        handler: Any = control_run(bus, "pty")._handlers["rounds"]
        assert "rounds" in {spec.name for spec in KINDS["run"]}
        for args, says in (
            (["x", "9.lamp"], "number of the last round"),
            (["0", "9.all"], "octets are no trace"),
            (["0", "9.none"], "none"),
            (["0", "77.lamp"], "no slave"),
            (["0", "9:speed"], "drive"),
            (["0", "3:length"], "is no value"),
            (["0", *["9.lamp"] * 9], "at most 8"),
        ):
            with pytest.raises(UsageError, match=says):
                await handler(args)
        assert (await handler(["0", "9.lamp"]))["rounds"] == []
