"""The same GSD file at both ends as users start them: ``sim`` and ``run`` and ``address`` on a segment of ptys."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_kit import Cli
from gsd_kit import FILES
from programs import Starter

from dpstack.cli.main import main

HEAD = '[bus]\nport = "{port}"\nbaud = 500000\n'
IO = f"""
[[slave]]
name = "io"
address = 8
gsd = "{FILES / "whole.gsd"}"
modules = ["8 DO", "8 DI"]
parameters = {{ "Diagnosis" = "off" }}
sync = true
"""
RAW = '[[slave]]\nname = "raw"\naddress = 20\nident = 0x1234\nconfig = "20 10"\n'


@pytest.fixture
def bus(tmp_path: Path, start: Starter) -> Path:
    """A segment of two with simulated slaves on port 0; ``plant.toml`` beside it is for port 1."""
    folder = tmp_path / "bus"
    (tmp_path / "plant.toml").write_text(HEAD.format(port=folder / "1") + IO)
    (tmp_path / "sim.toml").write_text(HEAD.format(port=folder / "0") + IO + RAW)
    start.segment(folder)
    start("sim", str(tmp_path / "sim.toml"), "--port", str(folder / "0")).wait_for("raw")
    return folder


def test_run_and_address_against_simulated_slaves(bus: Path, capsys: pytest.CaptureFixture[str], cli: Cli) -> None:
    plant, port = str(bus.parent / "plant.toml"), str(bus / "1")
    assert (
        cli.out("address", "20", "9", "--port", port, "--baud", "500000")
        == "slave 20 has address 9 now: ident 0x1234, verified there\n"
    )
    assert main(["address", "8", "10", "--port", port, "--baud", "500000"]) == 1  # Set_Slave_Add_supp = 0
    assert "Set_Slave_Add" in capsys.readouterr().err

    summary = cli.json("run", plant, "--rotations", "50", "--outputs", "8=5A")
    assert summary["slaves"]["8"]["state"] == "data_exchange"
    assert summary["slaves"]["8"]["inputs"] == "5a"
