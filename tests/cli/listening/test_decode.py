"""``dpstack decode``: files, hex digits and standard input; the examples of docs/how-to/decode.md, run as they stand
there. Files that it and ``monitor`` read: what is no ordinary file is refused with a line, or read as it comes."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from cli_kit import Cli
from far_ends import HANG_S
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from octet_slave import DL, sd2
from property_kit import examples

from dpstack.capture.pcapng import PROFIBUS_DL, Writer
from dpstack.capture.transmission import Damage
from dpstack.cli.main import main
from dpstack.decode.filter import parse_filter

DIAG = "68 05 05 68 83 82 6D 3C 3E EC 16"
Out = pytest.CaptureFixture[str]


def _capture(path: Path, *, linktype: int = PROFIBUS_DL) -> str:
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        port = writer.interface("/dev/ttyUSB0", 500_000, "", linktype=linktype)
        writer.packet(port, 1_000_000_000, bytes.fromhex("DC 02 02"))
        writer.packet(port, 1_000_100_000, bytes.fromhex("68 04 04 68 03 02 5D 07 69 16"))
        writer.packet(port, 1_000_350_000, bytes.fromhex("68 04 04 68 02 03 08 AA B7 16"))
        writer.packet(port, 1_001_000_000, b"\xe5", Damage.PARITY_OR_FRAMING, "from 50 octets")
    return str(path)


def _json(cli: Cli, *args: str, code: int = 0) -> list[dict[str, object]]:
    return cli.jsons("decode", *args, code=code)


def test_a_capture_with_its_times(cli: Cli, tmp_path: Path) -> None:
    token, poll, answer, damaged = _json(cli, _capture(tmp_path / "bus.pcapng"))
    assert (token["kind"], token["t"], poll["fcv"], poll["function"]) == ("SD4", 1.0, True, "SRD_HIGH")
    # 250 us from begin to begin, of which the request itself takes 10 octets of 22 us
    assert answer["course"]["response_us"] == 30.0  # type: ignore[index]
    assert "marked by the port: parity or framing; from 50 octets" in str(damaged["text"])


def test_times_are_shown_to_the_nanosecond(cli: Cli, tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:
        writer = Writer(file, "a test")
        writer.packet(writer.interface("p", 500_000, ""), 1_790_000_000_123_456_789, b"\xe5")
    assert "     1  1790000000.123456789  e5\n" in cli.out("decode", str(tmp_path / "a"))


def test_hex_digits_in_words(cli: Cli) -> None:
    out = cli.out("decode", *DIAG.split(), "AA", code=1)
    assert "     1  68 05 05 68 83 82 6d 3c 3e ec 16\n        Slave_Diag request 2 -> 3" in out
    assert "     2  aa\n        no telegram: no start octet" in out


def test_slots_of_a_diagnosis_count_from_1(cli: Cli) -> None:
    """42 02: the second module (octet 2, bit 1). JSON keeps the number of the wire, which counts from 0."""
    octets = "68 0d 0d 68 82 88 08 3e 3c 08 0c 00 02 12 34 42 02 2c 16"
    out = cli.out("decode", octets)
    assert "Slave_Diag answer 8 -> 2, 8 octets: slots with a diagnosis: 2 (DL, slave)" in out
    assert "kind identifier, text slots with a diagnosis: 2\n" in out
    assert "modules" not in out
    assert cli.json("decode", octets)["fields"]["Ext_Diag_Data"] == [
        {"kind": "identifier", "modules": [1], "text": "slots with a diagnosis: 2"}
    ]


def test_text_from_standard_input(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f"# a comment\n0x10,0x02,0x63,0x49,0xAE,0x16\n\n{DIAG} E5  # two in a line"
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert [one["service"] for one in _json(cli, "-")] == ["FDL_Status", "Slave_Diag", "Slave_Diag"]


LOG = """DPM1: Requesting Slave_Diag from slave 2...
PHY-serial: TX   68 05 05 68 83 82 6D 3C 3E EC 16
PHY-serial: RX   E5
DPM1: \x1b[2Jevil
"""


def test_a_log_is_explained_with_its_lines_of_words(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    out, err = cli("decode", str(tmp_path / "a.log"))
    assert out == (
        "        line 1: DPM1: Requesting Slave_Diag from slave 2...\n"
        "     1  68 05 05 68 83 82 6d 3c 3e ec 16\n"
        "        Slave_Diag request 2 -> 3 (SRD high, FCV=0 FCB=1); PHY-serial: TX\n"
        "     2  e5\n"
        "        SC 3 -> 2, acknowledges Slave_Diag; PHY-serial: RX\n"
        "        line 4: DPM1: \\x1b[2Jevil\n"
    )
    assert err == "dpstack: 2 lines without octets: 1, 4\n"


def test_a_log_as_json_and_with_a_filter_keeps_standard_output_to_telegrams(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    assert len(_json(cli, str(tmp_path / "a.log"))) == 2
    out, err = cli("decode", str(tmp_path / "a.log"), "--filter", "kind == SC")
    assert "line" not in out
    assert err == "dpstack: 2 lines without octets: 1, 4\n"


def test_a_pasted_line_is_explained_as_an_argument(cli: Cli) -> None:
    assert "FDL_Status request 2 -> 5" in cli.out("decode", "2021/10/04 TX: 10 05 02 49 50 16")
    assert "FDL_Status request 2 -> 5" in cli.out("decode", "PHY-serial:", "TX", "10", "05", "02", "49", "50", "16")
    assert "'nothing/here' is" not in cli.err("decode", "nothing/here")


def test_an_acknowledgement_in_a_damaged_telegram_is_none(cli: Cli) -> None:
    broken = DIAG.replace("EC", "E5")
    first, second = _json(cli, f"{broken} DC 02 02", code=1)
    assert (first["octets"], first["error"]) == (
        broken.lower().replace(" ", ""),
        "no telegram: wrong check sequence (FCS): octet 10 is e5, the sum is ec",
    )
    assert second["service"] == "token"


def test_a_filter_shows_what_fits_and_keeps_the_numbers(cli: Cli, tmp_path: Path) -> None:
    shown = _json(cli, _capture(tmp_path / "a"), "--filter", "sa == 3 or da == 3")
    assert [one["number"] for one in shown] == [2, 3]


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("nothing.pcapng",), "'nothing.pcapng' is no file here, and 'n' is no hex digit"),
        (("",), "no octets to decode; give a file"),
        (("6",), "an octet has two hex digits, one is missing"),
    ],
)
def test_wrong_use_ends_with_2(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: tuple[str, ...], text: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert text in cli.err("decode", *args)


def test_several_files_are_no_octets(cli: Cli, tmp_path: Path) -> None:
    err = cli.err("decode", _capture(tmp_path / "a"), _capture(tmp_path / "b"), "--json")
    assert err.startswith("dpstack: these are 2 files: name one; ")


def test_a_wrong_filter_ends_with_2(capsys: Out) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["decode", DIAG, "--filter", "sa >"])
    assert "a number is missing at the end" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        (b"\x89PNG", "this is no pcapng file"),
        (b"68 05\nhello\n", "1 line without octets: 2\n"),
        (b"hello\n", "no octets in its lines; they are written as in 68 05 05 68"),
        (b"\n \r\n", "a: nothing but blanks\n"),
        (b"\xff\xfe", "a: nothing but blanks\n"),
        (b"E5\n68 O5 05 68 83 82\n", "line 2 was not understood: 'O5' is no octet: 68 O5 05 68 83 82\n"),
        (b"\x68\x05\x05\x68", "octets, not their hex digits: xxd FILE | dpstack decode -"),
        (b"1" * (1 << 21), "line 1 has more than 1048576 characters"),
    ],
)
def test_files_that_cannot_be_read_end_with_1(cli: Cli, tmp_path: Path, octets: bytes, text: str) -> None:
    (tmp_path / "a").write_bytes(octets)
    assert text in cli.err("decode", str(tmp_path / "a"), code=1)


def test_a_cut_capture_and_one_of_another_link_type(cli: Cli, tmp_path: Path) -> None:
    path = Path(_capture(tmp_path / "a"))
    path.write_bytes(path.read_bytes()[:-20])
    out, err = cli("decode", str(path), code=1)
    assert out.count("\n     ") >= 2
    assert "the file ends within a block" in err
    assert "packets of link type 1, PROFIBUS has 147 (USER0) or 257" in cli.err(
        "decode", _capture(tmp_path / "b", linktype=1), code=1
    )


COURSE: dict[str, object] = {
    "retry_of": None,
    "answer_to": None,
    "response_us": None,
    "unanswered": None,
    "late": False,
    "repeated_poll_of": None,
    "fcb_turned": None,
    "probably_answers": None,
    "remarks": [],
}


def test_json_has_the_keys_of_the_interface(cli: Cli) -> None:
    """Each kind of telegram, a retry, an answer, an acknowledgement and octets that are none: all keys and values."""
    poll, answer = "6804046803025D076916", "68040468020308AAB716"
    token, first, again, got, nothing = _json(cli, "DC0202", poll, poll, answer, "AA", code=1)
    none = dict.fromkeys(("fc", "function", "fcb", "fcv", "dsap", "ssap", "data", "error", "t"))
    assert token == none | {
        "number": 1,
        "octets": "dc0202",
        "kind": "SD4",
        "da": 2,
        "sa": 2,
        "service": "token",
        "fields": {},
        "course": COURSE,
        "text": "token 2 -> 2 (to itself)",
    }
    asked = {
        "number": 2,
        "t": None,
        "octets": "6804046803025d076916",
        "kind": "SD2",
        "da": 3,
        "sa": 2,
        "fc": 0x5D,
        "function": "SRD_HIGH",
        "fcb": False,
        "fcv": True,
        "service": "Data_Exchange",
        "dsap": None,
        "ssap": None,
        "data": "07",
        "fields": {},
        "course": COURSE,
        "error": None,
        "text": "Data_Exchange request 2 -> 3, 1 octet (SRD high, FCV=1 FCB=0)",
    }
    assert first == asked
    assert again == asked | {
        "number": 3,
        "course": COURSE | {"retry_of": 2, "unanswered": 2, "fcb_turned": False},
        "text": f"{asked['text']}; retry of 2",
    }
    assert got == asked | {
        "number": 4,
        "octets": answer.lower(),
        "da": 2,
        "sa": 3,
        "fc": 8,
        "function": "DL",
        "fcb": None,
        "fcv": None,
        "data": "aa",
        "course": COURSE | {"answer_to": 3},
        "text": "Data_Exchange answer 3 -> 2, 1 octet (DL, slave)",
    }
    why = "no telegram: no start octet (10, 68, A2, DC, E5): octet 1 is aa"
    keys = dict.fromkeys(("da", "sa", "kind", "service"))
    assert nothing == none | keys | {
        "number": 5,
        "octets": "aa",
        "fields": {},
        "course": COURSE,
        "error": why,
        "text": why,
    }


def test_an_acknowledgement_is_from_the_station_that_was_asked(cli: Cli) -> None:
    _, ack = _json(cli, "680C0C6883825D3D3E8814050B0696012616E5")
    assert (ack["kind"], ack["da"], ack["sa"], ack["from"], ack["service"]) == ("SC", None, None, 3, "Set_Prm")


@pytest.mark.parametrize(
    ("args", "error"),
    [
        (("--config", "none.toml"), "none.toml: there is no such file"),
        (("--gsd", "none.gsd"), "none.gsd: No such file or directory; give the path of a GSD file"),
        (("--gsd", "."), "no GSD file (.gsd, .gse, .gsg ...) is in this directory"),
    ],
)
def test_names_that_cannot_be_read_are_one_line(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: tuple[str, ...], error: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert error in cli.err("decode", *args, "E5")


def test_modules_and_texts_of_a_gsd_file_of_the_user(cli: Cli) -> None:
    """The slave is in no configuration: its ident number in Set_Prm and its Chk_Cfg name the device of the file."""
    folder = str(Path(__file__).parents[3] / "examples")
    octets = [
        sd2(9, 2, 0x5D, 61, 62, bytes.fromhex("88 01 01 0B 1A 2B 00 80 00 00 08 00 01 00 64")),
        sd2(9, 2, 0x7D, 62, 62, bytes.fromhex("10 20")),
        sd2(2, 9, DL, 62, 60, bytes.fromhex("08 0C 00 02 1A 2B 02 01 81 41 A6")),
    ]
    _, chk_cfg, diag = _json(cli, "--gsd", folder, *(one.hex() for one in octets))
    fields: Any = chk_cfg["fields"]
    assert fields["Parameters"] == {"Diagnosis": "on", "Delay": 100}
    assert [(one["slot"], one["module"]) for one in fields["Cfg_Data"]] == [(1, "8 DI"), (2, "8 DO")]
    assert fields["names_from"] == "terminal.gsd"
    fields = diag["fields"]
    assert fields["texts"] == ["fuse blown (replace F1)", "slot 2 (8 DO), input channel 1 (word): line break"]
    assert "fuse blown (replace F1); slot 2 (8 DO)" in str(diag["text"])


def test_a_folder_with_a_broken_gsd_file_is_used_all_the_same(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "a.gsd").write_bytes(b"\x89PNG")
    terminal = Path(__file__).parents[3] / "examples/terminal.gsd"
    (tmp_path / "b.gsd").write_bytes(terminal.read_bytes())
    diag = sd2(2, 9, DL, 62, 60, bytes.fromhex("08 0C 00 02 1A 2B 02 01")).hex()
    out, err = cli("decode", "--gsd", str(tmp_path), diag)
    assert "fuse blown (replace F1)" in out
    assert err.startswith(f"dpstack: left out: {tmp_path}/a.gsd: ")


def test_a_diagnosis_without_its_telegram_gets_a_hint(cli: Cli) -> None:
    assert "explained by dpstack decode --diagnosis" in cli.err("decode", "08 0C 00 02 80 6A 42 02", code=1)
    assert cli.err("decode", "08 08 00 02 80 6A 42 02", code=1) == ""


def test_a_reader_that_goes_away_ends_the_decoding(tmp_path: Path) -> None:
    """``| head``: a process, because standard output itself is lost."""
    file = tmp_path / "bus.txt"
    file.write_text("DC 02 02\n" * 50_000)
    run = "from dpstack.cli.main import main; raise SystemExit(main())"
    program = f"{sys.executable} -c '{run}' decode {file} --json | head -2"
    done = subprocess.run(program, shell=True, capture_output=True, text=True, check=False)
    assert len(done.stdout.splitlines()) == 2
    assert done.stderr == ""


def test_two_ports_in_one_file_are_two_buses(cli: Cli, tmp_path: Path) -> None:
    """Their telegrams alternate; each answer belongs to the request on its own port."""
    poll, answer = bytes.fromhex("6804046803025D076916"), bytes.fromhex("68040468020308AAB716")
    with (tmp_path / "two").open("wb") as file:
        writer = Writer(file, "a test")
        ports = [writer.interface(name, 500_000, "") for name in ("one", "two")]
        for number, octets in enumerate((poll, poll, answer, answer)):
            writer.packet(ports[number % 2], 1_000_000_000 + number, octets)
    found = [one["course"] for one in _json(cli, str(tmp_path / "two"))]
    assert [(one["answer_to"], one["retry_of"], one["remarks"]) for one in found] == [  # type: ignore[index]
        (None, None, []),
        (None, None, []),
        (1, None, []),
        (2, None, []),
    ]


PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "decode.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"<!-- decode -->\n```text\n\$ dpstack (decode .*?)\n(.*?)```", PAGE, re.DOTALL)
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", PAGE, re.DOTALL))


@pytest.mark.parametrize(("command", "printed"), EXAMPLES)
def test_an_example_prints_what_the_page_says(
    command: str,
    printed: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code = main(shlex.split(command))
    assert capsys.readouterr().out == printed
    assert code == ("no telegram" in printed)


def test_the_filters_are_filters() -> None:
    (text,) = re.findall(r"<!-- filters -->\n```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert len([parse_filter(line) for line in text.splitlines()]) >= 3


def test_there_are_examples_of_all_kinds() -> None:
    assert len(EXAMPLES) >= 5


TOKEN = bytes.fromhex("DC 02 02")


def capture(path: Path, packets: int = 3) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, "a test")
        port = writer.interface("p", 500_000, "")
        for number in range(packets):
            writer.packet(port, 1_790_000_000_000_000_000 + number * 1_000_000, TOKEN)
    return path


@pytest.mark.parametrize("command", ["decode", "monitor"])
def test_a_source_that_is_no_file_is_refused(cli: Cli, tmp_path: Path, command: str) -> None:
    why = {"decode": "is a directory; name a capture file in it", "monitor": "no capture file (pcapng) in this folder"}
    assert f"{tmp_path}: {why[command]}" in cli.err(command, str(tmp_path))
    assert "/dev/null: is a device; to listen to a port: dpstack capture --port /dev/null" in cli.err(
        command, "/dev/null"
    )
    dangling = tmp_path / "gone"
    dangling.symlink_to(tmp_path / "nowhere")
    assert f"{dangling}: cannot be read (No such file or directory)" in cli.err(command, str(dangling))
    nameless = {"decode": "no octets to decode; give a file", "monitor": "the name of the file is empty"}
    assert nameless[command] in cli.err(command, "")


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="permissions of POSIX")
@pytest.mark.parametrize("command", ["decode", "monitor"])
def test_a_file_without_permission(cli: Cli, tmp_path: Path, command: str) -> None:
    path = capture(tmp_path / "a.pcapng")
    path.chmod(0)
    cli.err(command, "/dev/null")  # imports, for which nobody else may have the permission
    own = os.geteuid()
    if own == 0:
        os.seteuid(65534)
    try:
        text = cli.err(command, str(path))
    finally:
        os.seteuid(own)
    assert "cannot be read (Permission denied); name a capture file" in text


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="a file of Linux whose octet 0 cannot be read")
@pytest.mark.parametrize("command", ["decode", "monitor"])
def test_a_file_that_fails_while_it_is_read(cli: Cli, command: str) -> None:
    assert "/proc/self/mem: cannot be read to its end (Input/output error)" in cli.err(
        command, "/proc/self/mem", code=1
    )


def test_a_file_goes_before_hex_digits(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    capture(tmp_path / "E5")
    assert [one["kind"] for one in cli.jsons("decode", "E5")] == ["SD4"] * 3
    assert [one["kind"] for one in cli.jsons("decode", "E5", "E5")] == ["SC"] * 2
    Path("DC0202").mkdir()
    assert "DC0202: is a directory" in cli.err("decode", "DC0202")


def test_a_reader_that_ends_leaves_no_traceback(tmp_path: Path) -> None:
    """``dpstack decode FILE | head``."""
    name = tmp_path / "bus.pcapng"
    with name.open("wb") as file:
        writer = Writer(file, "a test")
        port = writer.interface("/dev/ttyUSB0", 500_000, "", linktype=PROFIBUS_DL)
        for number in range(3000):  # more text than a pipe holds
            writer.packet(port, number, bytes.fromhex("DC 02 02"))
    order = [sys.executable, "-m", "dpstack", "decode", str(name)]
    with subprocess.Popen(order, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        assert b"dc 02 02" in program.stdout.readline()
        program.stdout.close()
        assert program.stderr.read() == b""
        program.wait(HANG_S)


def test_a_pipe_is_decoded_as_it_comes(tmp_path: Path) -> None:
    """The first telegrams are printed while the writer still has the pipe open."""
    octets = capture(tmp_path / "a.pcapng").read_bytes()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    program = subprocess.Popen(
        [sys.executable, "-m", "dpstack.cli.main", "decode", str(pipe), "--json"], stdout=subprocess.PIPE, text=True
    )
    assert program.stdout is not None
    hangs = threading.Timer(HANG_S, program.kill)
    hangs.start()
    try:
        with pipe.open("wb", buffering=0) as out:
            out.write(octets[:-40])  # the last packet has 36 octets
            lines = [json.loads(program.stdout.readline()) for _ in range(1)]
            out.write(octets[-40:])
            lines += [json.loads(program.stdout.readline()) for _ in range(2)]
        assert program.wait(HANG_S) == 0
    finally:
        hangs.cancel()
        program.kill()
        program.stdout.close()
    assert [one["number"] for one in lines] == [1, 2, 3]


_TELEGRAMS = ("DC0202", "68050568 83826D3C3E EC16", "680B0B68 8283083E3C 0205 00FF 1234 D316", "E5")


def _octets() -> bytes:
    file = io.BytesIO()
    writer = Writer(file, "a test")
    port = writer.interface("p", 500_000, "a port")
    for number, telegram in enumerate(_TELEGRAMS * 2):
        writer.packet(port, 1_790_000_000_000_000_000 + number * 1_000_000, bytes.fromhex(telegram), number << 24, "c")
    return file.getvalue()


OCTETS = _octets()


@given(
    st.lists(
        st.tuples(st.integers(0, len(OCTETS) // 4 - 1), st.binary(min_size=4, max_size=4) | st.just(b"\xff" * 4)),
        min_size=1,
        max_size=4,
    )
)
@settings(examples(20, soak=2_000), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_damage_of_a_file_is_a_defect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: list[tuple[int, bytes]]
) -> None:
    octets = bytearray(OCTETS)
    for word, changed in damage:
        octets[4 * word : 4 * word + 4] = changed
    path = tmp_path / "a.pcapng"
    path.write_bytes(octets)
    for command in ("decode", "monitor"):
        assert main([command, str(path), "--json"]) in (0, 1, 2)
    assert "Traceback" not in capsys.readouterr().err
