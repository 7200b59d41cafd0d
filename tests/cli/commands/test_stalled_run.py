"""``run`` that is stopped and goes on: nothing old goes out, the lines and ``ctl`` tell it, and it ends with 1."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from cli_kit import Cli
from process_kit import SPEC, eventually, octet_slaves
from programs import Program, Starter
from support_responder import Responder

PLANT = """
[bus]
port = "{port}"
baud = 1500000
gap = 0
max_retry = 15
{keys}
[[slave]]
name = "valves"
address = 4
ident = 0x1234
config = "21 11"
watchdog_ms = 1000
"""
OUT = bytes.fromhex("1122")
#: A process may be stopped between its last look at the clock and the write. That telegram goes out after SIGCONT, to a
#: slave whose watchdog has run out: it must refuse it.
WATCHED = SPEC + ",watchdog=1"


def recording(there: Responder) -> list[bytes]:
    """The outputs that slave 4 accepts from now on."""
    heard: list[bytes] = []
    request = there.request

    def recorded(body: bytes) -> bytes:
        slave = there.slaves[4]
        before = slave.exchanges
        answer = request(body)
        if slave.exchanges != before:
            heard.append(slave.outputs)
        return answer

    there.request = recorded  # type: ignore[method-assign]
    return heard


def stop_and_go(run: Program, there: Responder) -> list[bytes]:
    """SIGSTOP for longer than the watchdog, SIGCONT; the outputs from then on."""
    run.process.send_signal(signal.SIGSTOP)
    idle = there.idle
    eventually(lambda: there.idle > idle + 1, "what was sent before is read")
    heard = recording(there)
    time.sleep(1.2)
    run.process.send_signal(signal.SIGCONT)
    return heard


def ctl(cli: Cli, *args: str) -> Any:
    return cli.json("ctl", *args)["result"]


@pytest.mark.parametrize("driver", ["asyncio", "process"])
def test_stopped_and_continued(tmp_path: Path, start: Starter, cli: Cli, driver: str) -> None:
    config = tmp_path / "plant.toml"
    with octet_slaves(WATCHED) as (path, there):
        config.write_text(PLANT.format(port=path, keys='after_stall = "safe"'), encoding="utf-8")
        run = start("run", str(config), "--outputs", "4=1122", "--json", "--driver", driver)
        eventually(lambda: there.slaves[4].outputs == OUT, "its outputs")
        if driver == "process":  # the whole group is stopped, as Ctrl-Z does
            child = int(Path(f"/proc/{run.process.pid}/task/{run.process.pid}/children").read_text().split()[0])
            heard = stop_group(run, child, there)
        else:
            heard = stop_and_go(run, there)
        run.wait_for('"event":"stalled"')
        run.wait_for('"mode":"clear"')
        (stalled,) = [line for line in run.lines if line.get("event") == "stalled"]
        assert (stalled["slaves"], stalled["blocked"]) == ([4], "program")
        assert stalled["gap_ms"] > 1000
        eventually(lambda: len(heard) > 20, "data exchange in Clear")
        assert set(heard) == {bytes(2)}
        assert there.slaves[4].expired
        status = ctl(cli, path, "status")
        assert status["mode"] == "clear"
        assert "slave 4 (valves) was not asked for" in status["clear"]["because"]
        ctl(cli, path, "operate")
        eventually(lambda: there.slaves[4].outputs == OUT, "its outputs after the order")
        assert "clear" not in ctl(cli, path, "status")
        assert run.end(signal.SIGTERM) == 1


def stop_group(run: Program, child: int, there: Responder) -> list[bytes]:
    os.kill(child, signal.SIGSTOP)
    try:
        return stop_and_go(run, there)
    finally:
        os.kill(child, signal.SIGCONT)


def test_for_people_and_the_end_in_clear(tmp_path: Path, start: Starter) -> None:
    config = tmp_path / "plant.toml"
    with octet_slaves(SPEC) as (path, there):
        config.write_text(PLANT.format(port=path, keys='after_stall = "safe"'), encoding="utf-8")
        run = start("run", str(config), "--outputs", "4=1122")
        eventually(lambda: there.slaves[4].outputs == OUT, "its outputs")
        stop_and_go(run, there)
        run.wait_for("master: stall: outputs become safe: slave 4 (valves) was not asked for")
        run.wait_for("master: clear")
        assert run.end(signal.SIGTERM) == 1
        assert "in Clear since" in run.err
        assert "because of a stall: slave 4 (valves) was not asked for" in " ".join(run.err.split())


@pytest.mark.parametrize("command", [("run",), ("drive", "valves", "status")])
def test_the_application_watchdog_is_refused(tmp_path: Path, cli: Cli, command: tuple[str, ...]) -> None:
    config = tmp_path / "plant.toml"
    text = PLANT.format(port="virtual", keys="application_watchdog_ms = 500").replace(
        'ident = 0x1234\nconfig = "21 11"', 'drive = "demag-dedrive"'
    )
    config.write_text(text, encoding="utf-8")
    name, *rest = command
    error = cli.err(name, str(config), *rest)
    assert f"{config}:7: [bus]: application_watchdog_ms is for a program that calls bus.alive()" in error
    assert f"which `dpstack {name}` does not; leave it out of this file" in error
