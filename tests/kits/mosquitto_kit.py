"""The broker mosquitto as a program of its own, for tests of strangers."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

LONGEST_S = 30.0


class Mosquitto:
    """A broker on a free port. ``lines``: of its configuration, besides the listener."""

    def __init__(self, folder: Path, *lines: str, anonymous: bool = True) -> None:
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        config = [
            f"listener {self.port} 127.0.0.1",
            f"allow_anonymous {str(anonymous).lower()}",
            "log_type all",
            *lines,
        ]
        if os.geteuid() == 0:
            config.append("user root")  # else it becomes a user who may not read the folder
        (folder / "mosquitto.conf").write_text("\n".join(config) + "\n")
        self.log = folder / "mosquitto.log"
        self.program: subprocess.Popen[bytes] | None = None
        self.start()

    def start(self) -> None:
        with self.log.open("ab") as log:
            self.program = subprocess.Popen(
                ["mosquitto", "-c", str(self.folder / "mosquitto.conf")], stdout=log, stderr=log, cwd=self.folder
            )
        wait_for(self.listens)

    def listens(self) -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        assert self.program is not None
        assert self.program.poll() is None, self.log.read_text()
        return False

    def subscriptions(self) -> int:
        """Those that it has confirmed since its start."""
        return self.log.read_text(errors="replace").count("Sending SUBACK")

    def kill(self, number: int = signal.SIGKILL) -> None:
        assert self.program is not None
        self.program.send_signal(number)
        if number in (signal.SIGKILL, signal.SIGTERM):
            self.program.wait(LONGEST_S)

    def clients(self, program: str, *options: str) -> list[str]:
        return [program, "-h", "127.0.0.1", "-p", str(self.port), "-V", "5", *options]


def wait_for(found: Callable[[], object]) -> None:
    end = time.monotonic() + LONGEST_S
    while not found():
        assert time.monotonic() < end
        time.sleep(0.02)
