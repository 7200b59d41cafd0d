"""Inputs of simulated slaves from recordings and functions, as the master reads them; errors in both."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest
from api_kit import bench_of, bus_of, in_operate

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import parse_config
from dpstack.api.slave_side import simulated_inputs
from dpstack.api.slave_side.simulated_inputs import SimulatedInputs
from dpstack.errors import ConfigError

pytestmark = pytest.mark.virtual_time


@pytest.fixture(autouse=True)
def busy_computer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A call of a function may take long where other tests compute."""
    monkeypatch.setattr(simulated_inputs, "PATIENCE_S", 20.0)


HEAD = '[bus]\nport = "virtual"\nbaud = 93750\ncycle_ms = 10\n'
TANK = (
    HEAD + '[[slave]]\nname = "tank"\naddress = 8\nident = 0x1234\nconfig = "11 20"\n'
    'inputs = { level = { at = "u16@0", scale = 0.1, unit = "bar" } }\noutputs = { valve = "bool@0.0" }\n'
)
#: as `run --record` writes it, with a row that is not valid
RECORDED = """time,t,tank.state,tank.level [bar],tank.valve,other.level,note
2026-01-31T12:00:00.000Z,3.5,data_exchange,12.3,true,1,
2026-01-31T12:00:00.100Z,3.6,data_exchange,12.4,true,2,
2026-01-31T12:00:00.200Z,3.7,offline,,,3,
2026-01-31T12:00:00.300Z,3.8,data_exchange,99999,true,4,
2026-01-31T12:00:00.400Z,3.9,data_exchange,0.5,true,5,the end
"""


async def inputs_at(
    folder: Path, simulate: str, times: tuple[float, ...], *, table: str = TANK, outputs: bytes = b"\0"
) -> tuple[list[str], list[str]]:
    """The inputs that the master reads at ``times``, in s after the start, and the remarks about their source."""
    events: list[dpstack.Event] = []
    config = parse_config(f"{table}simulate = {{ {simulate} }}\n", str(folder / "plant.toml"))
    async with in_operate(dpstack.open_bus(config, on_event=events.append)) as bus:
        bus.slave("tank").outputs = outputs
        await asyncio.sleep(0.02)
        bench = bench_of(bus)
        inputs = SimulatedInputs(bench, core_of(bus).publish, allow_code=True)
        origin = bench.now
        inputs.start(origin)
        found = []
        for at in times:
            await asyncio.sleep(at - (bench.now - origin) / 1e9)
            found.append(bus.slave("tank").inputs.hex())
        inputs.close()
    marks = ("recording", "function")
    return found, [event.text for event in events if any(mark in event.text for mark in marks)]


@pytest.mark.parametrize("name", ["plant.csv", "plant.jsonl"])
async def test_a_recording_is_played(tmp_path: Path, name: str) -> None:
    text = RECORDED
    if name.endswith("jsonl"):
        text = (
            '{"recording":{"version":1,"slaves":[{"name":"tank","columns":[{"field":"level","type":"number"}]}]}}\n'
            '{"time":"2026-01-31T12:00:00.000Z","t":3.5,"tank.level":12.3}\n'
            '{"time":"2026-01-31T12:00:00.100Z","t":3.6,"tank.level":12.4}\n'
            '{"time":"2026-01-31T12:00:00.300Z","t":3.8,"tank.level":99999}\n'
            '{"time":"2026-01-31T12:00:00.400Z","t":3.9,"tank.level":0.5}\n'
        )
    (tmp_path / name).write_text(text, encoding="utf-8")
    found, told = await inputs_at(tmp_path, f'recording = "{name}"', (0.05, 0.15, 0.25, 0.35, 0.45, 0.6))
    assert found == ["007b", "007c", "007c", "007c", "0005", "0005"]  # 123, 124 and 5 tenths
    assert told == [
        f"recording {name}: level = 99999 is outside 0.0..6553.5 bar (u16, scale 0.1, offset 0); left out, and so are "
        "others of tank.level",
        f"recording {name}: is over; the last inputs stay",
    ]


