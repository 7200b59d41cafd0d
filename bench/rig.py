"""A wire and a master on it, as processes of their own on processors of their own, and the results of both."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple, Protocol

from bench.calibration import calibrate_python
from bench.commit_probe import cpu_of, family
from bench.losses import stolen_ns, story
from bench.masters import CONFIG, DRIVERS, FIRST, IDENT, OCTETS
from bench.records import Record
from bench.report import Report
from dpstack.api.config.config import make_config
from dpstack.errors import ConfigError
from dpstack.params import BusParams

#: the master polls no GAP
NO_GAP: Final = ("--gap", "0")
_ROOT: Final = Path(__file__).resolve().parent.parent
_PROBE: Final = Path(__file__).resolve().parent / "probe"
_START_S: Final = 90.0
_SETTLE_S: Final = 0.2
#: a measurement has so many rounds at least, unless that takes longer than this
_LEAST_ROUNDS: Final = 12
_PATIENCE_NS: Final = 10_000_000_000
#: more than this share of the time in run queues is worth a note
_DISTURBED: Final = 0.02
#: and with more than this no goal is judged
_SPOILT: Final = 0.2


class MasterFailedError(RuntimeError):
    """A master did not bring its slaves up, or ended before its order; the text says which one and why."""


class NotAvailableError(Exception):
    """A master or driver that cannot be measured here; the text names it and the reason."""


@dataclass(frozen=True, slots=True)
class Taken:
    """Result of one measurement of ``seconds``. ``cpu``: CPU time of the master in ns, ``python_loop``: the Python loop
    beside it in ns. ``turns``: turn-arounds in ns, ``token_turns``: those with the token between; ``due``: a
    due time of the fixed cycle in ns, 0 without one."""

    seconds: float
    exchanges: int
    cpu: int
    waited: float  # share of the time in which either end could have run, and another program had its processor
    records: list[Record]
    held: int
    turns: list[int]
    token_turns: list[int]
    python_loop: float = 0.0
    due: int = 0
    wake_ups: int = 0  # times that the master has slept
    preempted: int = 0  # times that another program took its processor

    @property
    def cpu_per_exchange(self) -> tuple[float, float]:
        """CPU time per exchange and the Python loop beside it, both in ns."""
        return self.cpu / max(self.exchanges, 1), self.python_loop


class Processors(NamedTuple):
    """Where the ends run; None: wherever the system puts them."""

    master: int | None
    wire: int | None

    @property
    def text(self) -> str:
        """For a report's notes."""
        if self.master is None:
            return "processors not pinned"
        if self.wire is None:
            return f"everything on processor {self.master}: there is no other"
        return f"master on processor {self.master}, wire on processor {self.wire}"


@contextlib.contextmanager
def pinned() -> Iterator[Processors]:
    """The first for the master, and for the calibration loops of this process; the next one for the wire."""
    if not hasattr(os, "sched_setaffinity"):
        yield Processors(None, None)
        return
    before = os.sched_getaffinity(0)
    mine, *others = sorted(before)
    os.sched_setaffinity(0, {mine})
    try:
        yield Processors(mine, others[0] if others else None)
    finally:
        os.sched_setaffinity(0, before)


class Process:
    """A process of ours with lines of JSON on its output and orders on its input."""

    def __init__(self, words: Sequence[str], processor: int | None, env: dict[str, str] | None = None) -> None:
        self._process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=_ROOT,
            env=env,
            # Linux shares the time out by sessions (autogroup), and within one the wire's priority took the master's
            start_new_session=True,
        )
        if processor is not None:
            os.sched_setaffinity(self._process.pid, {processor})

    @property
    def pid(self) -> int:
        return self._process.pid

    def waited(self) -> int:
        """Time in ns that it and its children have waited in run queues so far."""
        return sum(map(_waited_of, family(self.pid)))

    def order(self, text: str) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(text + "\n")
            self._process.stdin.flush()

    def line(self, timeout: float = _START_S) -> str:
        """The next line from it, empty at its end; it is killed when none comes in time."""
        assert self._process.stdout is not None
        killer = threading.Timer(timeout, self._process.kill)
        killer.daemon = True
        killer.start()
        try:
            return self._process.stdout.readline()
        finally:
            killer.cancel()

    def end(self, timeout: float = 10.0) -> list[dict[str, object]]:
        """Close its input and wait for its end, or kill it; what it still had to tell, nothing when repeated."""
        stdin, self._process.stdin = self._process.stdin, None
        if stdin is None:
            return []
        with contextlib.suppress(BrokenPipeError):
            stdin.close()
        try:
            out, _ = self._process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            out, _ = self._process.communicate()
        return [json.loads(line) for line in out.splitlines() if line.startswith("{")]


