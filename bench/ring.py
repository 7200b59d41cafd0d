"""Two masters in a token ring on one segment, at the highest rate at which two bare loops hold it.

The segment is a program in C (bench/segment.c), because Python cannot keep the times of 12 Mbit/s: it joins two ptys as
one RS-485 line, gives every octet its 11 bits, and answers for the slaves. It is compiled into a temporary folder.

A bare loop waits for the token, exchanges data with its slaves and passes the token on, with T_ID1 before each telegram
and without any protocol. Two of them *hold* the ring at a rate when no token is lost, and half of the tokens at least
are answered within the slot time by the clock of the segment. A token is *lost* when its sender repeats it or claims a
new one; at a pty bare loops have the same patience as dpstack, because a computer may stand still for longer than T_SL.
*Efficiency* is the time by the rules of what was sent (11 bits an octet, min T_SDR, idle times), divided by the time
that it took.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from bench.masters import CONFIG, DRIVERS, FIRST, IDENT, OCTETS, RING_KIND
from bench.options import count, duration, slaves
from bench.report import Report, Table, quantile
from bench.rig import MasterFailedError, Process, Processors, available, note_disturbance, pinned
from dpstack.params import BusParams
from dpstack.units import baud_text

_SOURCE: Final = Path(__file__).with_name("segment.c")
_BAUDS: Final = (500_000, 1_500_000, 3_000_000, 6_000_000, 12_000_000)
_ADDRESSES: Final = (1, 2)
#: of dpstack's masters: few addresses to look for other masters at
_HSA: Final = 10
_COMPILERS: Final = ("cc", "gcc", "clang")
#: share of tokens that are answered within T_SL where two bare loops hold the ring
_IN_TIME: Final = 0.5
_SETTLE_S: Final = 0.5
_LOOPS: Final = "two bare loops"
_COLUMNS: Final = ("rotations", "efficiency", "lost", "repeats", "collisions", "after T_SL", "p50", "p99")


class Ring(NamedTuple):
    """One measurement of two masters. Times in ns; ``answers``: from a token's end to the next telegram's begin."""

    took: int
    ruled: int
    rotations: Sequence[int]
    answers: Sequence[int]
    tokens: int
    lost: int
    late: int  # tokens that were answered later than T_SL
    repeats: int
    collisions: int
    exchanges: int
    waited: float = 0.0  # share of the time in which one of them could have run, and another program had its processor

    @property
    def efficiency(self) -> float:
        return self.ruled / self.took

    @property
    def per_second(self) -> float:
        """Rotations."""
        return len(self.rotations) * 1e9 / self.took

    @property
    def holds(self) -> bool:
        """No token is lost, most are answered in time."""
        return bool(self.rotations) and not self.lost and self.late <= (1 - _IN_TIME) * self.tokens


def ring_of(counted: dict[str, Any], waited: float = 0.0) -> Ring:
    """Counters of the segment."""
    return Ring(
        counted["took_ns"],
        counted["ruled_ns"],
        counted["rotations_ns"],
        counted["answers_ns"],
        counted["tokens"],
        counted["token_repeats"] + counted["claims"],
        counted["late_tokens"],
        counted["repeats"],
        counted["collisions"],
        counted["exchanges"],
        waited,
    )


def run(argv: list[str]) -> Report:
    """The benchmark with its own options."""
    parser = argparse.ArgumentParser(prog="python -m bench ring")
    parser.add_argument("--bauds", type=int, nargs="*", default=_BAUDS, help="in bit/s (default: %(default)s)")
    parser.add_argument("--slaves", type=slaves, default=3, help="of each master")
    parser.add_argument("--seconds", type=duration, default=2.0, help="of one measurement")
    parser.add_argument("--rounds", type=count, default=5, help="of all kinds in turn (default: %(default)s)")
    parser.add_argument("--kinds", nargs="*", choices=DRIVERS, default=DRIVERS, help="drivers (default: all)")
    args = parser.parse_args(argv)
    report = Report("ring")
    with pinned() as where, tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder:
        program = compiled(Path(folder))
        report.notes.append(f"both masters share a processor: {where.text}")
        kinds = available(args.kinds, report.notes)
        bauds = sorted(args.bauds)
        report.tables.append(Table(_LOOPS, _COLUMNS, tuple(map(baud_text, bauds))))
        held = 0
        for baud in bauds:
            one = measure(program, RING_KIND, baud, args.slaves, args.seconds, where)
            _add(report, report.tables[0], baud_text(baud), [one])
            held = baud if one.holds else held
        report.add("highest rate that two bare loops hold", held / 1e6, "Mbit/s", more=True)
        if not held:
            report.notes.append("two bare loops hold the ring at no rate: this computer is busy, or too slow")
            return report
        runs: dict[str, list[Ring]] = {kind: [] for kind in (RING_KIND, *kinds)}
        for _ in range(args.rounds):
            for kind, taken in runs.items():
                taken.append(measure(program, kind, held, args.slaves, args.seconds, where))
        compared(report, runs, held)
    return report


def _add(report: Report, table: Table, row: str, taken: Sequence[Ring]) -> None:
    columns: dict[str, tuple[Sequence[float], str]] = {
        "rotations": ([each.per_second for each in taken], "1/s"),
        "efficiency": ([each.efficiency for each in taken], "ratio"),
        "lost": ([float(each.lost) for each in taken], ""),
        "repeats": ([float(each.repeats) for each in taken], ""),
        "collisions": ([float(each.collisions) for each in taken], ""),
        "after T_SL": ([each.late / max(each.tokens, 1) for each in taken], "ratio"),
        "p50": ([quantile(each.answers, 0.5) / 1000 for each in taken if each.answers], "us"),
        "p99": ([quantile(each.answers, 0.99) / 1000 for each in taken if each.answers], "us"),
    }
    for column, (values, unit) in columns.items():
        report.measured(table.name(row, column), values, unit, more=column in ("rotations", "efficiency"))


def compared(report: Report, runs: dict[str, list[Ring]], baud: int) -> None:
    """Add the drivers at the rate that two bare loops hold, beside these, round by round."""
    bare = runs[RING_KIND]
    rows = tuple(_LOOPS if kind == RING_KIND else kind for kind in runs)
    table = Table(f"ring at {baud_text(baud)}", _COLUMNS, rows)
    report.tables.append(table)
    held = not any(each.lost for each in bare)
    if not held:
        report.notes.append(
            f"no verdict: two bare loops lost {sum(each.lost for each in bare)} tokens in the same rounds"
        )
    for row, (kind, taken) in zip(rows, runs.items(), strict=True):
        _add(report, table, row, taken)
        if kind in DRIVERS:  # whatever the rate is, for comparisons of runs
            lost = float(sum(each.lost for each in taken))
            report.add(f"two masters, {kind}: tokens lost", lost, "", 0.0 if held else None)
            ratios = [each.efficiency / its.efficiency for each, its in zip(taken, bare, strict=True)]
            report.measured(f"two masters, {kind}: efficiency to two bare loops'", ratios, "ratio", more=True)
    note_disturbance(report, (each for taken in runs.values() for each in taken))
    report.notes.append(
        "rotations a second; lost: tokens; repeats: of requests; after T_SL: share of the tokens that nobody had "
        f"answered then ({BusParams.preset(baud).ns(BusParams.preset(baud).t_sl) / 1000:.0f} us at {baud_text(baud)}); "
        "p50, p99: us from a token's end to the next telegram"
    )


# --- the segment ---


def compiled(folder: Path, compilers: Sequence[str] = _COMPILERS) -> Path:
    """The segment as a program in ``folder``. Raises RuntimeError where there is no compiler, or it fails."""
    compiler = next(filter(None, map(shutil.which, compilers)), None)
    if compiler is None:
        raise RuntimeError(
            f"the segment of this benchmark needs a C compiler ({', '.join(compilers)}): apt install gcc"
        )
    program = folder / "segment"
    words = [compiler, "-O2", "-Wall", "-Wextra", "-o", str(program), str(_SOURCE)]
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if ended.returncode:
        raise RuntimeError(f"{compiler} cannot compile {_SOURCE.name}: {ended.stderr.strip()[-300:]}")
    return program


def words_of(params: BusParams, stations: int, slaves: Sequence[str]) -> list[str]:
    """The segment's arguments; answers come in portions of a quarter slot time."""
    portion = max(1, params.t_sl // 4 // 11)
    times = (params.baud, params.t_id1, params.t_id2, params.min_tsdr, params.t_sl, portion, stations)
    return [*map(str, times), *slaves]


@contextlib.contextmanager
def segment(
    program: Path, params: BusParams, stations: int, slaves: Sequence[str], processor: int | None = None
) -> Iterator[tuple[Process, list[str]]]:
    """A segment with so many masters' ports, and its ports. Raises RuntimeError when it does not start."""
    process = Process([str(program), *words_of(params, stations, slaves)], processor)
    try:
        ports = json.loads(process.line() or "{}").get("ports", [])
        if len(ports) != stations:
            raise RuntimeError("the segment did not start")
        yield process, ports
    finally:
        process.end(2.0)


def counted(process: Process) -> dict[str, Any]:
    """Counters of the segment since the order "begin"."""
    process.order("end")
    answer = process.line(30.0)
    if not answer:
        raise RuntimeError("the segment ended before its order")
    data: dict[str, Any] = json.loads(answer)
    return data


def measure(program: Path, kind: str, baud: int, slaves: int, seconds: float, where: Processors) -> Ring:
    """Two masters of ``kind`` with ``slaves`` slaves each, for so long.

    Raises MasterFailedError when one does not bring its slaves up, or loses one.
    """
    params = BusParams.preset(baud)
    all_slaves = [f"{FIRST + n}:{IDENT:04x}:{CONFIG.hex()}:{OCTETS}:{OCTETS}" for n in range(2 * slaves)]
    with contextlib.ExitStack() as stack:
        wire, ports = stack.enter_context(segment(program, params, 2, all_slaves, where.wire))
        masters: list[Process] = []
        for number in (1, 0):  # the bare loop that listens has to be there first
            words = [sys.executable, "-m", "bench.masters", kind, ports[number], "--baud", str(baud)]
            words += ["--slaves", str(slaves), "--first", str(FIRST + number * slaves)]
            words += ["--address", str(_ADDRESSES[number]), "--other", str(_ADDRESSES[1 - number])]
            words += ["--t-id1", str(params.t_id1), "--hsa", str(_HSA)]
            master = Process(words, where.master)
            stack.callback(master.end)
            masters.append(master)
            if kind == RING_KIND and "listens" not in json.loads(master.line() or "{}"):
                raise MasterFailedError(f"{kind}: it did not start")
        for master in masters:
            facts = json.loads(master.line() or "{}")
            if "ready" not in facts:
                why = facts.get("error", "the master ended without a word")
                raise MasterFailedError(f"{kind}, two masters at {baud_text(baud)}: {why}")
        time.sleep(min(_SETTLE_S, seconds))
        wire.order("begin")
        waited = sum(process.waited() for process in (wire, *masters))
        time.sleep(seconds)
        data = counted(wire)
        waited = sum(process.waited() for process in (wire, *masters)) - waited
        taken = ring_of(data, waited / data["took_ns"])
        told = [fact for master in masters for fact in master.end()]
        if told:
            raise MasterFailedError(f"{kind}, two masters at {baud_text(baud)}: {told[0].get('error', told[0])}")
        return taken
