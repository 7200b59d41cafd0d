"""Settings of a bus process that make its cycles steady, and how a benchmark switches each of them off.

The switches work in the bus process itself (bench/settings_hook/sitecustomize.py) and in the bare loop beside it. They
replace functions of :mod:`dpstack.drivers.realtime` by ones that do nothing; the product has no such switch.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

HOOK: Final = Path(__file__).resolve().parent / "settings_hook"


def _nothing(*_args: object, **_more: object) -> str:
    return ""


def _memory() -> None:
    from dpstack.drivers.realtime import rights

    rights.lock_memory = _nothing


def _priority() -> None:
    from dpstack.drivers.realtime import rights

    rights.set_priority = rights.set_niceness = _nothing


def _timers() -> None:
    from dpstack.drivers.realtime import rights

    rights.exact_timers = _nothing


def _slice() -> None:
    from dpstack.drivers.realtime import rights

    _replace(rights, "shorten_slice")


def _collection() -> None:
    from dpstack.drivers.realtime.gc_control import Collector

    _replace(Collector, "begin", "idle")


def _spin() -> None:
    from dpstack.drivers.line import select_loop

    for name in ("_LEAD_NS", "_LEAST_LEAD_NS", "_MOST_LEAD_NS"):
        setattr(select_loop, name, 0)


def _awake() -> None:
    from dpstack.drivers.realtime.processors import AwakeProcessors

    _replace(AwakeProcessors, "hold")


def _affinity() -> None:
    os.sched_setaffinity(0, range(os.cpu_count() or 1))


def _replace(owner: Any, *names: str) -> None:
    for name in names:
        setattr(owner, name, _nothing)


_OFF: Final[Mapping[str, Callable[[], None]]] = {
    "memory": _memory,  # locked
    "priority": _priority,  # niceness before a pty, else SCHED_FIFO
    "timers": _timers,  # a slack of 1 ns
    "slice": _slice,  # of an ordinary process, short
    "collection": _collection,  # of garbage, outside the cycle
    "spin": _spin,  # for the rest of a sleep
    "awake": _awake,  # /dev/cpu_dma_latency
    "affinity": _affinity,  # one processor
}
SETTINGS: Final = tuple(_OFF)


def switch_off(names: Iterable[str]) -> None:
    """Switch these settings of this process off, before it takes them. Raises KeyError for another name."""
    for name in names:
        _OFF[name]()


def environment(without: Iterable[str]) -> dict[str, str]:
    """The environment of a program whose bus process, or whose bare loop, does without these settings."""
    root = HOOK.parent.parent  # sitecustomize runs before the folder of the program is on the path
    path = os.pathsep.join(filter(None, (str(HOOK), str(root), os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": path, "BENCH_WITHOUT": ",".join(without)}
