"""``dpstack monitor`` on capture files and on ports: summary, verdicts, names, files that cannot be read;
``--report`` of monitor and run: the figures of the same bus, a new file or none, never the end of a run."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import os
import re
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW
from bus_kit import SimBus
from cli_kit import Cli
from page_kit import Page
from plant_files import plant_file
from programs import Starter, plant_of
from rich.console import Console
from support import MS, S

from dpstack.api.listen import report_file
from dpstack.api.listen.listening import keep_listening
from dpstack.capture.listener import Listener
from dpstack.capture.pcapng import Writer
from dpstack.capture.recording import Gaps, PortAbout, Recording
from dpstack.capture.timing import ADAPTER, TAP, timing_of
from dpstack.capture.transmission import Transmission
from dpstack.cli.listening.monitor_view import LiveView
from dpstack.decode.source import read_transmissions
from dpstack.monitor.monitor import Monitor
from dpstack.params import BusParams
from dpstack.sim.world import World
from tests.cli.listening.speaking_pty import SpeakingPty

EPOCH = 1_800_000_000 * S
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, str]:
    """One bus of a master and slaves 3, 4 and 5: 8 s in order, once with exact times, once as an adapter times it; and
    the same with slave 4 switched off for 200 ms and again at the end."""
    folder = tmp_path_factory.mktemp("captures")
    world = World(keep=10, referee=False)
    bus = SimBus(world, BusParams.preset(93_750, address=2), [3, 4, 5])
    names = ("exact", "adapter", "lost")
    with contextlib.ExitStack() as stack:
        files = {name: stack.enter_context((folder / f"{name}.pcapng").open("wb")) for name in names}
        heard: list[Recording] = []

        def hear(one: Transmission) -> None:
            for recording in heard:
                recording.add(one)

        for name, file in files.items():
            exact = name != "adapter"
            heard.append(Recording(file, "a test", PortAbout("seg", TAP if exact else ADAPTER, True, exact)))
        made = list(heard)
        world.add(Listener(world.now, hear, baud=93_750, epoch_ns=EPOCH), name="listener")
        world.run_for(8 * S)
        del heard[:2]
        world.silence(bus.slaves[4], 200 * MS)
        world.run_for(1 * S)
        world.silence(bus.slaves[4], 60 * S)
        world.run_for(13 * S)
        for recording in made:
            recording.close(EPOCH + world.now)
    return {name: str(folder / f"{name}.pcapng") for name in names}


#: the keys of the interface; others may be added, none renamed
SUMMARY = "event time baud seconds telegrams load damaged unattributed timing masters stations verdict reasons"
MASTER = "mode token_us rotation_us hold_us gap_polls drops slaves"
STATION = """role name ident model state master requests answers damaged no_answer repetitions retry_depth
repeated_polls late rs rr diagnoses diagnosis syncs lost max_tsdr tsdr_us verdict reasons"""


def test_the_keys_of_the_summary(captures: Mapping[str, str], cli: Cli) -> None:
    summary = cli.json("monitor", captures["exact"])
    assert set(SUMMARY.split()) <= summary.keys()
    assert set(summary["timing"]) == {"source", "resolution_us", "batched"}
    assert set(MASTER.split()) <= summary["masters"]["2"].keys()
    for station in summary["stations"].values():
        assert set(STATION.split()) <= station.keys()
        assert station["requests"] == station["answers"] + station["damaged"] + station["no_answer"]
        assert len(station["retry_depth"]) >= 2


def test_a_bus_in_order(captures: Mapping[str, str], cli: Cli) -> None:
    lines = cli.jsons("monitor", captures["exact"])
    summary = lines[-1]
    states = [(line["address"], line["state"]) for line in lines if line["event"] == "slave"]
    assert states == [(address, "data_exchange") for address in (3, 4, 5)]
    assert (summary["verdict"], summary["reasons"], summary["profibus"]) == ("good", [], True)
    assert summary["timing"] == {"source": "tap", "resolution_us": 0.001, "batched": 0.0}
    assert (summary["baud"], summary["damaged"], summary["unattributed"]) == (93_750, {}, 0)
    master = summary["masters"]["2"]
    assert (master["mode"], master["slaves"], master["drops"]) == ("operate", [3, 4, 5], 0)
    assert 0 < master["rotation_us"]["min"] <= master["rotation_us"]["mean"] <= master["rotation_us"]["max"]
    station = summary["stations"]["4"]
    assert station["requests"] == station["answers"] >= 200
    # T_SDR of the simulated slaves: 11 bit times
    assert station["tsdr_us"] == dict.fromkeys(("min", "p50", "p99", "max"), pytest.approx(11 / 0.09375, abs=0.1))
    assert (station["ident"], station["state"], station["verdict"]) == ("0x1234", "data_exchange", "good")


def test_an_adapter_times_no_single_answer(captures: Mapping[str, str], cli: Cli) -> None:
    summary = cli.json("monitor", captures["adapter"])
    assert summary["timing"]["source"] == "adapter"
    assert summary["timing"]["resolution_us"] >= 1000  # more where this computer reads late
    assert {one["tsdr_us"] for one in summary["stations"].values()} == {None}
    assert summary["masters"]["2"]["rotation_us"]["mean"] > 0
    assert "-  " in cli.out("monitor", captures["adapter"])


def test_a_slave_that_is_lost(captures: Mapping[str, str], cli: Cli) -> None:
    lines = cli.jsons("monitor", captures["lost"], code=1)
    told = [(line["address"], line["state"]) for line in lines[:-1] if line["event"] == "slave"]
    assert [state for address, state in told if address == 4 and state in ("offline", "data_exchange")] == [
        "data_exchange",
        "offline",
        "data_exchange",
        "offline",
    ]
    station = lines[-1]["stations"]["4"]
    assert (station["verdict"], station["lost"], station["syncs"]) == ("critical", 2, 2)
    assert "does not answer any more: look at its power" in station["reasons"][0]
    assert lines[-1]["stations"]["3"]["verdict"] == "good"
    assert lines[-1]["verdict"] == "critical"
    out = cli.out("monitor", captures["lost"], code=1)
    assert "station 4: left data exchange\n" in out
    assert "verdict: critical\n" in out
    assert "listening cannot see: voltage levels" in out


def test_names_of_a_configuration_and_models_of_gsd_files(
    captures: Mapping[str, str], cli: Cli, tmp_path: Path
) -> None:
    config = plant_file(tmp_path, {**RAW, "name": "valves", "address": 3, "config": "F3 F1"}, baud=93_750)
    gsd = '#Profibus_DP\nGSD_Revision = 1\nVendor_Name = "Acme"\nModel_Name = "Mirror"\nIdent_Number = 0x1234\n'
    (tmp_path / "mirror.gsd").write_text(f"{gsd}93.75_supp = 1\nMaxTsdr_93.75 = 60\n")
    (tmp_path / "empty.gsd").write_text("")
    out, err = cli("monitor", captures["exact"], "--config", str(config), "--gsd", str(tmp_path), "--json")
    assert '"name":"valves"' in out
    assert err.count("skipped") == 1
    assert "empty.gsd" in err
    summary: Any = cli.json("monitor", captures["exact"], "--gsd", str(tmp_path))
    assert (summary["stations"]["5"]["model"], summary["stations"]["5"]["max_tsdr"]) == ("Acme Mirror", 60)


def test_thresholds_of_a_file(captures: Mapping[str, str], cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("min_seconds = 3600\n")
    summary = cli.json("monitor", captures["exact"], "--thresholds", str(path))
    assert (summary["verdict"], summary["thresholds"]["min_seconds"]) == ("unknown", 3600)
    assert "too little was heard: " in summary["reasons"][0]
    path.write_text("\nretry_warning = 3\n")
    assert cli.err("monitor", captures["exact"], "--thresholds", str(path)) == (
        f"dpstack: {path}:2: thresholds: unknown key 'retry_warning'; did you mean 'retries_warning'?\n"
    )


def test_files_that_are_cut_or_without_a_rate(captures: Mapping[str, str], cli: Cli, tmp_path: Path) -> None:
    cut = tmp_path / "cut.pcapng"
    cut.write_bytes(Path(captures["exact"]).read_bytes()[:-5])
    out, err = cli("monitor", str(cut), code=1)
    assert "verdict: good" in out
    assert "the file ends within a block" in err
    with (tmp_path / "rate.pcapng").open("wb") as file:
        writer = Writer(file, "a test")
        writer.packet(writer.interface("p", 0, ""), EPOCH, b"\xdc\x02\x02")
    assert "give it, for instance --baud 500000" in cli.err("monitor", file.name)
    summary = cli.json("monitor", file.name, "--baud", "19200")
    assert (summary["baud"], summary["timing"]["source"], summary["verdict"]) == (19_200, "file", "unknown")
    assert "give either a capture file or --port" in cli.err("monitor")
    assert "No such file" in cli.err("monitor", str(tmp_path / "none"))


def test_the_thresholds_are_in_the_documents() -> None:
    from dpstack.monitor.thresholds import limits

    page = (ROOT / "docs" / "how-to" / "monitor.md").read_text(encoding="utf-8")
    rows = [f"| `{one.name}` | {one.default:g} | {one.unit} | {one.text} | {one.source} |\n" for one in limits()]
    assert page.partition("<!-- thresholds -->\n")[2].partition("<!-- end -->")[0].splitlines(True)[2:] == rows


def test_a_port_is_listened_to_and_never_written(cli: Cli, speaking: SpeakingPty, alone: None) -> None:
    lines = cli.jsons("monitor", "--port", speaking.path, "--baud", "500000", "--seconds", "0.12")
    start = lines[0]
    assert [start[key] for key in ("event", "baud", "source", "program")] == ["start", 500_000, "host", None]
    summary = lines[-1]
    assert summary["stations"]["3"]["answers"] > 2
    assert summary["timing"]["resolution_us"] >= 1000  # more where this computer reads late
    assert summary["stations"]["3"]["tsdr_us"] is None
    assert summary["verdict"] == "unknown"
    out = cli.out("monitor", "--port", speaking.path, "--baud", "500000", "--seconds", "0.05")
    assert out.startswith(f"listening on {speaking.path}, 500 kbit/s; Ctrl-C ends\n")
    assert "too little was heard" in out
    assert speaking.heard == b""


def test_the_seconds_begin_when_the_port_is_open(
    cli: Cli, speaking: SpeakingPty, alone: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def slow(*ways: Any) -> None:
        await asyncio.sleep(0.1)
        await keep_listening(*ways)

    monkeypatch.setattr("dpstack.cli.listening.port_listener.keep_listening", slow)
    summary = cli.jsons("monitor", "--port", speaking.path, "--baud", "500000", "--seconds", "0.12")[-1]
    assert summary["seconds"] >= 0.12


@pytest.mark.parametrize(("columns", "lines"), [(40, 12), (60, 10), (120, 40)])
def test_the_live_list_fits_the_terminal(
    columns: int, lines: int, captures: Mapping[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("LINES", str(lines))
    monitor = Monitor(timing_of(TAP, 93_750, exact=True))
    with open(captures["lost"], "rb") as file:
        for one in read_transmissions(file, "lost"):
            monitor.add(one)
    console = Console(width=columns, height=lines)
    drawn = console.render_lines(LiveView(monitor, "/dev/ttyUSB0").picture(monitor.counters.ended_ns))
    text = ["".join(segment.text for segment in row).rstrip() for row in drawn]
    assert len(text) <= lines
    assert all(len(row) <= columns for row in text)
    shown = "\n".join(text)
    assert "critical" in shown
    assert any(row.startswith(("│ 4 ", "│ 4")) for row in text), shown
    if lines == 40:
        assert "station 4: left data exchange" in shown
        assert "│ 3 " in shown
    else:
        assert "the window is too small" in " ".join(shown.split())


def test_a_file_of_two_ports_is_judged_by_the_first(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "two.pcapng"
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        ports = [writer.interface(name, 500_000, "") for name in ("left", "right")]
        for number in range(6):
            writer.packet(ports[number % 2], EPOCH + number * MS, bytes((0xDC, number % 2, number % 2)))
    out, err = cli("monitor", str(path), "--json")
    assert err == f"dpstack: {path}: only the port 'left' is read; left out: 'right'\n"
    summary = json.loads(out.splitlines()[-1])
    assert (summary["telegrams"], list(summary["masters"])) == (3, ["0"])


def test_a_pasted_log_is_judged_and_its_other_lines_are_counted(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("DPM1: hello\nTX: 10 03 02 49 4E 16\nRX: 10 02 03 00 05 16\n")
    out, err = cli("monitor", str(tmp_path / "a.log"), "--baud", "500000", "--json")
    *events, summary = map(json.loads, out.splitlines())
    assert summary["telegrams"] == 2
    assert not [event for event in events if "TX" in str(event)]
    assert "dpstack: 1 line without octets: 1\n" in err


def test_gaps_and_remarks_of_a_capture(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "gap.pcapng"
    with path.open("wb") as file:
        gaps = Gaps()
        recording = Recording(file, "a test", PortAbout("seg", TAP, True, True), gaps)
        for number in range(4):
            recording.add(Transmission(b"\xdc\x02\x02", EPOCH + number * MS, 93_750))
        gaps.add("the port was lost", 3)
        recording.add(Transmission(b"\xdc\x02\x02", EPOCH + 100 * S, 93_750), gap=gaps.take())
        recording.add(Transmission(b"\xdc\x02\x02", EPOCH + 100 * S + MS, 93_750), remark="the pump started")
        recording.close(EPOCH + 101 * S)
    lines = cli.jsons("monitor", str(path))
    start = {"event": "start", "time": "2027-01-15T08:00:00.000Z", "file": str(path), "port": "seg", "baud": 93_750}
    assert lines[0] == {**start, "source": "tap"}
    told = [(line["event"], line["t"], line["text"]) for line in lines if line["event"] in ("gap", "notice")]
    assert told == [("gap", 100.0, "the port was lost"), ("notice", 100.001, "the pump started")]
    # 100 s without an octet are no time of listening, and no drop-out of the master
    assert lines[-1]["seconds"] < 0.01
    assert lines[-1]["masters"]["2"]["drops"] == 0
    assert lines[-1]["masters"]["2"]["token_us"]["max"] == 1000


def test_standing_diagnoses_are_not_heard_while_nobody_asks_for_them(cli: Cli, tmp_path: Path) -> None:
    """6 s in which master 2 exchanges data with slave 5, in literal telegrams, and reads no diagnosis."""
    path, report = tmp_path / "bus.pcapng", tmp_path / "report.html"
    telegrams = ["DC 02 02", "10 05 02 5D 64 16", "68 04 04 68 02 05 08 33 42 16"]
    telegrams += ["DC 02 02", "10 05 02 7D 84 16", "68 04 04 68 02 05 08 33 42 16"]
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        port = writer.interface("seg", 500_000, "")
        for number, octets in enumerate([*telegrams * 500, "68 07 07 68 FF 82 46 3A 3E 00 00 3F 16"]):
            writer.packet(port, EPOCH + number * 2 * MS, bytes.fromhex(octets))
    out = cli.out("monitor", str(path), "--report", str(report))
    assert "verdict: good, as far as heard\n" in out
    assert "not heard: standing diagnoses of 5: no Slave_Diag was on the wire\n" in out
    summary = cli.json("monitor", str(path))
    assert (summary["verdict"], summary["stations"]["5"]["verdict"]) == ("good", "good")
    assert summary["stations"]["5"]["not_heard"] == ["diagnosis", "parameters"]
    assert summary["not_heard"] == [
        "standing diagnoses of 5: no Slave_Diag was on the wire",
        "parameters of 5 (watchdog, groups, user parameters): no Set_Prm was on the wire",
    ]
    page = Page.of(report.read_text(encoding="utf-8"))
    assert page.faults == []
    for text in ("No reason to object, as far as heard.", "good, as far as heard", *summary["not_heard"]):
        assert text in page.text
    assert _rows(page, "Diagnosis of each slave")["5"][1:] == ["no Slave_Diag was heard", "diagnosis, parameters"]


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
    """The rows of a table by their headers, several with the same in one; the table after ``caption``."""
    rows: dict[str, list[str]] = {}
    head, within = "", False
    for element in page.elements:
        text = element.text.strip()
        if element.tag == "caption":
            within = text == caption
        elif within and element.tag == "th" and element.attributes["scope"] == "row":
            head = text
            rows.setdefault(head, [])
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


def test_the_report_of_a_run_has_modules_standing_diagnoses_and_identification(cli: Cli, tmp_path: Path) -> None:
    """The words are those of examples/terminal.gsd and of the step: a line break of slot 4."""
    valves = {"name": "valves", "address": 8, "gsd": str(ROOT / "examples" / "terminal.gsd")}
    valves |= {"modules": ["8 DO", "8 DI", "", "4 AI"]}
    plant = plant_file(tmp_path, valves, RAW)
    steps = tmp_path / "steps.toml"
    steps.write_text(
        '[[step]]\nat = 0.05\nslave = "valves"\ndo = "diagnosis"\nwhat = "slot 4 channel 1 line break"\n',
        encoding="utf-8",
    )
    path = tmp_path / "report.html"
    cli.json("run", str(plant), "--seconds", "0.3", "--scenario", str(steps), "--report", str(path))
    page = Page.of(path.read_text(encoding="utf-8"))
    assert page.faults == []
    slots = _rows(page, "Slots of each slave")
    assert slots["8"][:6] == ["valves", "1", "8 DO", "20", "", "0"]
    assert slots["8"][-6:] == ["valves", "4", "4 AI", "43 43 01 02 03", "1 to 8", ""]
    standing = _rows(page, "Diagnoses that stood at the end of the run")
    assert standing.keys() == {"8"}
    channel, slot = standing["8"][:7], standing["8"][7:]
    assert channel[:-1] == ["valves", "4", "1", "inputs", "bad", "line break: slot 4 (4 AI), input channel 1"]
    assert slot[:-1] == ["valves", "4", "", "inputs", "uncertain", "data invalid: slot 4 (4 AI)"]
    assert float(channel[-1]) >= 0.05
    assert "Standing diagnoses at the end of the run: 2." in page.text
    inventory = _rows(page, "Inventory")
    assert inventory["8"][:6] == ["valves", "0x1A2B", "Nobody & Sons", "Terminal 8", "0", "T8-001"]
    assert inventory["9"][-1] == "configured without DP-V1"
    assert "Not heard, and so not judged" not in page.text


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
