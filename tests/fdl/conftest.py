"""The ways of telling a passive station what is on the wire."""

from __future__ import annotations

import pytest

from tests.fdl.passive_kit import HOWS


@pytest.fixture(params=HOWS)
def how(request: pytest.FixtureRequest) -> str:
    return str(request.param)
