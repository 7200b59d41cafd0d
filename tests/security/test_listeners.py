"""Listeners of every command: looked for in /proc while it runs, and in the interpreter's audit events from its start.

The commands run as programs of their own; their children are looked at too.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from api_kit import HOIST, RAW
from plant_files import plant_file

#: reports each socket of an Internet family, and each bind
_HOOK = """
import os, sys
def hook(name, args):
    if name == "socket.bind" or (name == "socket.__new__" and args[1] in (2, 10)):
        with open(os.environ["AUDIT_FILE"], "a") as file:
            file.write(f"{name} {args[1:]}\\n")
sys.addaudithook(hook)
"""
SLAVES = ({**HOIST, "name": "a"}, {**RAW, "name": "b", "address": 8})
#: audit events of a connection to a broker: its own end is bound to no address and no port before it connects
CLIENT = {"socket.__new__ (2, 1, 6)", "socket.bind (('', 0),)"}
#: seconds for which a command that does not end by itself is watched after it has begun
_WATCHED_S = 2.0
_START_S = 60.0


class Watched:
    """A command with its listeners as /proc has them."""

    def __init__(self, folder: Path, *words: str) -> None:
        hooks = folder / "hooks"
        hooks.mkdir(exist_ok=True)
        hooks.joinpath("sitecustomize.py").write_text(_HOOK)
        self.audit = folder / "audit"
        self.audit.write_text("")
        self._runtime = folder / "run"
        self._runtime.mkdir(mode=0o700, exist_ok=True)
        environment = {
            **os.environ,
            "PYTHONPATH": str(hooks),
            "AUDIT_FILE": str(self.audit),
            "XDG_RUNTIME_DIR": str(self._runtime),
            "TERM": "dumb",
        }
        self.output = folder / "output"
        with self.output.open("wb") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", "dpstack.cli.main", *words],
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self.listening: set[str] = set()

    def watch(self, begins: str = "") -> None:
        """Until its end, or for a while after its first output and a listener that begins like ``begins``."""
        until = time.monotonic() + _START_S
        begun = False
        while self.process.poll() is None and time.monotonic() < until:
            self.listening |= set(self._listeners())
            there = not begins or any(one.startswith(begins) for one in self.listening)
            if not begun and there and self.output.stat().st_size:
                begun, until = True, time.monotonic() + _WATCHED_S
            time.sleep(0.02)
        self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def _listeners(self) -> Iterator[str]:
        inodes = {inode for pid in _tree(self.process.pid) for inode in _sockets(pid)}
        for name in ("tcp", "tcp6", "udp", "udp6", "raw", "raw6"):
            with contextlib.suppress(FileNotFoundError):
                for line in Path("/proc/net", name).read_text().splitlines()[1:]:
                    fields = line.split()
                    if fields[9] in inodes and (fields[3] == "0A" or not name.startswith("tcp")):
                        yield f"{name} {fields[1]}"
        for line in Path("/proc/net/unix").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[6] in inodes and int(fields[3], 16) & 0x10000:
                yield "unix " + (fields[7] if len(fields) > 7 else "")


def _tree(pid: int) -> set[int]:
    found = {pid}
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in (task / "children").read_text().split():
                found |= _tree(int(child))
    return found


def _sockets(pid: int) -> Iterator[str]:
    with contextlib.suppress(OSError):
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            with contextlib.suppress(OSError):
                link = os.readlink(entry)
                if link.startswith("socket:["):
                    yield link[8:-1]


@pytest.fixture
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="l") as path:
        place = Path(path)
        master, slave = os.openpty()
        plant_file(place, *SLAVES).rename(place / "virtual.toml")
        plant_file(place, *SLAVES, port=os.ttyname(slave)).rename(place / "pty.toml")
        place.joinpath("port").symlink_to(os.ttyname(slave))
        try:
            yield place
        finally:
            os.close(slave)
            os.close(master)


@pytest.mark.soak
@pytest.mark.parametrize(
    "command",
    [
        "run virtual.toml",
        "run virtual.toml --read-only",
        "run pty.toml --clear",
        "sim virtual.toml --port pty",
        "segment",
        "demo",
        "drive virtual.toml a status",
        "acyclic virtual.toml 8 im",
        "ctl virtual status",
        "scan --port port --baud 500000",
        "diag 3 --port port --baud 500000",
        "why virtual.toml a",
        "plan virtual.toml",
        "baud --port port",
        "capture --port port --baud 500000 --write c.pcapng",
        "monitor --port port --baud 500000",
        "decode 10 03 02 49 4E 16",
        "plot none.csv --json",
        "fleet --mqtt mqtt://127.0.0.1:9 --seconds 2 --json",
        "wireshark where",
        "ports",
        "doctor",
        "gsd show virtual.toml",
    ],
)
def test_no_command_listens_on_a_network(folder: Path, command: str) -> None:
    watched = Watched(folder, *command.split())
    watched.watch()
    assert watched.output.stat().st_size, "it did nothing"
    assert not {one for one in watched.listening if not one.startswith("unix ")}
    unix = {Path(one.removeprefix("unix ")).name for one in watched.listening}
    assert all(name.endswith(".sock") for name in unix)
    events = set(watched.audit.read_text().splitlines())
    if command.startswith("fleet"):
        events -= CLIENT
    assert not [one for one in events if not one.startswith("socket.bind (") or "/proc/self/fd/" not in one]
    assert bool(unix) is command.startswith(("run", "sim", "segment"))


@pytest.mark.soak
@pytest.mark.parametrize(
    ("command", "address"),
    [
        ("web virtual.toml --listen 127.0.0.1:0", "0100007F"),
        ("web virtual.toml --control --listen [::1]:0", "0" * 24 + "01000000"),
        ("demo --web --listen 127.0.0.1:0", "0100007F"),
    ],
)
def test_the_page_listens_on_this_computer_alone(folder: Path, command: str, address: str) -> None:
    watched = Watched(folder, *command.split())
    watched.watch("tcp")
    networks = {one for one in watched.listening if not one.startswith("unix ")}
    assert {one.split()[1].partition(":")[0] for one in networks} == {address}
    assert len(networks) == 1
