"""Auto-clear: the master goes to Clear when a slave had no good data exchange for the Data_Control_Time.

docs/protocol.md#auto-clear (Error_Action_Flag, Data_Control_Time, Ignore_Aclr of each slave).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.units import NS_PER_MS, NS_PER_S

#: the standard's default
DATA_CONTROL_TIME: Final = NS_PER_S


class DataControl:
    """``time_ns`` is the Data_Control_Time; without ``auto_clear`` nobody is ever late or missing."""

    __slots__ = ("_began", "_due", "enabled", "time_ns")

    def __init__(self, *, auto_clear: bool, time_ns: int) -> None:
        self.enabled = auto_clear
        self.time_ns = time_ns
        self._began = 0
        self._due = 0

    def began(self, now: int) -> None:
        """Operate was reached: the time runs from here."""
        self._began = now
        self._due = now + self.time_ns

    def late(self, handlers: Iterable[SlaveHandler], now: int) -> list[SlaveHandler]:
        """The slaves without a good exchange for the Data_Control_Time; looked at again when one can be late."""
        if not self.enabled or now < self._due:
            return []
        ages = [(max(h.image.input_time, self._began), h) for h in handlers if _counts(h)]
        self._due = min((at for at, _ in ages), default=now) + self.time_ns
        return [h for at, h in ages if now - at >= self.time_ns]

    def missing(self, handlers: Iterable[SlaveHandler]) -> list[SlaveHandler]:
        """The slaves that keep the master from Operate: not in data exchange."""
        if not self.enabled:
            return []
        return [h for h in handlers if _counts(h) and h.state is not SlaveState.DATA_EXCHANGE]

    def late_reasons(self, late: Sequence[SlaveHandler]) -> tuple[str, ...]:
        """One line for each of ``late``."""
        return tuple(
            f"slave {h.setup.address} ({h.setup.name}) had no data exchange for {self.time_ns // NS_PER_MS} ms "
            f"({_why(h)})"
            for h in late
        )


def missing_reasons(missing: Sequence[SlaveHandler]) -> tuple[str, ...]:
    """One line for each of ``missing``."""
    return tuple(f"slave {h.setup.address} ({h.setup.name}): {_why(h)}" for h in missing)


def _counts(handler: SlaveHandler) -> bool:
    return handler.state is not SlaveState.DEACTIVATED and not handler.setup.ignore_auto_clear


def _why(handler: SlaveHandler) -> str:
    fault = handler.fault
    return fault.message if fault is not None else f"it is in {handler.state.value}"
