"""``dpstack run`` in trouble: a port that cannot be used is one line that says what to do; on a flooded line it
still hears orders and signals; stopped and continued, nothing old goes out, and it ends with 1."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import select
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW
from cli_kit import Cli
from far_ends import PtyFarEnd, eventually
from plant_files import plant_file
from process_kit import SPEC, octet_slaves
from programs import Program, Starter, wait_for_socket
from support_responder import Responder

from dpstack.api.config.config import Config
from dpstack.api.control.client import connect
from dpstack.cli.commands import run
from dpstack.ports import termios2


@pytest.fixture
def far() -> Iterator[PtyFarEnd]:
    far = PtyFarEnd()
    yield far
    far.hang_up()


def refusal(far: PtyFarEnd, folder: Path, cli: Cli) -> str:
    plant = plant_file(folder, RAW, port=far.path, baud=12_000_000)
    out, err = cli("run", str(plant), "--seconds", "1", "--json", code=1)
    assert out == ""
    (line,) = err.splitlines()
    return line


def test_no_permission(far: PtyFarEnd, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def refuse(path: str, *rest: Any, **more: Any) -> int:
        if path == far.path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return opened(path, *rest, **more)

    monkeypatch.setattr(os, "open", refuse)
    line = refusal(far, tmp_path, cli)
    assert line.startswith(f"dpstack: {far.path}: no permission; ")
    assert "group" in line


def test_a_rate_the_port_cannot_do(far: PtyFarEnd, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(termios2, "set_raw", lambda _fd, _baud, marks: termios2.Applied(9_600, True))
    assert refusal(far, tmp_path, cli) == (
        f"dpstack: {far.path} cannot do 12 Mbit/s, it set itself to 9.6 kbit/s: choose another rate or adapter"
    )


def test_a_rate_the_driver_refuses(far: PtyFarEnd, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_fd: int, _baud: int, *, marks: bool) -> termios2.Applied:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(termios2, "set_raw", refuse)
    assert refusal(far, tmp_path, cli) == (
        f"dpstack: {far.path} refuses 12 Mbit/s 8E1 (Invalid argument): choose another rate or adapter"
    )


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE])
def test_no_file_descriptors_left(number: int, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python raises a plain OSError where it cannot import a module or make an event loop for the command."""

    def refuse(_name: str) -> Config:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(run, "load_config", refuse)
    _, err = cli("run", "plant.toml", code=1)
    assert err.strip() == f"dpstack: no file descriptors left ({os.strerror(number)}): raise that limit (ulimit -n)"


