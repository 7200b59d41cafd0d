"""Programs of others for the tests marked ``strangers``: a missing one fails the test, with the way to install it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

from tools.strangers import PROGRAMS

#: a program that takes longer hangs
HANGS_S: Final = 60.0


def program(name: str) -> str:
    """The path of a program of :data:`tools.strangers.PROGRAMS`."""
    package = PROGRAMS[name]
    path = shutil.which(name)
    if path is None:
        pytest.fail(
            f"{name} is missing; `make strangers` installs it, or: sudo apt-get install {package}", pytrace=False
        )
    return path


def run_program(
    name: str, arguments: Sequence[str | Path], timeout: float = HANGS_S
) -> subprocess.CompletedProcess[str]:
    """Run a program to its end; the test fails where it ends with an error or hangs."""
    done = subprocess.run(
        [program(name), *map(str, arguments)], capture_output=True, text=True, timeout=timeout, check=False
    )
    assert done.returncode == 0, f"{name} ended with {done.returncode}: {done.stderr[-2000:]}"
    return done


def environment(folder: Path, *requirements: str) -> Path:
    """The interpreter of a new environment with ``requirements``."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True, timeout=120)
    python = folder / "bin" / "python"
    words: list[str | Path] = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", *requirements]
    subprocess.run(words, check=True, timeout=300, stdout=subprocess.DEVNULL)
    return python


def npm_folder(folder: Path, package: str) -> Path:
    """``folder`` with ``package`` from npm, for node."""
    words = ("install", "--no-audit", "--no-fund", "--silent", "--ignore-scripts", package)
    run_program("npm", ["--prefix", folder, *words], timeout=300)
    return folder