class Bench:
    """One master on one wire, both running, all slaves in data exchange. ``facts`` is what the master told then."""

    def __init__(self, wire: Process, master: Process, slaves: int, facts: dict[str, Any], folder: Path) -> None:
        self.facts = facts
        self._least = _LEAST_ROUNDS * slaves
        self._wire = wire
        self._master = master
        self._folder = folder

    def measure(self, seconds: float) -> Taken:
        """Leave both alone for a moment, then measure for ``seconds``, longer while there are too few exchanges.

        The Python loop runs directly before and after, on the master's processor.
        """
        time.sleep(min(_SETTLE_S, seconds))
        loop = calibrate_python()
        self._ask("begin")
        since, cpu, waited, slept = time.monotonic_ns(), self._sum(cpu_of), self._waited(), self._switches()
        time.sleep(seconds)
        give_up = time.monotonic_ns() + _PATIENCE_NS
        while int(self._ask("count")) < self._least and time.monotonic_ns() < give_up:
            time.sleep(seconds)
        cpu, until = self._sum(cpu_of) - cpu, time.monotonic_ns()
        waited = self._waited() - waited
        wake_ups, preempted = (now - then for now, then in zip(self._switches(), slept, strict=True))
        data = self._data()
        loop = (loop + calibrate_python()) / 2
        turns, token_turns = self._turns(since, until)
        records = [Record(*record) for record in data["records"]]
        took = until - since
        return Taken(
            took / 1e9,
            data["exchanges"],
            cpu,
            waited / took,
            records,
            data["held"],
            turns,
            token_turns,
            loop,
            int(self.facts.get("due", 0)),
            wake_ups,
            preempted,
        )

    def system_calls(self, seconds: float) -> float | None:
        """System calls of the master per exchange, counted by perf; None without perf or its permission."""
        if shutil.which("perf") is None:
            return None
        pids = ",".join(map(str, family(self._master.pid)))
        self._ask("begin")
        begin = time.monotonic()
        words = ["perf", "stat", "-x,", "-e", "raw_syscalls:sys_enter", "-p", pids, "--", "sleep", str(seconds)]
        counted = subprocess.run(words, capture_output=True, text=True, check=False).stderr.partition(",")[0]
        rate = int(self._ask("count")) / (time.monotonic() - begin)  # perf needs some time to begin
        return int(counted) / seconds / rate if counted.isdecimal() and rate else None

    def _switches(self) -> tuple[int, int]:
        """How often the master has slept so far, and how often another program took its processor."""
        found = [_switches_of(pid) for pid in family(self._master.pid)]
        return sum(slept for slept, _ in found), sum(preempted for _, preempted in found)

    def cycles(self, seconds: float) -> list[int]:
        """Fixed cycles within ``seconds`` by the master's books: begun, late, left out; missed after a long round."""
        before = self._told_cycles()
        time.sleep(seconds)
        return [now - then for now, then in zip(self._told_cycles(), before, strict=True)]

    def _told_cycles(self) -> list[int]:
        os.kill(self._master.pid, signal.SIGHUP)
        numbers: list[int] = json.loads(self._master.line(30.0) or "{}").get("cycles", [])
        if not numbers:
            raise RuntimeError("the master ended before it told its cycles")
        return numbers

    def cpu_slices(self, seconds: float) -> tuple[int, int, int]:
        """CPU time of the master in ns, that of its bus process alone (with the driver asyncio the same one), and the
        exchanges meanwhile."""
        self._ask("begin")
        pids = family(self._master.pid)
        before = [cpu_of(pid) for pid in pids]
        time.sleep(seconds)
        exchanges = int(self._ask("count"))
        took = [cpu_of(pid) - cpu for pid, cpu in zip(pids, before, strict=True)]
        return sum(took), sum(took[1:] or took), exchanges

    def switch_connectors(self, *, on: bool) -> list[str]:
        """Have a master begin its connectors, or end them, and wait until that is done. Returns the remarks of
        connectors that have ended. Raises RuntimeError if it is not done."""
        os.kill(self._master.pid, signal.SIGUSR1 if on else signal.SIGUSR2)
        answer = json.loads(self._master.line(60.0) or "{}")
        connectors = answer.get("connectors")
        if bool(connectors) is not on:
            raise RuntimeError(f"the connectors do not {'serve' if on else 'end'}: {connectors}")
        return list(answer.get("remarks", ()))

    def of_wire(self) -> dict[str, Any]:
        """The data of the wire; after its end only the reason of the end."""
        try:
            return self._data()
        except RuntimeError as error:
            return {"over": str(error)}

    def _data(self) -> dict[str, Any]:
        path = self._folder / "taken.json"
        self._ask(f"end {path}")
        data: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return data

    def _ask(self, order: str) -> str:
        self._wire.order(order)
        answer = self._wire.line(30.0)
        if not answer:
            raise RuntimeError("the wire ended before its order")
        return answer

    def _sum(self, of: Callable[[int], int]) -> int:
        return sum(of(pid) for pid in family(self._master.pid))

    def _waited(self) -> int:
        return self._master.waited() + self._wire.waited()

    def _turns(self, since: int, until: int) -> tuple[list[int], list[int]]:
        turns: list[int] = []
        token_turns: list[int] = []
        for path in self._folder.iterdir():
            if path.name.isdigit():
                pairs = memoryview(path.read_bytes()).cast("Q")
                for place in range(2, min(len(pairs), 2 + 2 * pairs[0]), 2):
                    if since <= pairs[place] < until:
                        value = pairs[place + 1]
                        (token_turns if value & 1 else turns).append(value >> 1)
        return turns, token_turns


