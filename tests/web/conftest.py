"""Web servers in tests: pages get their items at once, control sockets stand in a directory of the test."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.web.fan_out.TICK_S", 0.005)


@pytest.fixture(autouse=True)
def runtime(runtime_directory: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """XDG_RUNTIME_DIR of the test; its path is short, as that of a socket has to be."""
    with tempfile.TemporaryDirectory(prefix="w", dir=runtime_directory) as path:
        monkeypatch.setenv("XDG_RUNTIME_DIR", path)
        yield Path(path)
