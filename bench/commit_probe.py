"""A script that measures the start of one commit of dpstack from outside: ``PYTHON bench/commit_probe.py``.

It runs in the environment of that commit and imports nothing of bench, so that an old commit whose own benchmarks lack
a figure is measured by the same rule as a new one. One JSON object: name of the figure -> CPU time, or time,
in Python loops.
"""

from __future__ import annotations

import contextlib
import json
import os
import pty
import resource
import runpy
import select
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

#: of this folder: the bench of the commit may have none
_loop_clock: Final[Callable[..., Callable[[], int]]] = runpy.run_path(str(Path(__file__).with_name("loop_clock.py")))[
    "LoopClock"
]
#: name of a figure -> Python loops
Figures = dict[str, float]

_BAUD: Final = 500_000
_FIRST: Final = 3
#: told when the slaves are in data exchange; the end of standard input ends it
_SLAVES_UP: Final = """\
import asyncio, sys, dpstack
async def main():
    async with dpstack.open_bus(port={port!r}, baud={baud}, driver={driver!r}, slaves={tables}) as bus:
        await bus.operate()
        await bus.ready(30)
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.read)
asyncio.run(main())
"""
_CONFIG: Final = """\
[bus]
port = "{port}"
baud = {baud}
driver = "{driver}"

[[slave]]
name = "valves"
address = 9
ident = 0x1234
config = "20 10"
"""
#: tells its CPU time when it opens the bus
_OPENS: Final = """\
import asyncio, time, dpstack
async def main():
    print(time.process_time_ns(), flush=True)
    async with dpstack.open_bus({path!r}):
        await asyncio.sleep(60)
asyncio.run(main())
"""
#: s after which a program with a connector is at rest, and one whose slaves have come up
_REST_S: Final = 3.0
_SETTLE_S: Final = 1.0
_SLAVES: Final = 32
#: no octets, or no slaves, within so many seconds
_LIMIT_S: Final = 60.0
_DPSTACK: Final = str(Path(sys.executable).with_name("dpstack"))
#: programs are measured as users have them, with their byte code
_ENVIRONMENT: Final = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def _in_loops(run: Callable[[], object]) -> float:
    """CPU time of the programs that ``run`` runs."""
    clock = _loop_clock(_children_ns)
    begin = clock()
    run()
    return (clock() - begin) / 1000


def _version() -> Figures:
    return {"dpstack --version: CPU time": _in_loops(partial(command, "--version"))}


def command_ns(words: str) -> int:
    """CPU time of the command ``dpstack WORDS`` of this environment."""
    begin = _children_ns()
    command(words)
    return _children_ns() - begin


def command(words: str) -> None:
    """Run the command ``dpstack WORDS`` of this environment. Raises RuntimeError when it fails."""
    _output([_DPSTACK, *words.split()])


#: the program that --version and a plain ctl are compared with
PLAIN: Final = ("-c", "import argparse, json, socket")


def plain_ns() -> int:
    """CPU time of an interpreter that only loads what a plain command cannot do without."""
    begin = _children_ns()
    _output([sys.executable, *PLAIN])
    return _children_ns() - begin


def _plain_figure() -> Figures:
    """The interpreter of :data:`PLAIN`, beside the commands of either side."""
    return {"python -c 'import argparse, json, socket': CPU time": _in_loops(plain_ns)}


@contextlib.contextmanager
def running() -> Iterator[str]:
    """A ``dpstack run`` on a simulated bus in this environment, and the name by which ``dpstack ctl`` finds it."""
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder:
        config = Path(folder, "plant.toml")
        config.write_text(_CONFIG.format(port="virtual", baud=_BAUD, driver="auto"), encoding="utf-8")
        words = [_DPSTACK, "run", str(config), "--json"]
        with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=_ENVIRONMENT) as program:
            try:
                assert program.stdout is not None
                if not program.stdout.readline():
                    raise RuntimeError("dpstack run ended without a word")
                yield _name_of(program.pid)
            finally:
                program.terminate()
                program.communicate()


#: commands whose start is a figure; GSD: a file of 256 KB
COMMANDS: Final = ("gsd show GSD", "gsd check GSD", "gsd show demag-dedrive", "plan PLANT", "decode DC0202")
_MODULE: Final = 'Module = "Digital input, 8 channels, variant {}" 0x10\n{}\nEndModule\n'


def _commands() -> Figures:
    examples = Path(__file__).parent.parent / "examples"
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder:
        gsd = Path(folder, "big.gsd")
        modules = "".join(_MODULE.format(number, number) for number in range(1_000, 5_100))
        gsd.write_text((examples / "terminal.gsd").read_text(encoding="latin-1") + modules, encoding="latin-1")
        places = {"GSD": str(gsd), "PLANT": str(examples / "plant.toml")}
        words = {one: " ".join(places.get(word, word) for word in one.split()) for one in COMMANDS}
        return {f"dpstack {one}: CPU time": _in_loops(partial(command, words[one])) for one in COMMANDS}


def _name_of(pid: int) -> str:
    """The name of a run on a simulated bus; older commits have no process number in it."""
    name = f"virtual:{pid}"
    try:
        command(f"ctl {name} status")
    except RuntimeError:
        return "virtual"
    return name


def _status() -> Figures:
    """A command to a running program and its answer."""
    with running() as name:
        return {"dpstack ctl status: CPU time": _in_loops(partial(command, f"ctl {name} status"))}


