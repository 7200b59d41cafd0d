"""``dpstack capture``: what is on the line gets into the file, with its damage and its gaps, and nothing is sent."""

from __future__ import annotations

import asyncio
import io
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from api_kit import RAW
from cli_kit import Cli
from far_ends import HANG_S, eventually
from plant_files import plant_file

from dpstack.api.listen.listening import ListenedLine, OctetsLost
from dpstack.capture.pcapng import PROFIBUS_DL, Packet, Reader
from dpstack.capture.transmission import Damage, Transmission
from dpstack.cli.listening import port_listener
from dpstack.cli.main import main
from dpstack.fdl.baud_search import BaudFound, Confidence
from dpstack.trace import Event
from tests.cli.listening.speaking_pty import ANSWER, REQUEST, TOKEN, SpeakingPty

T = 1_790_000_000_000_000_000


@pytest.fixture
def short_bus(speaking: SpeakingPty) -> SpeakingPty:
    """It ends the capture of this process after some rounds."""
    speaking.stop_after = 40
    return speaking


def wait_for_octets(path: Path) -> None:
    """Until the capture has written some telegrams to ``path``."""
    eventually(lambda: path.exists() and path.stat().st_size > 2_000, "some telegrams")


def packets(path: Path) -> list[Packet]:
    with path.open("rb") as file:
        return list(Reader(file, path.name))


