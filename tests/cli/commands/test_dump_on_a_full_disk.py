"""``dpstack drive ... dump`` where the disk has no room for the file: nothing is said to be there that is not."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from cli_kit import SIMULATED
from programs import PLANT

from dpstack.cli.main import main


def test_all_is_read_and_there_is_no_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "plant.toml"
    config.write_text(PLANT.format(port="virtual"), encoding="utf-8")
    there, link = tmp_path / "disk" / "h.toml", tmp_path / "link.toml"
    there.parent.mkdir()
    link.symlink_to(there)

    def fsync(file: int) -> None:
        if os.fstat(file).st_size:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    assert main(["drive", str(config), "hoist", "dump", str(link), "--data-set", "3"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.replace(SIMULATED, "", 1) == (
        f"dpstack: {link}: cannot be written (No space left on device); make room there, or name a file elsewhere\n"
    )
    assert list(there.parent.iterdir()) == []
