"""Scenario files: errors with their line, steps in virtual time as a master sees them, and `ctl fault`."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest
from api_kit import bench_of, operating

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import event_json
from dpstack.api.config.config import slave_config
from dpstack.api.control.scenario import ScenarioRun, parse_scenario
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.injected import ScenarioEvent
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.dp.master.events import SlaveDiagnosis
from dpstack.errors import ConfigError
from dpstack.params import BusParams
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

VALVES: dict[str, object] = {
    "name": "valves",
    "address": 8,
    "gsd": "examples/terminal.gsd",
    "modules": ["8 DO", "8 DI"],
    "inputs": {"limit": "bool@0.3", "level": "u8@0"},
}
RAW: dict[str, object] = {"name": "raw", "address": 9, "ident": 0x1234, "config": "20"}
HOIST: dict[str, object] = {
    "name": "hoist",
    "address": 3,
    "drive": "demag-dedrive",
    "options": {"check_settings": False},
}

STEPS = """
[[step]]
at = 2.0
slave = "valves"
do = "power-off"
for = 0.5

[[step]]
at = 0.5
slave = 8
do = "set"
inputs = { level = 9 }
for = 0.5

[[step]]
at = 1.0
slave = "valves"
do = "diagnosis"
text = "fuse blown"
for = 0.5

[[step]]
at = 3.5
slave = "raw"
do = "silence"

