"""Trials of mutants: each in a forked process, against the tests that can notice it, until the first one fails.

A mutant in a function is tried in a copy of a process that has collected all tests already: the function gets the code
of the mutated one. Other mutants (constants, defaults of arguments, classes, functions that are called at import) are
tried in a process that has imported nothing of dpstack yet and finds the mutated source in place of the file.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.util
import mmap
import os
import resource
import signal
import struct
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import pytest

from tools.mutants.made import ROOT

OPTIONS: Final = ("-q", "-p", "no:cacheprovider", "-n", "0", "--tb=no", "--assert=plain")
_SURVIVED, _KILLED, _BROKEN = 0, 1, 3
_MEMORY: Final = 4 << 30


@dataclass(frozen=True, slots=True)
class Order:
    """A trial: the file, its mutated source ("": as it is), the function, and the tests with the seconds of each."""

    path: str
    source: str
    qualname: str
    function_line: int
    tests: Sequence[str]
    seconds: Sequence[float]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a trial: killed, survived, timeout, or broken (the trial could not be made)."""

    result: str
    test: str = ""


class CannotSwapError(Exception):
    """The function's code cannot be replaced while the program runs."""


def _limit(seconds: float) -> None:
    """The time of a test: processor time by its usual time, and time on the clock for one that only waits."""
    signal.setitimer(signal.ITIMER_PROF, 10 * seconds + 1.0)
    signal.setitimer(signal.ITIMER_REAL, 100 * seconds + 60.0)


def _in_child(work: Callable[[mmap.mmap], int], tests: Sequence[str]) -> Outcome:
    """Run ``work`` in a forked process; its number of the present test is shared."""
    shared = mmap.mmap(-1, 4)
    child = os.fork()
    if not child:
        code = _BROKEN
        try:
            os.setpgid(0, 0)
            for number in (signal.SIGPROF, signal.SIGALRM):
                signal.signal(number, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            null = os.open(os.devnull, os.O_RDWR)
            for handle in (0, 1, 2):
                os.dup2(null, handle)
            code = work(shared)
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)  # processes that the child's tests started
    number = struct.unpack("i", shared[:4])[0]
    test = tests[number] if number < len(tests) else ""
    if os.WIFSIGNALED(status):
        late = os.WTERMSIG(status) in (signal.SIGPROF, signal.SIGALRM)
        return Outcome("timeout" if late else "killed", test)
    code = os.WEXITSTATUS(status)
    if code == _SURVIVED:
        return Outcome("survived")
    return Outcome("killed" if code == _KILLED else "broken", test)


# -- in a process that has collected all tests --