def cpu_to_bare(runs: Sequence[Taken], bare: Sequence[Taken]) -> list[float]:
    """CPU time per exchange to that of a bare loop, round by round."""
    return [ours.cpu_per_exchange[0] / loop.cpu_per_exchange[0] for ours, loop in zip(runs, bare, strict=True)]


@contextlib.contextmanager
def wire_with(
    slaves: int, baud: int, processor: int | None, *, paced: bool, ident: int = IDENT, more: Sequence[str] = ()
) -> Iterator[tuple[Process, str]]:
    """A wire with slaves, see :func:`bench`, and its port. Raises RuntimeError when it does not start."""
    params = BusParams.preset(baud)
    words = [sys.executable, str(_ROOT / "bench" / "wire.py"), "--baud", str(baud)]
    words += [f"{FIRST + n}:{ident:04x}:{CONFIG.hex()}:{OCTETS}:{OCTETS},records=1" for n in range(slaves)]
    if paced:
        words += ["--paced", "--min-tsdr", str(params.min_tsdr), "--slice-bits", str(params.t_sl // 4), *more]
        words += ["--t-id1", str(params.t_id1), "--t-id2", str(params.t_id2), "--t-sl", str(params.t_sl)]
    wire = Process(words, processor)
    try:
        port = str(json.loads(wire.line() or "{}").get("port", ""))
        if not port:
            raise RuntimeError("the wire did not start")
        yield wire, port
    finally:
        wire.end(2.0)


@contextlib.contextmanager
def bench(
    kind: str,
    slaves: int,
    baud: int,
    where: Processors,
    *,
    paced: bool = True,
    probe: bool = False,
    cycle_ms: float | None = None,
    ident: int = IDENT,
    env: dict[str, str] | None = None,
    more: Sequence[str] = (),
    of_wire: Sequence[str] = (),
) -> Iterator[Bench]:
    """Start a wire and a master of ``kind`` on it. Raises NotAvailableError when there is none of that kind,
    MasterFailedError when it does not get its slaves into data exchange.

    ``paced``: the wire takes its time; ``probe``: turn-arounds are noted; ``ident``: what the slaves are, of which the
    masters believe IDENT. ``env``: of a master without a probe. ``more``, ``of_wire``: further words of its command
    line, and of that of a paced wire.
    """
    refused = unavailable(kind, cycle_ms)
    if refused:
        raise NotAvailableError(refused)
    params = BusParams.preset(baud)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="dpstack-bench-")))
        wire, port = stack.enter_context(wire_with(slaves, baud, where.wire, paced=paced, ident=ident, more=of_wire))
        words = [sys.executable, "-m", "bench.masters", kind, port, "--baud", str(baud), "--slaves", str(slaves)]
        words += more
        if cycle_ms is not None:
            words += ["--cycle-ms", str(cycle_ms)]
        if kind == "bare" and paced:
            words += ["--t-id1", str(params.t_id1)]
        master = Process(words, where.master, _probed(port, folder) if probe else env)
        told: list[dict[str, object]] = []
        stack.callback(lambda: told.extend(master.end()))
        facts = json.loads(master.line() or "{}")
        if "ready" not in facts:
            raise MasterFailedError(f"{kind}, {slaves} slaves: {facts.get('error', 'the master ended without a word')}")
        stolen = stolen_ns()
        running = Bench(wire, master, slaves, facts, folder)
        yield running
        told += master.end()
        if told:
            why = story(told[0], running.of_wire(), stolen_ns() - stolen)
            raise MasterFailedError(f"{kind}, {slaves} slaves: {why}")


