"""``dpstack drive ... dump`` where the disk has no room for the file: nothing is said to be there that is not."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from cli_kit import SIMULATED, Cli
from programs import plant_of


@pytest.mark.usefixtures("virtual_time")
def test_all_is_read_and_there_is_no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    config = plant_of(tmp_path)
    there = tmp_path / "disk" / "h.toml"
    there.parent.mkdir()

    def fsync(file: int) -> None:
        if os.fstat(file).st_size:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    out, err = cli("drive", str(config), "hoist", "dump", str(there), "--data-set", "3", code=2)
    assert out == ""
    assert err.startswith(SIMULATED)
    assert err.endswith(
        f"dpstack: {there}: cannot be written (No space left on device); make room there, or name a file elsewhere\n"
    )
    assert list(there.parent.iterdir()) == []
