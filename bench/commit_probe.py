"""A script that measures one commit of dpstack from outside: ``PYTHON bench/commit_probe.py BENCHMARK``.

It runs in the environment of that commit and imports nothing of bench, so that an old commit whose own benchmarks lack
a figure is measured by the same rule as a new one. Each figure has adapters, the newest first; the first one whose
names exist in the commit is used. One JSON object: name of the figure -> {"loops": CPU time in Python loops} or
{"count": a number}; figures without a fitting adapter are absent.
"""

from __future__ import annotations

import asyncio
import importlib
import json
import resource
import runpy
import subprocess
import sys
from collections.abc import Callable, Sequence
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
    ended = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if ended.returncode:
        raise RuntimeError(f"{' '.join(words)}: {ended.stderr.strip()[-200:]}")
    return ended.stdout


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
