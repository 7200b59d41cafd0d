"""Parser of the diagnoses of one slave: an event when they change, remarks on deviations, alarms for their handler."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.dp.master.events import SlaveDiagnosis
from dpstack.dp.master.fault_report import SlaveReports
from dpstack.dp.master.verdicts import deviations
from dpstack.dp.pdu.diag_texts import block_texts
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmCounts:
    """What came of the alarms of one slave. ``raised``: delivered; ``acknowledged``: the slave took it.

    ``repeated``: acknowledgements sent again; ``refused``: that the slave did not take. ``too_many``: more at a time
    than agreed, ``dropped``: those of them that nobody could keep. ``not_enabled``: kinds that Set_Prm did not enable,
    ``malformed``: blocks that are neither alarm nor status; neither is delivered. ``statuses``: told.
    """

    raised: int = 0
    acknowledged: int = 0
    repeated: int = 0
    refused: int = 0
    too_many: int = 0
    dropped: int = 0
    not_enabled: int = 0
    malformed: int = 0
    statuses: int = 0


class DiagObserver:
    """Reads alarms and status messages in the diagnoses of one slave. This one reads none: for slaves without DP-V1."""

    @property
    def counts(self) -> AlarmCounts | None:
        """What came of its alarms; None where it can have none."""
        return None

    def opened(self, last: Diagnosis | None, now: int) -> None:
        """Data exchange begins; ``last`` was read before it."""

    def take(self, diagnosis: Diagnosis, flagged_at: int, exchanges: int, now: int) -> None:
        """A diagnosis of the slave in data exchange, after so many ``exchanges``; ``flagged_at``: the first of them in
        which it asked for it (DH), 0: it did not."""

    def closed(self, now: int) -> None:
        """Data exchange ended."""


NO_ALARMS: Final = DiagObserver()


class Diagnoses:
    """The diagnoses of one slave: ``last`` is the one read last.

    ``ident``: the ident number that the device must have, None until the first diagnosis gives one. ``observer`` reads
    alarms and status messages of DP-V1 in them.
    """

    def __init__(self, setup: SlaveParams, own: int, reports: SlaveReports) -> None:
        self.last: Diagnosis | None = None
        self.ident = setup.ident
        self._setup = setup
        self._own = own
        self._reports = reports
        #: number of the first exchange with DH since the last diagnosis was read, 0 where there was none
        self.flagged = 0
        self.observer = NO_ALARMS

    def read(self, octets: bytes, now: int) -> Diagnosis | None:
        """Read the answer to Slave_Diag; None where it is no diagnosis."""
        diagnosis = Diagnosis.parse(octets)
        if diagnosis is None:
            text = f"answers Slave_Diag with {len(octets)} octets, at least 6 are required"
            self._reports.remark(text, now)
            return None
        if diagnosis != self.last:
            self.last = diagnosis
            texts = block_texts(diagnosis, self._setup.texts, dpv1=self._setup.dpv1 is not None)
            self._reports.event(SlaveDiagnosis, now, diagnosis=diagnosis, texts=texts)
        if self.ident is None:
            self.ident = diagnosis.ident
            self._reports.remark(f"its ident number is 0x{diagnosis.ident:04X} (taken from its diagnosis)", now)
        for deviation in deviations(diagnosis, self._own):
            self._reports.remark(deviation, now)
        return diagnosis