def _probed(port: str, folder: Path) -> dict[str, str]:
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, (str(_PROBE), os.environ.get("PYTHONPATH")))),
        "BENCH_LINE": port,
        "BENCH_PROBE": str(folder),
    }


@cache
def unavailable(kind: str, cycle_ms: float | None = None) -> str:
    """Why a master of ``kind`` cannot be measured here; empty when it can."""
    if kind == "pyprofibus":
        found = importlib.util.find_spec("pyprofibus") is not None
        return "" if found else "pyprofibus is not installed: python -m pip install -e '.[bench]'"
    if kind in DRIVERS:
        keys: dict[str, object] = {"driver": kind} | ({} if cycle_ms is None else {"cycle_ms": cycle_ms})
        try:
            make_config("/dev/null", 12_000_000, 2, (), bus=keys)
        except ConfigError as error:
            return f"{kind} is not available: {error}".replace("\n", " ")
    return ""


def available(kinds: Sequence[str], notes: list[str], cycle_ms: float | None = None) -> list[str]:
    """Those of ``kinds`` that can be measured; why the others cannot goes to ``notes``."""
    notes.extend(filter(None, (unavailable(kind, cycle_ms) for kind in kinds)))
    return [kind for kind in kinds if not unavailable(kind, cycle_ms)]


def one_round(
    taken: dict[tuple[str, int], list[Taken]], measure: Callable[[str, int], Taken], notes: list[str]
) -> None:
    """Measure every (kind, slaves) of ``taken`` once more.

    What others than our own drivers cannot do is their affair: it goes to ``notes`` and out of ``taken``. Raises
    MasterFailedError for our own.
    """
    for kind, slaves in list(taken):
        try:
            taken[kind, slaves].append(measure(kind, slaves))
        except MasterFailedError as error:
            if kind in DRIVERS:
                raise
            notes.append(f"left out: {error}")
            del taken[kind, slaves]


def _waited_of(pid: int) -> int:
    """Time in ns that threads of a process have waited in a run queue (second figure of schedstat)."""
    waited = 0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError, IndexError):
            waited += int(path.read_text().split()[1])
    return waited


def _switches_of(pid: int) -> tuple[int, int]:
    """Voluntary and other context switches of all threads of a process."""
    found = [0, 0]
    for path in Path(f"/proc/{pid}/task").glob("*/status"):
        with contextlib.suppress(OSError):  # it has just ended
            *_, slept, preempted = path.read_text().split("ctxt_switches:")
            found[0] += int(slept.split()[0])
            found[1] += int(preempted.split()[0])
    return found[0], found[1]


class Waited(Protocol):
    """A measurement that knows the share of the time in which another program had its processors."""

    @property
    def waited(self) -> float: ...


def note_disturbance(report: Report, taken: Iterable[Waited], where: str = "") -> None:
    """Say in ``report`` when other programs had the processors; for a good part of the time: goals are not judged."""
    shares = [t.waited for t in taken]
    share = median(shares) if shares else 0.0
    if share >= _DISTURBED:
        text = f"other programs had the processors {share:.0%} of the time (median): these figures are theirs too"
        report.notes.append(f"{where}: {text}" if where else text)
    report.busy |= share >= _SPOILT
