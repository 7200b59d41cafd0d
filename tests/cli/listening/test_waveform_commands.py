"""``decode``, ``monitor`` and ``capture --from`` read a file of a logic analyser as they read a capture."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
from cli_kit import Cli
from waveforms import TELEGRAMS, line, sampled, session

from dpstack.capture.pcapng import Packet, Reader, Writer
from dpstack.capture.transmission import Damage
from dpstack.cli.main import main
from dpstack.units import NS_PER_S

FOUND = "channel 'D0', 500 kbit/s, 4 MS/s, 8 samples a bit\n"


@pytest.fixture
def recorded(tmp_path: Path) -> str:
    """Ten token holds in 4 MS/s."""
    path = tmp_path / "bus.sr"
    path.write_bytes(session(sampled(line(TELEGRAMS * 10), 500_000, 4_000_000), "4 MHz"))
    return str(path)


def packets(path: Path) -> list[Packet]:
    with path.open("rb") as file:
        return list(Reader(file, path.name))


def test_a_recorded_bus_becomes_a_capture_with_the_times_of_its_samples(
    cli: Cli, tmp_path: Path, recorded: str
) -> None:
    path = tmp_path / "bus.pcapng"
    start, summary = cli.jsons("capture", "--from", recorded, "--write", str(path))
    assert {key: start[key] for key in ("event", "port", "baud", "source")} == {
        "event": "start",
        "port": recorded,
        "baud": 500_000,
        "source": "waveform",
    }
    assert (summary["telegrams"], summary["kept"], summary["files"]) == (40, 40, [str(path)])
    found = packets(path)
    assert [one.octets for one in found] == [*TELEGRAMS] * 10
    assert (found[0].t_ns, found[1].t_ns) == (37 * 2000, (37 + 11 * 11 + 37) * 2000)
    interface = found[0].interface
    assert (interface.name, interface.bits_per_s) == ("D0", 500_000)
    assert interface.description == "D0, 500 kbit/s, 8 data bits, even parity; times by waveform, resolution 0.25 us"
    same = cli("decode", recorded)
    assert same == (cli.out("decode", str(path)), f"dpstack: {recorded}: {FOUND}")


def test_a_recorded_bus_is_timed_to_the_sample(cli: Cli, recorded: str) -> None:
    summary = cli.jsons("monitor", recorded)[-1]
    assert summary["timing"] == {"source": "waveform", "resolution_us": 0.25, "batched": 0.0}
    assert (summary["baud"], summary["time"]) == (500_000, None)
    # 37 bits after the request
    assert summary["stations"]["5"]["tsdr_us"]["p50"] == pytest.approx(74, abs=0.3)


def test_capture_from_a_file_filters_and_stops_by_its_times(cli: Cli, tmp_path: Path, recorded: str) -> None:
    path = tmp_path / "kept.pcapng"
    hold = sum(37 + 11 * len(one) for one in TELEGRAMS) / 500_000
    words = ("--filter", "service == Data_Exchange and request", "--seconds", f"{3.5 * hold:.6f}")
    cli.out("capture", "--from", recorded, "--write", str(path), *words)
    assert [one.octets for one in packets(path)] == [TELEGRAMS[0]] * 4
    out = cli.out("capture", "--from", recorded, "--trigger", "68 05 05 68 02", "--before", "0", "--after", "0")
    assert out.splitlines()[0] == f"reading {recorded}, D0, 500 kbit/s"
    assert "    0.000 s  trigger 1: " in out
    assert "40 telegrams in 0.0 s; damaged: none" in out


def test_capture_from_a_capture_keeps_times_damage_and_comments(cli: Cli, tmp_path: Path) -> None:
    old, new = tmp_path / "old.pcapng", tmp_path / "new.pcapng"
    with old.open("wb") as file:
        writer = Writer(file, "a test")
        ports = [writer.interface(name, 500_000, "times by tap, resolution 1000 us") for name in ("one", "two")]
        begin = 1_790_000_000 * NS_PER_S
        for number, telegram in enumerate(TELEGRAMS):
            writer.packet(ports[number == 3], begin + number, telegram)
        writer.packet(ports[0], begin + 9, b"\x68", Damage.TOO_SHORT, "gap: the port was lost; damaged: too short")
    out, err = cli("capture", "--from", str(old), "--write", str(new))
    assert err == f"dpstack: {old}: only the port 'one' is read; left out: 'two'\n"
    *sent, last = packets(new)
    assert [(one.octets, one.t_ns) for one in sent] == [(one, begin + n) for n, one in enumerate(TELEGRAMS[:3])]
    assert (last.flags, last.comments) == (Damage.TOO_SHORT, ("gap: the port was lost; damaged: too short",))
    assert "times by tap, resolution 1000 us" in last.interface.description
    assert "4 transmissions kept in" in out


def test_a_file_that_ends_within_a_row_is_kept_up_to_there(cli: Cli, tmp_path: Path) -> None:
    table, kept = tmp_path / "bus.csv", tmp_path / "bus.pcapng"
    samples = sampled(line(TELEGRAMS * 4), 500_000, 4_000_000)
    head = b"; Channels (1/1): D0\n; Samplerate: 4 MHz\nlogic\n"
    table.write_bytes(head + b"".join(b"%d\n" % level for level in samples) + b"7")
    assert "the file ends within a row" in cli.err("capture", "--from", str(table), "--write", str(kept), code=1)
    assert len(packets(kept)) == 16


def test_waveforms_come_through_pipes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli, recorded: str) -> None:
    read, write = os.pipe()
    os.write(write, Path(recorded).read_bytes())
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=pipe))
        out, err = cli("decode", "-", "--json")
    assert [json.loads(row)["octets"] for row in out.splitlines()][:4] == [one.hex() for one in TELEGRAMS]
    assert err == f"dpstack: standard input: {FOUND}"


def test_names_of_channels_reach_the_terminal_escaped(tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "bus.sr"
    path.write_bytes(session(sampled(line(TELEGRAMS * 3), 500_000, 4_000_000), "4 MHz", ["D\x1b[31m\u202e0"]))
    out, err = cli("monitor", str(path))
    assert "\x1b" not in out + err
    assert "\u202e" not in out + err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["capture"], "capture: give either --port, for instance --port /dev/ttyUSB0, or --from FILE"),
        (
            ["capture", "--port", "x", "--from", "y"],
            "capture: give either --port, for instance --port /dev/ttyUSB0, or",
        ),
        (["capture", "--port", "x", "--channel", "D0"], "--channel is of a file: it needs --from FILE"),
        (["capture", "--from", "/"], "/: is a directory; name a capture file in it"),
    ],
)
def test_options_that_do_not_go_together(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    assert message in capsys.readouterr().err


def test_octets_without_a_rate_need_one(cli: Cli, tmp_path: Path) -> None:
    path, kept = tmp_path / "bus.txt", tmp_path / "bus.pcapng"
    path.write_text("DC 02 02\n", encoding="ascii")
    assert "give it, for instance --baud 500000" in cli.err(
        "capture", "--from", str(path), "--write", str(kept), code=2
    )
    cli.out("capture", "--from", str(path), "--write", str(kept), "--baud", "500000")
    assert [(one.octets, one.interface.bits_per_s) for one in packets(kept)] == [(b"\xdc\x02\x02", 500_000)]
