"""``dpstack gsd find`` and ``gsd diff``: what people and scripts read, exit codes."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli
from gsd_kit import FILES

WHOLE = (FILES / "whole.gsd").read_text()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gsd").mkdir()
    for ending in ("gse", "GSG"):
        (tmp_path / f"gsd/terminal.{ending}").write_text(WHOLE)
    (tmp_path / "gsd/bad.gsd").write_bytes(b"\x89PNG\r\n")
    return tmp_path


def test_find_says_where_the_words_are_and_which_files_it_left_out(cli: Cli, folder: Path) -> None:
    out, err = cli("gsd", "find", "NOBODY", "8di", "gsd")
    assert out == (
        "gsd/terminal.gse (also .GSG): Nobody & Sons Terminal 8, ident 0x1A2B, order number T8-001; "
        'found in vendor; module "8 DI"\n'
    )
    assert err.startswith("dpstack: left out: gsd/bad.gsd: ")
    assert err.count("\n") == 1


def test_find_looks_here_and_in_the_folders_below_and_among_its_own_files(cli: Cli, folder: Path) -> None:
    files = [line.split(" ")[0] for line in cli.out("gsd", "find", "1A2B").splitlines()]
    assert files == ["gsd/terminal.gse"]
    assert cli.out("gsd", "find", "0x0696").startswith("demag-dedrive: Demag")


def test_find_names_files_as_the_folder_was_named(cli: Cli, folder: Path) -> None:
    padded = WHOLE.replace("T8-001", "T8-001    ")
    (folder / "gsd/terminal.gse").write_text(padded)
    elsewhere = folder / "gsd"
    out, _ = cli("gsd", "find", "1A2B", str(elsewhere))
    assert out.startswith(
        f"{elsewhere}/terminal.gse (also .GSG): Nobody & Sons Terminal 8, ident 0x1A2B, order number T8-001; "
    )


def test_find_as_json(cli: Cli, folder: Path) -> None:
    hit, bad = cli.jsons("gsd", "find", "t8-001", "gsd")
    assert hit == {
        "file": "gsd/terminal.gse",
        "bundled": False,
        "also": ["gsd/terminal.GSG"],
        "ident": "0x1A2B",
        "vendor": "Nobody & Sons",
        "model": "Terminal 8",
        "order_number": "T8-001",
        "matches": [{"field": "order_number", "text": "T8-001", "reference": None}],
    }
    assert bad["file"] == "gsd/bad.gsd"
    assert "no GSD file" in bad["error"]


def test_find_without_a_hit_ends_with_1_and_without_words_with_2(cli: Cli, folder: Path) -> None:
    assert "devices in gsd and among those of dpstack\n" in cli.err("gsd", "find", "nix", "gsd", code=1)
    assert "no word to look for" in cli.err("gsd", "find", "--", "-", "gsd")


def test_diff_as_diff_has_it(cli: Cli, folder: Path) -> None:
    (folder / "new.gsd").write_text(WHOLE.replace("0x1A2B", "0x1A2C").replace('"fuse blown"', '"fuse"'))
    assert cli.out("gsd", "diff", "gsd/terminal.gse", "new.gsd", code=1) == (
        "on the wire: 1 difference\n"
        "  ident number: 0x1A2B -> 0x1A2C\n"
        "texts of the diagnosis:\n"
        "  bit 0: 'fuse blown' (replace F1) -> 'fuse' (replace F1)\n"
    )
    assert cli.out("gsd", "diff", "gsd/terminal.gse", "gsd/terminal.GSG").startswith("the same: ")
    assert "nix.gsd: No such file" in cli.err("gsd", "diff", "nix.gsd", "new.gsd", code=2)


def test_diff_of_the_wire_alone(cli: Cli, folder: Path) -> None:
    (folder / "new.gsd").write_text(WHOLE.replace('"fuse blown"', '"fuse"'))
    assert cli.out("gsd", "diff", "gsd/terminal.gse", "new.gsd", "--wire") == "on the wire: the same\n"
    assert cli.json("gsd", "diff", "gsd/terminal.gse", "new.gsd", code=1) == {
        "old": "gsd/terminal.gse",
        "new": "new.gsd",
        "same_on_wire": True,
        "changes": [
            {
                "part": "diagnosis",
                "what": "bit 0",
                "old": "'fuse blown' (replace F1)",
                "new": "'fuse' (replace F1)",
            }
        ],
    }
