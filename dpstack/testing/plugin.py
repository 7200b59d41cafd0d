"""The pytest plugin: fixtures, and the wire log of a failing test.

pytest imports this module at its start, in every project of an environment with dpstack. It imports the rest of dpstack
when a fixture is used.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from dpstack.testing.bus import BusFactory, VirtualTime

_LOG = "dpstack_wire_log"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addini(_LOG, "telegrams of a simulated bus in the report of a failing test; 0: none", default="40")


@pytest.fixture
def dpstack_time() -> Iterator[VirtualTime]:
    """Virtual time for one test: ``dpstack_time.run(program())``."""
    from dpstack.testing.bus import VirtualTime

    time = VirtualTime()
    yield time
    time.close()


@pytest.fixture
def dpstack_bus(dpstack_time: VirtualTime) -> Iterator[BusFactory]:
    """Makes simulated buses in virtual time: ``bus = dpstack_bus("plant.toml")``; they end in order with the test."""
    from dpstack.testing.bus import BusFactory

    factory = BusFactory(dpstack_time)
    yield factory
    factory.close()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A drive's conformance runs with each telegram that the class names."""
    of_class = getattr(metafunc.cls, "dpstack_telegrams", None)
    if of_class is not None and "dpstack_telegram" in metafunc.fixturenames:
        metafunc.parametrize("dpstack_telegram", of_class())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Append the decoded wire log of the test's buses to the report of its failure."""
    report = yield
    factory = getattr(item, "funcargs", {}).get("dpstack_bus")
    buses = getattr(factory, "buses", ())
    telegrams = int(item.config.getini(_LOG))
    if report.failed and telegrams > 0:
        for number, bus in enumerate(buses, 1):
            report.sections.append((f"dpstack bus {number} of {len(buses)}", bus.report(telegrams)))
    return report
