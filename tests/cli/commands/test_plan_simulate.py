"""``dpstack plan --simulate``: the configured plant in virtual time beside its plan."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack.api.commissioning.plan_simulation import PlanSimulation
from dpstack.cli.commands import plan as plan_command
from dpstack.cli.terminal import drawing

FIVE = str(Path(__file__).resolve().parents[3] / "examples" / "two_milliseconds.toml")
#: two slaves with an octet each way. Their bus of 500 kbit/s by hand, in bit times: request 110, T_SDR 60, answer 110,
#: T_ID1 37, twice; then the token with 33 and 37
ROTATION_US = (2 * (110 + 60 + 110 + 37) + 33 + 37) * 2
TWO = """
[bus]
port = "/dev/no-such-port"
baud = 500000
gap = 0
application_watchdog_ms = 500
[[slave]]
name = "valves"
address = 5
ident = 0x1234
config = "20 10"
[[slave]]
name = "lamps"
address = 6
ident = 0x1234
config = "20 10"
"""
STATION = """
[[slave]]
name = "station"
address = 9
gsd = "io-station"
modules = ["8 DI", "8 DO"]
dpv1 = { alarms = [], alarm_mode = 0 }
"""
ELSEWHERE = """
[[slave]]
name = "pump"
address = 12
drive = "imo-hd2"
"""


@pytest.fixture
def plant(tmp_path: Path) -> Callable[..., str]:
    def write(*more: str, keys: str = "") -> str:
        path = tmp_path / "plant.toml"
        path.write_text(TWO.replace("gap = 0\n", f"gap = 0\n{keys}\n") + "".join(more), encoding="utf-8")
        return str(path)

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
    slow = plant().replace("plant.toml", "slow.toml")
    Path(slow).write_text(TWO.replace("500000", "9600"), encoding="utf-8")
    assert cli.json("plan", slow, "--simulate")["simulated"]["seconds"] == 60


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
    kept = cli.json("plan", plant(keys="cycle_ms = 4"), "--simulate", "2", code=1)["simulated"]
    assert kept["rotation_us"]["min"] == kept["rotation_us"]["max"] == 4000
    assert kept["cycle"] == {
        "cycles": 500,
        "late_us": {"min": 0, "p50": 0, "p99": 0, "max": 0},
        "missed": 0,
        "left_out": 0,
        "missed_by": {},
    }
    lines = cli.out("plan", plant(keys="cycle_ms = 4"), "--simulate", "0.1", code=1).splitlines()
    at = next(n for n, line in enumerate(lines) if line.startswith("Time from cycle to cycle of the plan, and of "))
    assert lines[at + 2].split() == ["shortest", "4.000", "ms", "min", "4.000", "ms"]
    # shorter than the typical rotation
    file = plant(keys=f"cycle_ms = {ROTATION_US / 1000 - 0.05:g}")
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
    path = tmp_path / "pump.toml"
    path.write_text('[bus]\nport = "virtual"\nbaud = 9600\n' + ELSEWHERE, encoding="utf-8")
    assert cli.json("plan", str(path), "--simulate", "1", code=1)["simulated"]["rotation_us"]["min"] is None
    last = cli.out("plan", str(path), "--simulate", "1", code=1).splitlines()[-1]
    assert last == "not simulated: no slave was in data exchange"


def test_other_masters_are_not_simulated_and_the_output_says_so(cli: Cli, plant: Callable[..., str]) -> None:
    limits = cli.json("plan", plant(keys="other_masters = 2"), "--simulate", "1")["simulated"]["limits"]
    assert limits[-1] == "2 other masters: the plan counts their token holds, the simulation does not"


def test_an_impossible_cycle_is_not_simulated(cli: Cli, plant: Callable[..., str]) -> None:
    file = plant(keys="cycle_ms = 1")
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