def test_a_file(cli: Cli, short_bus: SpeakingPty, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    lines = cli.jsons("capture", "--port", short_bus.path, "--baud", "500000", "--write", str(path))
    found = packets(path)
    whole = {TOKEN, REQUEST, ANSWER}
    assert {one.octets for one in found if not one.damage} == whole
    assert lines[0]["event"] == "start"
    summary = lines[-1]
    assert (summary["event"], summary["baud"], summary["gaps"]) == ("summary", 500_000, 0)
    assert summary["telegrams"] == sum(one.octets in whole for one in found)
    assert summary["kept"] == len(found)
    assert (found[0].interface.name, found[0].interface.bits_per_s) == (short_bus.path, 500_000)
    assert short_bus.heard == b""


def test_the_screen_with_a_filter_and_names(cli: Cli, short_bus: SpeakingPty, tmp_path: Path, alone: None) -> None:
    plant = plant_file(tmp_path, {**RAW, "name": "valves", "address": 3})
    listen = ("capture", "--port", short_bus.path, "--baud", "500000")
    out = cli.out(*listen, "--filter", "service==slave_diag", "--config", str(plant))
    shown = [line for line in out.splitlines() if "Slave_Diag" in line]
    assert shown
    assert all("3 [valves]" in line for line in shown)
    assert "token" not in out
    assert " telegrams in " in out.splitlines()[-1]


def test_the_link_type_of_profibus(cli: Cli, short_bus: SpeakingPty, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    args = ("--port", short_bus.path, "--baud", "500000", "--write", str(path), "--linktype", "257")
    assert "show only octets" in cli("capture", *args)[1]
    assert packets(path)[0].interface.linktype == PROFIBUS_DL


def test_an_existing_file_is_kept(cli: Cli, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    path.write_bytes(b"mine")
    assert "there is a file of that name" in cli.err("capture", "--port", "/dev/none", "--write", str(path))
    assert path.read_bytes() == b"mine"


def test_no_file_is_left_where_the_port_cannot_be_opened(cli: Cli, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    assert "no such port" in cli.err("capture", "--port", "/dev/none", "--write", str(path), code=1)
    assert not path.exists()


def test_a_ring_of_triggered_windows(cli: Cli, short_bus: SpeakingPty, tmp_path: Path, alone: None) -> None:
    name = tmp_path / "ring.pcapng"
    args = ("--port", short_bus.path, "--baud", "500000", "--write", str(name), "--ring", "2", "--size", "0.001")
    summary = cli.json("capture", *args, "--trigger", "dc 02 02", "--before", "0", "--after", "0")
    files = sorted(tmp_path.iterdir())
    assert [str(path) for path in files] == summary["files"]
    assert len(files) == 2
    found = [one for path in files for one in packets(path)]
    triggered = [one for one in found if any(text.endswith("trigger: dc 02 02") for text in one.comments)]
    assert triggered
    assert {one.octets for one in triggered} == {TOKEN}
    assert any("2 transmissions before this one were not kept" in one.comments[0] for one in found if one.comments)
    assert 0 < summary["windows"] <= summary["kept"] < summary["telegrams"]
    assert summary["triggers"]["dc 02 02"] >= summary["windows"]


def test_the_screen_around_a_trigger(cli: Cli, short_bus: SpeakingPty, alone: None) -> None:
    args = ("--port", short_bus.path, "--baud", "500000")
    lines = cli.jsons("capture", *args, "--trigger", "station 3", "--before", "0", "--after", "0")
    services = [line["service"] for line in lines if line.get("service")]
    assert services.count("Slave_Diag") > services.count("token")
    assert lines[-1]["windows"] >= 1
    assert next(line["number"] for line in lines if line.get("event") == "trigger") == 1


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("--ring", "3", "--write", "x"), "--ring and --size belong together"),
        (("--ring", "3", "--size", "1"), "--ring needs --write FILE"),
        (("--ring", "3", "--size", "1", "--write", "-"), "--ring needs --write FILE"),
        (("--before", "1"), "--before and --after need a --trigger"),
        (("--ring", "1"), "number of files from 2 on"),
        (("--trigger", "nonsense"), "there are back, diagnosis, left, lost"),
        (("--linktype", "1"), "invalid choice: 1"),
        (("--config", "/nowhere/plant.toml"), "/nowhere/plant.toml"),
    ],
)
def test_options_that_do_not_go_together(cli: Cli, args: tuple[str, ...], text: str) -> None:
    assert text in cli.err("capture", "--port", "/dev/none", *args)


def test_a_port_that_vanishes_and_comes_back(cli: Cli, speaking: SpeakingPty, tmp_path: Path, alone: None) -> None:
    port, path = tmp_path / "port", tmp_path / "a.pcapng"
    port.symlink_to(speaking.path)
    again: list[SpeakingPty] = []

    def replug() -> None:
        wait_for_octets(path)
        port.unlink()
        speaking.end()
        again.append(SpeakingPty())
        port.symlink_to(again[0].path)
        end = time.monotonic() + HANG_S
        while b"gap: " not in path.read_bytes() and time.monotonic() < end:
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    replugging = threading.Thread(target=replug)
    replugging.start()
    args = ("capture", "--port", str(port), "--baud", "500000", "--write", str(path))
    lines = cli.jsons(*args)
    replugging.join()
    again[0].end()
    assert [line["event"] for line in lines if line["event"] in ("gap", "port")] == ["gap", "port"]
    assert lines[-1]["gaps"] == 1
    (told,) = (one for one in packets(path) if one.comments and one.comments[0].startswith("gap: "))
    assert "vanished" in told.comments[0]


def test_standard_output_carries_the_file(
    short_bus: SpeakingPty, capfdbinary: pytest.CaptureFixture[bytes], alone: None
) -> None:
    assert main(["capture", "--port", short_bus.path, "--baud", "500000", "--write", "-"]) == 0
    out, err = capfdbinary.readouterr()
    found = list(Reader(io.BytesIO(out), "-"))
    assert {one.octets for one in found if not one.damage} == {TOKEN, REQUEST, ANSWER}
    assert f"dpstack: {len(found)} transmissions kept in standard output" in err.decode()


class Forked:
    """``dpstack ARGS`` in a fork of this process, its output in ``path``; ``most``: the size of its files at most."""

    def __init__(self, path: Path, *args: str, most: int = -1) -> None:
        self._path = path
        self.pid = os.fork()
        if self.pid == 0:
            code = 99
            try:
                out = os.open(path, os.O_WRONLY | os.O_CREAT)
                os.dup2(out, 1)
                os.dup2(out, 2)
                sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
                resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
                code = main(args)
            finally:
                os._exit(code)

    def end(self) -> int:
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])

    @property
    def out(self) -> str:
        return self._path.read_text(encoding="utf-8")


