"""The program as users start it: several processes on one segment, signals, a simulator that dies and comes back.

Assert what happens, never when: the figures belong to the benchmarks.
"""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from api_kit import FAN
from cli_kit import Cli
from plant_files import plant_file
from programs import Program, Starter, plant_of, wait_for_exchanges, wait_for_socket

from dpstack.cli.main import main


@pytest.fixture
def segment(tmp_path: Path, start: Starter) -> Path:
    directory = tmp_path / "bus"
    start.segment(directory)
    return directory


def plant(tmp_path: Path, port: object) -> str:
    return str(plant_of(tmp_path, port))


def exchanging(start: Starter, config: str, segment: Path, *options: str) -> tuple[Program, Program]:
    """A simulator at port 0 of ``segment``, and a run that exchanges data with its slaves."""
    sim = start("sim", config, "--port", str(segment / "0"))
    sim.wait_for("raw")
    run = start("run", config, "--json", *options)
    run.wait_for_slaves(3)
    return sim, run


@pytest.mark.parametrize("driver", ["asyncio", "process"])
def test_a_plant_on_a_segment(tmp_path: Path, start: Starter, segment: Path, driver: str) -> None:
    config = plant(tmp_path, segment / "1")
    sim = start.interpreter("sim", config, "--port", str(segment / "0"))
    sim.wait_for("raw")
    run = start.interpreter("run", config, "--json", "--outputs", "9=5A", "--driver", driver)
    run.wait_for('"mode":"operate"')
    run.wait_for_slaves(3)
    wait_for_exchanges(segment / "1", 51)
    assert run.end(signal.SIGTERM) == 0
    assert run.err == ""
    assert run.lines[0]["driver"] == driver
    summary = run.lines[-1]
    assert summary["event"] == "summary"
    assert summary["paced"] is False
    assert all(s["state"] == "data_exchange" for s in summary["slaves"].values())
    assert all(s["exchanges"] > 50 for s in summary["slaves"].values())
    assert summary["slaves"]["9"]["inputs"] == "5a"
    assert sim.end(signal.SIGTERM) == 0
    assert "Slaves" in sim.out
    assert sim.err == ""


def test_the_simulator_dies_and_comes_back(tmp_path: Path, start: Starter, segment: Path) -> None:
    config = plant(tmp_path, segment / "1")
    sim, run = exchanging(start, config, segment)
    sim.end(signal.SIGKILL)
    run.wait_for('"kind":"lost"', 3)
    start("sim", config, "--port", str(segment / "0")).wait_for("raw")
    run.wait_for('"state":"data_exchange"', 6)
    run.wait_for_slaves(3)
    assert run.end(signal.SIGINT) == 0
    assert all(s["state"] == "data_exchange" for s in run.lines[-1]["slaves"].values())


def test_a_pty_made_by_sim(tmp_path: Path, start: Starter) -> None:
    sim = start("sim", "--drive", "fuji-frenic", "--address", "4", "--telegram", "PPO3", "--port", "pty", "--json")
    sim.wait_for("}")
    first = sim.lines[0]
    assert set(first) == {"port"}
    config = plant_file(tmp_path, {**FAN, "ident": "ask"}, port="/dev/elsewhere", max_retry=7)
    run = start("run", str(config), "--port", first["port"], "--json")
    run.wait_for('"state":"data_exchange"')
    assert run.end(signal.SIGTERM) == 0
    assert run.lines[0]["port"] == first["port"]
    assert sim.end(signal.SIGINT) == 0
    told = sim.lines
    assert [e["state"] for e in told if e.get("event") == "slave"][:2] == ["wait_cfg", "data_exchange"]
    assert told[-1]["event"] == "summary"
    assert told[-1]["slaves"]["4"]["exchanges"] > 0


def test_the_end_leaves_safe_outputs(tmp_path: Path, start: Starter, segment: Path) -> None:
    config = plant(tmp_path, segment / "1")
    _, run = exchanging(start, config, segment)
    assert run.end(signal.SIGTERM) == 0
    told = run.lines
    assert [e["mode"] for e in told if e["event"] == "mode"] == ["operate", "clear", "offline"]
    assert told[-2]["event"] == "ring"
    assert told[-1]["event"] == "summary"


