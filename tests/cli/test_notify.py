"""Datagrams to a service manager, as sd_notify(3) has them, read from a socket of the test."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from api_kit import RAW
from cli_kit import Cli
from far_ends import eventually
from plant_files import plant_file
from programs import Starter, plant_of

import dpstack
from dpstack.service.notify import BusState, Manager, ServiceReport


class Far:
    """The manager's end of the socket."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "notify"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self._socket.setblocking(False)

    def told(self) -> list[str]:
        """The messages since the last call, the lines of each joined by " | "."""
        found = []
        while True:
            try:
                found.append(self._socket.recv(4096).decode().replace("\n", " | "))
            except BlockingIOError:
                return found

    def wait_for(self, line: str) -> None:
        eventually(lambda: any(line in message for message in self.told()), f"the manager is told {line}")

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(runtime_directory: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Far]:
    """A manager with a watchdog of 2 s."""
    far = Far(Path(runtime_directory))
    monkeypatch.setenv("NOTIFY_SOCKET", str(far.path))
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    yield far
    far.close()
    far.path.unlink()


def test_messages_of_a_bus_that_comes_up_stops_and_goes_on(manager: Far) -> None:
    states = [
        BusState(ready=False, beat=0, status="opens the port"),
        BusState(ready=False, beat=5, status="clear"),
        BusState(ready=False, beat=9, status="clear"),
        BusState(ready=True, beat=11, status="operate"),
        BusState(ready=True, beat=12, status="operate"),
        BusState(ready=True, beat=12, status="operate"),  # the machine is stuck, or the bus process is dead
        BusState(ready=False, beat=12, status="offline\nREADY=1"),
        BusState(ready=False, beat=13, status="clear"),
    ]
    seen: list[list[str]] = []

    async def run() -> None:
        given = iter(states)
        with ServiceReport(lambda: next(given)) as service:
            for _ in states:
                await asyncio.sleep(0.25)
                seen.append(manager.told())
                await asyncio.sleep(0.25)
            service.end()
            service.end()
        seen.append(manager.told())

    dpstack.run_virtual(run())
    assert seen == [
        ["STATUS=opens the port"],
        ["STATUS=clear | EXTEND_TIMEOUT_USEC=60000000"],
        ["EXTEND_TIMEOUT_USEC=60000000"],
        ["STATUS=operate | READY=1 | WATCHDOG=1"],
        ["WATCHDOG=1"],
        [],
        ["STATUS=offline\\nREADY=1"],
        ["STATUS=clear | WATCHDOG=1"],
        ["STOPPING=1 | STATUS=ending: safe values, Clear"],
    ]


@pytest.mark.parametrize(
    ("options", "mode"),
    [([], "operate"), (["--clear"], "clear"), (["--read-only"], "read-only")],
    ids=["operate", "clear", "read-only"],
)
def test_a_run_tells_its_manager(
    manager: Far, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], mode: str
) -> None:
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    config = plant_file(tmp_path, RAW, baud=19_200)
    cli("run", str(config), "--seconds", "2", *options, code=0 if mode != "read-only" else 1)
    told = manager.told()
    assert told[0].startswith("STATUS=opens the port")
    lines = [line for message in told for line in message.split(" | ")]
    assert lines.count("READY=1") == 1
    before, after = lines[: lines.index("READY=1")], lines[lines.index("READY=1") :]
    assert "WATCHDOG=1" not in before
    assert 2 <= after.count("WATCHDOG=1") <= 5  # one each half second
    assert any(line.startswith(f"STATUS={mode}, ") for line in before)
    assert lines[-2:] == ["STOPPING=1", "STATUS=ending: safe values, Clear"]


def test_a_run_without_a_manager_sends_nothing(
    manager: Far, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    monkeypatch.delenv("NOTIFY_SOCKET")
    config = plant_file(tmp_path, RAW, baud=19_200)
    cli("run", str(config), "--rotations", "5")
    assert manager.told() == []


def test_slaves_that_are_missing_are_in_the_status(
    manager: Far, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    config = plant_file(tmp_path, RAW, baud=19_200)
    scenario = tmp_path / "off.toml"
    scenario.write_text('[[step]]\nat = 0.6\nslave = "raw"\ndo = "power-off"\n', encoding="utf-8")
    cli("run", str(config), "--seconds", "2", "--scenario", str(scenario), code=1)
    told = " | ".join(manager.told())
    assert "STATUS=operate, 1 of 1 slaves in data exchange |" in told
    assert "STATUS=operate, 0 of 1 slaves in data exchange; not: raw (9) |" in told


def test_where_the_manager_is() -> None:
    assert Manager.of({}) is None
    assert Manager.of({"NOTIFY_SOCKET": "relative"}) is None
    assert Manager.of({"NOTIFY_SOCKET": "vsock:2:1234"}) is None
    made = [
        Manager.of({"NOTIFY_SOCKET": "/n", **more})
        for more in (
            {},
            {"WATCHDOG_USEC": "30000000"},
            {"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())},
            {"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "1"},  # of another process
            {"WATCHDOG_USEC": "0"},
            {"WATCHDOG_USEC": "-3"},
        )
    ]
    assert [one and one.watchdog_s for one in made] == [None, 30.0, 30.0, None, None, None]


def test_an_abstract_socket_and_one_that_is_gone() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as far:
        name = f"dpstack-test-{os.getpid()}"
        far.bind("\0" + name)
        Manager(f"@{name}").tell("READY=1")
        assert far.recv(100) == b"READY=1"
    Manager(f"@{name}").tell("READY=1")
    Manager("/nowhere/notify").tell("READY=1")


@pytest.mark.soak
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_a_bus_process_that_is_stopped_or_killed_is_not_reported_alive(
    manager: Far, start: Starter, tmp_path: Path, number: signal.Signals
) -> None:
    """Nothing about life is sent during two times of the watchdog, in which the program itself runs on."""
    start.segment(tmp_path / "bus")
    config = plant_of(tmp_path, tmp_path / "bus" / "0")
    run = start("run", str(config), "--driver", "process", "--json")
    manager.wait_for("READY=1")
    manager.wait_for("WATCHDOG=1")
    children = Path(f"/proc/{run.process.pid}/task/{run.process.pid}/children").read_text().split()
    (child,) = [int(pid) for pid in children if b"dpstack.drivers.process" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(child, number)
    time.sleep(1.0)  # a look that had begun is over
    manager.told()
    time.sleep(4.0)
    silent = manager.told()
    assert [message for message in silent if "WATCHDOG" in message or "READY" in message] == []
    if number is signal.SIGSTOP:
        assert run.process.poll() is None
        os.kill(child, signal.SIGCONT)
        manager.wait_for("WATCHDOG=1")
    run.end(signal.SIGTERM)
