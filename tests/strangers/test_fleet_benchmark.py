"""``python -m bench fleet`` in small, with mosquitto: every part gives its figures, and the host finds no breach."""

from __future__ import annotations

import pytest

from bench.plant import fleet
from tests.strangers.stranger_kit import program

pytestmark = pytest.mark.strangers

SMALL = (
    "--gateways 4 --buses 1 --slaves 2 --processes 2 --seconds 2 --losses 2 --restarts 1 --down 0.5 --recorded 8 "
    "--interval-ms 200"
)


def test_a_small_fleet_is_measured() -> None:
    program("mosquitto")
    report = fleet.run(SMALL.split())
    values = {figure.name: figure.value for figure in report.figures}
    assert {figure.name: figure.met for figure in report.figures if figure.met is False} == {}
    death = "DDEATH at the subscriber, "
    assert values[f"{death}from the loss of a slave's power: samples"] == 2
    assert values[f"{death}from the master's event: samples"] == 2
    # the master finds the loss first, then the subscriber hears of it
    assert values[f"{death}from the master's event: max"] < values[f"{death}from the loss of a slave's power: max"]
    assert values["broker back to births of a gateway: samples"] == 4
    assert values["NDEATH by the broker, from SIGKILL of the gateway: samples"] == 2
    assert values["messages"] > 4
    assert values["values of history that came after restarts of the broker"] > 0
    assert values["NBIRTH, the largest: metrics"] > values["DBIRTH, the largest: metrics"] > 4
    assert values["memory of a gateway in a process of many, all"] > 0
