"""A script that measures one commit of dpstack from outside: ``PYTHON bench/commit_probe.py BENCHMARK``.

It runs in the environment of that commit and imports nothing of bench, so that an old commit whose own benchmarks lack
a figure is measured by the same rule as a new one. Each figure has adapters, the newest first; the first one whose
names exist in the commit is used. One JSON object: name of the figure -> {"loops": CPU time in Python loops} or
{"count": a number}; figures without a fitting adapter are absent.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
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
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

#: of this folder: the bench of the commit may have none
_loop_clock: Final[Callable[..., Callable[[], int]]] = runpy.run_path(str(Path(__file__).with_name("loop_clock.py")))[
    "LoopClock"
]
#: name of a figure -> {"loops": CPU time} or {"count": a number}
Figures = dict[str, dict[str, float]]

_BAUD: Final = 500_000
_FIRST: Final = 3
#: simulated seconds before and during a measurement, of which the median counts
_SETTLE: Final = 0.5
_PORTION: Final = 0.25
_PORTIONS: Final = 5
_CALLS: Final = 2_000
_COUNT: Final = """\
import sys
from dpstack.cli.main import main
try:
    main(["--version"])
except SystemExit:
    pass
print(sum(name.partition(".")[0] in ("dpstack", "dpstack_drives") for name in sys.modules))
"""
_BRING_UP: Final = """\
import dpstack
async def main():
    async with dpstack.open_bus(port="virtual", baud={baud}, slaves={tables}) as bus:
        await bus.operate()
        await bus.ready()
