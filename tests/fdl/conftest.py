"""The ways of telling a passive station what is on the wire, and a wire without stations."""

from __future__ import annotations

import pytest
from ring_bus import RingBus

from tests.fdl.passive_kit import HOWS


@pytest.fixture(params=HOWS)
def how(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def bus() -> RingBus:
    return RingBus()
