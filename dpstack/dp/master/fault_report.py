"""Faults and remarks of one slave as events: a fault when it changes, each remark once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.dp.master.events import Fault, FaultKind, SlaveFaulted, SlaveRemark
from dpstack.report_once import Novelty, ReportOnce
from dpstack.trace import Event

_MAX_REMARKS: Final = 20
_NO_MORE: Final = "; further deviations are not told"


class Findings:
    """The last fault (some slaves show it in one diagnosis only), and what was said already."""

    __slots__ = ("_address", "_emit", "_name", "_remarks", "_told", "fault")

    def __init__(self, address: int, name: str, emit: Callable[[Event], None]) -> None:
        self.fault: Fault | None = None
        self._address = address
        self._name = name
        self._emit = emit
        self._told = ""
        self._remarks = ReportOnce(_MAX_REMARKS)

    def tell(self, fault: Fault, now: int) -> None:
        """Keep ``fault``; tell it when it is another than the last one."""
        self.fault = fault
        if fault.text != self._told:
            self._told = fault.text
            self._emit(SlaveFaulted(t_ns=now, address=self._address, name=self._name, fault=fault))

    def remark(self, message: str, now: int) -> None:
        """Tell ``message``, once; of a slave that always deviates in another way the first ones."""
        news = self._remarks.novelty(message)
        if news is not Novelty.KNOWN:
            message += _NO_MORE if news is Novelty.LAST else ""
            self._emit(SlaveRemark(t_ns=now, address=self._address, name=self._name, message=message))

    @property
    def silence_told(self) -> bool:
        """The last fault says already that it does not answer."""
        return self.fault is not None and self.fault.kind in (FaultKind.ABSENT, FaultKind.LOST)

    def clear(self) -> None:
        """The slave is well again: the next fault is told even if it is the same."""
        self.fault, self._told = None, ""
