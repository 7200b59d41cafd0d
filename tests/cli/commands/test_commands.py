"""The commands in this process: what they print, their exit codes, and one clear line for wrong use."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, cast

import pytest
from api_kit import RAW
from cli_kit import Cli
from plant_files import plant_file, plant_text

import dpstack
from dpstack.api.bus.bus import Bus
from dpstack.api.config.config import make_config
from dpstack.api.slave_side.simulation import Simulation
from dpstack.cli.commands import sim

HOIST = {"name": "hoist", "address": 3, "drive": "demag-dedrive", "watchdog_ms": 200}
PLANT = plant_text(HOIST, RAW, gap=0)


@pytest.fixture
def plant(tmp_path: Path) -> str:
    return str(plant_file(tmp_path, HOIST, RAW, gap=0))


# --- run ------------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("virtual_time")
def test_run_with_a_fixed_cycle_says_how_it_was_kept(tmp_path: Path, cli: Cli) -> None:
    config = plant_file(tmp_path, HOIST, RAW, gap=0, cycle_ms=10)
    out = cli.out("run", str(config), "--rotations", "20")
    assert " cycles of 10 ms, late in us: min 0, p50 0, p99 0, p999 0, max 0\nno deadline was missed\n" in out
    plant_file(tmp_path, HOIST, RAW, gap=0, cycle_ms=3)
    summary = cli.json("run", str(config), "--rotations", "20")
    assert (summary["cycle_us"], summary["missed"]) == (3000, sum(summary["missed_by"].values()))


@pytest.mark.usefixtures("virtual_time")
def test_run_json_is_the_documented_one(plant: str, cli: Cli) -> None:
    out, err = cli("run", plant, "--rotations", "50", "--json", "--outputs", "9=5A")
    assert err == ""
    told = [json.loads(line) for line in out.splitlines()]
    start, summary = told[0], told[-1]
    assert set(start) == {"event", "time", "port", "baud", "driver"}
    assert (start["event"], start["port"], start["baud"], start["driver"]) == ("start", "virtual", 500_000, "virtual")
    assert start["time"].endswith("Z")
    states = [e["state"] for e in told if e["event"] == "slave" and e["address"] == 3]
    assert states == ["set_prm", "chk_cfg", "wait_ready", "data_exchange"]
    diagnosis = next(e for e in told if e["event"] == "diagnosis" and e["address"] == 3)
    assert "station_not_ready" in diagnosis["flags"]
    assert diagnosis["texts"] == []
    assert all(isinstance(e["t"], float) for e in told[1:])
    assert summary["event"] == "summary"
    assert summary["paced"] is True
    assert summary["rotations"] == 50
    for name in ("rotation_us", "token_us"):
        assert list(summary[name]) == ["min", "p50", "p99", "p999", "max"]
    assert summary["rotation_us"]["p50"] == pytest.approx(1696, rel=0.004)  # 848 bits, by hand; buckets of 0.4 %
    raw = summary["slaves"]["9"]
    assert raw["state"] == "data_exchange"
    assert (raw["inputs"], raw["outputs"]) == ("5a", "5a")
    assert (raw["retries"], raw["timeouts"]) == (0, 0)
    assert raw["exchanges"] >= 50


@pytest.mark.usefixtures("virtual_time")
def test_run_in_clear_sends_zeros(plant: str, cli: Cli) -> None:
    summary = cli.json("run", plant, "--rotations", "20", "--outputs", "9=5A", "--clear")
    assert summary["slaves"]["9"]["inputs"] == "00"


@pytest.mark.usefixtures("virtual_time")
@pytest.mark.parametrize(
    "words",
    [
        "PLANT --outputs 9=5A hoist=000000000000000000000000 --rotations 20",
        "--outputs raw=5A --outputs 3=000000000000000000000000 PLANT --rotations 20",
        "--outputs raw=00 --rotations 20 PLANT --outputs hoist=000000000000000000000000 raw=5A",
    ],
)
def test_outputs_of_several_slaves_by_address_or_name(plant: str, cli: Cli, words: str) -> None:
    args = [plant if word == "PLANT" else word for word in words.split()]
    told = cli.jsons("run", *args, "--address", "7")
    assert (told[-1]["slaves"]["9"]["outputs"], told[-1]["slaves"]["9"]["inputs"]) == ("5a", "5a")
    assert "station 7 claimed the token on a silent bus" in {line.get("text") for line in told}


@pytest.mark.usefixtures("virtual_time")
def test_rotations_count_from_operate_on(plant: str, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy computer many rotations pass before the run orders Operate."""
    opened = Bus.open

    async def open_slowly(bus: Bus) -> None:
        await opened(bus)
        await bus.rotated(50)

    monkeypatch.setattr(Bus, "open", open_slowly)
    summary = cli.json("run", plant, "--outputs", "9=5A", "--rotations", "20")
    assert summary["slaves"]["9"]["inputs"] == "5a"
    assert summary["rotations"] == 70


