"""Plugin and simulated drive against each other, in addition to the literal tests of each end."""

from __future__ import annotations

import contextlib
import json
import random

import pytest
from drive_bench import BUS, MS, NONE, PZD, Named, PairBench, pair
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.errors import ConfigError
from dpstack.profile import DriveProfile, State
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS

ALL = [
    (DEMAG, "PPO1", BUS),
    (DEMAG, "PPO2", BUS),
    (DEMAG, "PPO3", BUS),
    (DEMAG, "PPO4", BUS),
    (FUJI, "PPO1", NONE),
    (FUJI, "PPO2", NONE),
    (FUJI, "PPO3", NONE),
    (FUJI, "PPO4", NONE),
    (KEB, "PCH+4/4", NONE),
    (KEB, "PCH+8/8", NONE),
    (KEB, "4/4", NONE),
    (IMO, "PKW+12", PZD),
    (LS, "PPO1", NONE),
    (LS, "PPO2", NONE),
    (LS, "PPO6", NONE),
    (LS, "ST1", NONE),
]


@pytest.mark.parametrize("rotation", [MS // 2, 40 * MS])  # between them: tests/testing/test_drive_conformance.py
@pytest.mark.parametrize(("drive", "telegram", "presets"), ALL)
def test_one_program_for_every_drive(drive: DriveProfile, telegram: str, presets: Named, rotation: int) -> None:
    bench = pair(drive, telegram, presets, rotation=rotation)
    bench.ok("speed", value=0.5)
    assert bench.ok("start", timeout_s=3) == "running"
    assert bench.ok("reached", timeout_s=10) == pytest.approx(0.5, abs=0.01)
    assert bench.core.status().running
    bench.ok("stop")
    assert bench.core.status().state not in (State.RUNNING, State.STOPPING)
    assert bench.core.status().speed == pytest.approx(0, abs=0.02)
    bench.ok("speed", value=-0.25)
    bench.ok("start")
    bench.ok("reached", tolerance=0.001)
    assert bench.core.status().speed == pytest.approx(-0.25, abs=0.001)
    if drive is IMO:
        assert "imo-hd2 has no quick stop ramp" in bench.refused("quick_stop")[1]
    else:
        bench.ok("quick_stop")
    bench.ok("start")
    bench.ok("coast")
    assert bench.core.status().state is (State.READY if drive in (KEB, IMO) else State.SWITCH_ON_INHIBITED)
    bench.ok("start")
    bench.device.trip(
        {DEMAG.name: "F2100", FUJI.name: "OC1", KEB.name: "E.OL", IMO.name: "OC1", LS.name: "overload"}[drive.name]
    )
    bench.pass_time(400)
    assert bench.core.status().state is State.FAULT
    assert bench.refused("start")[0] == "fault"
    bench.ok("acknowledge")
    assert bench.ok("start") == "running"
    for event in bench.events:
        json.dumps(event)


def test_the_demo_story_of_demag() -> None:
    bench = pair(DEMAG, "PPO1", {"412": 44})
    text = bench.refused_as("fault", "start")
    assert "412 is 44" in text
    assert bench.ok("read", number=412) == 44
    assert bench.ok("write", number=412, value=1) == 1
    assert bench.ok("start", timeout_s=3) == "running"
    bench.ok("speed", value=0.5)
    assert bench.ok("reached") == pytest.approx(0.5, abs=0.001)
    assert bench.ok("read", number=400) == 2
    assert bench.ok("read", number=480, data_set=3) == 5.0
    assert bench.ok("stop") == "ready"


def test_set_412_starts_at_once_and_spares_the_eeprom() -> None:
    bench = pair(DEMAG, "PPO1", {"412": 44}, options={"set_412": True})
    assert bench.ok("start") == "running"
    assert bench.ok("read", number=412, data_set=1) == 1
    assert bench.ok("read", number=412, data_set=2) == 44
    assert bench.refused("read", number=412)[0] == "parameter"


def test_release_lost_and_given_back_does_not_restart() -> None:
    bench = pair(DEMAG, "PPO1", BUS)
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.device.release(False)
    bench.pass_time(300)
    assert bench.core.status().state is State.READY
    assert not bench.core.status().remote
    assert "no hardware release" in bench.refused("start")[1]
    bench.device.release(True)
    bench.pass_time(500)
    assert bench.core.status().state is State.SWITCH_ON_INHIBITED
    assert not bench.device.motor.on
    assert bench.ok("start") == "running"


def test_release_lost_during_the_start() -> None:
    bench = pair(DEMAG, "PPO1", BUS)
    token = bench.order("start")
    bench.pass_time(50)
    bench.device.release(False)
    bench.pass_time(1500)
    assert "no hardware release" in bench.text(token)


def test_load_shows_in_current_and_torque() -> None:
    bench = pair(DEMAG, "PPO2", BUS)
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("reached")
    bench.pass_time(500)
    before = bench.core.status()
    bench.device.set_load(0.8)
    bench.pass_time(500)
    after = bench.core.status()
    assert before.torque == pytest.approx(0.2, abs=0.01)
    assert after.torque == pytest.approx(0.8, abs=0.01)
    assert (after.current or 0) > (before.current or 0)
    bench.device.set_load(2.0)
    bench.pass_time(500)
    assert "limit" in bench.core.status().bits


@pytest.mark.parametrize(
    ("drive", "telegram", "presets", "numbers", "unknown"),
    [
        (DEMAG, "PPO1", BUS, [400, 412, 414, 392, 480, 549], 999),
        (FUJI, "PPO1", NONE, ["F26", "y98", "F07", "F03"], "F99"),
        (KEB, "PCH+4/4", NONE, ["oP.3", "sy.6", "oP.1", "oP.10"], 0x5001),
        (IMO, "PKW+12", PZD, ["P15.02", "P00.10", "P15.13"], "P77.77"),
        (LS, "PPO1", NONE, ["dr-03", 918, "dr-20", "COM-11"], "dr-98"),
    ],
)
def test_many_parameter_orders_at_once(
    drive: DriveProfile, telegram: str, presets: Named, numbers: list[str | int], unknown: str | int
) -> None:
    """Each waits for those before it and gets its own answer; one in the middle that is refused harms no other."""
    bench = pair(drive, telegram, presets)
    alone = {number: bench.do("read", number=number) for number in (*numbers, unknown)}
    assert [alone[number]["ok"] for number in numbers] == [True] * len(numbers)
    assert alone[unknown]["error"] == "parameter"
    asked = [*numbers, *numbers[1:], unknown, *numbers * 2]
    tokens = [bench.order("read", number=number) for number in asked]
    bench.pass_time(4000)
    for number, token in zip(asked, tokens, strict=True):
        result = bench.done(token)
        assert {**result, "token": 0} == {**alone[number], "token": 0}


@pytest.mark.parametrize(("drive", "telegram", "presets"), ALL)
def test_unchanged_inputs_cost_nothing(drive: DriveProfile, telegram: str, presets: Named) -> None:
    bench = pair(drive, telegram, presets)
    bench.ok("start")
    inputs = bench.inputs
    first = bench.core.cyclic(inputs, bench.now)
    assert bench.core.cyclic(inputs, bench.now + 1) is first


@examples(60)
@given(st.data())
def test_random_outputs_never_break_a_simulated_drive(data: st.DataObject) -> None:
    drive, telegram, presets = data.draw(st.sampled_from(ALL))
    device = drive.simulated(telegram, {}, presets)
    core = drive.core("it", telegram, simulated=True)
    config = core.telegram.config
    octets = core.telegram.output_octets
    now = 0
    device.enter(config, now)
    for outputs in data.draw(st.lists(st.binary(min_size=octets, max_size=octets), max_size=40)):
        now += data.draw(st.integers(0, 60 * MS))
        inputs = device.exchange(outputs, now)
        assert len(inputs) == core.telegram.input_octets
        core.cyclic(inputs, now)
        assert core.status().state is not State.UNKNOWN


@examples(60)
@given(st.data())
def test_random_inputs_and_orders_never_break_a_plugin(data: st.DataObject) -> None:
    drive, telegram, _ = data.draw(st.sampled_from(ALL))
    core = drive.core("it", telegram, simulated=True)
    octets, sent = core.telegram.input_octets, core.telegram.output_octets
    rng = random.Random(data.draw(st.integers(0, 1 << 30)))
    ops = ["start", "stop", "coast", "quick_stop", "acknowledge", "speed", "frequency", "reached", "read", "write", "x"]
    ops += ["read_map", "write_map", "inputs", "output", "inch", "pre_excite", "control"]
    now = 0
    answered: set[object] = set()
    tokens = 0
    for _ in range(80):
        now += rng.randrange(0, 200 * MS)
        if rng.random() < 0.3:
            tokens += 1
            args: dict[str, object] = rng.choice(
                [{}, {"value": rng.uniform(-3, 3)}, {"number": rng.choice([412, 480, 947, 7])}, {"number": "F26"}]
            )
            core.command(rng.choice(ops), {**args, "timeout_s": 1} if rng.random() < 0.7 else args, tokens, now)
        if rng.random() < 0.03:
            core.lost(now)
        out = core.cyclic(rng.randbytes(octets if rng.random() < 0.95 else rng.randrange(0, 21)), now)
        assert len(out) == sent
        json.dumps(core.status().as_dict())
        answered |= {event["token"] for event in core.take_events() if event["type"] == "result"}
    core.lost(now)
    answered |= {event["token"] for event in core.take_events() if event["type"] == "result"}
    assert answered == set(range(1, tokens + 1))


def test_switched_off_and_on_a_drive_has_what_its_eeprom_holds() -> None:
    hoist = pair(DEMAG, "PPO1")
    hoist.ok("write", number=412, value=1)
    hoist.ok("write", number=480, value=7.5, data_set=2, ram=True)
    after = DEMAG.simulated("PPO1", {}, {})
    after.inherit(hoist.device)
    bench = PairBench(DEMAG.core("it", "PPO1"), after)
    assert bench.ok("start") == "running"
    assert bench.ok("read", number=480, data_set=2) == 5.0  # that was RAM only
    fan = pair(FUJI, "PPO1")
    fan.ok("write", number="o30", value=3)
    other = FUJI.simulated("PPO1", {}, {})
    other.inherit(fan.device)
    assert other.check_cfg(FUJI.telegram("PPO1").config) == "configuration f3 71 is not PPO3 (71), o30 is 3"
    assert other.check_cfg(FUJI.telegram("PPO3").config) is None
    assert other.configs[0] == FUJI.telegram("PPO3").config


@pytest.mark.parametrize(("drive", "telegram", "presets"), ALL)
def test_a_name_that_no_parameter_has_faults_no_plugin(drive: DriveProfile, telegram: str, presets: Named) -> None:
    bench = pair(drive, telegram, presets)
    for name in (
        "9" * 5000,
        "9" * 60,
        "\u0663",
        "\u00b2",
        "0x" + "f" * 5000,
        "-1",
        "",
        "F" + "9" * 90,
        "\ud800",
        "1" * 4,
    ):
        if bench.core.access is not None:
            assert bench.refused("read", number=name)[0] in ("usage", "parameter"), name
            assert bench.refused("write", number=name, value=1)[0] in ("usage", "parameter"), name
            assert "error" in str(bench.do("read_many", parameters=[{"number": name}])), name


@pytest.mark.parametrize(("drive", "telegram", "presets"), ALL)
@pytest.mark.parametrize("number", [10**400, 10**19, 1e308, -1e308, 1e16, float("inf"), float("nan")], ids=str)
def test_a_number_that_no_drive_has_is_refused_and_faults_no_plugin(
    drive: DriveProfile, telegram: str, presets: Named, number: float
) -> None:
    bench = pair(drive, telegram, presets)
    bench.ok("start", timeout_s=3)
    orders: list[tuple[str, dict[str, object]]] = [
        ("speed", {"value": number}),
        ("frequency", {"value": number}),
        ("reached", {"tolerance": number}),
        ("start", {"timeout_s": number}),
    ]
    if bench.core.access is not None:
        listed = bench.core.parameters()
        orders += [("write", {"number": one.name, "value": number}) for one in listed if not one.read_only][:20]
        orders += [("read", {"number": number}), ("read", {"number": listed[0].name, "data_set": number})]
        orders += [("read", {"number": listed[0].name, "index": number})]
    for op, args in orders:
        assert bench.refused(op, **args)[0] in ("usage", "parameter"), (op, args)
    assert bench.core.status().running


_LONG = "9" * 5000
STRANGE_OPTIONS: list[object] = [
    10**400, 1e308, float("nan"), True, None, [], {}, _LONG, f"{_LONG}+{_LONG}", f"P15.02={_LONG}", f"{_LONG}={_LONG}",
    f"1:{_LONG}", f"F{_LONG}", f"0x{'f' * 5000}", f"{_LONG} {_LONG}", "\u0663", "\u00b2", "\ud800", ",", ";=:+", "1,2",
]  # fmt: skip


@pytest.mark.parametrize("drive", [DEMAG, FUJI, IMO, KEB, LS], ids=lambda drive: drive.name)
def test_any_value_of_any_option_is_taken_or_refused(drive: DriveProfile) -> None:
    for option in (*drive.core_options, *drive.device_options, "412", "F26", "dr-03", "ud.01", "P00.03"):
        for value in STRANGE_OPTIONS:
            for make in (lambda given: drive.core("it", None, given), lambda given: drive.device(None, given)):
                with contextlib.suppress(ConfigError):
                    make({option: value})
