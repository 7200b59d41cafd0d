"""Files that sigrok-cli writes of a bus, and its UART decoder as the judge of the characters in them."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from waveforms import bits, sampled

from bench.listen import traffic
from dpstack.cli.main import main
from dpstack.decode.source import read_transmissions
from dpstack.units import NS_PER_S
from tests.strangers.stranger_kit import run_program

pytestmark = pytest.mark.strangers

BAUD, RATE = 500_000, 24_000_000
PERIOD_NS = NS_PER_S / RATE
#: forms that sigrok-cli writes; the one with the times of libsigrok 0.5.2 has 41 ns a sample
FORMS = {
    "sr": ("srzip", 0),
    "vcd": ("vcd", 0),
    "csv": ("csv", 0),
    "named.csv": ("csv:label=channel", 0),
    "bare.csv": ("csv:label=off", 0),
    "times.csv": ("csv:time=true", 1),
    "changes.csv": ("csv:time=true:dedup=true:label=channel", 1),
}


@cache
def telegrams() -> tuple[bytes, ...]:
    return tuple(one.octets for one in traffic(250))


@cache
def bus(damage: bool = False) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The bits of the line with gaps by chance, and the bit with which each telegram begins. ``damage``: every 97th
    octet has a wrong parity bit, every 131st no stop bit if it ends its telegram."""
    chance = random.Random(1)
    levels: list[int] = []
    begins: list[int] = []
    number = 0
    for telegram in telegrams():
        levels += [1] * chance.choice((11, 33, 37, 60))
        begins.append(len(levels))
        for place, octet in enumerate(telegram):
            number += 1
            one = bits(octet)
            if damage and number % 97 == 0:
                one[9] ^= 1
            if damage and number % 31 == 0 and place == len(telegram) - 1:
                one[10] = 0
            levels += one
    return (*levels, *[1] * 500), tuple(begins)


def session(folder: Path, levels: Sequence[int], baud: int = BAUD, rate: int = RATE, channels: int = 1) -> Path:
    """A session file that sigrok-cli makes of samples: the line is its channel 0, the channel above is inverted."""
    samples = sampled(list(levels), baud, rate)
    raw = folder / "raw.bin"
    raw.write_bytes(bytes(level | (1 - level) << 1 for level in samples) if channels == 2 else samples)
    made = folder / "bus.sr"
    how = f"binary:numchannels={channels}:samplerate={rate}"
    run_program("sigrok-cli", ["-I", how, "-i", raw, "-O", "srzip", "-o", made])
    return made


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return session(tmp_path_factory.mktemp("sigrok"), bus()[0])


class Seen(NamedTuple):
    """A character: its start edge in samples, octet, errors."""

    start: int
    octet: int
    parity: bool
    framing: bool


def by_sigrok(path: Path, channel: str = "0", invert: str = "no", baud: int = BAUD) -> list[Seen]:
    how = f"uart:baudrate={baud}:parity=even:rx={channel}:invert_rx={invert}"
    what = "uart=rx-data:rx-start:rx-parity-err:rx-warnings"
    text = run_program("sigrok-cli", ["-i", path, "-P", how, "-A", what, "--protocol-decoder-samplenum"]).stdout
    return list(_characters(text))


def _characters(text: str) -> Iterator[Seen]:
    start, octet, parity, framing = -1, -1, False, False
    for begin, said in re.findall(r"^(\d+)-\d+ uart-1: (.*)$", text, re.MULTILINE):
        if said == "Start bit":
            if octet >= 0:
                yield Seen(start, octet, parity, framing)
            start, octet, parity, framing = int(begin), -1, False, False
        elif re.fullmatch("[0-9A-F]{2}", said):
            octet = int(said, 16)
        elif said == "Parity error":
            parity = True
        elif said == "Frame error":
            framing = True
    if octet >= 0:
        yield Seen(start, octet, parity, framing)


