"""``dpstack plan`` with a cycle and with other masters."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cli_kit import Cli
from memory_port import MemoryPort

from dpstack.api.bus import compose
from dpstack.cli.main import main
from dpstack.ports.base import Delivery

ROOT = Path(__file__).resolve().parents[3]
FIVE = str(ROOT / "examples" / "two_milliseconds.toml")
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


def test_parameters_that_are_impossible_at_another_rate(cli: Cli, tmp_path: Path) -> None:
    """T_SL must be max T_SDR + 15 at least: 300 is enough up to 3 Mbit/s, but not at 45.45 kbit/s."""
    path = tmp_path / "slow.toml"
    text = Path(FIVE).read_text(encoding="utf-8")
    path.write_text(text.replace("baud = 1500000\n", "baud = 1500000\nt_sl = 300\n"), encoding="utf-8")
    plans = cli.json("plan", str(path), "--baud", "all")
    without = [plan for plan in plans if plan["rotation_us"] is None]
    assert [plan["baud"] for plan in plans][::5] == [9600, 187_500, 12_000_000]
    assert [plan["baud"] for plan in without] == [45_450, 6_000_000, 12_000_000]
    assert "t_sl = 300 is less than max_tsdr + 15 = 815" in without[2]["findings"][0]
    assert "12 Mbit/s: no plan: " in cli.out("plan", str(path), "--baud", "all")
    path.write_text(text.replace("baud = 1500000\n", "baud = 12000000\nt_sl = 300\n"), encoding="utf-8")
    assert f"{path}:9: [bus]: bus parameters at 12 Mbit/s: t_sl = 300 is less than" in cli.err(
        "plan", str(path), "--baud", "all"
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
    path = tmp_path / "two.toml"
    text = Path(FIVE).read_text(encoding="utf-8")
    path.write_text(text.replace("baud = 1500000\n", "baud = 1500000\nother_masters = 1\n"), encoding="utf-8")
    out = cli.out("plan", str(path))
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
    path = tmp_path / "adapter.toml"
    text = Path(FIVE).read_text(encoding="utf-8").replace('"virtual"', '"/dev/ttyUSB0"')
    path.write_text(text.replace("baud = 1500000\n", f"baud = 1500000\nother_masters = {others}\n"), encoding="utf-8")
    adapter = MemoryPort("adapter", 1_500_000)
    monkeypatch.setattr(adapter, "delivery", Delivery.ADAPTER)
    monkeypatch.setattr(compose, "port_of", lambda *_: adapter)
    assert main(["plan", str(path), "--json"]) in (0, 1)
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any("other master" in note for note in notes) is bool(others)
    assert main(["plan", str(path)]) in (0, 1)
    assert ("other master" in capsys.readouterr().out) is bool(others)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "fast"])
def test_no_cycle_at_all(value: str, cli: Cli) -> None:
    says = f"argument --cycle-ms: '{value}' is no number of milliseconds above 0"
    assert says in cli.err("plan", FIVE, f"--cycle-ms={value}")


def test_a_run_with_an_impossible_cycle_does_not_begin(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "fast.toml"
    text = Path(FIVE).read_text(encoding="utf-8")
    path.write_text(text.replace("baud = 1500000\n", "baud = 1500000\ncycle_ms = 1\n"), encoding="utf-8")
    err = cli.err("run", str(path), "--seconds", "1")
    assert err.startswith(f"dpstack: {path}:9: [bus]: cycle_ms = 1 is shorter than possible: ")
    assert err.endswith(
        "take cycle_ms = 1.16 or more, a larger every for slaves that need not be in each cycle, "
        "or a faster rate (3 Mbit/s would do)\n"
    )
