"""``dpstack fleet`` at mosquitto with three gateways: what it shows of their ends, and that it publishes nothing."""

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
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from programs import Program, Starter

from tests.strangers.mosquitto_kit import LONGEST_S, Mosquitto, wait_for

pytestmark = pytest.mark.strangers

CONFIG = """
[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "hoist"
address = 3
drive = "fuji-frenic"
ident = 0x1234

[[slave]]
name = "fan"
address = 4
drive = "fuji-frenic"
ident = 0x1234

[mqtt]
url = "mqtt://127.0.0.1:{port}"
group = "hall 3"
node = "{node}"
format = "{format}"
keepalive_s = 2
"""
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

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        end = time.monotonic() + LONGEST_S
        while self.process.poll() is None:
            assert self.text is not None
            assert time.monotonic() < end
            time.sleep(0.02)
        return self.process.returncode

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
        config = tmp_path / f"{node}.toml"
        config.write_text(CONFIG.format(port=broker.port, node=node, format=form))
        (tmp_path / node).mkdir(mode=0o700)
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / node))  # each one is called "virtual"
        gateways[node] = starter("run", str(config), "--json")
    screen = Screen("--mqtt", url)
    try:
        for node in NODES:
            wait_for(lambda: state_of(fleet, node) == ("ok", []))  # noqa: B023
        shown(screen, lambda text: "3 segments: 3 ok" in text)

        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "north"))
        ctl = [sys.executable, "-m", "dpstack.cli.main", "ctl", "virtual", "power-off", "4"]
        subprocess.run(ctl, check=True, timeout=LONGEST_S, capture_output=True)
        wait_for(lambda: state_of(fleet, "north") == ("lost_slaves", ["fan"]))
        shown(screen, lambda text: "1 lost slaves" in text and "fan (4, offline)" in text)

        gateways["south"].end(signal.SIGKILL)
        wait_for(lambda: state_of(fleet, "south")[0] == "dead")
        gateways["west"].end(signal.SIGTERM)
        wait_for(lambda: state_of(fleet, "west")[0] == "ended")
        shown(screen, lambda text: "3 segments: 1 dead, 1 lost slaves, 1 ended" in text)

        gateways["north"].process.send_signal(signal.SIGSTOP)
        wait_for(lambda: state_of(fleet, "north")[0] == "dead")  # by its keep alive
        gateways["north"].process.send_signal(signal.SIGCONT)
        wait_for(lambda: state_of(fleet, "north")[0] == "lost_slaves")

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


def shown(screen: Screen, right: Callable[[str], bool]) -> None:
    end = time.monotonic() + LONGEST_S
    while not right(screen.last()):
        assert time.monotonic() < end, screen.last()
        time.sleep(0.05)


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
        assert asking.end(signal.SIGINT) == 0
        wait_for(lambda: "'spBv1.0/hall 3/NCMD/north'" in broker.log.read_text(errors="replace"))
    finally:
        broker.kill()