[[step]]
at = 3.7
slave = "raw"
do = "normal"
"""


def bench_with(*tables: Mapping[str, object]) -> VirtualBench:
    bench = VirtualBench(World(), BusParams.preset(500_000))
    for table in tables:
        bench.add(slave_config(table))
    return bench


async def test_steps_happen_in_the_order_of_their_times_and_end() -> None:
    events: list[dpstack.Event] = []
    async with operating(VALVES, RAW, on_event=events.append, baud=45_450) as bus:
        bench = bench_of(bus)
        scenario = parse_scenario("repeat = 5.0\n" + STEPS, bench, slave_handlers(bench))
        origin = core_of(bus).runtime.now()
        ScenarioRun(scenario, bench, core_of(bus).publish).start(origin)
        seen: dict[float, tuple[str, str, object]] = {}
        for at in (0.4, 0.7, 1.2, 2.4, 3.4, 3.68, 4.9, 5.7):
            await asyncio.sleep((origin - core_of(bus).runtime.now()) / 1e9 + at)
            slave = bus.slave("valves")
            seen[at] = (slave.inputs.hex(), slave.state.value, bus.slave("raw").state.value)
    there, gone = "data_exchange", "offline"
    assert seen == {
        0.4: ("00", there, there),
        0.7: ("09", there, there),  # set
        1.2: ("00", there, there),
        2.4: ("00", gone, there),  # power-off
        3.4: ("00", there, there),
        3.68: ("00", there, gone),  # silence
        4.9: ("00", there, there),
        5.7: ("09", there, there),  # the second round
    }
    told = [
        (round((event.t_ns - origin) / 1e9, 3), event.step, event.state)
        for event in events
        if isinstance(event, ScenarioEvent)
    ]
    assert told[:14] == [
        (0.5, 2, "begin"),
        (1.0, 2, "end"),
        (1.0, 3, "begin"),
        (1.5, 3, "end"),
        (2.0, 1, "begin"),
        (2.5, 1, "end"),
        (3.5, 4, "begin"),
        (3.7, 5, "begin"),
        (3.7, 4, "end"),
        (5.0, 0, "again"),
        (5.5, 2, "begin"),
    ]
    diagnosed = [str(event_json(event, 0.0)) for event in events if isinstance(event, SlaveDiagnosis)]
    assert any("fuse blown" in line for line in diagnosed)
    line = event_json(next(event for event in events if isinstance(event, ScenarioEvent)), 0.5)
    assert line == {
        "event": "scenario",
        "t": 0.5,
        "step": 2,
        "state": "begin",
        "address": 8,
        "name": "valves",
        "do": "set",
        "for": 0.5,
        "text": "scenario step 2, slave 8 (valves): inputs level = 9 for 0.5 s",
    }


STEP = '[[step]]\nat = 1\nslave = "valves"\ndo = '


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "scenario:1: no step; add [[step]]"),
        ("[[steps]]\nat = 1", "scenario:1: unknown table or key 'steps'"),
        ("[step]\nat = 1", "scenario:1: [step] must be [[step]]"),
        ("[[step]]\nat = 1 s", "scenario:2: not valid TOML"),
        ("[[step]]\nat = 1", "scenario:1: [[step]] 1: no do; say what happens"),
        (
            '[[step]]\nat = 1\nslave = "fan"\ndo = "rs"',
            "scenario:3: [[step]] 1: no slave 'fan'; there are: 3 (hoist), 8 (valves)",
        ),
        ('[[step]]\nat = 1\nslave = "valve"\ndo = "rs"', "did you mean 'valves'?"),
        ('[[step]]\nslave = 8\ndo = "rs"', "scenario:1: [[step]] 1: no at"),
        (
            '[[step]]\nat = 1\nslave = 8\n\ndo = "late_anwers"',
            "scenario:5: [[step]] 1: unknown do 'late_anwers'; did you",
        ),
        (STEP + '"late_answers"\nby = 3', "scenario:5: [[step]] 1: unknown key 'by'; did you mean 'by_ms'?"),
        (STEP + '"late_answers"\nby_ms = "long"', "scenario:5: [[step]] 1: by_ms"),
        (STEP + '"noise"\nrate = 2', "scenario:5: [[step]] 1: rate = 2 is outside"),
        (STEP + '"diagnosis"\nerror = "wire brake"', "scenario:5: [[step]] 1: unknown error 'wire brake'"),
        (STEP + '"diagnosis"\nerror = "line braek"', "did you mean 'line break'?"),
        (STEP + '"diagnosis"', "scenario:1: [[step]] 1: a diagnosis without what, error, text, octets"),
        (STEP + '"diagnosis"\nerror = 6\noctets = "00"', "error and octets; give one"),
        (STEP + '"trip"\ncode = "F1"', "scenario:4: [[step]] 1: slave 8 (valves) is no simulated drive"),
        ('[[step]]\nat = 1\nslave = "hoist"\ndo = "trip"\ncode = "F99999"', "scenario:5: [[step]] 1: 'F99999' is no"),
        ('[[step]]\nat = 1\nslave = "hoist"\ndo = "set"\noctets = "00"', "the simulated drive makes its inputs"),
        (STEP + '"set"\ninputs = { levl = 1 }', "scenario:5: [[step]] 1: slave 8 (valves): no input is called 'levl'"),
        (STEP + '"set"\ninputs = { level = 256 }', "level = 256 is outside 0..255"),
        (STEP + '"set"\noctets = "00 01"', "scenario:5: [[step]] 1: slave 8 (valves) has 1 octet of inputs"),
        (STEP + '"trip"\ncode = "F1"\nfor = 2', "trip has no end of its own; leave for out"),
        (STEP + '"load"', "scenario:1: [[step]] 1: load takes SLAVE TORQUE"),
        ("repeat = 0.5\n" + STEP + '"rs"\nfor = 2', "scenario:1: repeat = 0.5, and the last step is over at 3 s"),
    ],
)
def test_errors_have_the_line_and_say_what_to_do(text: str, says: str) -> None:
    bench = bench_with(VALVES, HOIST)
    with pytest.raises(ConfigError) as told:
        parse_scenario(text, bench, slave_handlers(bench))
    assert says in str(told.value)
    assert str(told.value).count("scenario:") == 1
    assert "\n" not in str(told.value)


async def test_ctl_begins_and_ends_faults() -> None:
    events: list[str] = []
    async with operating(RAW, on_event=lambda event: events.append(event.text)) as bus:
        bench = bench_of(bus)
        handlers = slave_handlers(bench, core_of(bus))
        handlers["fault"](["raw", "late-answers", "by_ms=0.1", "for=500ms"])
        handlers["fault"](["raw", "noise", "rate=1e-6"])
        assert bench.injected(9) == ["late answers by 0.1 ms", "noise on its stub, 1e-06 a bit"]
        before = bus.slave("raw").exchanges
        await asyncio.sleep(0.6)
        assert bus.slave("raw").exchanges > before + 100  # late, but in time
        assert bench.injected(9) == ["noise on its stub, 1e-06 a bit"]
        assert events[-1] == "slave 9 (raw): over: late answers by 0.1 ms"
        handlers["normal"](["raw"])
        assert events[-2] == "slave 9 (raw): over: noise on its stub, 1e-06 a bit"
        assert bench.injected(9) == []
        for words, says in (
            (["rs", "by=1"], "unknown key 'by'"),
            (["rs", "1"], "not KEY=VALUE"),
            (["rz"], "unknown fault 'rz'; did you"),
        ):
            with pytest.raises(ConfigError, match=says):
                handlers["fault"](["raw", *words])


async def test_several_diagnoses_of_one_slave_each_with_its_end() -> None:
    rack: dict[str, object] = {"name": "rack", "address": 5, "gsd": "io-station", "modules": ["8 DI", "8 DO", "2 AI"]}
    said = [
        (0.1, 0.6, "slot 3 channel 0 line break"),
        (0.2, 0.2, "slot 3 channel 1 upper limit exceeded"),
        (0.3, 0.6, "slot 2 no module"),
    ]
    text = "".join(
        f'[[step]]\nat = {at}\nslave = "rack"\ndo = "diagnosis"\nwhat = "{what}"\nfor = {for_s}\n'
        for at, for_s, what in said
    )
    async with operating(rack, baud=93_750) as bus:
        bench = bench_of(bus)
        origin = core_of(bus).runtime.now()
        run = ScenarioRun(parse_scenario(text, bench, slave_handlers(bench)), bench, lambda event: None)
        run.start(origin)
        seen = []
        for at in (0.15, 0.25, 0.35, 0.45, 0.75, 0.95):
            await asyncio.sleep((origin - core_of(bus).runtime.now()) / 1e9 + at)
            found = bus.slave("rack").diagnosis
            assert found is not None
            seen.append(found.ext.hex(" "))
            assert len(bench.injected(5)) == [1, 2, 3, 2, 1, 0][len(seen) - 1]
    assert seen == [
        "42 04 05 82 00 00 10 82 40 a6",
        "42 04 05 82 00 00 10 82 40 a6 82 41 a7",
        "42 06 05 82 00 00 1c 82 40 a6 82 41 a7",
        "42 06 05 82 00 00 1c 82 40 a6",
        "42 02 05 82 00 00 0c",
        "",
    ]
