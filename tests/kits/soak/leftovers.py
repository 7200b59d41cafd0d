"""Memory and leftovers of a process as the operating system and the interpreter count them, without tracemalloc."""

from __future__ import annotations

import asyncio
import gc
import os
import threading
from collections import Counter
from pathlib import Path
from typing import Final, NamedTuple

_PAGE: Final = os.sysconf("SC_PAGE_SIZE")
_SHM: Final = Path("/dev/shm")


class Memory(NamedTuple):
    """``rss`` in octets, and the number of objects that the garbage collector follows; after a full collection."""

    rss: int
    objects: int


def memory() -> Memory:
    """The memory of this process now."""
    gc.collect()
    return Memory(rss_of(os.getpid()), len(gc.get_objects()))


def rss_of(pid: int) -> int:
    """Octets of memory that the process ``pid`` occupies."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * _PAGE


def handles_of(pid: int | str = "self") -> list[str]:
    """The open files, sockets and pipes of a process, by name."""
    found = []
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            found.append(os.readlink(link))
        except FileNotFoundError:  # the one that lists the folder
            continue
    return sorted(found)


def locks_of(pid: int) -> list[str]:
    """The file locks that the process ``pid`` holds, as /proc/locks has them."""
    lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    # without its number in the list, which changes with the locks of others
    return [line.partition(": ")[2] for line in lines if line.split()[4:5] == [str(pid)]]


def children_of(pid: int) -> list[int]:
    """The processes that ``pid`` has started and not waited for."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += map(int, (task / "children").read_text(encoding="ascii").split())
    return found


class Belongings(NamedTuple):
    """The belongings of a process that an ended bus must have given back."""

    handles: Counter[str]
    threads: Counter[str]
    tasks: Counter[str]
    shared: Counter[str]
    locks: Counter[str]
    children: Counter[str]

    def more_than(self, before: Belongings) -> list[str]:
        """Everything that was not there ``before``, as "kind: name"."""
        return [
            f"{kind}: {name}"
            for kind, mine, theirs in zip(self._fields, self, before, strict=True)
            for name in sorted((mine - theirs).elements())
        ]


def belongings() -> Belongings:
    """Those of this process now; the tasks are those of the running event loop, if there is one."""
    gc.collect()
    try:
        tasks = [task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    except RuntimeError:
        tasks = []
    pid = os.getpid()
    return Belongings(
        Counter(handles_of()),
        Counter(thread.name for thread in threading.enumerate()),
        Counter(tasks),
        Counter(path.name for path in _SHM.iterdir()) if _SHM.is_dir() else Counter(),
        Counter(locks_of(pid)),
        Counter(map(str, children_of(pid))),
    )


def stack_objects() -> Counter[str]:
    """The objects of dpstack that are alive and followed by the garbage collector, by type."""
    gc.collect()
    kinds = (type(thing) for thing in gc.get_objects())
    return Counter(f"{k.__module__}.{k.__qualname__}" for k in kinds if str(k.__module__).startswith("dpstack"))