def test_the_bus_process_is_killed_and_run_says_what_that_means(
    tmp_path: Path, start: Starter, segment: Path, cli: Cli
) -> None:
    config = plant(tmp_path, segment / "1")
    _, run = exchanging(start, config, segment, "--driver", "process")
    wait_for_socket(segment / "1")

    def slaves() -> dict[str, Any]:
        found: dict[str, Any] = cli.json("ctl", str(segment / "1"), "status")["result"]["slaves"]
        return found

    while slaves()["3"]["drive"]["state"] == "offline":  # its first status comes a cycle after its data exchange
        assert run.process.poll() is None
    assert {slave["state"] for slave in slaves().values()} == {"data_exchange"}
    pid = run.process.pid
    (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    os.kill(int(child), signal.SIGKILL)
    assert run.end() == 1
    assert run.err.count("\n") == 1
    assert run.err.startswith(
        "dpstack: the bus process was killed by SIGKILL: nothing is sent any more. The slaves' wat"
    )
    assert start("run", config, "--driver", "process", "--seconds", "0.1").end() in (0, 1)  # the port is free


def test_the_port_vanishes(tmp_path: Path, start: Starter) -> None:
    directory = tmp_path / "bus"
    segment = start.interpreter("segment", "--stations", "2", "--dir", str(directory))
    segment.wait_for(str(directory / "1"))
    # a new segment may come sooner or later than the watchdogs run out: the outputs shall go on all the same
    config = str(plant_of(tmp_path, directory / "1", after_stall="resume"))
    _, run = exchanging(start, config, directory)
    segment.end(signal.SIGTERM)
    run.wait_for('"lost":true')
    start.segment(directory)
    run.wait_for('"lost":false')
    run.wait_for('"state":"data_exchange"', 6)
    run.wait_for_slaves(3)
    assert run.end(signal.SIGINT) == 0
    assert run.err == ""


def test_a_bus_without_slaves_ends_with_1(tmp_path: Path, start: Starter, segment: Path) -> None:
    run = start("run", plant(tmp_path, segment / "1"), "--seconds", "1", "--json")
    assert run.end() == 1
    errors = run.err.splitlines()
    assert len(errors) == 3
    assert errors[0].startswith("dpstack: slave 3 (hoist) is not in data exchange: no answer from address 3")


def test_a_held_port_names_its_holder(tmp_path: Path, start: Starter, segment: Path) -> None:
    config = plant(tmp_path, segment / "1")
    sim = start("sim", config, "--port", str(segment / "1"))
    sim.wait_for("raw")
    run = start("run", config, "--seconds", "1")
    assert run.end() == 1
    assert "is held by" in run.err
    assert str(sim.process.pid) in run.err
    assert run.err.count("\n") == 1


def test_the_rate_of_a_running_bus_is_found_and_a_second_master_joins_at_it(tmp_path: Path, start: Starter) -> None:
    directory = tmp_path / "bus"
    start.segment(directory, 4, "--baud", "187500")
    config = plant_of(tmp_path, directory / "1", baud=187_500)
    sim = start("sim", str(config), "--port", str(directory / "0"), "--baud", "auto")
    run = start("run", str(config), "--json")
    run.wait_for_slaves(3)
    assert "at 187.5 kbit/s" in sim.out
    found = start("baud", "--port", str(directory / "2"), "--timeout", "20", "--json")
    assert found.end() == 0
    (line,) = found.lines
    assert line["baud"] == 187_500
    assert (line["confidence"], line["profibus"]) == ("checked", True)
    assert line["telegrams"] >= 2
    assert line["seconds"] > 0
    second = tmp_path / "second.toml"
    second.write_text(f'[bus]\nport = "{directory / "3"}"\nbaud = "auto"\naddress = 5\n', encoding="utf-8")
    joined = start("run", str(second), "--json", "--seconds", "1")
    assert joined.end(limit=60) == 0, joined.err
    assert joined.lines[0]["baud"] == 187_500
    assert joined.lines[-1]["tokens"] > 0
    run.wait_for_slaves(3)
    assert run.end(signal.SIGINT) == 0
    assert run.err == ""


def test_slaves_follow_to_another_rate_without_a_restart(
    tmp_path: Path, start: Starter, segment: Path, cli: Cli
) -> None:
    """A master at 187.5 kbit/s, its end, another one at 500; what is searching says so, and is told what to do."""

    def ask(port: Path, *order: str) -> dict[str, Any]:
        answer: dict[str, Any] = cli.json("ctl", str(port), *order)
        return answer

    config = plant_of(tmp_path, segment / "1", each={"watchdog_ms": 500})
    sim = start("sim", str(config), "--port", str(segment / "0"), "--baud", "auto", "--json")
    listening = start("run", str(config), "--baud", "auto")
    listening.wait_for("searching for the baud rate on")
    wait_for_socket(segment / "1")
    assert ask(segment / "1", "status") == {"result": {"baud": None, "text": "searching for the baud rate"}}
    assert "the bus is not open" in cli.err("ctl", str(segment / "1"), "operate")
    assert listening.end(signal.SIGTERM) == 1
    assert listening.err == "dpstack: ended before the baud rate was found\n"
    wait_for_socket(segment / "0")
    status = ask(segment / "0", "status")["result"]
    assert (status["baud"], status["search"]) == (None, "baud_search")

    for turn, baud in enumerate((187_500, 500_000), 1):
        run = start("run", str(config), "--baud", str(baud), "--json")
        run.wait_for_slaves(3)
        assert ask(segment / "0", "status")["result"]["baud"] == baud
        assert ask(segment / "1", "status")["result"]["baud"] == baud
        assert run.end(signal.SIGTERM) == 0
        sim.wait_for('"state":"baud_search"', turn)
    assert sim.end(signal.SIGTERM) == 0
    found = [line["baud"] for line in sim.lines if line.get("event") == "baud" and line["state"] != "dp_mode"]
    assert [baud for before, baud in zip([None, *found], found, strict=False) if baud != before] == [
        187_500,
        None,
        500_000,
        None,
    ]
    assert sim.err == ""


def test_a_run_on_a_pty_of_its_own_is_found_by_either_name(
    tmp_path: Path, start: Starter, capsys: pytest.CaptureFixture[str], cli: Cli
) -> None:
    run = start("run", plant(tmp_path, "/dev/elsewhere"), "--port", "pty", "--json")
    run.wait_for('"mode":"operate"')
    path = run.lines[0]["port"]
    assert path.startswith("/dev/pts/")
    wait_for_socket(Path(path))
    for port in (path, "pty", f"pty:{run.process.pid}"):
        assert cli.out("ctl", port).startswith(f"run on {path} (pid {run.process.pid})")
    other = start("sim", "--drive", "fuji-frenic", "--address", "4", "--port", "pty", "--json")
    other.wait_for("}")
    wait_for_socket(Path(other.lines[0]["port"]))
    assert main(["ctl", "pty"]) == 0  # the first that came
    assert capsys.readouterr().out.startswith("run on ")
    assert run.end(signal.SIGTERM) == 1
    assert other.end(signal.SIGTERM) == 0
    assert other.err == ""


def test_nothing_to_be_found_on_a_silent_bus(start: Starter, segment: Path) -> None:
    told = start.interpreter("baud", "--port", str(segment / "0"), "--timeout", "0.3", "--json")
    words = start("baud", "--port", str(segment / "1"), "--timeout", "0.3")
    assert told.end() == words.end() == 1
    (line,) = told.lines
    assert (line["baud"], line["telegrams"], line["reason"]) == (None, 0, "silence")
    assert told.err == ""
    assert words.err.startswith(f"dpstack: {segment / '1'}: silence: no octet in 0.3 s; is a master running, ")
    assert words.err.count("\n") == 1
    slave = ("--drive", "demag-dedrive", "--address", "3")
    sim = start("sim", *slave, "--port", str(segment / "0"), "--baud", "auto", "--seconds", "0.3")
    assert sim.end() == 1
    assert re.search(rf"{segment / '0'}: the baud rate was not found: silence: no octet in [0-9.]+ s;", sim.err), (
        sim.err
    )


def test_a_reader_that_has_seen_enough_is_no_traceback(virtual_plant: str) -> None:
    """The bus is left in order, nothing is said of it."""
    run = [sys.executable, "-m", "dpstack.cli.main", "run", virtual_plant, "--json", "--seconds", "600"]
    with subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        while b'"data_exchange"' not in process.stdout.readline():
            pass
        process.stdout.close()
        err = process.stderr.read().decode()
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "raised" not in err


@pytest.mark.parametrize(
    ("redirected", "code", "line"),
    [
        (">&-", 0, ""),
        (">&- 2>&- <&-", 0, ""),
        (">/dev/full", 1, "dpstack: standard output cannot be written (No space left on device)"),
    ],
)
@pytest.mark.parametrize("command", ["run --rotations 20", "plan"])
def test_standard_output_that_takes_nothing(
    virtual_plant: str, command: str, redirected: str, code: int, line: str
) -> None:
    script = f'exec "{sys.executable}" -m dpstack.cli.main {command} "{virtual_plant}" {redirected}'
    ended = subprocess.run(["sh", "-c", script], stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert ended.returncode == code
    assert ended.stderr.startswith(line)
    assert "Traceback" not in ended.stderr


def test_a_terminal_that_is_closed_ends_in_order(tmp_path: Path, start: Starter, segment: Path) -> None:
    run = start("run", plant(tmp_path, segment / "1"))
    run.wait_for("operate")
    assert run.end(signal.SIGHUP) == 1
    assert "left the token ring: ordered" in run.out


@pytest.fixture
def virtual_plant(tmp_path: Path) -> str:
    return plant(tmp_path, "virtual")


def test_the_demo_on_a_terminal() -> None:
    """A live table, and the end as promised."""
    child, terminal = pty.fork()
    if child == 0:
        os.environ["TERM"] = "xterm"
        os.environ["COLUMNS"] = "100"
        os.execv(sys.executable, [sys.executable, "-m", "dpstack.cli.main", "demo"])
    shown = b""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        if select.select([terminal], [], [], 0.5)[0]:
            try:
                chunk = os.read(terminal, 65_536)
            except OSError:  # the child is gone
                break
            if not chunk:
                break
            shown += chunk
    _, status = os.waitpid(child, 0)
    os.close(terminal)
    text = re.sub(rb"\x1b\[[0-9;?]*[A-Za-z]", b"", shown).decode()
    assert os.waitstatus_to_exitcode(status) == 0, text[-2000:]
    assert "the end" in text
    assert "running" in text
    assert "planned 6.472 ms" in text
    assert "parameter 412 (local/remote) is 44" in text
    assert "|███" in text
    assert "███|" in text
