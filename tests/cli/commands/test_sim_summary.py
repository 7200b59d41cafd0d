"""The summary of ``dpstack sim``."""

from __future__ import annotations

import pytest
from api_kit import RAW

from dpstack.api.config.config import make_config
from dpstack.api.slave_side.simulation import Simulation
from dpstack.cli.commands import sim


async def test_the_summary_says_why_answers_were_too_late(capsys: pytest.CaptureFixture[str]) -> None:
    """The computer was busy, or another master talked meanwhile: either way the answer was not sent."""
    simulation = Simulation(make_config("pty", 500_000, 2, [RAW]), "pty", 500_000)
    sim.print_summary(simulation, json=False)
    assert "another master talked" not in capsys.readouterr().out
    simulation.slaves[0].station.stats.dropped = 3
    sim.print_summary(simulation, json=False)
    table, _, text = capsys.readouterr().out.partition("answers too late were not sent, ")
    assert table.rstrip().endswith("0                 3")
    assert text.startswith(
        "because another telegram was there already: this computer was busy for longer than the master waits, or "
        "another master talked at the same time"
    )
