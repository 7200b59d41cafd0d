"""The live screen of ``dpstack run`` on a terminal (tmux) under a shell with job control; slaves of octets alone."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
from far_ends import HANG_S, eventually
from plant_files import plant_file
from process_kit import octet_slaves
from support_responder import Responder

from tests.strangers.stranger_kit import program

pytestmark = pytest.mark.strangers

#: the name of a slave that tries everything
NAME: Final = "[red]tank[/] <b> 🚀日本"
TANK: Final[dict[str, object]] = {
    "name": "tank",
    "address": 4,
    "ident": 0x1234,
    "config": "21 11",
    "watchdog_ms": 5000,
    "safe": "A5 5A",
    "inputs": {"level": {"at": "i16@0", "unit": "bar"}},
}
BUS: Final[dict[str, Any]] = {"baud": 1_500_000, "gap": 0, "max_retry": 15}
SPEC: Final = "4:1234:2111:2:2,watchdog=1"
OUT: Final = bytes.fromhex("1122")
SAFE: Final = bytes.fromhex("A55A")
DPSTACK: Final = shlex.join([sys.executable, "-m", "dpstack.cli.main"])


class Terminal:
    """A terminal of tmux in which bash runs."""

    def __init__(self, folder: Path, width: int = 100, height: int = 30) -> None:
        self._socket = folder / "tmux"
        self.tmux("-f", "/dev/null", "new-session", "-d", "-x", str(width), "-y", str(height), "bash --norc -i")
        self.type("PS1='done:$? '; unset HISTFILE; stty -g > before")
        self.folder = folder

    def tmux(self, *arguments: str) -> str:
        done = subprocess.run(
            [program("tmux"), "-S", str(self._socket), *arguments],
            capture_output=True, text=True, timeout=HANG_S, check=True, cwd=self._socket.parent,
        )  # fmt: skip
        return done.stdout

    def type(self, line: str) -> None:
        self.keys("-l", line)
        self.keys("Enter")

    def keys(self, *names: str) -> None:
        self.tmux("send-keys", *names)

    def text(self) -> str:
        return self.tmux("capture-pane", "-p")

    def history(self) -> str:
        return self.tmux("capture-pane", "-p", "-J", "-S", "-")

    def value(self, name: str) -> str:
        return self.tmux("display-message", "-p", f"#{{{name}}}").strip()

    def until(self, *wanted: str, text: Callable[[], str] | None = None) -> str:
        """Wait until all of ``wanted`` are seen, and return the text."""
        seen = text or self.text
        end = time.monotonic() + HANG_S
        while not all(one in (found := seen()) for one in wanted):
            assert time.monotonic() < end, f"not seen: {wanted} in:\n{found}"
            time.sleep(0.05)
        return found

    def is_as_before(self) -> None:
        """The terminal is as it was before the run: modes, normal screen, cursor, no mouse."""
        assert self.value("alternate_on") == "0"
        assert self.value("cursor_flag") == "1"
        assert self.value("mouse_any_flag") == "0"
        self.type("stty -g > after; echo com''pared")
        self.until("compared")
        assert (self.folder / "after").read_text() == (self.folder / "before").read_text()

    def shell(self) -> int:
        return int(self.value("pane_pid"))

    def kill(self) -> None:
        with contextlib.suppress(subprocess.CalledProcessError):
            self.tmux("kill-server")


@pytest.fixture
def terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("LC_ALL", "C.UTF-8")
    found = Terminal(tmp_path)
    yield found
    found.kill()


@pytest.fixture
def wire() -> Iterator[tuple[str, Responder]]:
    with octet_slaves(SPEC) as (path, there):
        yield path, there


def recorded(there: Responder) -> list[tuple[bytes, bytes]]:
    """Outputs and last Global_Control of slave 4, from now on, without repetitions."""
    heard: list[tuple[bytes, bytes]] = []
    request = there.request

    def record(body: bytes) -> bytes:
        answer = request(body)
        slave = there.slaves[4]
        if not heard or heard[-1] != (slave.outputs, slave.control):
            heard.append((slave.outputs, slave.control))
        return answer

    there.request = record  # type: ignore[method-assign]
    return heard


def run(terminal: Terminal, wire: tuple[str, Responder], *options: str, before: str = "", **keys: Any) -> Path:
    """Type `dpstack run`, and wait until the slave has its outputs."""
    path, there = wire
    config = plant_file(terminal.folder, {**TANK, "name": NAME}, port=path, **BUS, **keys)
    terminal.type(f"{before}{DPSTACK} run {config} --outputs 4=1122 {' '.join(options)}")
    eventually(lambda: there.slaves[4].outputs == OUT, "outputs")
    return config


def children(pid: int) -> list[int]:
    return [int(one) for found in Path(f"/proc/{pid}/task").glob("*/children") for one in found.read_text().split()]


def command_of(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()


def run_pid(terminal: Terminal) -> int:
    (found,) = [pid for pid in children(terminal.shell()) if " run " in command_of(pid)]
    return found


def screen_pid(terminal: Terminal) -> int:
    (found,) = [pid for pid in children(run_pid(terminal)) if "dpstack.screen" in command_of(pid)]
    return found


def test_values_keys_resizing_and_the_end(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    text = terminal.until("Operate", "level 4386 bar", "out 1122", "master: operate", "rotation")
    assert "[red]tank[/] <b> 🚀日" in text
    assert terminal.value("alternate_on") == "1"
    terminal.keys("Enter")
    terminal.until("slave 4", "watchdog", "5000 ms", "safe outputs   a55a")
    terminal.keys("w")
    terminal.until("Set_Prm 88", "healthy")
    terminal.keys("Escape")
    terminal.until("last events")
    terminal.tmux("resize-window", "-x", "40", "-y", "12")
    terminal.until("level")
    assert all(len(line) <= 40 for line in terminal.text().splitlines())
    terminal.tmux("resize-window", "-x", "110", "-y", "34")
    terminal.until("telegrams", "space pause  q end")
    terminal.keys("q")
    terminal.until("End the run?")
    terminal.keys("n")
    terminal.until("last events")
    terminal.keys("C-c")
    found = terminal.until("rotations in", "done:0", text=terminal.history)
    assert "Process data" in found
    assert "Traceback" not in found
    there = wire[1]
    assert (there.slaves[4].outputs, there.slaves[4].control[:1]) == (bytes(2), b"\x02")
    terminal.is_as_before()


@pytest.mark.parametrize("driver", ["asyncio", "process"])
@pytest.mark.parametrize("options", [(), ("--plain",)], ids=["screen", "plain"])
def test_ctrl_z_is_safe_first_and_fg_stays_in_clear(
    terminal: Terminal, wire: tuple[str, Responder], driver: str, options: tuple[str, ...]
) -> None:
    path, there = wire
    run(terminal, wire, "--driver", driver, *options)
    if not options:
        terminal.until("level 4386 bar")
    heard = recorded(there)
    terminal.keys("C-z")
    if not options:
        terminal.until("Stop the run for a while?")
        terminal.keys("y")
    terminal.until("Stopped", "done:")
    assert heard[0][0] == OUT
    assert next(outputs for outputs, _ in heard if outputs != OUT) == SAFE
    assert (heard[-1][0], heard[-1][1][:1]) == (bytes(2), b"\x02")
    if not options:
        assert terminal.value("alternate_on") == "0"
    idle, count = there.idle, len(heard)
    eventually(lambda: there.idle > idle + 4, "nobody sends while it is stopped")
    assert len(heard) == count
    terminal.type("fg")
    goes_on(there)
    terminal.until("in Clear", text=terminal.history if options else None)
    assert OUT not in [outputs for outputs, _ in heard[count:]]
    done = subprocess.run(
        [sys.executable, "-m", "dpstack.cli.main", "ctl", path, "operate"],
        capture_output=True,
        timeout=HANG_S,
        check=True,
    )
    assert done.returncode == 0
    eventually(lambda: there.slaves[4].outputs == OUT, "outputs after the order")
    terminal.keys("C-c")
    terminal.until("rotations in", "done:0", text=terminal.history)
    terminal.is_as_before()


def goes_on(there: Responder) -> None:
    """Wait for more exchanges of data."""
    before = there.slaves[4].exchanges
    eventually(lambda: there.slaves[4].exchanges > before + 3, "data exchange goes on")


def test_fg_goes_on_with_outputs_where_the_configuration_says_so(
    terminal: Terminal, wire: tuple[str, Responder]
) -> None:
    there = wire[1]
    run(terminal, wire, after_stall="resume")
    terminal.until("level 4386 bar")
    terminal.keys("C-z")
    terminal.until("Stop the run for a while?")
    terminal.keys("y")
    terminal.until("Stopped", "done:")
    assert there.slaves[4].outputs == bytes(2)
    terminal.type("fg")
    eventually(lambda: there.slaves[4].outputs == OUT, "outputs")
    terminal.until("Operate", "level 4386 bar")
    terminal.keys("C-c")
    terminal.until("done:0", text=terminal.history)


def test_a_screen_that_is_killed_leaves_plain_lines(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    terminal.until("level 4386 bar")
    os.kill(screen_pid(terminal), signal.SIGKILL)
    terminal.until("the live screen was ended by SIGKILL: plain lines from here on")
    assert terminal.value("alternate_on") == "0"
    goes_on(wire[1])
    assert wire[1].slaves[4].outputs == OUT
    terminal.keys("C-c")
    terminal.until("rotations in", "done:0", text=terminal.history)
    terminal.is_as_before()


def test_a_run_that_is_killed_gives_the_terminal_back(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire, "--driver", "process")
    terminal.until("level 4386 bar")
    os.kill(run_pid(terminal), signal.SIGKILL)
    eventually(lambda: terminal.value("alternate_on") == "0", "the screen leaves the terminal")
    terminal.keys("Enter")  # the shell may have written its prompt while the screen was still there
    terminal.until("done:137")
    eventually(lambda: wire[1].slaves[4].outputs == bytes(2), "the bus process ends in order")
    terminal.is_as_before()


def test_a_screen_that_hangs_costs_the_bus_nothing(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    terminal.until("level 4386 bar")
    screen = screen_pid(terminal)
    os.kill(screen, signal.SIGSTOP)
    try:
        for _ in range(20):
            goes_on(wire[1])
            time.sleep(0.1)
        os.kill(run_pid(terminal), signal.SIGTERM)
        eventually(lambda: wire[1].slaves[4].outputs == bytes(2), "the ordered end")
        terminal.until("rotations in", "done:0", text=terminal.history)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(screen, signal.SIGCONT)
    terminal.is_as_before()


def test_a_lost_terminal_is_the_ordered_end(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    terminal.until("level 4386 bar")
    heard, pid = recorded(wire[1]), run_pid(terminal)
    terminal.kill()
    eventually(lambda: not Path(f"/proc/{pid}").exists(), "the run ends")
    assert SAFE in [outputs for outputs, _ in heard]
    assert (heard[-1][0], heard[-1][1][:1]) == (bytes(2), b"\x02")


@pytest.mark.parametrize("options", [(), ("--plain",)], ids=["screen", "plain"])
def test_a_lost_terminal_under_nohup_ends_nothing(
    terminal: Terminal, wire: tuple[str, Responder], options: tuple[str, ...]
) -> None:
    run(terminal, wire, *options, before="trap '' HUP; ")
    if not options:
        terminal.until("level 4386 bar")
    pid = run_pid(terminal)
    shell = terminal.shell()
    terminal.kill()
    eventually(lambda: not Path(f"/proc/{shell}").exists() or os.getpgid(shell) > 0, "the terminal is gone")
    try:
        for _ in range(15):
            goes_on(wire[1])
            assert wire[1].slaves[4].outputs == OUT
            time.sleep(0.1)
    finally:
        os.kill(pid, signal.SIGTERM)
    eventually(lambda: not Path(f"/proc/{pid}").exists(), "the run ends")
    assert wire[1].slaves[4].outputs == bytes(2)


def test_ctrl_c_again_and_again(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    terminal.until("level 4386 bar")
    for _ in range(6):
        terminal.keys("C-c")
    terminal.until("done:", text=terminal.history)
    assert wire[1].slaves[4].outputs == bytes(2)
    terminal.is_as_before()


@pytest.mark.parametrize(
    ("before", "behind"),
    [("TERM=dumb ", ""), ("", " | cat"), ("", " < /dev/null"), ("LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 ", "")],
)
def test_plain_lines(terminal: Terminal, wire: tuple[str, Responder], before: str, behind: str) -> None:
    run(terminal, wire, "--seconds", "2", behind, before=before)
    terminal.until("master: operate", "rotations in", text=terminal.history)
    assert "Operate " not in terminal.history()
    assert terminal.value("alternate_on") == "0"


def test_without_textual_one_line_says_how_to_get_it(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    hidden = terminal.folder / "sitecustomize.py"
    hidden.write_text(
        "import importlib.util as u, builtins\n"
        "old = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'textual' else old(name, *a)\n"
    )
    run(terminal, wire, "--seconds", "1", before=f"PYTHONPATH={terminal.folder} ")
    found = terminal.until("rotations in", text=terminal.history)
    assert found.count("pip install 'dpstack[screen]'") == 1


def test_no_color(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire, before="NO_COLOR=1 ")
    terminal.until("level 4386 bar")
    drawn = terminal.tmux("capture-pane", "-p", "-e")
    codes = {int(code) for found in re.findall(r"\x1b\[([\d;]*)m", drawn) for code in found.split(";") if code}
    assert not codes & {*range(30, 39), *range(40, 49), *range(90, 108)}  # 39 and 49 are the terminal's own
    terminal.keys("C-c")
    terminal.until("done:0", text=terminal.history)


def test_bg_goes_on_without_the_screen_and_fg_brings_it_back(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    terminal.until("level 4386 bar")
    terminal.keys("C-z")
    terminal.until("Stop the run for a while?")
    terminal.keys("y")
    terminal.until("Stopped", "done:")
    terminal.type("bg")
    goes_on(wire[1])
    terminal.type("echo still a sh''ell")
    terminal.until("still a shell")
    assert terminal.value("alternate_on") == "0"
    terminal.type("fg")
    terminal.until("in Clear: no outputs go out", "level")
    assert terminal.value("alternate_on") == "1"
    terminal.keys("C-c")
    terminal.until("rotations in", "done:0", text=terminal.history)
    terminal.is_as_before()


def test_a_group_that_is_stopped_from_outside_comes_back(terminal: Terminal, wire: tuple[str, Responder]) -> None:
    run(terminal, wire)
    terminal.until("level 4386 bar")
    os.killpg(os.getpgid(run_pid(terminal)), signal.SIGSTOP)
    terminal.until("Stopped")
    terminal.type("fg")
    terminal.until("Operate", "level 4386 bar")
    terminal.keys("Enter")
    terminal.until("slave 4")
    terminal.keys("C-c")
    terminal.until("rotations in", "done:0", text=terminal.history)
    terminal.is_as_before()


@pytest.mark.parametrize("driver", ["asyncio", "process"])
def test_a_program_that_no_shell_could_continue_goes_to_clear_and_on(
    tmp_path: Path, wire: tuple[str, Responder], driver: str
) -> None:
    path, there = wire
    config = plant_file(tmp_path, TANK, port=path, **BUS)
    program = subprocess.Popen(
        [sys.executable, "-m", "dpstack.cli.main", "run", config, "--outputs", "4=1122", "--driver", driver],
        start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        eventually(lambda: there.slaves[4].outputs == OUT, "outputs")
        os.killpg(program.pid, signal.SIGTSTP)
        eventually(lambda: there.slaves[4].outputs == bytes(2), "Clear")
        goes_on(there)
    finally:
        program.terminate()
        _, errors = program.communicate(timeout=HANG_S)
    assert "not stopped: no shell could continue this program" in errors
    assert program.returncode == 0
