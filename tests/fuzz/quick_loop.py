"""An event loop for fuzz targets: real sockets, and a clock that jumps to the next timer while nothing is ready."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")
_NS = 1_000_000_000


class _Selector(selectors.DefaultSelector):
    """A selector that never waits."""

    def __init__(self) -> None:
        super().__init__()
        self.skipped = 0.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(0)
        if not found:
            if timeout is None:
                raise AssertionError("everything waits, and nothing will ever happen")
            self.skipped += max(0.0, timeout)
        return found


class QuickLoop(asyncio.SelectorEventLoop):
    """The loop. ``failures``: what reached its exception handler."""

    def __init__(self) -> None:
        self._clock = _Selector()
        super().__init__(self._clock)
        self.failures: list[dict[str, Any]] = []
        self.set_exception_handler(lambda _loop, context: self.failures.append(context))

    def time(self) -> float:
        return 1_000.0 + self._clock.skipped

    def now_ns(self) -> int:
        """The time of the loop in ns, in place of ``monotonic_ns``."""
        return round(self.time() * _NS)

    def play(self, work: Coroutine[Any, Any, T]) -> T:
        """Run ``work``. Raises AssertionError where an exception reached the loop's handler."""
        self.failures.clear()
        _loops.clear()  # what a failing execution leaves behind does not disturb the next one
        result = self.run_until_complete(work)
        _loops.append(self)
        assert not self.failures, self.failures
        return result


_loops: list[QuickLoop] = []


def quick_loop() -> QuickLoop:
    """The one loop of this process."""
    if not _loops:
        _loops.append(QuickLoop())
    return _loops[0]
