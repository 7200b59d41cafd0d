"""Fixtures that tests of commands share."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest
from cli_kit import Cli


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(capsys)


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch, runtime_directory: str) -> Iterator[None]:
    """No run of another test is there."""
    with tempfile.TemporaryDirectory(prefix="d", dir=runtime_directory) as path:
        monkeypatch.setenv("XDG_RUNTIME_DIR", path)
        yield