dpstack.run_virtual(main())
"""
_FIRST_BUS: Final = """\
import os, pty, dpstack
slave = {{"name": "valves", "address": 9, "ident": 0x1234, "config": "20 10"}}
dpstack.open_bus(port=os.ttyname(pty.openpty()[1]), baud={baud}, driver="asyncio", slaves=[slave])
"""
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
_SLAVES: Final = 32
#: no octets, or no slaves, within so many seconds
_LIMIT_S: Final = 60.0
#: programs are measured as users have them, with their byte code
_ENVIRONMENT: Final = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


class Adapter(NamedTuple):
    """Adapter for one generation of commits: ``needs`` are the names ("module:attribute") that it uses."""

    needs: tuple[str, ...]
    measure: Callable[[], Figures]


# --- virtual: the whole library, application included, on a simulated bus ---


def _virtual(title: str, tables: Sequence[dict[str, Any]]) -> Figures:
    dpstack: Any = importlib.import_module("dpstack")

    clock = _loop_clock()

    async def main() -> float:
        async with dpstack.open_bus(port="virtual", baud=_BAUD, slaves=list(tables)) as bus:
            await bus.operate()
            await bus.ready()
            for table in tables:
                if "drive" in table:
                    drive = bus.drive(table["name"])
                    await drive.start()
                    drive.speed = 0.5
            await asyncio.sleep(_SETTLE)
            costs = []
            for _ in range(_PORTIONS):
                exchanges, begin = _exchanges(bus), clock()
                await asyncio.sleep(_PORTION)
                costs.append((clock() - begin) / 1000 / max(1, _exchanges(bus) - exchanges))
            return median(costs)

    return {f"public API, {title}: CPU per exchange": {"loops": dpstack.run_virtual(main())}}


def _exchanges(bus: Any) -> int:
    return sum(slave.exchanges for slave in bus.stats.slaves.values())


def _drives(count: int) -> list[dict[str, Any]]:
    options = {"set_412": True}
    return [
        {"name": f"d{n}", "address": _FIRST + n, "drive": "demag-dedrive", "telegram": "PPO1", "options": options}
        for n in range(count)
    ]


def _mirrors(count: int) -> list[dict[str, Any]]:
    return [{"name": f"s{n}", "address": _FIRST + n, "ident": 0x1234, "config": "F3 F1"} for n in range(count)]


# --- codec ---


def _codec() -> Figures:
    codec: Any = importlib.import_module("dpstack.fdl.codec")
    data = [bytes((n, 0x55, *range(10))) for n in range(4)]
    fcs = (0x5D, 0x7D, 0x5D, 0x7D)
    request = codec.request_octets
    exchanges = [partial(request, 3, 2, fc, each, None, None) for fc, each in zip(fcs, data, strict=True)]
    kinds: dict[str, tuple[Sequence[Callable[[], object]], Sequence[bytes]]] = {
        "SD1 FDL status": ([partial(request, 3, 2, 0x49, b"", None, None)], [b"\x10\x03\x02\x49\x4e\x16"]),
        "SD2 Data_Exchange, PPO1": (exchanges, [call() for call in exchanges]),
        "SD4 token": ([partial(codec.encode_token, 3, 2)], [b"\xdc\x03\x02"]),
    }
    figures: Figures = {}
    for title, (writes, octets) in kinds.items():
        figures[f"{title}: encode, dpstack"] = {"loops": _each(writes)}
        figures[f"{title}: decode, dpstack"] = {"loops": _each([partial(codec.decode, each) for each in octets])}
    return figures


def _each(calls: Sequence[Callable[[], object]]) -> float:
    clock = _loop_clock()
    turns = _CALLS // len(calls)
    times = []
    for _ in range(5):
        begin = clock()
        for _ in range(turns):
            for call in calls:
                call()
        times.append((clock() - begin) / (turns * len(calls)))
    return median(times) / 1000


# --- startup: commands as processes of their own ---


def _command(words: str) -> Figures:
    clock = _loop_clock(_children_ns)
    begin = clock()
    command(words)
    return {f"dpstack {words}: CPU time": {"loops": (clock() - begin) / 1000}}


def command_ns(words: str) -> int:
    """CPU time of the command ``dpstack WORDS`` of this environment."""
    begin = _children_ns()
    command(words)
    return _children_ns() - begin


def command(words: str) -> None:
    """Run the command ``dpstack WORDS`` of this environment. Raises RuntimeError when it fails."""
    _output([str(Path(sys.executable).with_name("dpstack")), *words.split()])


#: the program that --version and a plain ctl are compared with
PLAIN: Final = ("-c", "import argparse, json, socket")


def plain_ns() -> int:
    """CPU time of an interpreter that only loads what a plain command cannot do without."""
    begin = _children_ns()
    _output([sys.executable, *PLAIN])
    return _children_ns() - begin


def _plain_figure() -> Figures:
    """The interpreter of :data:`PLAIN`, beside the commands of either side."""
    clock = _loop_clock(_children_ns)
    begin = clock()
    _output([sys.executable, *PLAIN])
    return {"python -c 'import argparse, json, socket': CPU time": {"loops": (clock() - begin) / 1000}}


@contextlib.contextmanager
def running() -> Iterator[str]:
    """A ``dpstack run`` on a simulated bus in this environment, and the name by which ``dpstack ctl`` finds it."""
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder:
        config = Path(folder, "plant.toml")
        config.write_text(_CONFIG.format(port="virtual", baud=_BAUD, driver="auto"), encoding="utf-8")
        words = [str(Path(sys.executable).with_name("dpstack")), "run", str(config), "--json"]
        with subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, env=_ENVIRONMENT) as program:
            try:
                assert program.stdout is not None
                if not program.stdout.readline():
                    raise RuntimeError("dpstack run ended without a word")
                yield _name_of(program.pid)
            finally:
                program.terminate()
                program.communicate()


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
        clock = _loop_clock(_children_ns)
        begin = clock()
        command(f"ctl {name} status")
        return {"dpstack ctl status: CPU time": {"loops": (clock() - begin) / 1000}}


def _first_octet(driver: str) -> Figures:
    spent = 0
    clock = _loop_clock(lambda: spent)
    begin = clock()
    spent = first_octet_ns(driver)
    return {f"dpstack run, {driver}, until the first octet: CPU time": {"loops": (clock() - begin) / 1000}}


def first_octet_ns(driver: str) -> int:
    """CPU time of ``dpstack run`` and its bus process until the first octet is on a pty where nobody else sends."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    with tempfile.TemporaryDirectory(prefix="dpstack-bench-") as folder, os.fdopen(master, "rb", 0) as line:
        config = Path(folder, "plant.toml")
        config.write_text(_CONFIG.format(port=os.ttyname(slave), baud=_BAUD, driver=driver), encoding="utf-8")
        words = [str(Path(sys.executable).with_name("dpstack")), "run", str(config)]
        program = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=_ENVIRONMENT
        )
        try:
            if not select.select([line], [], [], _LIMIT_S)[0]:
                raise RuntimeError("dpstack run sent nothing")
            return _cpu_of_family(program.pid)
        finally:
            _kill_family(program)
            os.close(slave)


def _slaves_up(driver: str) -> Figures:
    """A program with 32 slaves behind a pty whose octets take no time, until all are in data exchange."""
    words = [sys.executable, str(Path(__file__).with_name("wire.py")), "--baud", "12000000"]
    words += [f"{_FIRST + n}:1234:20 10:1:1,records=1" for n in range(_SLAVES)]
    tables = [{"name": f"s{n}", "address": _FIRST + n, "ident": 0x1234, "config": "20 10"} for n in range(_SLAVES)]
    spent = 0
    took = 0
    clock = _loop_clock(lambda: spent)
    time_clock = _loop_clock(lambda: took)
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=_ENVIRONMENT) as wire:
        assert wire.stdout is not None
        port = json.loads(wire.stdout.readline())["port"]
        code = _SLAVES_UP.format(port=port, baud=12_000_000, driver=driver, tables=tables)
        begin, time_begin = clock(), time_clock()
        started = time.monotonic_ns()
        with subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=_ENVIRONMENT
        ) as program:
            assert program.stdout is not None
            ready = program.stdout.readline()
            took = time.monotonic_ns() - started
            spent = _cpu_of_family(program.pid)
            program.communicate()
        wire.communicate()
    if not ready:
        raise RuntimeError(f"{driver}: the slaves did not come up")
    title = f"{driver}, {_SLAVES} slaves behind a pty in data exchange"
    return {
        f"{title}: time": {"loops": (time_clock() - time_begin) / 1000},
        f"{title}: CPU time": {"loops": (clock() - begin) / 1000},
    }


