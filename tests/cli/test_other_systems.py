"""Commands on systems without ``fcntl``, ``termios`` and the like: what needs none of them works, the rest refuses."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from api_kit import HOIST
from plant_files import plant_file

from dpstack.cli.main import _COMMANDS

#: hides modules (and, as on Windows, parts of others), then runs commands one after the other
PROGRAM = """
import contextlib, io, json, os, select, socket, sys

HIDDEN = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"}

class Hider:
    def find_spec(self, name, path=None, target=None):
        if name in HIDDEN:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hider())
for name in HIDDEN:
    sys.modules.pop(name, None)
if sys.argv[1] == "windows":
    for name in ("O_DIRECTORY", "O_NOFOLLOW", "O_CLOEXEC", "O_NONBLOCK", "O_NOCTTY", "O_PATH", "geteuid", "openpty"):
        delattr(os, name)
    pair, family = socket.socketpair, socket.AF_UNIX
    socket.socketpair = lambda: pair(family)  # has no other family here; there it is made of TCP
    del socket.AF_UNIX

from dpstack.cli.main import main

for argv in json.loads(sys.argv[2]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(argv)
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]))
"""

WORKS = [
    ["--help"],
    *([command, "--help"] for command in _COMMANDS),
    ["plan", "PLANT"],
    ["gsd", "show", "io-station", "--json"],
    ["gsd", "check", "demag-dedrive"],
    ["run", "PLANT", "--rotations", "5"],
    ["drive", "PLANT", "hoist", "status"],
]
#: and what their one line on standard error begins with
REFUSED = [
    (["segment"], "dpstack: a segment of ptys needs "),
    (["sim", "PLANT", "--port", "pty"], "dpstack: a pty needs "),
    (["run", "PLANT", "--port", "pty"], "dpstack: a pty needs "),
    (["ctl", "virtual", "status"], "dpstack: a control socket needs "),
    (["ports"], "dpstack: the list of serial adapters needs fcntl, "),
    (["run", "PLANT", "--port", "/dev/ttyS0", "--seconds", "0.1"], "dpstack: /dev/ttyS0 needs fcntl, "),
    (["baud", "--port", "/dev/ttyS0"], "dpstack: /dev/ttyS0 needs fcntl, "),
    (["run", "PLANT", "--port", "rfc2217://localhost:1"], "dpstack: rfc2217://localhost:1 needs fcntl, "),
]


@pytest.mark.parametrize("system", ["posix", pytest.param("windows", marks=pytest.mark.soak)])
def test_without_fcntl_and_its_kin(system: str, tmp_path: Path) -> None:
    plant = plant_file(tmp_path, HOIST)
    orders = [[str(plant) if arg == "PLANT" else arg for arg in argv] for argv in [*WORKS, *(a for a, _ in REFUSED)]]
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, system, json.dumps(orders)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines()]
    for argv, (code, out, err) in zip(WORKS, told, strict=False):
        assert code == 0, (argv, err)
        assert "Traceback" not in err
        assert out
    for (argv, begins), (code, out, err) in zip(REFUSED, told[len(WORKS) :], strict=True):
        assert code == 1, (argv, out, err)
        (line,) = [one for one in err.splitlines() if not one.startswith("dpstack: a control socket")] or [err.strip()]
        assert line.startswith(begins), argv
        assert "which Python does not have on this system" in line