class Flood(threading.Thread):
    """Writes ``octets`` to the descriptor again and again, and reads what comes back; ``end()`` joins it."""

    def __init__(self, fd: int, octets: bytes) -> None:
        super().__init__(daemon=True)
        os.set_blocking(fd, False)
        self._fd, self._octets, self._over = fd, octets * (65_536 // len(octets)), threading.Event()

    def run(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(BlockingIOError):
                os.read(self._fd, 65_536)
            try:
                os.write(self._fd, self._octets)
            except BlockingIOError:
                select.select((), (self._fd,), (), 0.05)

    def end(self) -> None:
        self._over.set()
        self.join()


@pytest.mark.soak
@pytest.mark.parametrize(
    "octets", [b"\x55", b"\xe5", b"\x10", random.Random(2).randbytes(65_536)], ids=["55", "e5", "10", "random"]
)
def test_a_run_on_a_flooded_line_answers_and_ends(tmp_path: Path, octets: bytes) -> None:
    far, near = os.openpty()
    port = Path(os.ttyname(near))
    config = plant_file(tmp_path, RAW, port=port)
    run = Program(tmp_path, "run", str(config), "--driver", "asyncio", "--json")
    flood = Flood(far, octets)
    try:
        run.wait_for('"mode":"operate"')
        wait_for_socket(port)
        flood.start()
        for _ in range(5):
            with connect(str(port)) as client:
                assert client.call("status")
        run.process.send_signal(signal.SIGINT)
        assert run.process.wait(60) == 1
        assert '"event":"summary"' in run.out
    finally:
        run.process.kill()
        run.process.wait()
        flood.end()
        os.close(far)
        os.close(near)


VALVES = {"name": "valves", "address": 4, "ident": 0x1234, "config": "21 11", "watchdog_ms": 1000}
BUS: dict[str, Any] = {"baud": 1_500_000, "gap": 0, "max_retry": 15}
OUT = bytes.fromhex("1122")
#: A process may be stopped between its last look at the clock and the write. That telegram goes out after SIGCONT, to a
#: slave whose watchdog has run out: it must refuse it.
WATCHED = SPEC + ",watchdog=1"


def recording(there: Responder) -> list[bytes]:
    """The outputs that slave 4 accepts from now on."""
    heard: list[bytes] = []
    request = there.request

    def recorded(body: bytes) -> bytes:
        slave = there.slaves[4]
        before = slave.exchanges
        answer = request(body)
        if slave.exchanges != before:
            heard.append(slave.outputs)
        return answer

    there.request = recorded  # type: ignore[method-assign]
    return heard


def stop_and_go(run: Program, there: Responder) -> list[bytes]:
    """SIGSTOP for longer than the watchdog, SIGCONT; the outputs from then on."""
    run.process.send_signal(signal.SIGSTOP)
    idle = there.idle
    eventually(lambda: there.idle > idle + 1, "what was sent before is read")
    heard = recording(there)
    time.sleep(1.2)
    run.process.send_signal(signal.SIGCONT)
    return heard


def ctl(cli: Cli, *args: str) -> Any:
    return cli.json("ctl", *args)["result"]


@pytest.mark.parametrize("driver", ["asyncio", "process"])
def test_stopped_and_continued(tmp_path: Path, start: Starter, cli: Cli, driver: str) -> None:
    with octet_slaves(WATCHED) as (path, there):
        config = plant_file(tmp_path, VALVES, port=path, after_stall="safe", **BUS)
        run = start("run", str(config), "--outputs", "4=1122", "--json", "--driver", driver)
        eventually(lambda: there.slaves[4].outputs == OUT, "its outputs")
        if driver == "process":  # the whole group is stopped, as Ctrl-Z does
            child = int(Path(f"/proc/{run.process.pid}/task/{run.process.pid}/children").read_text().split()[0])
            heard = stop_group(run, child, there)
        else:
            heard = stop_and_go(run, there)
        run.wait_for('"event":"stalled"')
        run.wait_for('"mode":"clear"')
        (stalled,) = [line for line in run.lines if line.get("event") == "stalled"]
        assert (stalled["slaves"], stalled["blocked"]) == ([4], "program")
        assert stalled["gap_ms"] > 1000
        eventually(lambda: len(heard) > 20, "data exchange in Clear")
        assert set(heard) == {bytes(2)}
        assert there.slaves[4].expired
        status = ctl(cli, path, "status")
        assert status["mode"] == "clear"
        assert "slave 4 (valves) was not asked for" in status["clear"]["because"]
        ctl(cli, path, "operate")
        eventually(lambda: there.slaves[4].outputs == OUT, "its outputs after the order")
        assert "clear" not in ctl(cli, path, "status")
        assert run.end(signal.SIGTERM) == 1


def stop_group(run: Program, child: int, there: Responder) -> list[bytes]:
    os.kill(child, signal.SIGSTOP)
    try:
        return stop_and_go(run, there)
    finally:
        os.kill(child, signal.SIGCONT)


def test_for_people_and_the_end_in_clear(tmp_path: Path, start: Starter) -> None:
    with octet_slaves(SPEC) as (path, there):
        config = plant_file(tmp_path, VALVES, port=path, after_stall="safe", **BUS)
        run = start("run", str(config), "--outputs", "4=1122")
        eventually(lambda: there.slaves[4].outputs == OUT, "its outputs")
        stop_and_go(run, there)
        run.wait_for("master: stall: outputs become safe: slave 4 (valves) was not asked for")
        run.wait_for("master: clear")
        assert run.end(signal.SIGTERM) == 1
        assert "in Clear since" in run.err
        assert "because of a stall: slave 4 (valves) was not asked for" in " ".join(run.err.split())


@pytest.mark.parametrize("command", [("run",), ("drive", "valves", "status")])
def test_the_application_watchdog_is_refused(tmp_path: Path, cli: Cli, command: tuple[str, ...]) -> None:
    drive = {"name": "valves", "address": 4, "drive": "demag-dedrive"}
    config = plant_file(tmp_path, drive, **BUS, application_watchdog_ms=500)
    name, *rest = command
    error = cli.err(name, str(config), *rest)
    assert f"{config}:6: [bus]: application_watchdog_ms is for a program that calls bus.alive()" in error
    assert f"which `dpstack {name}` does not; leave it out of this file" in error
