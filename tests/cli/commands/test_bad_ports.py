"""A port that cannot be used, as a user of ``dpstack run`` sees it: exit code 1 and one line that says what to do."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cli_kit import Cli
from far_ends import PtyFarEnd

from dpstack.api.config.config import Config
from dpstack.cli.commands import run
from dpstack.ports import termios2

PLANT = """
[bus]
port = "{port}"
baud = 12000000

[[slave]]
name = "raw"
address = 9
ident = 0x1234
config = "20 10"
"""


@pytest.fixture
def far() -> Iterator[PtyFarEnd]:
    far = PtyFarEnd()
    yield far
    far.hang_up()


def refusal(far: PtyFarEnd, folder: Path, cli: Cli) -> str:
    plant = folder / "plant.toml"
    plant.write_text(PLANT.format(port=far.path), encoding="utf-8")
    out, err = cli("run", str(plant), "--seconds", "1", "--json", code=1)
    assert out == ""
    (line,) = err.splitlines()
    return line


def test_no_permission(far: PtyFarEnd, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def refuse(path: str, *rest: Any, **more: Any) -> int:
        if path == far.path:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return opened(path, *rest, **more)

    monkeypatch.setattr(os, "open", refuse)
    line = refusal(far, tmp_path, cli)
    assert line.startswith(f"dpstack: {far.path}: no permission; ")
    assert "group" in line


def test_a_rate_the_port_cannot_do(far: PtyFarEnd, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(termios2, "set_raw", lambda _fd, _baud, marks: termios2.Applied(9_600, True))
    assert refusal(far, tmp_path, cli) == (
        f"dpstack: {far.path} cannot do 12 Mbit/s, it set itself to 9.6 kbit/s: choose another rate or adapter"
    )


def test_a_rate_the_driver_refuses(far: PtyFarEnd, tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_fd: int, _baud: int, *, marks: bool) -> termios2.Applied:
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(termios2, "set_raw", refuse)
    assert refusal(far, tmp_path, cli) == (
        f"dpstack: {far.path} refuses 12 Mbit/s 8E1 (Invalid argument): choose another rate or adapter"
    )


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE])
def test_no_file_descriptors_left(number: int, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python raises a plain OSError where it cannot import a module or make an event loop for the command."""

    def refuse(_name: str) -> Config:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(run, "load_config", refuse)
    _, err = cli("run", "plant.toml", code=1)
    assert err.strip() == f"dpstack: no file descriptors left ({os.strerror(number)}): raise that limit (ulimit -n)"