def test_help_says_that_a_read_only_run_joins_the_ring(cli: Cli) -> None:
    words = " ".join(cli.out("run", "--help").split())
    assert "--read-only join the token ring as one more master, show who is there" in words
    assert "--address N another station address of the master" in words


@pytest.mark.usefixtures("virtual_time")
def test_run_for_people(plant: str, cli: Cli) -> None:
    out = cli.out("run", plant, "--seconds", "0.3")
    assert out.startswith("master 2 on virtual at 500 kbit/s\n")
    assert "slave 3 (hoist): data_exchange" in out
    assert "bus rotation time in us: min " in out
    assert "\nSlaves\naddress  name   state" in out
    assert "Named inputs" not in out
    assert "\nProcess data\naddress  name   inputs" in out


@pytest.mark.usefixtures("virtual_time")
def test_run_shows_named_values(plant: str, cli: Cli) -> None:
    named = 'inputs = { limit = "bool@0.3", raw = "bytes@0:1" }\noutputs = { flap = "bool@0.3" }\n'
    Path(plant).write_text(PLANT + named, encoding="utf-8")
    out = cli.out("run", plant, "--seconds", "0.3", "--outputs", "9=0A").splitlines()
    at = out.index("Named inputs and outputs")
    assert [line.split() for line in out[at + 1 : at + 5]] == [
        ["address", "name", "field", "value"],
        ["9", "raw", "limit", "True"],
        ["9", "raw", "raw", "0a"],
        ["9", "raw", "flap", "True"],
    ]
    slave = cli.json("run", plant, "--seconds", "0.3")["slaves"]["9"]
    assert slave["fields"] == {"limit": False, "raw": "00", "flap": False}


def test_version(cli: Cli) -> None:
    assert cli.out("--version") == f"dpstack {dpstack.__version__}\n"


def test_run_ends_with_1_when_a_slave_is_missing(plant: str, cli: Cli) -> None:
    """A new pty has no station at its other end."""
    err = cli.err("run", plant, "--port", "pty", "--seconds", "0.2", "--json", code=1).splitlines()
    assert err[0].startswith("dpstack: slave 3 (hoist) is not in data exchange: ")
    assert len(err) == 2


def test_plan_of_a_bus_whose_rate_is_found_by_listening(plant: str, tmp_path: Path, cli: Cli) -> None:
    plant_file(tmp_path, HOIST, RAW, gap=0, baud="auto")
    assert len(cli.jsons("plan", plant, "--baud", "all")[0]) == 11
    assert 'baud "auto" is found when the bus is opened; give the rate' in cli.err("plan", plant)


@pytest.mark.usefixtures("virtual_time")
def test_run_read_only_leaves_everybody_as_he_is(plant: str, cli: Cli) -> None:
    out, err = cli("run", plant, "--read-only", "--seconds", "1", "--json", code=1)
    assert err.splitlines() == [
        f"dpstack: slave {a} ({name}) is not in data exchange: it is in diagnosis"
        for a, name in ((3, "hoist"), (9, "raw"))
    ]
    told = [json.loads(line) for line in out.splitlines()]
    seen = {e["address"]: e for e in told if e["event"] == "station" and "state" in e}
    assert {a: (e["type"], e["state"], e["master"]) for a, e in seen.items()} == dict.fromkeys(
        (3, 9), ("slave", "wait_prm", None)
    )
    assert [e["mode"] for e in told if e["event"] == "mode"] == ["offline"]
    assert any(e["text"].startswith("bus: listened first: silence") for e in told if e["event"] == "notice")
    summary = told[-1]
    assert {s["exchanges"] for s in summary["slaves"].values()} == {0}
    assert summary["timeouts"] == 0


@pytest.mark.usefixtures("virtual_time")
def test_read_only_shows_people_no_process_data_since_none_is_exchanged(plant: str, cli: Cli) -> None:
    Path(plant).write_text(PLANT + 'inputs = { limit = "bool@0.0" }\n', encoding="utf-8")
    told = cli.out("run", plant, "--read-only", "--seconds", "0.5", code=1)
    assert "Slaves" in told
    assert not any(text in told for text in ("Process data", "Named inputs", "limit"))
    told = cli.out("run", plant, "--seconds", "0.5")
    assert all(text in told for text in ("Process data", "Named inputs", "limit"))


