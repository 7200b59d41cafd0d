"""``dpstack plan`` with a cycle and with other masters; ``--simulate``: the configured plant in virtual time beside its
plan."""

from __future__ import annotations

import contextlib
import json
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW
from cli_kit import Cli
from memory_port import MemoryPort
from plant_files import plant_file, toml

from dpstack.api.bus import compose
from dpstack.api.commissioning.plan_simulation import PlanSimulation
from dpstack.cli.commands import plan as plan_command
from dpstack.cli.main import main
from dpstack.cli.terminal import drawing
from dpstack.ports.base import Delivery

FIVE = str(Path(__file__).resolve().parents[3] / "examples" / "two_milliseconds.toml")


def five(folder: Path, **keys: object) -> str:
    """The plant of FIVE with these keys of [bus]."""
    lines = "".join(f"{key} = {toml(value)}\n" for key, value in {"port": "virtual", "baud": 1_500_000, **keys}.items())
    text = Path(FIVE).read_text(encoding="utf-8").replace('port = "virtual"\nbaud = 1500000\n', lines)
    path = folder / "five.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


Out = pytest.CaptureFixture[str]


def test_the_rate_that_a_cycle_needs(cli: Cli) -> None:
    plan = cli.json("plan", FIVE, "--cycle-ms", "4")
    assert plan["cycle"] == {
        "cycle_ms": 4.0,
        "verdict": "undisturbed",
        "load_percent": 39.2,
        "slowest_baud": {"possible": 500_000, "typical": 1_500_000, "undisturbed": 1_500_000, "always": None},
    }
    assert any("misses are to be expected for several repeated requests" in note for note in plan["notes"])


def test_each_rate_is_judged(cli: Cli) -> None:
    # exit code 1: at the bus's own rate it is too tight
    plans = cli.json("plan", FIVE, "--cycle-ms", "2", "--baud", "all", code=1)
    verdicts = {plan["baud"]: plan["cycle"]["verdict"] for plan in plans}
    assert len(verdicts) == 11
    assert set(list(verdicts.values())[:7]) == {"impossible"}
    assert list(verdicts.values())[7:] == ["typical", "typical", "undisturbed", "undisturbed"]
    impossible = [plan for plan in plans if plan["cycle"]["verdict"] == "impossible"]
    assert all(any("is shorter than possible" in f for f in plan["findings"]) for plan in impossible)


def test_without_a_cycle_nothing_is_said_of_one(cli: Cli) -> None:
    plan = cli.json("plan", FIVE)
    assert "cycle" not in plan
    assert plan["masters"] == {"others": 0, "t_tr_needed": plan["masters"]["t_tr_needed"]}


def test_slots_with_their_octets_and_channels(cli: Cli, tmp_path: Path) -> None:
    rack = {"name": "rack", "address": 8, "gsd": "io-station", "modules": ["8 DI", "2 AI", "", "16 DO"]}
    raw = {"name": "raw", "address": 9, "ident": 0x1234, "config": "93 70"}  # 4 octets consistent as a whole; a word
    path = str(plant_file(tmp_path, rack, raw))
    out = cli.out("plan", path).splitlines()
    at = next(number for number, line in enumerate(out) if line.startswith("Slots, "))
    assert [re.split("  +", line) for line in out[at + 2 : at + 7]] == [
        ["8", "rack", "1", "8 DI", "10", "0, 8 channels"],
        ["8", "rack", "2", "2 AI", "51", "1 to 4, 2 channels"],
        ["8", "rack", "4", "16 DO", "21", "0 to 1, 16 channels"],
        ["9", "raw", "1", "93", "0 to 3"],
        ["9", "raw", "2", "70", "4 to 5, 1 channel", "0 to 1, 1 channel"],
    ]
    slots = [slave["slots"] for slave in cli.json("plan", path)["slaves"]]
    assert [slot["name"] for slot in slots[0]] == ["8 DI", "2 AI", "", "16 DO"]
    nothing = {"outputs": 0, "output_at": 0, "output_width": 0}
    assert slots[0][1] == {
        "slot": 2,
        "name": "2 AI",
        "config": "51",
        "inputs": 4,
        "input_at": 1,
        "input_width": 16,
        **nothing,
    }
    assert [(slot["input_at"], slot["output_at"], slot["output_width"]) for slot in slots[1]] == [(0, 0, 0), (4, 0, 16)]