async def test_a_table_with_t_alone_is_played_again_and_again(tmp_path: Path) -> None:
    (tmp_path / "hand.csv").write_text("t,tank.level\n5,1\nx,9\n5.1,2 bar\n", encoding="utf-8")
    found, told = await inputs_at(tmp_path, 'recording = "hand.csv", repeat = true', (0.05, 0.15, 0.25, 0.35, 0.45))
    assert found == ["000a", "0014", "000a", "0014", "000a"]
    assert told == []


FUNCTIONS = """
import threading

again = threading.Event()
seen = []

def fill(t, outputs):
    seen.append((t, outputs))
    return {"level": t + outputs["valve"]}

def octets(t, outputs):
    return b"\\x01" + bytes([round(10 * t)])

def ill(t, outputs):
    if t < 0.15:
        return {"level": 1}
    if t < 0.25:
        raise ValueError("a leak")
    if t < 0.35:
        return {"levle": 1}
    if t < 0.45:
        return {"level": -1}
    if t < 0.55:
        return [1]
    if t < 0.65:
        raise SystemExit
    return {"level": 2}

def flaky(t, outputs):
    if round(10 * t) % 2:
        raise ValueError(f"at {t:.1f} s")

def slow(t, outputs):
    if t:
        again.wait()
    return {"level": 7}
"""


def functions(folder: Path, name: str) -> str:
    """A module of its own, as Python loads each once."""
    (folder / f"{name}.py").write_text(FUNCTIONS, encoding="utf-8")
    return name


async def test_a_function_gets_outputs_and_gives_inputs(tmp_path: Path) -> None:
    module = functions(tmp_path, "tank_fill")
    given = f'function = "{module}:fill", period_ms = 100'
    found, told = await inputs_at(tmp_path, given, (0.05, 0.15, 0.25, 0.35, 0.45), outputs=b"\x01")
    assert (found, told) == (["0100", "000a", "000b", "000c", "000d"], [])  # mirrored, then 1.0 to 1.3 bar
    seen: Any = __import__(module).seen  # the thread may not have begun the fifth call
    assert [(round(t, 6), outputs) for t, outputs in seen[:4]] == [(at, {"valve": True}) for at in (0.0, 0.1, 0.2, 0.3)]
    nameless = TANK.replace('outputs = { valve = "bool@0.0" }\n', "")
    found, told = await inputs_at(
        tmp_path, f'function = "{module}:octets", period_ms = 100', (0.15, 0.25), table=nameless
    )
    assert (found, told) == (["0100", "0101"], [])


async def test_an_ill_function_is_told_once_and_the_last_inputs_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated_inputs, "QUIET_NS", 0)
    module = functions(tmp_path, "tank_ill")
    given = f'function = "{module}:ill", period_ms = 50'
    found, told = await inputs_at(tmp_path, given, (0.12, 0.25, 0.35, 0.45, 0.55, 0.65, 0.8))
    assert found == [*["000a"] * 6, "0014"]
    who, stay = f"slave 8 (tank): function {module}:ill: ", "; the last inputs stay"
    assert told == [
        f"{who}failed (ValueError: a leak){stay}",
        f"{who}gave wrong inputs (slave 8 (tank): no input is called 'levle'; did you mean level?){stay}",
        f"{who}gave wrong inputs (level = -1 is outside 0.0..6553.5 bar (u16, scale 0.1, offset 0)){stay}",
        f"{who}gave wrong inputs (list: give a mapping of named inputs, octets, or None){stay}",
        f"{who}failed (SystemExit: ){stay}",
        f"{who}works again",
    ]


async def test_a_function_that_fails_again_and_again_does_not_fill_the_screen(tmp_path: Path) -> None:
    module = functions(tmp_path, "tank_flaky")
    _, told = await inputs_at(tmp_path, f'function = "{module}:flaky", period_ms = 100', (2.35,))
    who = f"slave 8 (tank): function {module}:flaky: "
    assert told == [
        f"{who}failed (ValueError: at 0.1 s); the last inputs stay",
        f"{who}failed (ValueError: at 1.1 s); the last inputs stay",
        f"{who}failed (ValueError: at 2.1 s); the last inputs stay",
    ]