def _first_octet(driver: str) -> Figures:
    spent = 0
    clock = _loop_clock(lambda: spent)
    begin = clock()
    spent = first_octet_ns(driver)
    figures = {f"dpstack run, {driver}, until the first octet: CPU time": (clock() - begin) / 1000}
    begin = clock()
    spent += opening_ns(driver)
    return figures | {f"open_bus, {driver}, until the first octet: CPU time": (clock() - begin) / 1000}


def first_octet_ns(driver: str) -> int:
    """CPU time of ``dpstack run`` and its bus process until the first octet is on a pty where nobody else sends."""
    with _on_pty(lambda config: [_DPSTACK, "run", config], driver) as program:
        return sum(map(cpu_of, family(program.pid)))


def opening_ns(driver: str) -> int:
    """CPU time of a program and its bus process from the call of ``open_bus`` until the first octet."""
    with _on_pty(lambda config: [sys.executable, "-c", _OPENS.format(path=config)], driver) as program:
        assert program.stdout is not None
        return sum(map(cpu_of, family(program.pid))) - int(program.stdout.readline())


def at_rest(connector: str, state: str) -> tuple[int, list[int]]:
    """CPU time in ns of ``dpstack run`` with the table ``connector`` until it is at rest, and the proportional memory
    in KiB of the application and of its bus process. ``state``: the folder of its state."""
    with _on_pty(lambda path: [_DPSTACK, "run", path], "process", connector, {"XDG_STATE_HOME": state}) as program:
        time.sleep(_REST_S)
        return cpu_of(program.pid), [pss_kib(pid) for pid in family(program.pid)]


@contextlib.contextmanager
def _on_pty(
    words: Callable[[str], Sequence[str]], driver: str, more: str = "", env: Mapping[str, str] = _ENVIRONMENT
) -> Iterator[subprocess.Popen[bytes]]:
    """The program ``words(CONFIG)`` once the first octet is on the pty of the configuration, with the tables ``more``.
    Raises RuntimeError if none comes."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder, os.fdopen(master, "rb", 0) as line:
        config = Path(folder, "plant.toml")
        config.write_text(_CONFIG.format(port=os.ttyname(slave), baud=_BAUD, driver=driver) + more, encoding="utf-8")
        program = subprocess.Popen(
            words(str(config)), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env={**_ENVIRONMENT, **env},
        )  # fmt: skip
        try:
            if not select.select([line], [], [], _LIMIT_S)[0]:
                raise RuntimeError("the program sent nothing")
            yield program
        finally:
            _kill_family(program)
            os.close(slave)


def _slaves_up(driver: str) -> Figures:
    spent = took = 0
    clock, time_clock = _loop_clock(lambda: spent), _loop_clock(lambda: took)
    begin, time_begin = clock(), time_clock()
    took, spent, memory = slaves_up(driver, _SLAVES)
    title = f"{driver}, {_SLAVES} slaves behind a pty in data exchange"
    return {
        f"{title}: time": (time_clock() - time_begin) / 1000,
        f"{title}: CPU time": (clock() - begin) / 1000,
        f"{title}: PSS in KiB": memory,
    }


def slaves_up(driver: str, slaves: int) -> tuple[int, int, int]:
    """A program with ``slaves`` behind a pty whose octets take no time: time in ns until all are in data exchange, CPU
    time in ns until then, and proportional memory in KiB a second later."""
    words = [sys.executable, str(Path(__file__).with_name("wire.py")), "--baud", "12000000"]
    words += [f"{_FIRST + n}:1234:20 10:1:1,records=1" for n in range(slaves)]
    tables = [{"name": f"s{n}", "address": _FIRST + n, "ident": 0x1234, "config": "20 10"} for n in range(slaves)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=_ENVIRONMENT) as wire:
        assert wire.stdout is not None
        port = json.loads(wire.stdout.readline())["port"]
        code = _SLAVES_UP.format(port=port, baud=12_000_000, driver=driver, tables=tables)
        started = time.monotonic_ns()
        with subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=_ENVIRONMENT
        ) as program:
            assert program.stdout is not None
            if not program.stdout.readline():
                raise RuntimeError(f"{driver}: the slaves did not come up")
            took = time.monotonic_ns() - started
            spent = sum(map(cpu_of, family(program.pid)))
            time.sleep(_SETTLE_S)
            memory = sum(map(pss_kib, family(program.pid)))
            program.communicate()
        wire.communicate()
    return took, spent, memory


def family(pid: int) -> list[int]:
    """The process, its children, theirs."""
    found = [pid]
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # it has ended
            for child in tasks.read_text().split():
                found += family(int(child))
    return found


def cpu_of(pid: int) -> int:
    """CPU time of another process in ns (the clock of a process, clock_getcpuclockid(3))."""
    return time.clock_gettime_ns((~pid << 3) | 2)


def pss_kib(pid: int) -> int:
    """Proportional memory of a process."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:"))


def _kill_family(program: subprocess.Popen[bytes]) -> None:
    for pid in family(program.pid)[1:]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, 9)
    program.kill()
    program.communicate()


def _children_ns() -> int:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round((usage.ru_utime + usage.ru_stime) * 1e9)


def _output(words: Sequence[str]) -> str:
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, env=_ENVIRONMENT)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(words)}: {ended.stderr.strip()[-200:]}")
    return ended.stdout


#: drivers whose start is a figure
DRIVERS: Final = ("asyncio", "process")
#: each gives figures of this commit
FIGURES: Final[tuple[Callable[[], Figures], ...]] = (
    _version,
    _plain_figure,
    _status,
    _commands,
    *(partial(_first_octet, driver) for driver in DRIVERS),
    *(partial(_slaves_up, driver) for driver in DRIVERS),
)


def main() -> int:
    figures: Figures = {}
    for measure in FIGURES:
        figures |= measure()
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main())
