"""Helpers of the jobs that run in the machine: plug adapters in, read what the kernel sent to them, run dpstack."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import glob
import json
import os
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from plant_files import plant_file

HERE = Path(__file__).resolve().parent
DPSTACK = [sys.executable, "-P", "-m", "dpstack"]
#: a user of the machine who is a member of dialout, and one who is not
USER, DIALOUT = 1000, 20
_NEW_TTY_S = 10.0
_SETTLE_S = 0.05


SLAVES: list[dict[str, object]] = [
    {"name": "a", "address": 8, "ident": 0x1234, "config": "20 10"},
    {"name": "b", "address": 9, "ident": 0x1235, "config": "13 23"},
    {"name": "c", "address": 10, "ident": 0x1236, "config": "17 27"},
]


def row(kind: str, **words: object) -> None:
    """One row of the result: the test on the host reads it."""
    print(json.dumps({"row": kind, **words}, default=str), flush=True)


def ttys() -> set[str]:
    return set(glob.glob("/dev/ttyUSB*") + glob.glob("/dev/ttyACM*"))


def until(condition: Callable[[], object], limit_s: float = 5.0) -> bool:
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return bool(condition())


class Plugged:
    """Emulated adapters on one line, plugged in; ``tty`` is the path of the first, ``ttys`` are those of all."""

    def __init__(self, *chips: str, options: Sequence[str] = ()) -> None:
        self._log = Path(tempfile.mkstemp(suffix=".log")[1])
        before = ttys()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "vm_adapter", *chips, *options, "--log", str(self._log)],
            stdin=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        if not until(lambda: len(ttys() - before) == len(chips), _NEW_TTY_S):
            raise SystemExit(f"{chips}: no tty came: {self._log.read_text()}")
        self.ttys = sorted(ttys() - before)
        self.tty = self.ttys[0]
        self._read = 0
        time.sleep(0.3)  # udev, and the first requests

    def say(self, *words: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(" ".join(words) + "\n")

    def news(self, event: str | None = None) -> list[dict[str, Any]]:
        """The entries of the log since the last look."""
        time.sleep(_SETTLE_S)
        text = self._log.read_text()
        new, self._read = text[self._read :], len(text)
        entries = [json.loads(line) for line in new.splitlines()]
        return [entry for entry in entries if event in (None, entry["event"])]

    def close(self) -> None:
        assert self._process.stdin is not None
        gone = set(self.ttys) & ttys()
        self.say("unplug")
        time.sleep(0.1)
        self._process.stdin.close()
        self._process.wait(5)
        until(lambda: not gone & ttys(), 3)


@contextlib.contextmanager
def plugged(*chips: str, options: Sequence[str] = ()) -> Iterator[Plugged]:
    adapter = Plugged(*chips, options=options)
    try:
        yield adapter
    finally:
        adapter.close()


@contextlib.contextmanager
def opened(path: str, flags: int = os.O_RDWR) -> Iterator[int]:
    fd = os.open(path, flags | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        yield fd
    finally:
        os.close(fd)


def attempt(call: Callable[[], object]) -> object:
    """The result of ``call``, or the name of its error."""
    try:
        return call()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))


def member_of_dialout() -> None:
    """For a child process: the rights of a user who is a member of dialout."""
    os.setgroups([DIALOUT])
    os.setgid(USER)
    os.setuid(USER)


def _program(as_user: bool) -> dict[str, Any]:
    """How a program is started: its rights, its environment, and where its output goes."""
    return {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.STDOUT,
        "text": True,
        "preexec_fn": member_of_dialout if as_user else None,
        "env": {**os.environ, "COLUMNS": "400", "XDG_RUNTIME_DIR": "/tmp/user" if as_user else "/run"},
    }


def dpstack(*words: str, as_user: bool = False, limit_s: float = 120) -> tuple[int, str]:
    """Run a command of dpstack: its exit code and what it says."""
    done = subprocess.run([*DPSTACK, *words], timeout=limit_s, check=False, **_program(as_user))
    return done.returncode, done.stdout


def dpstack_json(*words: str, as_user: bool = False) -> Any:
    """The last JSON object that a command prints."""
    code, text = dpstack(*words, "--json", as_user=as_user)
    lines = [line for line in text.splitlines() if line.startswith("{")]
    if not lines:
        raise SystemExit(f"dpstack {' '.join(words)} ended with {code}: {text}")
    return json.loads(lines[-1])


def start(*words: str, as_user: bool = False) -> subprocess.Popen[str]:
    return subprocess.Popen([*DPSTACK, *words], **_program(as_user))


def plant(*slaves: dict[str, object], **bus: Any) -> str:
    """The path of a configuration; its slaves are :data:`SLAVES` where none is given."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    path = plant_file(folder, *(slaves or SLAVES), port="/dev/none", baud=187_500, address=2, **bus)
    path.chmod(0o644)
    return str(path)


@contextlib.contextmanager
def slaves(config: str | None = None, baud: int = 187_500) -> Iterator[str]:
    """``dpstack sim``; the path of the tty that leads to it."""
    process = start("sim", config or plant(), "--port", "pty", "--baud", str(baud))
    assert process.stdout is not None
    path = next(found[0] for line in process.stdout if (found := re.search(r"/dev/pts/\d+", line)))
    try:
        yield path
    finally:
        process.send_signal(signal.SIGINT)
        process.stdout.close()
        try:
            process.wait(8)
        except subprocess.TimeoutExpired:
            process.kill()


def events(text: str) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The JSON lines of ``run --json``, and the summary, which is the last one."""
    lines = [json.loads(line) for line in text.splitlines() if line.startswith('{"event":')]
    return lines, lines[-1] if lines and lines[-1]["event"] == "summary" else {}


def of_slaves(summary: dict[str, Any], key: str) -> dict[str, Any]:
    """A value of each slave in the summary of a run."""
    return {address: one[key] for address, one in summary.get("slaves", {}).items()}


def serial_line(fd: int) -> tuple[int, int]:
    """Type and baud base of the UART, by TIOCGSERIAL."""
    buffer = bytearray(128)
    fcntl.ioctl(fd, 0x541E, buffer, True)
    words = struct.unpack_from("=8i", buffer)
    return words[0], words[7]