# --- wrong use ------------------------------------------------------------------------------------------------------

WRONG: list[tuple[list[str], int, str]] = [
    ([], 2, "dpstack: the following arguments are required: COMMAND; see dpstack --help"),
    (["scann"], 2, "dpstack: argument COMMAND: invalid choice: 'scann'"),
    (["run"], 2, "dpstack: run: no CONFIG; give the configuration file, for instance dpstack run plant.toml"),
    (["run", "nosuch.toml"], 2, "dpstack: nosuch.toml: there is no such file; "),
    (["run", "PLANT", "--port", "/dev/nosuch"], 1, "dpstack: /dev/nosuch: no such port; "),
    (["run", "PLANT", "--port", "/dev/null"], 1, "dpstack: /dev/null is no serial port but another device; "),
    (["run", "PLANT", "--port", "what://x"], 1, "dpstack: what://x: ports are /dev/..., socket://host:port, "),
    (["run", "PLANT", "--baud", "300"], 2, "dpstack run: argument --baud: 300 is no PROFIBUS rate, nearest is 9600;"),
    (["run", "PLANT", "--baud", "x"], 2, "dpstack run: argument --baud: 'x' is no baud rate in bit/s, for instance"),
    (["run", "PLANT", "--baud", "auto"], 2, 'dpstack: port "virtual": nobody else is on it who could be listened to'),
    (["plan", "PLANT", "--baud", "auto"], 2, "dpstack plan: argument --baud: 'auto' is no baud rate in bit/s, for "),
    (["baud"], 2, "dpstack baud: the following arguments are required: --port; see dpstack baud --help"),
    (["baud", "--port", "virtual"], 2, 'dpstack: port "virtual": nobody else is on it who could be listened to; '),
    (["baud", "--port", "/dev/null"], 1, "dpstack: /dev/null is no serial port but another device; "),
    (["run", "PLANT", "--seconds", "0"], 2, "dpstack run: argument --seconds: '0' is no number of seconds above 0"),
    (["run", "PLANT", "--rotations", "-1"], 2, "dpstack run: argument --rotations: '-1' is no whole number from 1"),
    (["run", "PLANT", "--outputs", "9"], 2, "dpstack: '9' is not SLAVE=HEX; write it as 9=00FF"),
    (["run", "PLANT", "--outputs", "9=5"], 2, "dpstack: '9=5': an odd number of digits; write it as 9=00FF"),
    (["run", "PLANT", "--outputs", "9=5A5A"], 2, "dpstack: outputs for slave 9 (raw): 2 octets given; it has 1 oct"),
    (["run", "PLANT", "--outputs", "7=5A"], 2, "dpstack: no slave '7' here; there are: 3 (hoist), 9 (raw)"),
    (["run", "PLANT", "--outputs", "9=00", "x=5A"], 2, "dpstack: no slave 'x' here; there are: 3 (hoist), 9 (raw)"),
    (["run", "--outputs", "9=00"], 2, "dpstack: run: no CONFIG; give the configuration file, for instance dpstack run"),
    (["run", "--seconds", "1"], 2, "dpstack: run: no CONFIG; give the configuration file, for instance dpstack run"),
    (["run", "PLANT", "--address", "3"], 2, "dpstack: PLANT:8: slave hoist has address 3, which is the master's own"),
    (["run", "PLANT", "--address", "126"], 2, "dpstack run: argument --address: '126' is no station address, 0..125"),
    (
        ["sim", "--drive", "keb-f5", "--address", "126", "--port", "pty"],
        2,
        "dpstack: slave keb-f5 has no Set_Slave_Add",
    ),
    (["sim", "--drive", "keb-f5", "--address", "127", "--port", "pty"], 2, "dpstack sim: argument --address: '127' is"),
    (["run", "PLANT", "--driver", "process"], 2, 'dpstack: PLANT:1: [bus]: driver = "process": a simulated bus lives'),
    (["run", "PLANT", "--read-only", "--outputs", "9=5A"], 2, "dpstack: --outputs on a read-only bus: nothing is writ"),
    (["scan"], 2, "dpstack scan: the following arguments are required: --port; see dpstack scan --help"),
    (
        ["scan", "--port", "pty", "--baud", "500000"],
        2,
        'dpstack: scan: nobody is on port "pty"; name the port of a bus',
    ),
    (["scan", "--port", "/dev/nosuch", "--baud", "500000"], 1, "dpstack: /dev/nosuch: no such port; "),
    (["scan", "--port", "x"], 1, "dpstack: x: no such port;"),
    (["sim", "PLANT"], 2, "dpstack sim: the following arguments are required: --port; see dpstack sim --help"),
    (["sim", "--port", "pty"], 2, "dpstack: sim: neither CONFIG nor --drive NAME with --address A; give one of them"),
    (["sim", "PLANT", "--drive", "x", "--port", "pty"], 2, "dpstack: sim: a CONFIG or --drive with --address, not bo"),
    (["sim", "PLANT", "--gsd", "x", "--port", "pty"], 2, "dpstack: sim: a CONFIG or --gsd with --address, not both"),
    (
        ["sim", "--gsd", "io-station", "--modules", "1", "9 DI", "--address", "8", "--port", "pty"],
        2,
        "dpstack: sim: slave io-station: there is no module '9 DI'; nearest are '8 DI', '16 DI',",
    ),
    (["sim", "PLANT", "--port", "virtual"], 2, 'dpstack: port "virtual" has no other end; take "pty" or a device'),
    (["sim", "PLANT", "--port", "/dev/nosuch"], 1, "dpstack: /dev/nosuch: no such port; "),
    (
        ["sim", "--drive", "fuji-frenik", "--address", "4", "--port", "pty"],
        2,
        "dpstack: sim: slave fuji-frenik: no drive is called 'fuji-frenik'; did you mean fuji-frenic?",
    ),
    (
        ["sim", "--drive", "fuji-frenic", "--address", "4", "--telegram", "PPO9", "--port", "pty"],
        2,
        "dpstack: sim: slave fuji-frenic: fuji-frenic has no telegram 'PPO9'; it has PPO1, PPO2, PPO3, PPO4",
    ),
    (["sim", "--drive", "x", "--address", "127", "--port", "pty"], 2, "dpstack sim: argument --address: '127' is no"),
    (["segment", "--stations", "1"], 2, "dpstack: 1 stations: a segment joins 2 to 64"),
    (["segment", "--error-rate", "2"], 2, "dpstack segment: argument --error-rate: '2' is no probability, 0 up to 1"),
    (["plan", "PLANT", "--baud", "7"], 2, "dpstack plan: argument --baud: 7 is no PROFIBUS rate, nearest is 9600;"),
    (["demo", "--baud", "7"], 2, "dpstack demo: argument --baud: 7 is no PROFIBUS rate, nearest is 9600; see dpstack"),
]


