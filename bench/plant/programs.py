"""The programs of a run of the benchmark ``fleet``: how each is started and asked; their CPU time and memory."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from bench.rig import Process

#: s until a program of a run must be there
_START_S: Final = 90.0
_LOOK_S: Final = 0.01


class Program:
    """One program, started from a module or as it is; it prints lines of JSON."""

    def __init__(self, words: Sequence[str], env: Mapping[str, str] | None = None) -> None:
        self._process = Process(words, None, None if env is None else dict(env))
        self.name = " ".join(words[:3])

    @classmethod
    def of_module(cls, module: str, *words: object, env: Mapping[str, str] | None = None) -> Program:
        return cls([sys.executable, "-m", f"bench.plant.{module}", *map(str, words)], env)

    @property
    def pid(self) -> int:
        return self._process.pid

    def line(self, timeout: float = _START_S) -> Any:
        """Its next line. Raises RuntimeError when it has ended."""
        line = self._process.line(timeout)
        if not line:
            raise RuntimeError(f"{self.name} has ended before its time, or did not answer")
        return json.loads(line)

    def ask(self, order: str) -> Any:
        """The answer to an order."""
        self._process.order(order)
        return self.line()

    def cpu_s(self) -> list[float]:
        """CPU time of the program and of each of its children so far."""
        return [time.clock_gettime_ns((~pid << 3) | 2) / 1e9 for pid in self.pids()]

    def waited_s(self) -> float:
        """The time that it and its children have waited for a processor so far."""
        return self._process.waited() / 1e9

    def pids(self) -> list[int]:
        """The program, then its children."""
        children = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text()
        return [self.pid, *map(int, children.split())]

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)
        self._process.end()

    def end(self, timeout: float = 15.0) -> list[dict[str, Any]]:
        """End it in order; the lines that it printed at the end."""
        return self._process.end(timeout)


def free_port() -> int:
    """A port of this computer that nobody uses."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def rss_kib(pid: int | str) -> int:
    """Resident memory of a process in KiB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    return 0


def mosquitto() -> str | None:
    """The program of the broker; None where it is not installed. Debian has it where only root looks."""
    return shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")


class Mosquitto:
    """The broker, on a free port of this computer; it keeps nothing on disk. Raises RuntimeError where it is not
    installed."""

    def __init__(self, folder: Path) -> None:
        path = mosquitto()
        if path is None:
            raise RuntimeError("mosquitto is not installed: sudo apt-get install mosquitto")
        self.port = free_port()
        config = folder / "mosquitto.conf"
        # a thousand births may wait for a subscriber
        config.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 100000\nlog_type none\n",
            "utf-8",
        )
        self._words = [path, "-c", str(config)]
        self.program: Program
        self.start()

    def start(self) -> int:
        """Start it; the time (CLOCK_MONOTONIC, ns) from which on it takes connections."""
        self.program = Program(self._words)
        try:
            wait_for(self._listens, "mosquitto", 10.0)
        except BaseException:
            self.program.kill()
            raise
        return time.monotonic_ns()

    def _listens(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False


def wait_for(found: Callable[[], object], what: str, seconds: float) -> None:
    """Wait until ``found()`` is true. Raises RuntimeError after ``seconds``."""
    limit = time.monotonic() + seconds
    while not found():
        if time.monotonic() > limit:
            raise RuntimeError(f"{what}: not there within {seconds:g} s; this computer may be too busy")
        time.sleep(_LOOK_S)


@contextlib.contextmanager
def ending(program: Program) -> Iterator[Program]:
    """Kill the program at the end of the block, unless it has ended."""
    try:
        yield program
    finally:
        program.kill()
