"""Shows that work grows with its input and not faster, in counted steps and octets: never in seconds."""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Callable
from types import FrameType
from typing import Any

#: what twice the input may take of what the input takes; a square would be 4
_MOST = 2.5


def steps(work: Callable[[], object]) -> int:
    """Lines of Python that are executed, calls and returns."""
    count = 0

    def trace(_frame: FrameType, _event: str, _argument: Any) -> Any:
        nonlocal count
        count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def peak(work: Callable[[], object]) -> int:
    """Octets of memory that are used at once."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def assert_linear(work_of: Callable[[int], Callable[[], object]], n: int) -> None:
    """``work_of(n)`` makes the work for an input of size n; it is done for n and for 2 n."""
    work_of(1)()  # what is made once for all
    few, many = steps(work_of(n)), steps(work_of(2 * n))
    assert many <= _MOST * few + 1000, f"{few} steps for {n}, {many} for {2 * n}"
    few, many = peak(work_of(n)), peak(work_of(2 * n))
    assert many <= _MOST * few + 50_000, f"{few} octets for {n}, {many} for {2 * n}"