def test_parameters_that_are_impossible_at_another_rate(cli: Cli, tmp_path: Path) -> None:
    """T_SL must be max T_SDR + 15 at least: 300 is enough up to 3 Mbit/s, but not at 45.45 kbit/s."""
    path = five(tmp_path, t_sl=300)
    plans = cli.json("plan", path, "--baud", "all")
    without = [plan for plan in plans if plan["rotation_us"] is None]
    assert [plan["baud"] for plan in plans][::5] == [9600, 187_500, 12_000_000]
    assert [plan["baud"] for plan in without] == [45_450, 6_000_000, 12_000_000]
    assert "t_sl = 300 is less than max_tsdr + 15 = 815" in without[2]["findings"][0]
    assert "12 Mbit/s: no plan: " in cli.out("plan", path, "--baud", "all")
    five(tmp_path, baud=12_000_000, t_sl=300)
    assert f"{path}:9: [bus]: bus parameters at 12 Mbit/s: t_sl = 300 is less than" in cli.err(
        "plan", path, "--baud", "all"
    )


def test_for_people(cli: Cli) -> None:
    out = cli.out("plan", FIVE, "--cycle-ms", "2", code=1).splitlines()
    assert "cycle of 2 ms: tight, missed now and then; the typical rotation takes 78% of it" in out
    assert (
        "this cycle is possible from 1.5 Mbit/s on, typically kept from 1.5 Mbit/s on, "
        "kept while nothing is repeated from 6 Mbit/s on, always kept at no rate" in out
    )
    assert out[-1].startswith("finding: cycle_ms = 2 is enough for the typical rotation (1.57 ms at 1.5 Mbit/s) only")
    table = cli.out("plan", FIVE, "--cycle-ms", "2", "--baud", "all", code=1).splitlines()
    assert table[1].split("  ")[0] == "rate"
    assert "cycle 2 ms" in table[1]
    assert [line.split()[8] for line in table[2:13]] == 7 * ["impossible"] + 2 * ["typical"] + 2 * ["undisturbed"]


def test_other_masters_for_people(cli: Cli, tmp_path: Path) -> None:
    out = cli.out("plan", five(tmp_path, other_masters=1))
    # the longest normal round, by hand: data at max T_SDR 150, a diagnosis of 244 octets, Global_Control and T_ID2, a
    # silent GAP poll, a Write of 240 octets; both masters' with their tokens, and one more
    hold = 5 * (143 + 150 + 143 + 37) + (121 + 150 + 255 * 11 + 37) + (143 + 150) + 366
    hold += 255 * 11 + 150 + 15 * 11 + 37
    needed = 2 * (hold + 70) + hold
    assert f"1 other master: a T_TR of {needed} or more on all of them, then each sees this rotation" in out


@pytest.mark.parametrize("others", [0, 1])
def test_an_adapter_is_judged_beside_other_masters_only_where_there_are_some(
    others: int, capsys: Out, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = five(tmp_path, port="/dev/ttyUSB0", other_masters=others)
    adapter = MemoryPort("adapter", 1_500_000)
    monkeypatch.setattr(adapter, "delivery", Delivery.ADAPTER)
    monkeypatch.setattr(compose, "port_of", lambda *_: adapter)
    assert main(["plan", path, "--json"]) in (0, 1)
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any("other master" in note for note in notes) is bool(others)
    assert main(["plan", path]) in (0, 1)
    assert ("other master" in capsys.readouterr().out) is bool(others)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "fast"])
def test_no_cycle_at_all(value: str, cli: Cli) -> None:
    says = f"argument --cycle-ms: '{value}' is no number of milliseconds above 0"
    assert says in cli.err("plan", FIVE, f"--cycle-ms={value}")


def test_a_run_with_an_impossible_cycle_does_not_begin(cli: Cli, tmp_path: Path) -> None:
    path = five(tmp_path, cycle_ms=1)
    err = cli.err("run", path, "--seconds", "1")
    assert err.startswith(f"dpstack: {path}:9: [bus]: cycle_ms = 1 is shorter than possible: ")
    assert err.endswith(
        "take cycle_ms = 1.16 or more, a larger every for slaves that need not be in each cycle, "
        "or a faster rate (3 Mbit/s would do)\n"
    )


