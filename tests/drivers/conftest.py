"""Tests of what drivers have in common run with each of them."""

from __future__ import annotations

import pytest

from tests.drivers import driver_rig


@pytest.fixture(params=driver_rig.DRIVERS)
def kind(request: pytest.FixtureRequest) -> str:
    """The name of a driver."""
    return str(request.param)


@pytest.fixture
def each_driver(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rig, and :func:`driver_rig.driver_on`, use this driver."""
    monkeypatch.setattr(driver_rig, "kind", kind)
