"""Standard output that nobody reads: the bus goes on, the program ends in order."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from far_ends import HANG_S
from programs import Starter, plant_of, wait_for_exchanges

from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import LIMIT, Queue, reader_watched

#: a bus about which `dpstack run` writes nothing after its beginning
RAW = """
[bus]
port = "virtual"
baud = 1500000

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "20 10"
"""
FAN = """
[bus]
port = "virtual"
baud = 1500000

[[slave]]
name = "fan"
address = 4
drive = "fuji-frenic"
ident = "ask"
telegram = "PPO3"
"""


@pytest.fixture
def full_pipe() -> Iterator[tuple[int, int]]:
    """Both ends of a pipe that takes no octet more."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for piece in (b"before\n" * 100, b"\n"):
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(writing, piece)
    os.set_blocking(writing, True)
    yield reading, writing
    os.close(reading)
    os.close(writing)


def queue(lost: list[OSError]) -> Queue:
    return Queue(lambda lines: f"({lines} missing)", lost.append)


def test_lines_that_find_no_room_are_counted_and_told_later(full_pipe: tuple[int, int]) -> None:
    reading, writing = full_pipe
    lost: list[OSError] = []
    waiting = queue(lost)
    count = LIMIT // 8 + 1000
    for number in range(count):
        waiting.put(writing, b"%07d\n" % number)  # a line of 8 octets: LIMIT // 8 of them find room
    got = bytearray()

    def read() -> None:
        while not got.endswith(b"the end\n"):
            got.extend(os.read(reading, 65_536))

    reader = threading.Thread(target=read)
    reader.start()
    assert waiting.drained(writing)
    waiting.put(writing, b"the end\n")
    reader.join(20)
    lines = got.decode().split()
    lines = lines[lines.index("0000000") :]
    kept = LIMIT // 8
    assert lines[:kept] == [f"{number:07d}" for number in range(kept)]
    assert lines[kept:] == [f"({count - kept}", "missing)", "the", "end"]
    assert lost == []


def test_a_reader_that_goes_away_is_told_once() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    told = threading.Event()
    lost: list[OSError] = []

    def on_lost(error: OSError) -> None:
        lost.append(error)
        told.set()

    waiting = Queue(str, on_lost)
    waiting.put(writing, b"for nobody\n")
    assert told.wait(20)
    waiting.put(writing, b"for nobody\n")
    assert waiting.drained(writing)
    assert [type(error) for error in lost] == [BrokenPipeError]
    os.close(writing)


async def test_a_reader_that_goes_away_is_noticed_without_a_write(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    gone = asyncio.Event()
    lost = output.Lost()
    lost.on_lost = gone.set
    monkeypatch.setattr(output, "lost", lost)
    with os.fdopen(writing, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        with reader_watched():
            for _ in range(3):
                await asyncio.sleep(0)
            assert not gone.is_set()
            os.close(reading)
            await asyncio.wait_for(gone.wait(), HANG_S)
    assert isinstance(output.lost.error, BrokenPipeError)


@pytest.mark.parametrize(
    ("plant", "command", "last_line"),
    [
        pytest.param(RAW, ["run", "--json"], '"operate"', id="run"),
        pytest.param(
            FAN, ["drive", "fan", "start", "speed", "0.5"], "running at (49|50)", id="drive", marks=pytest.mark.soak
        ),
    ],
)
def test_the_loss_of_its_reader_ends_a_master_that_writes_nothing(
    tmp_path: Path, plant: str, command: list[str], last_line: str
) -> None:
    config = tmp_path / "plant.toml"
    config.write_text(plant, encoding="utf-8")
    program = [sys.executable, "-m", "dpstack.cli.main", command[0], str(config), *command[1:]]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as master:
        try:
            assert master.stdout is not None
            assert any(re.search(last_line, line) for line in master.stdout)
            master.stdout.close()
            assert master.wait(HANG_S) == 1
        finally:
            master.kill()


def test_run_keeps_its_bus_going_when_nobody_reads(tmp_path: Path, start: Starter, full_pipe: tuple[int, int]) -> None:
    _, writing = full_pipe
    directory = tmp_path / "bus"
    start.segment(directory)
    config = plant_of(tmp_path, directory / "1")
    sim = start("sim", str(config), "--port", str(directory / "0"), "--json")
    command = [sys.executable, "-m", "dpstack.cli.main", "run", str(config), "--json"]
    with subprocess.Popen(command, stdout=writing, stderr=subprocess.PIPE) as run:
        try:
            sim.wait_for('"state":"data_exchange"', 3)
            wait_for_exchanges(directory / "1", 100)
            run.send_signal(signal.SIGINT)
            assert run.wait(HANG_S) == 1
        finally:
            run.kill()
        assert b"cannot be written (nobody has read it" in (run.stderr.read() if run.stderr else b"")


def test_standard_error_nobody_reads_does_not_hold_up_the_end(tmp_path: Path, full_pipe: tuple[int, int]) -> None:
    _, writing = full_pipe
    config = plant_of(tmp_path)
    command = [sys.executable, "-m", "dpstack.cli.main", "run", str(config), "--rotations", "5"]
    assert subprocess.run(command, stdout=writing, stderr=writing, timeout=60, check=False).returncode == 1