#: two slaves with an octet each way. Their bus of 500 kbit/s by hand, in bit times: request 110, T_SDR 60, answer 110,
#: T_ID1 37, twice; then the token with 33 and 37
ROTATION_US = (2 * (110 + 60 + 110 + 37) + 33 + 37) * 2
TWO = ({**RAW, "name": "valves", "address": 5}, {**RAW, "name": "lamps", "address": 6})
MODULES = ["8 DI", "8 DO"]
NO_ALARMS = {"alarms": [], "alarm_mode": 0}
STATION = {"name": "station", "address": 9, "gsd": "io-station", "modules": MODULES, "dpv1": NO_ALARMS}
ELSEWHERE: dict[str, object] = {"name": "pump", "address": 12, "drive": "imo-hd2"}


@pytest.fixture
def plant(tmp_path: Path) -> Callable[..., str]:
    def write(*more: dict[str, object], **keys: Any) -> str:
        own: dict[str, Any] = {"port": "/dev/no-such-port", "gap": 0, "application_watchdog_ms": 500}
        return str(plant_file(tmp_path, *TWO, *more, **own | keys))

    return write


def test_the_simulated_rotation_is_the_one_by_hand_and_no_port_is_opened(cli: Cli, plant: Callable[..., str]) -> None:
    file = plant()
    plan = cli.json("plan", file, "--simulate", "1")
    simulated = plan.pop("simulated")
    assert plan == cli.json("plan", file)
    times = simulated["rotation_us"]
    assert list(times) == ["min", "p50", "p99", "max"]
    assert times["min"] == ROTATION_US
    assert times["p50"] == pytest.approx(ROTATION_US, rel=0.004)
    # Global_Control: 12 characters, then T_ID2 of 150
    assert times["max"] <= ROTATION_US + 2 * (12 * 11 + 150)
    assert simulated["seconds"] == 1
    assert simulated["rotations"] == pytest.approx(1_000_000 / ROTATION_US, rel=0.01)
    assert simulated["missing"] == []
    assert simulated["gap_polls"] == 0
    assert not {"cycle", "services"} & simulated.keys()


def test_without_a_time_a_minute_of_the_bus_is_simulated(cli: Cli, plant: Callable[..., str]) -> None:
    assert cli.json("plan", plant(baud=9600), "--simulate")["simulated"]["seconds"] == 60


def test_the_plan_and_the_simulation_stand_side_by_side(cli: Cli) -> None:
    lines = cli.out("plan", FIVE, "--simulate", "1").splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("Bus rotation time of the plan, and of "))
    assert [line.split() for line in lines[at + 1 : at + 6]] == [
        ["plan", "time", "simulated", "time"],
        # 1985 bit times at 1.5 Mbit/s; a silent GAP poll of 366 makes the typical one
        ["shortest", "1.160", "ms", "min", "1.323", "ms"],
        ["typical", "1.567", "ms", "median", *lines[at + 3].split()[4:]],
        ["p99", *lines[at + 4].split()[1:]],
        ["longest", "10.070", "ms", "max", *lines[at + 5].split()[4:]],
    ]
    assert float(lines[at + 3].split()[4]) == pytest.approx(1985 / 1500, rel=0.004)
    assert float(lines[at + 4].split()[1]) == pytest.approx((1985 + 366) / 1500, rel=0.004)
    limits = [line for line in lines if line.startswith("not simulated: ")]
    assert limits[0] == "not simulated: delays of computer, port and adapter: only the wire is simulated"
    assert len(limits) == 4


def test_a_fixed_cycle_that_is_kept_and_one_that_is_not(cli: Cli, plant: Callable[..., str]) -> None:
    kept = cli.json("plan", plant(cycle_ms=4), "--simulate", "2", code=1)["simulated"]
    assert kept["rotation_us"]["min"] == kept["rotation_us"]["max"] == 4000
    assert kept["cycle"] == {
        "cycles": 500,
        "late_us": {"min": 0, "p50": 0, "p99": 0, "max": 0},
        "missed": 0,
        "left_out": 0,
        "missed_by": {},
    }
    lines = cli.out("plan", plant(cycle_ms=4), "--simulate", "0.1", code=1).splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("Time from cycle to cycle of the plan, and of "))
    assert lines[at + 2].split() == ["shortest", "4.000", "ms", "min", "4.000", "ms"]
    # shorter than the typical rotation
    file = plant(cycle_ms=ROTATION_US / 1000 - 0.05)
    missed = cli.json("plan", file, "--simulate", "1", code=1)["simulated"]["cycle"]
    assert sum(missed["missed_by"].values()) == missed["missed"] > 0
    assert missed["late_us"]["max"] > 0
    line = next(line for line in cli.out("plan", file, "--simulate", "1", code=1).splitlines() if "simulated: " in line)
    assert f" {missed['missed']} missed (" in line
    assert "after a long round" in line


