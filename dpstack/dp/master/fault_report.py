"""Reports of one slave to the application: a fault when it changes, each remark once, other events as they come."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from dpstack.dp.master.events import Fault, FaultKind, SlaveEvent, SlaveFaulted, SlaveRemark
from dpstack.dp.slave_params import SlaveParams
from dpstack.report_once import Novelty, ReportOnce
from dpstack.trace import Event

_MAX_REMARKS: Final = 20
_NO_MORE: Final = "; further deviations are not told"


class SlaveReports:
    """``fault`` is the last one since the slave was in data exchange (some slaves show it in one diagnosis only)."""

    def __init__(self, setup: SlaveParams, emit: Callable[[Event], None]) -> None:
        self.fault: Fault | None = None
        self._setup = setup
        self._emit = emit
        self._reported = ""
        self._remarks = ReportOnce(_MAX_REMARKS)

    def event(self, kind: type[SlaveEvent], now: int, **fields: Any) -> None:
        """An event of the slave; ``fields`` are those that ``kind`` has besides time, address and name."""
        self._emit(kind(t_ns=now, address=self._setup.address, name=self._setup.name, **fields))

    def set_fault(self, fault: Fault, now: int) -> None:
        """Keep ``fault``; report it when it is another than the last one."""
        self.fault = fault
        if fault.text != self._reported:
            self._reported = fault.text
            self.event(SlaveFaulted, now, fault=fault)

    def remark(self, message: str, now: int) -> None:
        """Report ``message`` once; of a slave that always deviates in another way the first ones."""
        novelty = self._remarks.novelty(message)
        if novelty is not Novelty.KNOWN:
            self.event(SlaveRemark, now, message=message + (_NO_MORE if novelty is Novelty.LAST else ""))

    @property
    def is_silent(self) -> bool:
        """The last fault says already that the slave does not answer."""
        return self.fault is not None and self.fault.kind in (FaultKind.ABSENT, FaultKind.LOST)

    def clear(self) -> None:
        """The slave is well again: the next fault is reported even if it is the same."""
        self.fault, self._reported = None, ""
