"""``dpstack`` as processes of their own, and a plant for them."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from operator import ge
from pathlib import Path
from typing import Any

from api_kit import FAN, HOIST, RAW
from control_kit import socket_of
from far_ends import HANG_S, eventually
from forked_programs import ForkedProcess, ForkServer
from plant_files import plant_file

from dpstack.api.control.client import connect

NOTHING: Mapping[str, object] = {}


def plant_of(folder: Path, port: object = "virtual", *, each: Mapping[str, object] = NOTHING, **bus: Any) -> Path:
    """Hoist (3), fan (4) and a slave without a drive (9) on ``port`` as the file ``plant.toml`` in ``folder``.

    ``each``: keys that every slave has. One is lost when it does not answer within 8 times 50 ms: programs may have to
    wait for a busy computer.
    """
    slaves = (HOIST, {**FAN, "ident": "ask"}, RAW)
    return plant_file(folder, *({**slave, **each} for slave in slaves), port=port, max_retry=7, **bus)


def wait_for_socket(port: Path) -> None:
    """Until the program on ``port`` holds it and can be talked to."""
    eventually(socket_of(str(port)).exists, f"an answer for {port}")


def wait_for_exchanges(port: Path, more: int) -> None:
    """Until the run on ``port`` had so many more exchanges with each of its slaves."""

    def exchanges() -> list[int]:
        with connect(str(port)) as client:
            return [slave["exchanges"] for slave in client.call("stats")["slaves"].values()]

    enough = [count + more for count in exchanges()]
    eventually(lambda: all(map(ge, exchanges(), enough)), f"the bus on {port} goes on")


class Program:
    """One ``dpstack`` process; its output goes to files, so that it never waits for a reader.

    With ``server`` it is forked from a process that has imported dpstack.
    """

    def __init__(self, folder: Path, *args: str, server: ForkServer | None = None) -> None:
        self._out = folder / f"out{len(list(folder.iterdir()))}"
        self.process: subprocess.Popen[bytes] | ForkedProcess
        with self._out.open("wb") as out, self._out.with_suffix(".err").open("wb") as err:
            if server is not None:
                self.process = ForkedProcess(server, args, self._out, self._out.with_suffix(".err"))
                return
            self.process = subprocess.Popen(
                [sys.executable, "-m", "dpstack.cli.main", *args], stdout=out, stderr=err, stdin=subprocess.DEVNULL
            )

    @property
    def out(self) -> str:
        return self._out.read_text(encoding="utf-8")

    @property
    def err(self) -> str:
        return self._out.with_suffix(".err").read_text(encoding="utf-8")

    @property
    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.out.splitlines() if line.endswith("}")]

    def wait_for(self, text: str, times: int = 1, limit: float = HANG_S) -> None:
        self._wait(lambda: self.out.count(text) >= times, repr(text), limit)

    def wait_for_slaves(self, count: int, limit: float = HANG_S) -> None:
        """Until ``count`` slaves of this ``run --json`` are in data exchange, each one whatever became of it before."""

        def exchanging() -> bool:
            states = {line["address"]: line["state"] for line in self.lines if line.get("event") == "slave"}
            return list(states.values()) == ["data_exchange"] * count

        self._wait(exchanging, f"data exchange with {count} slaves", limit)

    def _wait(self, happened: Callable[[], bool], what: str, limit: float) -> None:
        end = time.monotonic() + limit
        while not happened():
            assert self.process.poll() is None, f"ended with {self.process.returncode}: {self.out}{self.err}"
            assert time.monotonic() < end, f"{what} not seen in: {self.out}{self.err}"
            time.sleep(0.02)

    def end(self, number: int | None = None, limit: float = HANG_S) -> int:
        if number is not None:
            self.process.send_signal(number)
        return self.process.wait(limit)


class Starter:
    """Starts programs and sees to it that none is left."""

    def __init__(self, folder: Path, server: ForkServer | None = None) -> None:
        self.folder = folder
        self._server = server
        self._programs: list[Program] = []

    def __call__(self, *args: str) -> Program:
        """``dpstack`` as a process of its own, forked where there is a server."""
        return self._started(Program(self.folder, *args, server=self._server))

    def interpreter(self, *args: str) -> Program:
        """``python -m dpstack.cli.main``: an interpreter of its own, which imports everything."""
        return self._started(Program(self.folder, *args))

    def _started(self, program: Program) -> Program:
        self._programs.append(program)
        return program

    def segment(self, directory: Path, stations: int = 2, *more: str) -> Program:
        """``dpstack segment`` with the links 0, 1 ... in ``directory``, which are there now."""
        program = self("segment", "--stations", str(stations), "--dir", str(directory), *more)
        program.wait_for(str(directory / str(stations - 1)))
        return program

    def close(self) -> None:
        for program in self._programs:
            if program.process.poll() is None:
                program.process.kill()
            program.process.wait()
