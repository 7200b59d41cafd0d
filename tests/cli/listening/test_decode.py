"""``dpstack decode``: files, hex digits and standard input."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from cli_kit import Cli

from dpstack.capture.pcapng import PROFIBUS_DL, Writer
from dpstack.capture.transmission import Damage
from dpstack.cli.main import main

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


def test_text_from_standard_input(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f"# a comment\n0x10,0x02,0x63,0x49,0xAE,0x16\n\n{DIAG} E5  # two in a line"
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert [one["service"] for one in _json(cli, "-")] == ["FDL_Status", "Slave_Diag", "Slave_Diag"]


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


def test_a_wrong_filter_ends_with_2(capsys: Out) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["decode", DIAG, "--filter", "sa >"])
    assert "a number is missing at the end" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        (b"\x89PNG", "this is no pcapng file"),
        (b"68 05\nhello\n", "line 2: 'h' is no hex digit"),
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