def test_records_are_read_from_slaves_with_dp_v1(cli: Cli, plant: Callable[..., str]) -> None:
    services = cli.json("plan", plant(STATION), "--simulate", "3")["simulated"]["services"]
    assert services["done"] == 3
    assert services["failed"] == 0
    # the request and one poll for the answer, each in a rotation of its own
    assert services["took_us"]["min"] > ROTATION_US
    assert "one record read a second from each DP-V1 slave: 1 answered (1 of them refused); from the order" in cli.out(
        "plan", plant(STATION), "--simulate", "1"
    )


def test_a_slave_that_hears_another_rate_is_named(cli: Cli, plant: Callable[..., str]) -> None:
    file = plant(ELSEWHERE)
    lines = cli.out("plan", file, "--simulate", "0.1", code=1).splitlines()
    assert any(line.startswith("finding: slave 12 (pump): imo-hd2 ") for line in lines)
    assert "not in data exchange in the simulation: pump (12): offline" in lines


def test_without_any_slave_in_data_exchange_there_are_no_times(cli: Cli, tmp_path: Path) -> None:
    path = plant_file(tmp_path, ELSEWHERE, baud=9600)
    assert cli.json("plan", str(path), "--simulate", "1", code=1)["simulated"]["rotation_us"]["min"] is None
    last = cli.out("plan", str(path), "--simulate", "1", code=1).splitlines()[-1]
    assert last == "not simulated: no slave was in data exchange"


def test_other_masters_are_not_simulated_and_the_output_says_so(cli: Cli, plant: Callable[..., str]) -> None:
    limits = cli.json("plan", plant(other_masters=2), "--simulate", "1")["simulated"]["limits"]
    assert limits[-1] == "2 other masters: the plan counts their token holds, the simulation does not"


def test_an_impossible_cycle_is_not_simulated(cli: Cli, plant: Callable[..., str]) -> None:
    file = plant(cycle_ms=1)
    assert cli.json("plan", file, "--simulate", code=1)["simulated"] is None
    assert (
        cli.out("plan", file, "--simulate", code=1).splitlines()[-1].startswith("not simulated: cycle_ms = 1 is short")
    )


def test_one_rate_only(cli: Cli) -> None:
    assert "--simulate runs at one rate: give --baud B" in cli.err("plan", FIVE, "--baud", "all", "--simulate")
    assert cli.json("plan", FIVE, "--baud", "12000000", "--simulate", "0.1")["simulated"]["rotations"] > 300
    assert "number of seconds above 0" in cli.err("plan", FIVE, "--simulate", "0")


def test_ctrl_c_ends_the_simulation_with_its_figures_so_far(
    cli: Cli, plant: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(progress: object, done: float) -> None:
        if done >= 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(plan_command._Progress, "__call__", interrupt)
    seconds = cli.json("plan", plant(), "--simulate", "3600")["simulated"]["seconds"]
    assert 1 <= seconds < 2


def test_ctrl_c_during_the_bring_up(cli: Cli, plant: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    run = PlanSimulation.run

    async def interrupted(simulation: PlanSimulation, seconds: float, on_progress: Callable[[float], None]) -> None:
        signal.raise_signal(signal.SIGINT)
        await run(simulation, seconds, on_progress)

    monkeypatch.setattr(PlanSimulation, "run", interrupted)
    file = plant(ELSEWHERE)
    assert cli.json("plan", file, "--simulate", code=1)["simulated"] is None
    last = cli.out("plan", file, "--simulate", code=1).splitlines()[-1]
    assert last == "not simulated: ended before all slaves were in data exchange"


def test_a_long_simulation_shows_its_progress(
    cli: Cli, plant: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[tuple[str, int, int]] = []

    @contextlib.contextmanager
    def bar(title: str) -> Iterator[Callable[[str, int, int], None]]:
        assert title == "simulated seconds"
        yield lambda what, done, of: shown.append((what, done, of))

    monkeypatch.setattr(drawing, "progress_bar", bar)
    cli.json("plan", plant(), "--simulate", "0.5")
    assert shown == []
    monkeypatch.setattr(plan_command, "_QUICK_S", -1.0)
    cli.json("plan", plant(), "--simulate", "1.2")
    assert shown == [("simulated seconds", done, 1) for done in (0, 0, 1)]
