"""Programs of tests as forks of one process that has imported dpstack.

A start of ``dpstack`` takes 0.7 s of processor time, nearly all of it imports. A fork is a process of its own all the
same: it has its pid, signals, descriptors, environment and exit code. Only its command line is the server's.

This file is a program, too: the server, started by :class:`ForkServer`.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

#: modules of the programs that tests start most
_IMPORTED = (
    "dpstack_drives.demag",
    "dpstack_drives.fuji",
    *(f"dpstack.cli.commands.{name}" for name in ("demo", "drive", "run", "scan", "segment", "sim")),
    *(f"dpstack.cli.listening.{name}" for name in ("baud", "capture", "monitor")),
)
_LONGEST = 1 << 17


class ForkServer:
    """The process that forks, for one run of pytest."""

    def __init__(self) -> None:
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        number = theirs.fileno()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(number)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[number],
            )
        self.ended: dict[int, int] = {}  # by pid: exit code

    def start(self, args: tuple[str, ...], out: Path, err: Path) -> int:
        """``dpstack`` with ``args``, in the working directory and environment of this process; returns its pid."""
        order = {"args": args, "out": str(out), "err": str(err), "cwd": os.getcwd(), "environment": dict(os.environ)}
        self._channel.send(json.dumps(order).encode())
        while (pid := self._next(None)) is None:
            pass
        return pid

    def look(self, timeout: float) -> None:
        """Note the next end of a process, if there is one within ``timeout`` seconds."""
        self._next(timeout)

    def _next(self, timeout: float | None) -> int | None:
        """Read a message: returns the pid of a process that was started."""
        if not select.select([self._channel], [], [], timeout)[0]:
            return None
        octets = self._channel.recv(_LONGEST)
        assert octets, "the process that forks programs has ended"
        message = json.loads(octets)
        if "code" in message:
            self.ended[message["pid"]] = message["code"]
            return None
        return int(message["pid"])

    def close(self) -> None:
        self._channel.close()
        self._process.wait()


class ForkedProcess:
    """The part of ``subprocess.Popen`` that tests use."""

    def __init__(self, server: ForkServer, args: tuple[str, ...], out: Path, err: Path) -> None:
        self._server = server
        self.args = args
        self.returncode: int | None = None
        self.pid = server.start(args, out, err)

    def poll(self) -> int | None:
        return self._look(0)

    def wait(self, timeout: float | None = None) -> int:
        end = None if timeout is None else time.monotonic() + timeout
        while (code := self._look(1 if end is None else max(0.0, end - time.monotonic()))) is None:
            if end is not None and time.monotonic() >= end:
                raise subprocess.TimeoutExpired(self.args, timeout or 0)
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _look(self, timeout: float) -> int | None:
        if self.returncode is None:
            if self.pid not in self._server.ended:
                self._server.look(timeout)
            self.returncode = self._server.ended.pop(self.pid, None)
        return self.returncode


def _serve(channel: socket.socket) -> dict[str, Any]:
    """Fork a process for each order. Returns in that process, with the order."""
    running: dict[int, int] = {}  # by descriptor: pid
    while True:
        for ready in select.select([channel.fileno(), *running], [], [])[0]:
            if ready != channel.fileno():
                pid = running.pop(ready)
                os.close(ready)
                code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
                channel.send(json.dumps({"pid": pid, "code": code}).encode())
                continue
            order = channel.recv(_LONGEST)
            if not order:  # pytest has ended
                sys.exit()
            pid = os.fork()
            if pid == 0:
                channel.close()
                for descriptor in running:
                    os.close(descriptor)
                return dict(json.loads(order))
            running[os.pidfd_open(pid)] = pid
            channel.send(json.dumps({"pid": pid}).encode())


def _become(order: dict[str, Any]) -> list[str]:
    """Take what a new process would be given; returns the arguments of ``dpstack``."""
    os.environ.clear()
    os.environ.update(order["environment"])
    time.tzset()
    os.chdir(order["cwd"])
    for number, path in ((1, order["out"]), (2, order["err"])):
        file = os.open(path, os.O_WRONLY)
        os.dup2(file, number)
        os.close(file)
    sys.path[0] = order["cwd"]  # as ``python -m`` does
    sys.argv[:] = ["dpstack", *order["args"]]
    return sys.argv[1:]


if __name__ == "__main__":
    for name in _IMPORTED:
        importlib.import_module(name)
    from dpstack.cli.main import main
    from dpstack.devices.finding import known, known_devices

    known(), known_devices()  # the files that come with dpstack are read once, not in each fork
    gc.collect()
    gc.freeze()
    args = _become(_serve(socket.socket(fileno=int(sys.argv[1]))))
    sys.exit(main(args))