@pytest.mark.parametrize(("args", "code", "line"), WRONG, ids=[" ".join(args) or "nothing" for args, _, _ in WRONG])
def test_wrong_use_gets_one_clear_line(plant: str, cli: Cli, args: list[str], code: int, line: str) -> None:
    out, err = cli(*(plant if arg == "PLANT" else arg for arg in args), code=code)
    assert err.startswith(line.replace("PLANT", plant))
    assert err.count("\n") == 1
    assert out == ""


def test_a_bad_configuration_is_one_line_and_2(tmp_path: Path, cli: Cli) -> None:
    path = plant_file(tmp_path, HOIST, {**RAW, "address": 3}, gap=0)
    for command in ("run", "plan"):
        err = cli.err(command, str(path))
        assert err == (
            f"dpstack: {path}:14: slave hoist and slave raw both have address 3; give one of them another address\n"
        )


@pytest.mark.parametrize("command", ["demo", "run", "sim", "segment", "scan", "plan"])
def test_help_has_an_example(command: str, cli: Cli) -> None:
    assert f"example: dpstack {command}" in cli.out(command, "--help")


# --- plan -----------------------------------------------------------------------------------------------------------


def test_plan_json(plant: str, cli: Cli) -> None:
    (plan,) = cli.jsons("plan", plant)
    assert plan["baud"] == 500_000
    assert plan["rotation_us"]["min"] == 1696.0
    assert set(plan["rotation_us"]) == {"min", "typical", "max"}
    assert plan["parameters"]["t_sl"] == 200
    assert [s["address"] for s in plan["slaves"]] == [3, 9]
    assert plan["slaves"][0]["watchdog_ms"] == 200
    assert "F2062" in plan["slaves"][0]["on_loss"]
    assert plan["findings"] == []


