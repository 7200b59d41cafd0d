"""Fixtures that tests of commands share."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Iterator

import pytest
from cli_kit import Cli

from dpstack.drivers.virtual import loop
from tests.cli.listening.speaking_pty import SpeakingPty


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    return Cli(capsys)


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch, runtime_directory: str) -> Iterator[None]:
    """No run of another test is there."""
    with tempfile.TemporaryDirectory(prefix="d", dir=runtime_directory) as path:
        monkeypatch.setenv("XDG_RUNTIME_DIR", path)
        yield


@pytest.fixture
def virtual_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands of this test run in virtual time: a simulated bus neither waits for the clock nor for the computer."""
    monkeypatch.setattr(asyncio, "run", loop.run)


@pytest.fixture
def speaking() -> Iterator[SpeakingPty]:
    """A line with a bus that can be listened to."""
    far = SpeakingPty()
    yield far
    far.end()
