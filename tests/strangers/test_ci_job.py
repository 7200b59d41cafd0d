"""The job for CI in examples/ci: a shell runs it, on ptys."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

pytestmark = pytest.mark.strangers

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "ci"
#: a step that fails: the slot has its module
WRONG = '[[step]]\nat = 0.2\nslave = "rack"\ndo = "plug"\nargs = ["1"]\n'


def run_job(folder: Path, scenario: str = "") -> tuple[int, ElementTree.Element]:
    """Exit code and results of pytest of the job in a copy of its folder, with more steps in its scenario."""
    shutil.copytree(FOLDER, folder, ignore=shutil.ignore_patterns("__pycache__"))
    faults = folder / "faults.toml"
    faults.write_text(faults.read_text(encoding="utf-8") + scenario, encoding="utf-8")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "job.sh"], cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, timeout=120, check=False
    )
    (suite,) = ElementTree.parse(folder / "junit.xml").getroot()
    return done.returncode, suite


def test_the_job_is_green(tmp_path: Path) -> None:
    code, suite = run_job(tmp_path / "ci")
    assert (code, suite.get("name"), suite.get("tests"), suite.get("failures")) == (0, "plant", "2", "0")
    assert suite.get("skipped") == "0"
    assert "line break" in (tmp_path / "ci" / "sim.jsonl").read_text(encoding="utf-8")


def test_a_step_that_fails_makes_the_job_red(tmp_path: Path) -> None:
    code, suite = run_job(tmp_path / "ci", WRONG)
    assert (code, suite.get("errors")) == (1, "0")
    assert "failed: plug 1" in (tmp_path / "ci" / "sim.txt").read_text(encoding="utf-8")
