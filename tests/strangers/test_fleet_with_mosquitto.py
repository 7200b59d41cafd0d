"""``dpstack fleet`` at mosquitto with three gateways: what it shows of their ends, and that it publishes nothing.
``python -m bench fleet`` in small: every part gives its figures, and the host finds no breach."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from far_ends import eventually
from plant_files import plant_file
from programs import Program, Starter

from bench.plant import fleet
from tests.strangers.mosquitto_kit import LONGEST_S, Mosquitto
from tests.strangers.stranger_kit import program

pytestmark = pytest.mark.strangers

DRIVE: dict[str, object] = {"drive": "fuji-frenic", "ident": 0x1234}
SLAVES = ({"name": "hoist", "address": 3, **DRIVE}, {"name": "fan", "address": 4, **DRIVE})
#: by the format of each: the will of south is that of plain JSON
NODES = {"north": "sparkplug", "south": "json", "west": "sparkplug"}


class Screen:
    """``dpstack fleet`` on a terminal. ``text``: everything that it drew, without escape sequences."""

    def __init__(self, *words: str) -> None:
        self._fd, side = pty.openpty()
        fcntl.ioctl(side, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 120, 0, 0))
        environment = {**os.environ, "TERM": "xterm-256color"}
        for name in ("COLUMNS", "LINES", "NO_COLOR"):
            environment.pop(name, None)
        command = [sys.executable, "-m", "dpstack.cli.main", "fleet", *words]
        self.process = subprocess.Popen(
            command, stdin=side, stdout=side, stderr=side, env=environment, start_new_session=True
        )
        os.close(side)
        self._octets = b""

    @property
    def text(self) -> str:
        while select.select([self._fd], [], [], 0)[0]:
            try:
                got = os.read(self._fd, 65_536)
            except OSError:
                break
            if not got:
                break
            self._octets += got
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self._octets.decode("utf-8", "replace"))

    def last(self) -> str:
        """The last picture that it drew."""
        return re.split(r"(?=\d+ segments)", self.text)[-1]

    def shows(self, *texts: str) -> None:
        eventually(lambda: all(text in self.last() for text in texts), self.last)

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        eventually(lambda: self.text is not None and self.process.poll() is not None, "its end")
        return self.process.returncode or 0

    def close(self) -> None:
        self.process.kill()
        self.process.wait(LONGEST_S)
        os.close(self._fd)


@pytest.fixture
def starter(tmp_path: Path) -> Iterator[Starter]:
    (tmp_path / "out").mkdir()
    made = Starter(tmp_path / "out")
    yield made
    made.close()


def state_of(program: Program, node: str) -> tuple[str, list[Any]]:
    """The last state of a gateway in the JSON lines of ``dpstack fleet``, and its lost slaves."""
    lines = [line for line in program.lines if line["event"] == "segment" and line["node"] == node]
    return (lines[-1]["state"], [one["name"] for one in lines[-1]["lost"]]) if lines else ("", [])


def test_three_gateways(tmp_path: Path, broker: Mosquitto, starter: Starter, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    url = f"mqtt://127.0.0.1:{broker.port}"
    fleet = starter("fleet", "--mqtt", url, "--json")
    fleet.wait_for('"connected":true')
    gateways: dict[str, Program] = {}
    for node, form in NODES.items():
        mqtt = {"url": url, "group": "hall 3", "node": node, "format": form, "keepalive_s": 2}
        config = plant_file(tmp_path, *SLAVES, tables={"mqtt": mqtt}).rename(tmp_path / f"{node}.toml")
        (tmp_path / node).mkdir(mode=0o700)
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / node))  # each one is called "virtual"
        gateways[node] = starter("run", str(config), "--json")
    screen = Screen("--mqtt", url)
    try:
        for node in NODES:
            eventually(lambda: state_of(fleet, node) == ("ok", []), "the state")  # noqa: B023
        screen.shows("3 segments: 3 ok")

        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "north"))
        ctl = [sys.executable, "-m", "dpstack.cli.main", "ctl", "virtual", "power-off", "4"]
        subprocess.run(ctl, check=True, timeout=LONGEST_S, capture_output=True)
        eventually(lambda: state_of(fleet, "north") == ("lost_slaves", ["fan"]), "the state")
        screen.shows("1 lost slaves", "fan (4, offline)")

        gateways["south"].end(signal.SIGKILL)
        eventually(lambda: state_of(fleet, "south")[0] == "dead", "the state")
        gateways["west"].end(signal.SIGTERM)
        eventually(lambda: state_of(fleet, "west")[0] == "ended", "the state")
        screen.shows("3 segments: 1 dead, 1 lost slaves, 1 ended")

        gateways["north"].process.send_signal(signal.SIGSTOP)
        eventually(lambda: state_of(fleet, "north")[0] == "dead", "the state")  # by its keep alive
        gateways["north"].process.send_signal(signal.SIGCONT)
        eventually(lambda: state_of(fleet, "north")[0] == "lost_slaves", "the state")

        assert screen.end() == 1
        assert fleet.end(signal.SIGINT) == 1
        summary = fleet.lines[-1]
        assert summary["event"] == "summary"
        assert summary["states"] == {"dead": 1, "lost_slaves": 1, "ended": 1}
        assert (summary["broken"], summary["left_out"], summary["lost"]) == (0, 0, 0)
    finally:
        screen.close()
    log = broker.log.read_text(errors="replace")
    assert "Received PUBLISH from hall 3/north" in log
    assert "Received PUBLISH from dpstack-fleet" not in log
    assert (
        len(re.findall(r"Received PUBLISH from hall 3/north \(d0, q0, r1, m0, 'dpstack/hall 3/north/status'", log)) >= 3
    )


def test_a_wrong_password_and_a_rebirth(tmp_path: Path, starter: Starter) -> None:
    made = subprocess.run(
        ["mosquitto_passwd", "-b", "-c", str(tmp_path / "users"), "ops", "sesame"],
        check=True, timeout=LONGEST_S, capture_output=True,
    )  # fmt: skip
    assert made.returncode == 0
    broker = Mosquitto(tmp_path, f"password_file {tmp_path / 'users'}", anonymous=False)
    try:
        secret = tmp_path / "secret"
        secret.touch(mode=0o600)
        words = ["fleet", "--mqtt", f"mqtt://127.0.0.1:{broker.port}", "--user", "ops", "--password-file", str(secret)]
        secret.write_text("wrong\n")
        refused = starter(*words, "--seconds", "20")
        assert refused.process.wait(LONGEST_S) == 2
        assert "refuses user or password" in refused.err
        assert len(refused.err.splitlines()) == 1
        secret.write_text("sesame\n")
        asking = starter(*words, "--json", "--rebirth", "hall 3/north")
        asking.wait_for("asked for births: 1 gateway")
        assert asking.end(signal.SIGINT) == 1  # no segment is there
        eventually(
            lambda: "'spBv1.0/hall 3/NCMD/north'" in broker.log.read_text(errors="replace"), "a rebirth is asked for"
        )
    finally:
        broker.kill()


SMALL = (
    "--gateways 4 --buses 1 --slaves 2 --processes 2 --seconds 2 --losses 2 --restarts 1 --down 0.5 --recorded 8 "
    "--interval-ms 200"
)


def test_a_small_fleet_is_measured() -> None:
    program("mosquitto")
    report = fleet.run(SMALL.split())
    values = {figure.name: figure.value for figure in report.figures}
    assert {figure.name: figure.met for figure in report.figures if figure.met is False} == {}
    death = "DDEATH at the subscriber, "
    assert values[f"{death}from the loss of a slave's power: samples"] == 2
    assert values[f"{death}from the master's event: samples"] == 2
    # the master finds the loss first, then the subscriber hears of it
    assert values[f"{death}from the master's event: max"] < values[f"{death}from the loss of a slave's power: max"]
    assert values["broker back to births of a gateway: samples"] == 4
    assert values["NDEATH by the broker, from SIGKILL of the gateway: samples"] == 2
    assert values["messages"] > 4
    assert values["values of history that came after restarts of the broker"] > 0
    assert values["NBIRTH, the largest: metrics"] > values["DBIRTH, the largest: metrics"] > 4
    assert values["memory of a gateway in a process of many, all"] > 0
