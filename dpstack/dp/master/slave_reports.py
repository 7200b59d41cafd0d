"""Reports of one slave to the application: faults when they change, each remark once, diagnoses that differ.

Alarms and status messages in the diagnoses are left to an observer.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from msgspec import Struct

from dpstack.dp.master.events import Fault, FaultKind, SlaveDiagnosis, SlaveEvent, SlaveFaulted, SlaveRemark
from dpstack.dp.master.verdicts import deviations
from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.report_once import Novelty, ReportOnce
from dpstack.trace import Event

_MAX_REMARKS: Final = 20
_NO_MORE: Final = "; further deviations are not reported"


class AlarmCounts(Struct, frozen=True, kw_only=True):
    """Counts of the alarms of one slave. ``raised``: delivered alarms; ``acknowledged``: accepted acknowledgements.

    ``repeated``: repeated acknowledgements.
    """

    raised: int = 0
    acknowledged: int = 0
    repeated: int = 0
    #: refused acknowledgements
    refused: int = 0
    #: alarms beyond the agreed number
    too_many: int = 0
    #: alarms beyond the agreed number that found no room in the queue
    dropped: int = 0
    #: alarms of a type that Set_Prm did not enable; the master does not deliver them
    not_enabled: int = 0
    #: blocks that are neither alarm nor status; the master does not deliver them
    malformed: int = 0
    #: delivered status messages
    statuses: int = 0


class DiagObserver:
    """Reads alarms and status messages in the diagnoses of one slave. This one reads none: for slaves without DP-V1."""

    @property
    def counts(self) -> AlarmCounts | None:
        """The counts of its alarms; None for a slave that can have none."""
        return None

    @property
    def standing(self) -> tuple[Alarm, ...]:
        """The alarms whose slots are not good again since data exchange began."""
        return ()

    def opened(self, last: Diagnosis | None, now: int) -> None:
        """Data exchange begins; ``last`` was read before it."""

    def read(self, diagnosis: Diagnosis, flagged_at: int, exchanges: int, now: int) -> None:
        """Read a diagnosis of the slave in data exchange, after ``exchanges`` exchanges; ``flagged_at``: the number of
        the first exchange with DH, 0 without one."""

    def closed(self, now: int) -> None:
        """Data exchange ended."""


NO_ALARMS: Final = DiagObserver()


class SlaveReports:
    """``fault`` is the last one since the slave was in data exchange (some slaves show it in one diagnosis only).

    ``diagnosis``: the one read last. ``ident``: the ident number that the device must have, None until the first
    diagnosis gives one. ``observer`` reads alarms and status messages of DP-V1 in the diagnoses; ``own``: the master's
    address. The slave's address is put into ``changed`` after each change that the application can see, also of those
    without an event.
    """

    def __init__(self, setup: SlaveParams, emit: Callable[[Event], None], own: int, changed: set[int]) -> None:
        self.fault: Fault | None = None
        self.diagnosis: Diagnosis | None = None
        self.ident = setup.ident
        #: how many times the diagnosis was another one than before, and the time of the last one in ns
        self.diagnoses = self.diagnosis_ns = 0
        #: number of the first exchange with DH since the last diagnosis was read, 0 without one
        self.flagged = 0
        self.observer = NO_ALARMS
        self._setup = setup
        self._emit = emit
        self._own = own
        self._changed = changed
        self._reported = ""
        self._remarks = ReportOnce(_MAX_REMARKS)
        self.mark_changed()

    def event(self, kind: type[SlaveEvent], now: int, **fields: Any) -> None:
        """Report an event of the slave; ``fields``: all besides time, address and name."""
        self._emit(kind(t_ns=now, address=self._setup.address, name=self._setup.name, **fields))

    def mark_changed(self) -> None:
        """Something that the application can see has changed."""
        self._changed.add(self._setup.address)

    def keep_fault(self, fault: Fault | None) -> None:
        """Keep ``fault`` without a report."""
        if fault != self.fault:
            self.fault = fault
            self.mark_changed()

    def set_fault(self, fault: Fault, now: int) -> None:
        """Keep ``fault``; report it if it is not the same as the last one."""
        self.keep_fault(fault)
        if fault.text != self._reported:
            self._reported = fault.text
            self.event(SlaveFaulted, now, fault=fault)

    def remark(self, message: str, now: int) -> None:
        """Report each distinct ``message`` once, and only the first ones of a slave that always deviates."""
        novelty = self._remarks.novelty(message)
        if novelty is not Novelty.KNOWN:
            self.event(SlaveRemark, now, message=message + (_NO_MORE if novelty is Novelty.LAST else ""))

    @property
    def is_silent(self) -> bool:
        """Whether the last fault reports already that the slave does not answer."""
        return self.fault is not None and self.fault.kind in (FaultKind.ABSENT, FaultKind.LOST)

    def clear(self) -> None:
        """End the fault: the next one is reported even if it is the same."""
        self.keep_fault(None)
        self._reported = ""

    def read_diagnosis(self, octets: bytes, now: int) -> Diagnosis | None:
        """Read the answer to Slave_Diag; None if it is no diagnosis."""
        diagnosis = Diagnosis.parse(octets)
        if diagnosis is None:
            text = f"answers Slave_Diag with {len(octets)} octets, at least 6 are required"
            self.remark(text, now)
            return None
        if diagnosis != self.diagnosis:
            self.diagnosis = diagnosis
            self.diagnoses += 1
            self.diagnosis_ns = now
            self.mark_changed()
            self.event(SlaveDiagnosis, now, diagnosis=diagnosis, texts=self._setup.block_texts(diagnosis))
        if self.ident is None:
            self.ident = diagnosis.ident
            self.remark(f"its ident number is 0x{diagnosis.ident:04X} (taken from its diagnosis)", now)
        for deviation in deviations(diagnosis, self._own):
            self.remark(deviation, now)
        return diagnosis