@pytest.mark.parametrize("form", FORMS)
def test_each_form_of_sigrok_has_the_telegrams_at_their_times(made: Path, tmp_path: Path, form: str) -> None:
    written, first = FORMS[form]
    path = tmp_path / f"bus.{form}"
    run_program("sigrok-cli", ["-i", made, "-O", written, "-o", path])
    remarks: list[str] = []
    with path.open("rb") as file:
        found = list(read_transmissions(file, "bus", on_remark=remarks.append))
    assert remarks == ["bus: channel '0', 500 kbit/s, 24 MS/s, 48 samples a bit"]
    assert [one.octets for one in found] == list(telegrams())
    # libsigrok 0.5.2 counts the rows of a CSV with times from 1
    wanted = [round((begin * RATE // BAUD + first) * PERIOD_NS) for begin in bus()[1]]
    assert max(abs((one.t_ns or 0) - at) for one, at in zip(found, wanted, strict=True)) <= 1


@pytest.mark.parametrize(("channel", "invert"), [("0", "no"), ("1", "yes")])
def test_the_uart_decoder_of_sigrok_reads_the_same_characters_and_errors(
    tmp_path: Path, channel: str, invert: str
) -> None:
    path = session(tmp_path, bus(damage=True)[0], channels=2)
    judged = by_sigrok(path, channel, invert)
    assert sum(one.parity for one in judged) > 10
    assert sum(one.framing for one in judged) > 3
    remarks: list[str] = []
    with path.open("rb") as file:
        found = list(read_transmissions(file, "bus", channel=channel, on_remark=remarks.append))
    assert (", inverted" in remarks[0]) is (invert == "yes")
    assert b"".join(one.octets for one in found) == bytes(one.octet for one in judged)
    parity, framing = (sum(getattr(one, kind) for one in judged) for kind in ("parity", "framing"))
    assert remarks[1] == f"bus: characters {parity} with parity errors and {framing} with framing errors"
    # each transmission begins with the start edge that sigrok saw, and is damaged where sigrok says so
    place = 0
    for one in found:
        characters = judged[place : place + len(one.octets)]
        place += len(one.octets)
        assert abs((one.t_ns or 0) - characters[0].start * PERIOD_NS) <= 1
        bad = [n for n, character in enumerate(characters, 1) if character.parity or character.framing]
        assert one.note.startswith("damaged in the waveform") is bool(bad)
        assert [int(n) for n in re.findall(r"\d+", one.note.partition(" and ")[0])] == bad[:4]


@pytest.mark.parametrize(("baud", "rate"), [(9_600, 200_000), (45_450, 1_000_000), (3_000_000, 24_000_000)])
def test_rates_are_found_in_sessions_with_few_samples_a_bit(tmp_path: Path, baud: int, rate: int) -> None:
    path = session(tmp_path, bus()[0], baud, rate)
    with path.open("rb") as file:
        found = list(read_transmissions(file, "bus"))
    assert {one.baud for one in found} == {baud}
    assert b"".join(one.octets for one in found) == bytes(one.octet for one in by_sigrok(path, baud=baud))
    assert [one.octets for one in found] == list(telegrams())


def test_a_file_that_sigrok_converts_has_no_times_in_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw, table = tmp_path / "raw.bin", tmp_path / "bus.csv"
    raw.write_bytes(sampled(list(bus()[0]), BAUD, RATE))
    how = f"binary:numchannels=1:samplerate={RATE}"
    run_program("sigrok-cli", ["-I", how, "-i", raw, "-O", "csv:time=true:dedup=true", "-o", table])
    assert main(["decode", str(table)]) == 1
    assert "the times are missing (sigrok-cli writes zeros when it converts)" in capsys.readouterr().err


def test_the_commands_read_a_session(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))  # without a dissector for PROFIBUS, which the user may have installed
    kept = tmp_path / "bus.pcapng"
    assert main(["capture", "--from", str(made), "--write", str(kept), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["event"] for line in lines] == ["start", "summary"]
    assert (lines[0]["source"], lines[0]["baud"], lines[1]["kept"]) == ("waveform", BAUD, len(telegrams()))
    decoded = []
    for path in (made, kept):
        assert main(["decode", str(path), "--json"]) == 0
        decoded.append(capsys.readouterr().out)
    assert decoded[0] == decoded[1]
    main(["monitor", str(made), "--json"])
    summary = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert summary["timing"] == {"source": "waveform", "resolution_us": 0.042, "batched": 0.0}
    seen = run_program("tshark", ["-r", kept, "-T", "fields", "-e", "data.data", "-e", "frame.time_epoch"]).stdout
    first = seen.splitlines()[0].split("\t")
    assert bytes.fromhex(first[0]) == telegrams()[0]
    assert float(first[1]) == pytest.approx(bus()[1][0] / BAUD, abs=1e-9)