def _family(pid: int) -> list[int]:
    """The process, its children, theirs."""
    family = [pid]
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in tasks.read_text().split():
            family += _family(int(child))
    return family


def _cpu_of_family(pid: int) -> int:
    """CPU time in ns (the clock of a process, clock_getcpuclockid(3))."""
    return sum(time.clock_gettime_ns((~one << 3) | 2) for one in _family(pid))


def _kill_family(program: subprocess.Popen[bytes]) -> None:
    for pid in _family(program.pid)[1:]:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, 9)
    program.kill()
    program.wait()


def _children_ns() -> int:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return round((usage.ru_utime + usage.ru_stime) * 1e9)


def modules() -> int:
    """The number of modules of dpstack that ``dpstack --version`` imports."""
    return int(_output([sys.executable, "-c", _COUNT]).split()[-1])


def _program() -> Figures:
    """A program of its own whose slaves are in data exchange: imports, configuration, bring-up on a simulated bus."""
    clock = _loop_clock(_children_ns)
    begin = clock()
    _output([sys.executable, "-c", _BRING_UP.format(tables=_mirrors(32), baud=_BAUD)])
    return {"a program until 32 simulated slaves are in data exchange: CPU time": {"loops": (clock() - begin) / 1000}}


def _first_bus() -> Figures:
    """A program that makes its first bus with ``open_bus``: one slave behind a serial port."""
    clock = _loop_clock(_children_ns)
    begin = clock()
    _output([sys.executable, "-c", _FIRST_BUS.format(baud=_BAUD)])
    return {"the first open_bus of a program: CPU time": {"loops": (clock() - begin) / 1000}}


def _modules() -> Figures:
    return {"dpstack --version: modules of ours": {"count": modules()}}


def _needs(words: str) -> tuple[str, ...]:
    """The names without which a commit cannot run ``dpstack WORDS``."""
    command = words.partition(" ")[0]
    return (*_MAIN, f"dpstack.cli.listening.{command}:add_to") if command in _LISTENING else _MAIN


def _output(words: Sequence[str]) -> str:
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, env=_ENVIRONMENT)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(words)}: {ended.stderr.strip()[-200:]}")
    return ended.stdout


#: drivers whose start is a figure
DRIVERS: Final = ("asyncio", "process")
#: commands whose CPU time is a figure
COMMANDS: Final = ("--version", "ctl --help", "decode E5", "monitor --help", "capture --help")
#: those of them that older commits do not have stand in this room
_LISTENING: Final = ("decode", "monitor", "capture")
_API: Final = ("dpstack:open_bus", "dpstack:run_virtual")
_CODEC: Final = tuple(f"dpstack.fdl.codec:{name}" for name in ("request_octets", "encode_token", "decode"))
_MAIN: Final = ("dpstack.cli.main:main",)
#: benchmark -> of each group of figures its adapters
ADAPTERS: Final[dict[str, tuple[tuple[Adapter, ...], ...]]] = {
    "virtual": (
        (Adapter(_API, partial(_virtual, "10 demag-dedrive, PPO1", _drives(10))),),
        (Adapter(_API, partial(_virtual, "10 mirrors", _mirrors(10))),),
    ),
    "codec": ((Adapter(_CODEC, _codec),),),
    "startup": (
        *((Adapter(_needs(words), partial(_command, words)),) for words in COMMANDS),
        (Adapter(_MAIN, _modules),),
        (Adapter(_API, _first_bus),),
        (Adapter(_API, _program),),
        (Adapter((), _plain_figure),),
        (Adapter(_MAIN, _status),),
        *((Adapter(_MAIN, partial(_first_octet, driver)),) for driver in DRIVERS),
        *((Adapter(_API, partial(_slaves_up, driver)),) for driver in DRIVERS),
    ),
}


def exists(name: str) -> bool:
    """Whether "module:attribute" can be imported here."""
    module, _, attribute = name.partition(":")
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ImportError:
        return False


def chosen(benchmark: str, has: Callable[[str], bool] = exists) -> list[Adapter]:
    """Of each group of figures the first adapter whose names this commit has."""
    groups = ADAPTERS.get(benchmark, ())
    fitting = ([adapter for adapter in group if all(map(has, adapter.needs))] for group in groups)
    return [adapters[0] for adapters in fitting if adapters]


def main(words: Sequence[str]) -> int:
    figures: Figures = {}
    for adapter in chosen(words[0]):
        figures |= adapter.measure()
    print(json.dumps(figures))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
