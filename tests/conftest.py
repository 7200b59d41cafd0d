"""Fixtures for all tests."""

from __future__ import annotations

from collections.abc import Generator, Iterator

import pytest
from support import WorldFactory, wire_log


@pytest.fixture
def world() -> Iterator[WorldFactory]:
    """Makes worlds (arguments as ``World``); at the end of the test each one's referee has its say."""
    factory = WorldFactory()
    yield factory
    factory.check()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failing test prints the decoded wire log of its worlds."""
    report = yield
    factory = getattr(item, "funcargs", {}).get("world")
    if report.failed and call.when == "call" and isinstance(factory, WorldFactory):
        report.sections += [
            (f"wire log of world {number}", wire_log(made)) for number, made in enumerate(factory.worlds)
        ]
    return report
