"""Fixtures for all tests."""

from __future__ import annotations

import gc
import inspect
import os
import signal
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import probe_connector
import pytest
from _pytest.runner import runtestprotocol
from api_kit import in_virtual_time
from forked_programs import ForkServer
from hypothesis import is_hypothesis_test
from lost_errors import no_lost_errors
from programs import Starter
from property_kit import register_profiles, soaking
from shared_compilation import share_compilation
from support import WorldFactory, wire_log

from dpstack.sim.world import World

if TYPE_CHECKING:
    from xdist.remote import Producer
    from xdist.scheduler import LoadFileScheduling

register_profiles()  # before test modules take their settings from them


def pytest_configure() -> None:
    """A shell's ``&`` and ``nohup`` hand on signals that are ignored, also to the programs that tests start.

    A handler is not handed on: SIGHUP still does not end pytest, but a program under test.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda number, frame: None)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """``make soak`` runs what hypothesis drives too."""
    if soaking():
        for item in items:
            if is_hypothesis_test(getattr(item, "obj", None)):
                item.add_marker(pytest.mark.soak)


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makeitem(collector: pytest.Module | pytest.Class, name: str, obj: object) -> None:
    """``pytestmark = pytest.mark.virtual_time``: the coroutines of a module are programs of simulated buses.
    With the mark at a function it is that one."""
    marked = any(mark.name == "virtual_time" for mark in getattr(obj, "pytestmark", ()))
    if not marked and collector.get_closest_marker("virtual_time") is None:
        return
    if inspect.iscoroutinefunction(obj) and collector.istestfunction(obj, name):
        setattr(collector.obj, name, in_virtual_time(obj))


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Generator[None, object, object]:
    """Have no garbage collection look at what pytest collects: half a million objects that stay, 0.35 s each time."""
    gc.disable()
    share_compilation(session.config)
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadFileScheduling | None:
    """``--dist loadfile`` begins with the longest files."""
    if config.getoption("dist") != "loadfile":
        return None
    from file_scheduling import LongFilesFirst  # needs pytest-xdist, which a run in one process does not

    return LongFilesFirst(config, log)


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Where tests run in two processes, a test sends its result to the one that prints it, and no word about how it
    begins, is set up, torn down and ends unless something happened there: 1 ms of processor time for each test."""
    option = item.config.option
    if (
        not hasattr(item.config, "workerinput")
        or option.verbose > 0
        or option.durations
        or getattr(option, "xmlpath", None)
    ):
        return None
    for report in runtestprotocol(item, log=False, nextitem=nextitem):
        if report.when == "call" or not report.passed:
            item.ihook.pytest_runtest_logreport(report=report)
    return True


@pytest.fixture
def no_collection() -> Iterator[None]:
    """For tests that count calls: no garbage of other tests is collected meanwhile, with its ``__del__``."""
    collecting = gc.isenabled()
    gc.disable()
    yield
    if collecting:
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def runtime_directory() -> Iterator[str]:
    """Programs under test, in this process and in others, keep their sockets to themselves (short: a socket's path).

    What they are made of is compiled once, not at every start, whatever the environment says.
    """
    # tests bind sockets there by their paths, which have 107 octets at most: a long TMPDIR breaks none of them
    folder = tempfile.gettempdir()
    folder = folder if len(folder) < 40 else "/tmp"
    with tempfile.TemporaryDirectory(prefix="dp", dir=folder) as path, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", path)
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        yield path


@pytest.fixture(scope="session", autouse=True)
def errors_are_asked_for() -> Iterator[None]:
    """The last test of a process ends with an error where a task of any test has left one behind."""
    with no_lost_errors():
        yield


@pytest.fixture
def world() -> Iterator[WorldFactory]:
    """Makes worlds (arguments as ``World``); at the end of the test each one's referee has its say."""
    factory = WorldFactory()
    yield factory
    factory.check()


@pytest.fixture
def probe() -> Iterator[None]:
    """Configurations may have the connector ``[probe]``."""
    probe_connector.register()
    yield
    probe_connector.forget()


@pytest.fixture
def w(world: WorldFactory) -> World:
    """A world that has nothing of its own."""
    return world()


@pytest.fixture(scope="session")
def fork_server(runtime_directory: str) -> Iterator[ForkServer | None]:
    """None on systems where the server cannot wait for its forks."""
    if not hasattr(os, "pidfd_open"):
        yield None
        return
    server = ForkServer()
    yield server
    server.close()


@pytest.fixture
def start(tmp_path: Path, fork_server: ForkServer | None) -> Iterator[Starter]:
    """Starts ``dpstack`` with the arguments it is called with; at the end of the test nothing of it runs on."""
    folder = tmp_path / "output"
    folder.mkdir()
    starter = Starter(folder, fork_server)
    yield starter
    starter.close()


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
