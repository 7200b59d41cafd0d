"""``| head`` on any command: its reader has gone, it ends without a traceback, and its exit status says so."""

from __future__ import annotations

import gc
import io
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from api_kit import HOIST, RAW
from gsd_kit import FILES
from plant_files import plant_file
from step7_kit import PLANT

from dpstack.capture.pcapng import Writer
from dpstack.cli import main as program
from dpstack.cli.listening import judged_file
from dpstack.cli.listening.source_file import bus_in
from dpstack.cli.main import main
from dpstack.cli.terminal import output

#: words for files stand in capitals
PRINTING = [
    ["decode", "CAPTURE"],
    ["decode", "CAPTURE", "--json"],
    ["decode", "CAPTURE", "--json", "--filter", "not token"],
    ["decode", "LOG", "--json"],
    ["decode", "DC 02 02"],
    ["monitor", "CAPTURE"],
    ["monitor", "CAPTURE", "--json"],
    ["gsd", "show", "GSD"],
    ["gsd", "show", "GSD", "--json"],
    ["gsd", "check", "GSD"],
    ["gsd", "find", "rack", "GSDS"],
    ["gsd", "diff", "GSD", "io-station"],
    ["plan", "CONFIG", "--octets"],
    ["plan", "CONFIG", "--baud", "all", "--json"],
    ["names", "CONFIG"],
    ["sheet", "CONFIG"],
    ["import", "CFG"],
    ["drives"],
    ["device", "list"],
    ["device", "show", "demag-dedrive"],
    ["run", "CONFIG", "--seconds", "0.01", "--json"],
    ["demo", "--seconds", "0.01"],
    ["completion", "bash"],
    ["ports"],
    ["doctor"],
]
#: they print little, or nothing before a port, a running program, a broker, a recording or a client answers
OTHERS = "sim segment ctl drive acyclic hart pa fdl ppi scan diag why address baud capture plot web fleet mcp wireshark"


def test_every_command_is_in_the_list() -> None:
    assert {argv[0] for argv in PRINTING}.union(OTHERS.split()) == set(program._COMMANDS)


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("closed")
    capture = folder / "bus.pcapng"
    with capture.open("wb") as file:
        writer = Writer(file, "a test")
        port = writer.interface("p", 500_000, "")
        for number in range(100):
            writer.packet(port, 1_790_000_000_000_000_000 + number * 1_000_000, bytes.fromhex("10 02 03 49 4E 16"))
    (folder / "log.txt").write_text("TX: 10 02 03 49 4E 16\n" * 100)
    (folder / "plant.cfg").write_text(PLANT, newline="")
    return {
        "CAPTURE": str(capture),
        "LOG": str(folder / "log.txt"),
        "CFG": str(folder / "plant.cfg"),
        "CONFIG": str(plant_file(folder, HOIST, RAW)),
        "GSD": str(FILES / "rack.gsd"),
        "GSDS": str(FILES),
    }


class ClosedPipe:
    """Standard output whose reader has gone, ``unbuffered`` as PYTHONUNBUFFERED makes it. ``ignored``: exceptions that
    Python could only print."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, unbuffered: bool) -> None:
        reading, writing = os.pipe()
        os.close(reading)
        raw = io.FileIO(writing, "w")
        file = raw if unbuffered else io.BufferedWriter(raw)
        self.stdout = io.TextIOWrapper(file, encoding="utf-8", write_through=unbuffered)
        self.ignored: list[object] = []
        monkeypatch.setattr(sys, "stdout", self.stdout)
        monkeypatch.setattr(sys, "stdin", io.StringIO())
        monkeypatch.setattr(sys, "unraisablehook", lambda found: self.ignored.append(found.exc_value))
        monkeypatch.setattr(output, "lost", output.Lost())

    def main(self, *argv: str) -> int:
        """The exit code, when everything that a program leaves behind is gone."""
        try:
            code = main(argv)
        except SystemExit as end:
            code = int(str(end.code))
        gc.collect()
        self.stdout.close()
        return code


@pytest.mark.parametrize("unbuffered", [False, True], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("argv", PRINTING, ids=" ".join)
def test_a_command_whose_reader_has_gone(
    argv: list[str],
    unbuffered: bool,
    places: dict[str, str],
    alone: None,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pipe = ClosedPipe(monkeypatch, unbuffered=unbuffered)
    code = pipe.main(*(places.get(word, word) for word in argv))
    told = capsys.readouterr().err
    assert (code, pipe.ignored) == (1, []), told
    assert "Traceback" not in told
    assert "Broken pipe" not in told
    assert "is on the bus" not in told  # of another master: a program that ends at once has seen none


@pytest.mark.parametrize(("reported", "files"), [(False, 1), (True, 2)])
def test_files_are_judged_without_a_reader_only_for_a_report(
    reported: bool, files: int, places: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(places["CAPTURE"], tmp_path / "second.pcapng")
    read: list[str] = []

    def noted(name: str, *args: Any, **options: Any) -> Any:
        read.append(name)
        return bus_in(name, *args, **options)

    monkeypatch.setattr(judged_file, "bus_in", noted)
    report = tmp_path / "report.html"
    more = ["--report", str(report)] if reported else []
    pipe = ClosedPipe(monkeypatch, unbuffered=False)
    assert pipe.main("monitor", places["CAPTURE"], str(tmp_path / "second.pcapng"), *more) == 1
    assert (len(read), report.exists()) == (files, reported)


@pytest.mark.parametrize("unbuffered", [False, True], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("command", ["", *program._COMMANDS])
def test_a_help_whose_reader_has_gone(
    command: str, unbuffered: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pipe = ClosedPipe(monkeypatch, unbuffered=unbuffered)
    assert (pipe.main(*command.split(), "--help"), pipe.ignored) == (1, [])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("unbuffered", "argv"), [("1", ["decode", "CAPTURE", "--json"]), ("", ["--version"])])
def test_a_program_whose_reader_has_gone(unbuffered: str, argv: list[str], places: dict[str, str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "dpstack", *(places.get(word, word) for word in argv)]
    env = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, env=env, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")
