"""Tests of a plant in a CI job: on the line of job.sh, and in virtual time (``pytest examples/ci`` runs the latter)."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

import dpstack
from dpstack.testing import BusFactory

PLANT = Path(__file__).with_name("plant.toml")
PORT = os.environ.get("PLANT_PORT", "")


async def seen(slave: dpstack.Slave, text: str, there: bool = True) -> None:
    """Wait until ``text`` is in the diagnosis of ``slave``, or no more."""
    async with asyncio.timeout(15):
        while any(text in line for line in slave.diagnosis_texts) is not there:  # noqa: ASYNC110
            await asyncio.sleep(0.05)


@pytest.mark.skipif(not PORT, reason="job.sh makes the line")
def test_on_the_line() -> None:
    async def program() -> None:
        async with dpstack.open_bus(PLANT, port=PORT) as bus:
            rack = bus.slave("rack")
            await bus.operate()
            await rack.ready(10)
            await seen(rack, "input channel 0 (word): line break")
            await seen(rack, "input channel 5 (bit): short circuit")
            await seen(rack, "short circuit", there=False)
            await seen(rack, "line break", there=False)
            assert rack.state is dpstack.SlaveState.DATA_EXCHANGE

    asyncio.run(program())


def test_in_virtual_time(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(PLANT, baud=93_750, scenario=PLANT.with_name("faults.toml"))
    rack = bus.slave("rack")
    for _ in range(2):  # of the faults
        bus.run(seen(rack, "line break"))
        bus.run(seen(rack, "line break", there=False))
    bus.wire.assert_brought_up("rack")