async def test_a_function_that_never_returns_does_not_hold_the_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulated_inputs, "PATIENCE_S", 0.25)
    module = functions(tmp_path, "tank_slow")
    given = f'function = "{module}:slow", period_ms = 50'
    found, told = await inputs_at(tmp_path, given, (0.08, 0.3, 0.6))
    assert found == ["0046"] * 3
    assert told == [f"slave 8 (tank): function {module}:slow: takes longer than its period; the last inputs stay"]
    thread = next(one for one in threading.enumerate() if one.name == f"{module}:slow")
    __import__(module).again.set()
    await asyncio.to_thread(thread.join, 5)
    assert not thread.is_alive()


@pytest.mark.parametrize(
    ("simulate", "says"),
    [
        ('recording = "none.csv"', "plant.toml:12: [[slave]] tank: simulate: "),
        ('recording = "plant.toml"', "a recording ends in .csv, .jsonl, .parquet"),
        (
            'recording = "other.csv"',
            "no column of this slave; there are: other.level; wanted: tank.level",
        ),
        ('recording = "empty.csv"', "is empty"),
        ('function = "none_such:f"', "plant.toml:12: [[slave]] tank: simulate: 'none_such:f' cannot be loaded (Module"),
        ('function = "broken:f"', "cannot be loaded (ZeroDivisionError: division by zero)"),
        ('function = "math:tank"', "math has no function 'tank'; correct the name"),
        ('function = "math:pi"', "'math:pi' is no function; name a function"),
    ],
)
async def test_sources_that_cannot_be_used(tmp_path: Path, simulate: str, says: str) -> None:
    (tmp_path / "other.csv").write_text("t,other.level\n0,1\n", encoding="utf-8")
    (tmp_path / "empty.csv").write_text("", encoding="utf-8")
    (tmp_path / "broken.py").write_text("1 / 0", encoding="utf-8")
    with pytest.raises(ConfigError) as told:
        await inputs_at(tmp_path, simulate, ())
    assert says in str(told.value)
    assert "\n" not in str(told.value)


async def test_code_needs_a_word_for_it(tmp_path: Path) -> None:
    (tmp_path / "evil.py").write_text("raise AssertionError('it was loaded')", encoding="utf-8")
    config = parse_config(f'{TANK}simulate = {{ function = "evil:f" }}\n', str(tmp_path / "plant.toml"))
    async with bus_of(*config.slaves) as bus:
        with pytest.raises(ConfigError) as told:
            SimulatedInputs(bench_of(bus), core_of(bus).publish, allow_code=False)
    assert str(told.value).endswith(
        "plant.toml:12: [[slave]] tank: simulate: function = 'evil:f' runs a program; "
        "give --allow-code (in a test allow_code=True) if you trust it"
    )


@pytest.mark.parametrize(
    ("simulate", "says"),
    [
        ("3", "simulate"),
        ("{}", "neither recording nor function; give one of them"),
        ('{ recording = "a.csv", function = "a:b" }', "recording and function; give one of them"),
        ('{ recording = "a.csv", period_ms = 5 }', "period_ms without function"),
        ('{ function = "a:b", repeat = true }', "repeat without recording"),
        ('{ function = "a.py" }', "function = 'a.py'; write module:function"),
        ('{ function = "a:b", period_ms = 1 }', "period_ms = 1 is outside 5..3600000"),
        ('{ recordng = "a.csv" }', "did you mean 'recording'?"),
    ],
)
def test_the_key_is_checked(simulate: str, says: str) -> None:
    with pytest.raises(ConfigError) as told:
        parse_config(f"{TANK}simulate = {simulate}\n")
    assert says in str(told.value)
    assert "config:12: [[slave]] tank" in str(told.value)
    drive = HEAD + '[[slave]]\nname = "fan"\naddress = 4\ndrive = "fuji-frenic"\nsimulate = { function = "a:b" }\n'
    with pytest.raises(ConfigError, match="simulate beside drive"):
        parse_config(drive)