def _codes(code: CodeType, qualname: str) -> Iterator[CodeType]:
    """The codes of functions named ``qualname`` in a module's code, in order of the source."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_qualname == qualname:
                yield constant
            elif qualname.startswith(constant.co_qualname + "."):
                yield from _codes(constant, qualname)


#: functions by file, qualified name and first line
Live = Mapping[tuple[str, str, int], Sequence[FunctionType]]


def live_functions(folder: str) -> Live:
    """All functions of the files in ``folder``. (A child that looked for them would copy the whole memory.)"""
    found: dict[tuple[str, str, int], list[FunctionType]] = {}
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and function.__code__.co_filename.startswith(folder):
            code = function.__code__
            found.setdefault((code.co_filename, code.co_qualname, code.co_firstlineno), []).append(function)
    return found


def swap(order: Order, live: Live) -> None:
    """Give the live function of ``order`` the mutated code."""
    path = str(ROOT / order.path)
    before = compile((ROOT / order.path).read_text(encoding="utf-8"), path, "exec")
    after = compile(order.source, path, "exec")
    pairs = zip(_codes(before, order.qualname), _codes(after, order.qualname), strict=True)
    codes = [new for old, new in pairs if old.co_firstlineno == order.function_line]
    functions = live.get((path, order.qualname, order.function_line), ())
    if len(codes) != 1 or not functions:
        raise CannotSwapError
    try:
        for function in functions:
            function.__code__ = codes[0]
    except ValueError as error:  # other free variables
        raise CannotSwapError from error


class _Warm:
    """pytest plugin in place of the loop over tests: answers orders that come through a pipe."""

    def __init__(self, orders: Connection) -> None:
        self.orders = orders
        self.live: Live = {}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}
        for plugin in session.config.pluginmanager.get_plugins():
            if hasattr(plugin, "wire_log"):
                plugin.wire_log = lambda made: ""  # the log of a failing test is read by nobody
        first, other = session.items[0], session.items[-1]
        self._run(first, other)  # fixtures of the session are made once
        self.live = live_functions(str(ROOT / "dpstack"))
        gc.collect()
        gc.freeze()
        self.orders.send(sorted(items))
        while (order := self.orders.recv()) is not None:
            self.orders.send(self._trial(order, items))
        self._run(other, None)
        return True

    @staticmethod
    def _run(item: pytest.Item, following: pytest.Item | None) -> bool:
        """Whether the test fails."""
        from _pytest.runner import runtestprotocol

        return any(report.failed for report in runtestprotocol(item, log=False, nextitem=following))

    def _trial(self, order: Order, items: dict[str, pytest.Item]) -> Outcome:
        def work(shared: mmap.mmap) -> int:
            if order.source:
                try:
                    swap(order, self.live)
                except CannotSwapError:
                    return _BROKEN
                except SyntaxError:
                    return _KILLED
            wanted = [items[test] for test in order.tests]
            for number, item in enumerate(wanted):
                shared[:4] = struct.pack("i", number)
                _limit(order.seconds[number])
                if self._run(item, wanted[number + 1] if number + 1 < len(wanted) else item):
                    return _KILLED
            return _SURVIVED

        return _in_child(work, order.tests)


def start_warm(arguments: Sequence[str]) -> tuple[Connection, set[str]]:
    """Fork the process that has collected all tests; its pipe, and the ids of the tests."""
    ours, theirs = Pipe()
    child = os.fork()
    if not child:
        try:
            ours.close()
            pytest.main([*arguments, *OPTIONS], plugins=[_Warm(theirs)])
        finally:
            os._exit(0)
    theirs.close()
    return ours, set(ours.recv())


# -- in a process that has imported nothing of dpstack --


class _Mutated(SourceFileLoader):
    """Finds one module with the mutated source."""

    def __init__(self, order: Order) -> None:
        name = order.path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
        super().__init__(name, str(ROOT / order.path))
        self.source = order.source.encode()

    def find_spec(self, name: str, path: object, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(
            name,
            self.path,
            loader=self,
            submodule_search_locations=[str(Path(self.path).parent)] if self.path.endswith("__init__.py") else None,
        )

    def get_code(self, fullname: str) -> CodeType:
        code: CodeType = self.source_to_code(self.source, self.path)  # never the compiled file
        return code

    def invalidate_caches(self) -> None:
        """Part of what a finder has."""


class _Cold:
    """pytest plugin: runs the tests in the given order until one fails."""

    def __init__(self, order: Order, shared: mmap.mmap) -> None:
        self.order, self.shared = order, shared
        self.failed = self.ran = False

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        self.failed |= report.failed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}
        wanted = [(number, items[test]) for number, test in enumerate(self.order.tests) if test in items]
        self.ran = len(wanted) == len(self.order.tests)
        for index, (number, item) in enumerate(wanted):
            self.shared[:4] = struct.pack("i", number)
            _limit(self.order.seconds[number])
            if _Warm._run(item, wanted[index + 1][1] if index + 1 < len(wanted) else None):
                self.failed = True
                break
        return True


def cold_trial(order: Order) -> Outcome:
    """Try a mutant in a process that imports everything anew."""

    def work(shared: mmap.mmap) -> int:
        if order.source:
            sys.meta_path.insert(0, _Mutated(order))
        plugin: Any = _Cold(order, shared)
        _limit(30.0)
        code = pytest.main([*order.tests, *OPTIONS], plugins=[plugin])
        if plugin.failed:
            return _KILLED
        if plugin.ran:
            return _SURVIVED
        # a module that cannot be imported with the mutant stops conftest.py
        return _KILLED if order.source and code != pytest.ExitCode.NO_TESTS_COLLECTED else _BROKEN

    return _in_child(work, order.tests)


def prepare_cold() -> None:
    """Import what tests need of others, once for all trials."""
    for name in ("asyncio", "construct", "hypothesis", "msgspec", "pytest_asyncio.plugin", "rich", "serial", "anyio"):
        importlib.import_module(name)
    loaded = [name for name in sys.modules if name.split(".")[0] == "dpstack"]
    if loaded:
        raise RuntimeError(f"dpstack is imported already: {loaded[0]}")