def test_plan_of_all_rates(plant: str, cli: Cli) -> None:
    # at 9.6 kbit/s 200 ms are too short a watchdog, but the bus runs at 500 kbit/s
    (plans,) = cli.jsons("plan", plant, "--baud", "all")
    assert [p["baud"] for p in plans][:3] == [9600, 19_200, 31_250]
    assert len(plans) == 11
    assert any("its watchdog of 200 ms is shorter" in f for f in plans[0]["findings"])
    assert any("does not know 31.25 kbit/s" in f for f in plans[2]["findings"])
    assert plans[6]["findings"] == []


def test_plan_for_people(plant: str, cli: Cli) -> None:
    out = cli.out("plan", plant)
    assert "T_SL       200        400.0" in out
    assert "shortest  848        1.696 ms" in out
    assert "nothing is out of bounds" in out
    assert "500 kbit/s    1.696 ms" in cli.out("plan", plant, "--baud", "all")
    cli("plan", plant, "--baud", "9600", code=1)


# --- demo -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "baud", ["500000", "19200", *(pytest.param(quick, marks=pytest.mark.soak) for quick in ("1500000", "12000000"))]
)
def test_demo_fast(baud: str, cli: Cli) -> None:
    out, err = cli("demo", "--fast", "--json", "--baud", baud)
    assert err == ""
    told = [json.loads(line) for line in out.splitlines()]
    assert told[0]["event"] == "start"
    summary = told[-1]
    assert summary["event"] == "summary"
    assert summary["stories"] == {"ended": 5, "of": 5}
    assert summary["rotation_us"]["p50"] == pytest.approx(summary["planned_us"], rel=0.02)
    story = [e["text"] for e in told if e["event"] == "story" and e["name"] == "demag"]
    assert story[0] == "in data exchange"
    assert story[-1] == "the end"
    assert any("parameter 412 (local/remote) is 44" in text for text in story)
    assert all(s["state"] == "data_exchange" for s in summary["slaves"].values())


def test_demo_for_people_goes_on_as_long_as_asked(cli: Cli) -> None:
    out = cli.out("demo", "--fast", "--seconds", "6")
    assert "planned 6.472 ms, measured 6.4" in out
    assert "rotations in 6.0" in out


def test_demo_says_which_story_failed(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.api.slave.drive import Drive
    from dpstack.cli.commands import demo_stories
    from dpstack.errors import DriveError

    async def fails(drive: Drive, tell: demo_stories.Tell, trip: demo_stories.Trip) -> None:
        raise DriveError(drive.name, "it will not")

    monkeypatch.setitem(demo_stories.STORIES, "fuji-frenic", demo_stories.Story(fails, "PPO3"))
    out, err = cli("demo", "--fast", "--json", code=1)
    assert err == "dpstack: it will not\n"
    assert json.loads(out.splitlines()[-1])["stories"] == {"ended": 4, "of": 5}


async def test_a_simulated_slave_as_delivered_gets_an_address(tmp_path: Path) -> None:
    args: Any = argparse.Namespace(
        config=None, drive="demag-dedrive", gsd=None, modules=None, telegram=None, address=126, port="pty"
    )
    config = sim._config(args)
    async with Simulation(config, "pty", 500_000) as simulation:
        port = simulation.port_name
        async with dpstack.open_bus(port=port, baud=500_000, address=1) as bus:
            told = await bus.class2.set_address(126, 5)
        assert told.ident == 0x0696
        assert [*cast(dict[str, object], simulation.status()["slaves"])] == ["5"]
        simulation.power(5, False)
        simulation.power(5, True)
        assert [slave.address for slave in simulation.slaves] == [5]
        assert list(simulation.status()["slaves"]) == ["5"]  # type: ignore[call-overload]


def test_one_device_of_a_gsd_file_is_simulated(cli: Cli) -> None:
    args = ["--gsd", "io-station", "--modules", "1", "8 DO", "--address", "8", "--port", "pty", "--seconds", "0.05"]
    assert "    8  io-station  (io-station)\n" in cli.out("sim", *args)


async def test_the_summary_says_why_answers_were_too_late(capsys: pytest.CaptureFixture[str]) -> None:
    """The computer was busy, or another master talked meanwhile: either way the answer was not sent."""
    simulation = Simulation(make_config("pty", 500_000, 2, [RAW]), "pty", 500_000)
    sim.print_summary(simulation, json=False)
    assert "another master talked" not in capsys.readouterr().out
    simulation.slaves[0].station.stats.dropped = 3
    sim.print_summary(simulation, json=False)
    table, _, text = capsys.readouterr().out.partition("answers too late were not sent, ")
    assert table.rstrip().endswith("0                 3")
    assert text.startswith(
        "because another telegram was there already: this computer was busy for longer than the master waits, or "
        "another master talked at the same time"
    )
