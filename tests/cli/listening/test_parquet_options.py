"""``dpstack decode --parquet``: what is refused before a capture is read.

The files, which need pyarrow, are tested in tests/strangers/test_telegram_table.py.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from cli_kit import Cli


def test_a_folder_without_a_capture_makes_no_folder(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    (tmp_path / "bus.log").write_text("DC 02 02")
    folder = tmp_path / "archive"
    nothing = f"{tmp_path}: no capture file (pcapng) in this folder; name one that dpstack capture wrote to"
    assert cli.err("decode", str(tmp_path), "--parquet", str(folder)) == f"dpstack: {nothing}\n"
    assert not folder.exists()


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (("a.pcapng", "--segment", "press"), "--segment names the bus in Parquet files: it needs --parquet DIR"),
        (("a.pcapng", "--filter", "retry"), "give the filter in the query, not with --filter"),
        (("a.pcapng", "--diagnosis"), "it does not go with --diagnosis"),
        (("-",), "standard input has no name: name the segment, for instance --segment press"),
        (("a.pcapng", "--segment", ""), "'' is no name of a segment"),
        (("a.pcapng", "--segment", "\u00fc" * 40), "is no name of a segment; give a short one"),
        (("a.pcapng", "--segment", "__HIVE_DEFAULT_PARTITION__"), "is no name of a segment"),
    ],
)
def test_wrong_use_makes_no_folder(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, args: tuple[str, ...], text: str
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    folder = tmp_path / "archive"
    more = () if text.startswith("--segment names") else ("--parquet", str(folder))
    assert text in cli.err("decode", *args, *more)
    assert not folder.exists()


def test_without_pyarrow_the_extra_is_named(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    folder = tmp_path / "archive"
    err = cli.err("decode", "a.pcapng", "--parquet", str(folder))
    assert err == "dpstack: --parquet needs pyarrow: pip install 'dpstack[parquet]'\n"
    assert not folder.exists()
