"""``--report`` of monitor and run: the figures of the same bus, a new file or none, never the end of a run."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
from pathlib import Path
from typing import Any

import pytest
from bus_kit import SimBus
from cli_kit import Cli
from page_kit import Page
from programs import Starter, plant_of
from support import S

from dpstack.api.listen import report_file
from dpstack.capture.listener import Listener
from dpstack.capture.recording import PortAbout, Recording
from dpstack.capture.timing import TAP
from dpstack.params import BusParams
from dpstack.sim.world import World


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A second of a bus with two slaves."""
    path = tmp_path_factory.mktemp("capture") / "bus.pcapng"
    world = World(keep=10, referee=False)
    SimBus(world, BusParams.preset(93_750, address=2), [3, 4])
    with path.open("wb") as file:
        recording = Recording(file, "a test", PortAbout("seg", TAP, True, True))
        world.add(Listener(world.now, recording.add, baud=93_750, epoch_ns=1_800_000_000 * S), name="listener")
        world.run_for(S)
        recording.close(1_800_000_000 * S + world.now)
    return str(path)


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first octets of a report still fit, no more."""
    real = os.write
    written: list[int] = []

    class Disk:
        def __getattr__(self, name: str) -> Any:
            return getattr(os, name)

        def write(self, fd: int, octets: bytes) -> int:
            if written:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            written.append(fd)
            return real(fd, bytes(octets[:100]))

    monkeypatch.setattr(report_file, "os", Disk())


def _rows(page: Page, caption: str) -> dict[str, list[str]]:
    """The rows of a table by their headers; the table after ``caption``."""
    rows: dict[str, list[str]] = {}
    head, within = "", False
    for element in page.elements:
        text = element.text.strip()
        if element.tag == "caption":
            within = text == caption
        elif within and element.tag == "th" and element.attributes["scope"] == "row":
            head = text
            rows[head] = []
        elif within and element.tag == "td":
            rows[head].append(text)
    return rows


def test_monitor_of_a_file(capture: str, cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    summary = cli.json("monitor", capture, "--report", str(path))
    page = Page.of(path.read_text(encoding="utf-8"))
    assert page.faults == []
    counted = _rows(page, "Requests and answers")
    assert counted.keys() == summary["stations"].keys() == {"2", "3", "4"}
    for address, station in summary["stations"].items():
        assert counted[address][:4] == [str(station[key]) for key in ("requests", "answers", "damaged", "no_answer")]
    assert _rows(page, "Thresholds").keys() == summary["thresholds"].keys()
    assert len(_rows(page, "Telegrams of this rotation")) >= 5
    assert capture in page.text
    again = cli.json("monitor", capture)
    assert again == summary


def test_a_file_that_is_there_is_kept(capture: str, cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "signed.html"
    path.write_text("signed by the customer", encoding="utf-8")
    plant = str(plant_of(tmp_path))
    for command in (["monitor", capture], ["run", plant]):
        told = cli.err(*command, "--report", str(path))
        assert told == f"dpstack: {path}: there is a file of that name; give the name of a new file\n"
    assert path.read_text(encoding="utf-8") == "signed by the customer"


def test_places_that_cannot_be_written_are_refused_before_anything_begins(
    capture: str, cli: Cli, tmp_path: Path
) -> None:
    plant = str(plant_of(tmp_path))
    for place in (tmp_path, tmp_path / "no" / "report.html", Path("/dev/null")):
        for command in (["monitor", capture, "--json"], ["run", plant, "--json"]):
            out, err = cli(*command, "--report", str(place), code=2)
            assert out == ""
            assert err.startswith(f"dpstack: {place}: ")
            assert err.count("\n") == 1


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_is_one_line(capture: str, cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    out, err = cli("monitor", capture, "--json", "--report", str(path))
    assert json.loads(out.splitlines()[-1])["event"] == "summary"
    assert err == f"dpstack: {path}: the report cannot be written (No space left on device); make room there\n"
    assert not path.exists()


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_does_not_change_the_end_of_a_run(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    out, err = cli("run", str(plant_of(tmp_path)), "--seconds", "0.05", "--json", "--report", str(path))
    assert json.loads(out.splitlines()[-1])["event"] == "summary"
    assert "the report cannot be written (No space left on device)" in err
    assert not path.exists()


def test_the_report_of_a_run_counts_what_the_master_counts(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    summary = cli.json("run", str(plant_of(tmp_path)), "--seconds", "0.2", "--report", str(path))
    page = Page.of(path.read_text(encoding="utf-8"))
    assert page.faults == []
    counted = _rows(page, "Requests and answers")
    for address, slave in summary["slaves"].items():
        answers = int(counted[address][1])
        # bring-up, diagnoses and GAP polls come to the exchanges; some went on until the tap ended
        assert slave["exchanges"] < answers < 1.2 * slave["exchanges"] + 30
        assert slave["name"] in _rows(page, "Stations")[address]
    parameters = re.search(r"t_sl (\d+), min_tsdr \d+", page.text)
    assert parameters is not None
    assert int(parameters[1]) >= 100
    assert "Set_Prm heard" in page.text
    assert "this bus was simulated by dpstack" in page.text


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.soak)])
def test_a_run_that_a_signal_ends_has_its_report(start: Starter, tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "report.html"
    run = start("run", str(plant_of(tmp_path)), "--json", "--report", str(path))
    run.wait_for_slaves(3)
    assert run.end(number) == 0
    assert path.read_text(encoding="utf-8").endswith("</html>\n")
    assert run.lines[-1]["event"] == "summary"


def test_a_run_that_never_began_leaves_no_file(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    plant = str(plant_of(tmp_path, "/dev/nothing-there"))
    cli.err("run", plant, "--report", str(path), code=1)
    assert not path.exists()
