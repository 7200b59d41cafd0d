"""Drive plugins that fail, for ``ends.faults``; a bus process imports them by their names."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping


class Plugin:
    """Calls ``fails`` once, as the master asks for the outputs."""

    def __init__(self, fails: Callable[[], object]) -> None:
        self.fails: Callable[[], object] | None = fails

    def cyclic(self, _inputs: bytes, _now: int) -> bytes:
        fails, self.fails = self.fails, None
        if fails is not None:
            fails()
        return b"\x11\x22"

    def lost(self, _now: int) -> None: ...

    def safe(self, configured: bytes) -> bytes:
        return configured

    def moved(self, address: int) -> str | None:
        return None

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None: ...

    def take_events(self) -> list[dict[str, object]]:
        return []


class RAISES:
    @staticmethod
    def core(*_: object, **__: object) -> Plugin:
        def divide() -> float:
            return 1 / 0

        return Plugin(divide)


class EXITS:
    @staticmethod
    def core(*_: object, **__: object) -> Plugin:
        return Plugin(lambda: sys.exit(3))
