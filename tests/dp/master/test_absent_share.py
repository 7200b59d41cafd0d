"""The share of the bus time that polls of absent slaves may take."""

from __future__ import annotations

import pytest
from scripted_link import MS, exchanging, setup

from dpstack.dp.master.commands import AddSlave


@pytest.mark.parametrize(("divisor", "polls"), [(8, 12), (0, 30)])
def test_short_polls_take_their_share_and_no_more(divisor: int, polls: int) -> None:
    """A poll takes 1 ms. With a share of an eighth of the time the next one comes 8 ms later: five rounds of 1.6 ms."""
    bus = exchanging(setup(3), absent_divisor=divisor)
    for address in range(20, 50):
        bus.send(AddSlave(setup(address)))
    bus.step, bus.period = 1 * MS, 600_000
    bus.run_anew(100 * MS)
    assert len([r for r in bus.requests if r.da >= 20]) == polls