def test_killed_and_on_a_full_disk(speaking: SpeakingPty, tmp_path: Path, alone: None) -> None:
    """Killed, a file is readable to its last whole block. A full disk ends the capture with one line."""
    killed, full = tmp_path / "killed.pcapng", tmp_path / "full.pcapng"
    args = ("capture", "--port", speaking.path, "--baud", "500000", "--write")
    program = Forked(tmp_path / "1", *args, str(full), most=6_000)
    assert program.end() == 1
    lines = program.out.splitlines()
    assert sum("cannot be written" in line for line in lines) == 1
    assert lines[-1].endswith(
        "full.pcapng: cannot be written (File too large); make room there, or name a file elsewhere"
    )
    assert "lost chunks: 0" in lines[-2]
    assert 5_000 < full.stat().st_size <= 6_000
    program = Forked(tmp_path / "2", *args, str(killed))
    wait_for_octets(killed)
    os.kill(program.pid, signal.SIGKILL)
    assert program.end() == -signal.SIGKILL
    for path in (killed, full):
        assert {TOKEN, REQUEST, ANSWER} <= {one.octets for one in packets(path)}


def test_signals_end_it_in_order(speaking: SpeakingPty, tmp_path: Path, alone: None) -> None:
    path = tmp_path / "a.pcapng"
    program = Forked(tmp_path / "1", "capture", "--port", speaking.path, "--baud", "500000", "--write", str(path))
    wait_for_octets(path)
    os.kill(program.pid, signal.SIGTERM)
    assert program.end() == 0
    assert f"{len(packets(path))} transmissions kept in {path}" in program.out


class ScriptedLine:
    """Stands for a line on which things happen that no pty can do."""

    line = ListenedLine("/dev/ttyUSB0", "adapter", None, 500_000, paced=True, damaged="octets are marked")

    def __init__(
        self,
        _port: str,
        _baud: int | None,
        on_transmission: Callable[[Transmission], None],
        on_event: Callable[[Event], None],
        *,
        own: bool,
    ) -> None:
        assert own
        self._heard, self._event = on_transmission, on_event
        self._damage: dict[str, int] = {}

    async def __aenter__(self) -> ScriptedLine:
        return self

    async def __aexit__(self, *_: object) -> None: ...

    def damage(self) -> dict[str, int]:
        return self._damage

    async def ended(self) -> None:
        self._heard(Transmission(TOKEN, T, 500_000))
        self._event(OctetsLost(t_ns=0, count=3, port="p"))
        self._heard(Transmission(REQUEST, T + 1, 500_000))
        self._event(
            BaudFound(t_ns=0, baud=1_500_000, listened_ns=1, confidence=Confidence.CHECKED, telegrams=2, tried=1)
        )
        self._heard(Transmission(ANSWER[:5], T + 2, 1_500_000, "octet 2", Damage.TOO_SHORT))
        self._damage = {"overrun": 7, "marked": 2}
        await asyncio.Event().wait()


def test_gaps_rates_and_damage_are_in_the_file(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_listener, "Listening", ScriptedLine)
    path = tmp_path / "a.pcapng"
    lines = cli.jsons("capture", "--port", "x", "--write", str(path), "--seconds", "0.05")
    token, request, answer = packets(path)
    assert (token.comments, token.flags, token.interface.bits_per_s) == ((), 0, 500_000)
    assert "8 data bits, even parity; times by adapter, resolution 1000 us; octets are marked" in (
        token.interface.description
    )
    assert request.comments == (f"gap: {OctetsLost(t_ns=0, count=3, port='p').text}",)
    assert (answer.flags, answer.interface.bits_per_s) == (1 << 26, 1_500_000)
    assert answer.comments == (
        "gap: the bus runs at 1.5 Mbit/s, recognised by telegrams with check sum; what was sent during the search for "
        "the rate is missing; damaged: too short; octet 2",
    )
    summary = lines[-1]
    assert (summary["gaps"], summary["lost_chunks"], summary["kept"]) == (3, 3, 3)
    assert summary["port_damage"] == {"overrun": 7, "marked": 2}
    assert b"7 octets were lost within the last 1 s" in path.read_bytes()[-500:]
