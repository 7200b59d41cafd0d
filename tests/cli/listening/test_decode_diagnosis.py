"""``dpstack decode --diagnosis``: octets as SFC 13 of STEP 7 gives them, pasted in the forms of STEP 7 and TIA."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from cli_kit import Cli
from gsd_kit import FILES
from plant_files import plant_file

#: ext_diag, wd_on, master 2; module 2 of the configuration; a block of its maker with text
OCTETS = "08 0C 00 02 1A 2B 42 02 0A 01 46 75 73 65 20 46 31 20"
#: a variable table of STEP 7, whose area goes on after the diagnosis
TABLE = """\
     DB10.DBB    0   "HEX"   B#16#08
     DB10.DBB    1   "HEX"   B#16#0C
     DB10.DBW    2   "HEX"   W#16#0002
     DB10.DBD    4   "HEX"   DW#16#1A2B4202
     DB10.DBD    8   "HEX"   DW#16#0A014675
     DB10.DBD   12   "HEX"   DW#16#73652046
     DB10.DBD   16   "HEX"   DW#16#31200000
     DB10.DBD   20   "HEX"   DW#16#00000000
"""


def test_each_octet_in_words(cli: Cli) -> None:
    assert cli.out("decode", "--diagnosis", *OCTETS.split()) == (
        "ident 0x1A2B\n"
        "  data_exchange, master 2\n"
        "octets 1 to 6: 08 0c 00 02 1a 2b: ext_diag, wd_on\n"
        "  has something to report in its extended diagnosis: look at the device\n"
        "  watches its master\n"
        "octets 7 to 8: 42 02\n"
        "  slots with a diagnosis: 2\n"
        "octets 9 to 18: 0a 01 46 75 73 65 20 46 31 20\n"
        '  device: "Fuse F1" (01 46 75 73 65 20 46 31 20)\n'
        "no GSD file with its ident number: dpstack gsd find 0x1A2B, then --gsd FILE, has more texts\n"
    )


@pytest.mark.parametrize(
    "text",
    [
        OCTETS,
        OCTETS.replace(" ", ""),
        f"Diagnose: {OCTETS}",
        f"12:01:22 slave 3 diag = {OCTETS}",
        "0x" + ", 0x".join(OCTETS.split()),
        "B#16#" + " B#16#".join(OCTETS.split()),
        " ".join(f"%DB1.DBB{at} 16#{octet}" for at, octet in enumerate(OCTETS.split())),
        "00000000  08 0c 00 02 1a 2b 42 02  0a 01 46 75 73 65 20 46  |.....+B...Fuse F|\n00000010  31 20   |1 |",
    ],
)
def test_forms_of_the_octets(cli: Cli, text: str) -> None:
    assert cli.json("decode", "--diagnosis", text)["octets"] == OCTETS.replace(" ", "").lower()


def test_an_area_of_the_plc_that_is_longer_than_the_diagnosis(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "table.txt").write_text(TABLE)
    report = cli.json("decode", "--diagnosis", str(tmp_path / "table.txt"))
    assert (report["octets"], report["padding"], report["finding"]) == (OCTETS.replace(" ", "").lower(), 6, None)
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(TABLE.encode())))
    assert "6 octets of zeros behind it: the area of the PLC is longer" in cli.out("decode", "--diagnosis", "-")
    assert cli.json("decode", "--diagnosis", "02 05 00 FF 0C DA" + 250 * " 00")["padding"] == 250


def test_texts_of_a_gsd_file_and_names_of_a_configuration(cli: Cli, tmp_path: Path) -> None:
    whole = str(FILES / "whole.gsd")
    out = cli.out("decode", "--diagnosis", OCTETS, "--gsd", whole)
    assert "ident 0x1A2B, Nobody & Sons Terminal 8 (texts from whole.gsd)\n" in out
    assert "  fuse blown (replace F1)\n" in out
    plant = plant_file(
        tmp_path,
        {"name": "valves", "address": 8, "gsd": whole, "modules": ["8 DI", "8 DO"]},
        {"name": "lamps", "address": 9, "gsd": whole, "modules": ["4 AI", "8 DI"]},
    )
    for wanted in ("9", "lamps"):
        out = cli.out("decode", "--diagnosis", OCTETS, "--config", str(plant), "--address", wanted)
        assert out.startswith(
            "slave 9 (lamps), ident 0x1A2B, Nobody & Sons Terminal 8 (texts from the configuration)\n"
        )
        assert "  slots with a diagnosis: 2 (8 DI)\n" in out
    out, err = cli("decode", "--diagnosis", OCTETS, "--config", str(plant))
    assert "valves (8), lamps (9) have this ident number: --address says of which one the diagnosis is" in err
    other = OCTETS.replace("1A 2B", "12 34")
    out, err = cli("decode", "--diagnosis", other, "--config", str(plant), "--address", "8")
    assert "slave 8 (valves) is configured as 0x1A2B: this is another device" in err
    assert out.startswith("ident 0x1234\n")


def test_alarms_and_wrong_lengths(cli: Cli) -> None:
    out = cli.out("decode", "--diagnosis", "08 0C 00 02 12 34 06 01 02 29 AA BB")
    assert "  in DP-V1: diagnosis alarm, slot 2, appears, slot disturbed, data aa bb\n" in out
    out = cli.out("decode", "--diagnosis", "08 0C 00 02 12 34 43 02", code=1)
    assert "wrong length: octet 7 announces a block of 3 octets, 2 are left\n" in out
    assert "no slot has a diagnosis" in cli.out("decode", "--diagnosis", "00 0C 00 02 12 34 42 00")


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("--diagnosis", "08 0C"), "a diagnosis has 6 octets or more, here are 2: station status 1, 2 and 3"),
        (("--diagnosis", "68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16"), "decode it without --diagnosis"),
        (("--diagnosis", "hello"), "'h' is no hex digit"),
        (("--diagnosis", 245 * "11"), "a diagnosis has 244 octets at most, here are 245"),
        (("--diagnosis", OCTETS, "--address", "8"), "no slave '8' in the configuration; known are none: give --config"),
        (("E5", "--address", "8"), "it needs --diagnosis"),
    ],
)
def test_what_is_no_diagnosis_ends_with_2(cli: Cli, args: tuple[str, ...], text: str) -> None:
    assert text in cli.err("decode", *args)
