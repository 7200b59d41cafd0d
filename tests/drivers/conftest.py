"""Tests of what drivers have in common run with each of them."""

from __future__ import annotations

import driver_rig
import pytest


@pytest.fixture(params=["asyncio", "plain"])
def each_driver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rig, and :func:`driver_rig.driver_on`, are with this driver."""
    monkeypatch.setattr(driver_rig, "kind", request.param)
