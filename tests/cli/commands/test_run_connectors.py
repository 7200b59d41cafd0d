"""`dpstack run` with a connector in its configuration: it begins before the bus, and ends after it, however the run
ends."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import probe_connector
import pytest
from cli_kit import Cli

PLANT = """[bus]
port = "{port}"
baud = 500000

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "21 11"
outputs = {{ lamp = "bool@0.1" }}

[probe]
"""
_PROGRAM = """
import sys
import probe_connector
from dpstack.cli.main import main
probe_connector.register()
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def probe() -> Iterator[None]:
    probe_connector.register()
    yield
    probe_connector.forget()


def plant(tmp_path: Path, keys: str = "", port: str = "virtual") -> str:
    path = tmp_path / "plant.toml"
    path.write_text(PLANT.format(port=port) + keys, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("fails", ["no", "take", "serve", "close"])
def test_a_run_goes_on_without_a_connector_that_fails(tmp_path: Path, cli: Cli, probe: None, fails: str) -> None:
    config = plant(tmp_path, f'fails = "{fails}"\nlog = "{tmp_path}/course"')
    out, err = cli("run", config, "--seconds", "0.8", "--json")
    *events, summary = [json.loads(line) for line in out.splitlines()]
    assert summary["slaves"]["8"]["state"] == "data_exchange"
    assert events[0]["event"] == "start"
    told = [event["text"] for event in events if event["event"] == "notice" and "fault" in event["text"]]
    assert len(told) == (fails in ("take", "serve"))
    assert err == ("dpstack: probe: ZeroDivisionError: close\n" if fails == "close" else "")
    begun, served, *last = (tmp_path / "course").read_text().splitlines()
    assert (begun, served, last[-1]) == ("open", "serve", "close")
    assert ("last: Died 8, Died None" in last) == (fails in ("no", "close"))


def test_a_connector_that_cannot_begin_is_one_line_before_the_port_is_opened(
    tmp_path: Path, cli: Cli, probe: None
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        err = cli.err("run", plant(tmp_path, f"port = {port}", "/dev/there-is-none"), code=1)
        assert err == f"dpstack: [probe] port {port}: Address already in use; give another one\n"
    err = cli.err("run", plant(tmp_path, 'allow_commands = ["valves.lmap"]'))
    assert err.endswith("fits no order of this plant; did you mean 'valves.lamp'?\n")
    assert err.count("\n") == 1


@pytest.mark.parametrize(("fails", "signals", "code"), [("no", 1, 0), ("end", 2, 130)])
def test_signals_end_a_run_and_its_connectors(tmp_path: Path, fails: str, signals: int, code: int) -> None:
    config = plant(tmp_path, f'fails = "{fails}"\nlog = "{tmp_path}/course"')
    kits = Path(probe_connector.__file__).parent
    command = [sys.executable, "-c", _PROGRAM, "run", config, "--json"]
    with subprocess.Popen(command, cwd=kits, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        for line in run.stdout:
            if "probe: born 8" in line:
                break
        for number in range(signals):
            if number:
                time.sleep(1.1)  # signals within a second are the same one
            run.send_signal(signal.SIGTERM)
        _, err = run.communicate(timeout=30)
    assert (run.returncode, err) == (code, "")
    course = (tmp_path / "course").read_text().splitlines()
    assert course[-1] == "close"
    assert "last: Died 8, Died None" in course


@pytest.mark.parametrize("more", ["", 'on_connector_loss = "keep"', "read_only = true"])
def test_the_plan_says_the_rule_if_a_connector_may_give_orders(
    tmp_path: Path, cli: Cli, probe: None, more: str
) -> None:
    path = tmp_path / "plant.toml"
    plant = f'[bus]\nport = "virtual"\nbaud = 500000\n{more}\n[probe]\n[metrics]\n'
    path.write_text(plant, encoding="utf-8")
    assert "on_connector_loss" not in cli("plan", str(path))[0] + cli("plan", str(path), "--json")[0]
    path.write_text(plant.replace("[probe]", '[probe]\nallow_commands = ["tank.*"]'), encoding="utf-8")
    out, found = cli("plan", str(path))[0], json.loads(cli("plan", str(path), "--json")[0])
    if "read_only" in more:
        assert "on_connector_loss" not in out + str(found)
        return
    rule = "keep" if more else "safe"
    assert found["on_connector_loss"] == rule
    note = "note: probe: when a connector ends by a fault or hangs, all that it has ordered"
    assert note in " ".join(out.split())
    assert f'(on_connector_loss = "{rule}")' in " ".join(out.split())
