"""A look at the port when slaves fell silent: has another program changed its settings, does it read along?"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from functools import partial

from dpstack.ports import Loop, Port


class PortWatch:
    """Looks at ``port`` in a thread, never in the loop of the bus, and reports what disturbs it from within it."""

    def __init__(self, port: Port, report: Callable[[list[str]], None]) -> None:
        self._port = port
        self._report = report
        self._looking = False
        self._again: Loop | None = None  # slaves were lost during a look

    def look(self, loop: Loop) -> None:
        """Begin a look; while one is under way, another one follows it."""
        if self._looking:
            self._again = loop
            return
        inspect = self._port.inspection()
        if inspect is None:
            return
        self._looking = True
        name = f"looking at {self._port.name}"
        threading.Thread(target=self._look, args=(inspect, loop), name=name, daemon=True).start()

    def _look(self, inspect: Callable[[], list[str]], loop: Loop) -> None:
        found: list[str] = []
        with contextlib.suppress(OSError):  # the adapter is gone
            found = inspect()
        with contextlib.suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(partial(self._done, found))

    def _done(self, found: list[str]) -> None:
        self._looking = False
        again, self._again = self._again, None
        if found:
            self._report(found)
        if again is not None:
            self.look(again)
