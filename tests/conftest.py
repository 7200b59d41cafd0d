"""Fixtures for all tests."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Iterator

import pytest
from support import WorldFactory, wire_log


@pytest.fixture(scope="session", autouse=True)
def runtime_directory() -> Iterator[str]:
    """Programs under test, in this process and in others, keep their sockets to themselves (short: a socket's path)."""
    with tempfile.TemporaryDirectory(prefix="dp") as path, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", path)
        yield path


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
