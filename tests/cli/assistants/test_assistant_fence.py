"""The fence of `dpstack mcp` in a process of its own: what Python code in it can still open, start and connect to."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

#: tries one thing after the other and prints what became of it
PROGRAM = r"""
import json, os, pathlib, socket, subprocess, sys
from pathlib import Path
from dpstack.cli.assistants.fence import Fence
from dpstack.cli.assistants.folders import Folders

top = Path(sys.argv[1])
mine, peer = socket.socketpair()
Fence(Folders([top / "in"]), str(top / "port"), str(top / "sockets")).install()

def bound():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))

def connected(address):
    with socket.socket(socket.AF_UNIX if isinstance(address, str) else socket.AF_INET) as one:
        one.settimeout(0.2)
        one.connect(address)

tries = {
    "read within": lambda: (top / "in/a.toml").read_text(),
    "list within": lambda: os.listdir(top / "in"),
    "read outside": lambda: (top / "out/secret.toml").read_text(),
    "read over a link": lambda: (top / "in/link.toml").read_text(),
    "read over ..": lambda: open(f"{top}/in/../out/secret.toml").read(),
    "read relative": lambda: (os.chdir(top / "out"), open("secret.toml").read()),
    "os.open outside": lambda: os.open(top / "out/secret.toml", os.O_RDONLY),
    "read hidden": lambda: (top / "in/.env").read_text(),
    "read environ": lambda: open("/proc/self/environ").read(),
    "list outside": lambda: os.listdir(top / "out"),
    "scan outside": lambda: list(os.scandir(top / "out")),
    "write within": lambda: (top / "in/new.toml").write_text("x"),
    "append within": lambda: open(top / "in/a.toml", "a"),
    "remove within": lambda: (top / "in/a.toml").unlink(),
    "rename within": lambda: (top / "in/a.toml").rename(top / "in/b.toml"),
    "make a folder": lambda: (top / "in/new").mkdir(),
    "the port for reading": lambda: os.close(os.open(top / "port", os.O_RDONLY)),
    "the port for sending": lambda: os.open(top / "port", os.O_RDWR),
    "another port": lambda: os.open(top / "port2", os.O_RDONLY),
    "a program": lambda: subprocess.run(["true"]),
    "a shell": lambda: os.system("true"),
    "fork": os.fork,
    "connect": lambda: connected(("127.0.0.1", 9)),
    "name of a computer": lambda: socket.getaddrinfo("localhost", 80),
    "bind": bound,
    "control socket": lambda: connected(str(top / "sockets/run.sock")),
    "another socket": lambda: connected(str(top / "out/other.sock")),
    "a module of Python": lambda: __import__("wave"),
    "a module of dpstack": lambda: __import__("dpstack.sim.world"),
}
found = {}
for name, attempt in tries.items():
    try:
        attempt()
        found[name] = "done"
    except OSError as error:
        found[name] = type(error).__name__
print(json.dumps(found))
"""
#: the only ones that are let through; nobody listens at the control socket
THROUGH = {
    "read within": "done",
    "list within": "done",
    "the port for reading": "done",
    "control socket": "FileNotFoundError",
    "a module of Python": "done",
    "a module of dpstack": "done",
}


def test_only_reading_within_the_folders_the_port_and_control_sockets_are_left(tmp_path: Path) -> None:
    for folder in ("in", "out", "sockets"):
        (tmp_path / folder).mkdir()
    for name in ("in/a.toml", "in/.env", "out/secret.toml", "port", "port2"):
        (tmp_path / name).write_text("x")
    (tmp_path / "in/link.toml").symlink_to(tmp_path / "out/secret.toml")
    words = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    run = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    found = json.loads(run.stdout)
    assert len(found) == 29
    assert {name: what for name, what in found.items() if what != "PermissionError"} == THROUGH
    assert sorted(os.listdir(tmp_path / "in")) == [".env", "a.toml", "link.toml"]
    assert (tmp_path / "in/a.toml").read_text() == "x"


@pytest.mark.parametrize("url", ["socket://gateway:4001", "rfc2217://gateway:4001"])
def test_a_port_in_the_network_may_be_connected_to(url: str, tmp_path: Path) -> None:
    from dpstack.cli.assistants.fence import Fence
    from dpstack.cli.assistants.folders import Folders

    fence = Fence(Folders([tmp_path]), url, str(tmp_path))
    fence._look("socket.connect", (None, ("192.0.2.1", 4001)))
    with pytest.raises(PermissionError, match="running programs of dpstack only"):
        fence._look("socket.connect", (None, ("192.0.2.1", 80)))
    with pytest.raises(PermissionError, match="only reads"):
        fence._look("socket.bind", (None, ("0.0.0.0", 1)))
