"""The systemd unit as ``dpstack doctor --fix --yes`` installs it, read by systemd's own programs."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from dpstack.service import host_setup
from tests.strangers.stranger_kit import run_program

pytestmark = pytest.mark.strangers

#: of 10, as systemd-analyze judges; 2.4 in version 252
_MOST_EXPOSED = 2.5


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit of the plant "hall"."""
    assert shutil.which("sh")
    host_setup.carry_out({"PATH": "/usr/bin:/bin", "DESTDIR": str(tmp_path)})
    template = tmp_path / "etc/systemd/system/dpstack@.service"
    return template.rename(template.with_name("dpstack@hall.service"))


def test_systemd_finds_nothing_wrong(unit: Path) -> None:
    done = run_program("systemd-analyze", ["verify", "--man=no", unit])
    assert done.stdout + done.stderr == ""


def test_an_error_in_the_unit_is_found(unit: Path) -> None:
    """systemd-analyze judges this file indeed."""
    unit.write_text(unit.read_text().replace("WatchdogSec=30", "WatchdogSeconds=30"))
    done = run_program("systemd-analyze", ["verify", "--man=no", unit])
    assert "WatchdogSeconds" in done.stderr


def test_the_service_is_hardened(unit: Path) -> None:
    done = run_program("systemd-analyze", ["security", "--offline=true", "--no-pager", unit])
    exposure = re.search(r"exposure level for dpstack@hall.service: ([\d.]+)", done.stdout)
    assert exposure is not None
    assert float(exposure[1]) <= _MOST_EXPOSED
