"""Standard output that nobody reads: the bus goes on, the program ends in order. Standard streams whose encoding lacks
what is to be written, or that hold no text of it."""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from api_kit import FAN, RAW
from far_ends import HANG_S
from plant_files import plant_file
from programs import Starter, plant_of, wait_for_exchanges

from dpstack.cli import main as program
from dpstack.cli.main import main
from dpstack.cli.terminal import output
from dpstack.cli.terminal.nonblocking_stdout import LIMIT, Queue, reader_watched


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
        # a bus about which `dpstack run` writes nothing after its beginning
        pytest.param([RAW], ["run", "--json"], '"operate"', id="run"),
        pytest.param(
            [FAN], ["drive", "fan", "start", "speed", "0.5"], "running at (49|50)", id="drive", marks=pytest.mark.soak
        ),
    ],
)
def test_the_loss_of_its_reader_ends_a_master_that_writes_nothing(
    tmp_path: Path, plant: list[dict[str, object]], command: list[str], last_line: str
) -> None:
    config = plant_file(tmp_path, *plant, baud=1_500_000)
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


GSD = """#Profibus_DP
GSD_Revision = 5
Vendor_Name = "Müller \u2013 温度 \u2026"
Model_Name = "Öler\u00a0\U0001f600"
Ident_Number = 0x1234
500_supp = 1
Max_Input_Len = 1
Module = "Ö \u2013 温" 0x10
1
EndModule
"""


@pytest.fixture
def gsd(tmp_path: Path) -> str:
    path = tmp_path / "a.gsd"
    path.write_text(GSD, encoding="utf-8")
    return str(path)


class Streams:
    """The three of them, in one encoding and as strict as PYTHONIOENCODING makes them."""

    def __init__(self, encoding: str, typed: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
        self.encoding = encoding
        self._monkeypatch = monkeypatch
        self._octets = {"stdin": io.BytesIO(typed), "stdout": io.BytesIO(), "stderr": io.BytesIO()}

    def main(self, *argv: str) -> int:
        """The exit code."""
        for name, octets in self._octets.items():
            self._monkeypatch.setattr(sys, name, io.TextIOWrapper(octets, encoding=self.encoding, errors="strict"))
        try:
            return main(argv)
        except SystemExit as end:
            return int(str(end.code))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()

    def written(self, name: str) -> str:
        return self._octets[name].getvalue().decode(self.encoding)


@pytest.fixture(params=["ascii", "latin-1", "cp1252", "cp437"])
def streams(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Streams:
    return Streams(request.param, "\nÖ\n8\ny\nn\n".encode(), monkeypatch)


def test_a_table_is_written_with_what_there_is(streams: Streams, gsd: str) -> None:
    assert streams.main("gsd", "show", gsd) == 0
    shown = streams.written("stdout")
    assert r"ller" in shown
    assert r"\u6e29\u5ea6" in shown
    if streams.encoding != "cp1252":  # which has a dash
        assert r"ller - \u6e29" in shown


def test_rich_draws_with_what_there_is(streams: Streams, gsd: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "on_terminal", lambda: True)
    assert streams.main("gsd", "show", gsd) == 0
    assert r"\u6e29\u5ea6" in streams.written("stdout")


def test_json_keeps_its_values(streams: Streams, gsd: str) -> None:
    assert streams.main("gsd", "show", gsd, "--json") == 0
    told = json.loads(streams.written("stdout"))
    assert (told["vendor"], told["modules"][0]["name"]) == ("Müller \u2013 温度 \u2026", "Ö \u2013 温")


def test_toml_keeps_its_values(streams: Streams, gsd: str) -> None:
    """The second answer is UTF-8, which is no ASCII and no address: it is asked for again."""
    assert streams.main("gsd", "configure", gsd) == 0
    (slave,) = tomllib.loads(streams.written("stdout"))["slave"]
    assert slave["name"].startswith("öler")
    assert (slave["address"], slave["modules"]) == (8, ["Ö \u2013 温"])


def test_errors_are_written_with_what_there_is(streams: Streams) -> None:
    assert streams.main("plan", "Ö\u2013温.toml") == 2
    assert r"\u6e29.toml: there is no such file" in streams.written("stderr")


@pytest.mark.parametrize("command", ["", *program._COMMANDS])
def test_help(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    streams = Streams("ascii", b"", monkeypatch)
    assert streams.main(*command.split(), "--help") == 0
    assert "usage: dpstack" in streams.written("stdout")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_program_of_its_own(encoding: str, gsd: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "dpstack.cli.main", "gsd", "show", gsd],
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
        capture_output=True,
        check=True,
    )
    assert rb"\u6e29\u5ea6" in done.stdout
    assert done.stderr == b""
