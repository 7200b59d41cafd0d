"""Parser of the diagnoses of one slave: an event when they change, remarks on deviations, alarms for their handler."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from dpstack.dp.master.events import SlaveDiagnosis
from dpstack.dp.master.fault_report import Findings
from dpstack.dp.master.verdicts import deviations
from dpstack.dp.pdu.diag_texts import block_texts
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.trace import Event


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


class DiagObserver(Protocol):
    """Who reads alarms and status messages in the diagnoses of one slave."""

    @property
    def counts(self) -> AlarmCounts: ...

    def opened(self, last: Diagnosis | None, now: int) -> None:
        """Data exchange begins; ``last`` was read before it."""

    def take(self, diagnosis: Diagnosis, flagged_at: int, exchanges: int, now: int) -> None:
        """A diagnosis of the slave in data exchange, after so many ``exchanges``; ``flagged_at``: the first of them in
        which it asked for it (DH), 0: it did not."""

    def closed(self, now: int) -> None: ...


class Diagnoses:
    """``last`` is the diagnosis read last. ``ident``: the one the device must have, None until the first is taken.

    ``observer`` reads more in them: alarms and status messages of DP-V1.
    """

    __slots__ = ("_emit", "_findings", "_own", "_setup", "flagged", "ident", "last", "observer")

    def __init__(
        self,
        setup: SlaveParams,
        own: int,
        findings: Findings,
        emit: Callable[[Event], None],
    ) -> None:
        self.last: Diagnosis | None = None
        self.ident = setup.ident
        self._setup = setup
        self._own = own
        self._findings = findings
        self._emit = emit
        #: the slave wants to be read: number of the first exchange with DH since the last one, 0 without
        self.flagged = 0
        self.observer: DiagObserver | None = None

    def read(self, octets: bytes, now: int) -> Diagnosis | None:
        """The answer to Slave_Diag; None when it is none."""
        diagnosis = Diagnosis.parse(octets)
        if diagnosis is None:
            text = f"answers Slave_Diag with {len(octets)} octets, at least 6 are required"
            self._findings.remark(text, now)
            return None
        if diagnosis != self.last:
            self.last = diagnosis
            self._emit(
                SlaveDiagnosis(
                    t_ns=now,
                    address=self._setup.address,
                    name=self._setup.name,
                    diagnosis=diagnosis,
                    texts=self.texts,
                )
            )
        if self.ident is None:
            self.ident = diagnosis.ident
            self._findings.remark(f"its ident number is 0x{diagnosis.ident:04X} (taken from its diagnosis)", now)
        for deviation in deviations(diagnosis, self._own):
            self._findings.remark(deviation, now)
        return diagnosis

    def opened(self, now: int) -> None:
        if self.observer is not None:
            self.observer.opened(self.last, now)

    def flag(self, exchange: int) -> None:
        """The answer to that Data_Exchange had DH."""
        self.flagged = self.flagged or exchange

    def exchanging(self, diagnosis: Diagnosis, exchanges: int, now: int) -> None:
        """``diagnosis`` was read in data exchange, after so many ``exchanges``, and is of our slave."""
        if self.observer is not None:
            self.observer.take(diagnosis, self.flagged, exchanges, now)
        self.flagged = 0

    def closed(self, now: int) -> None:
        if self.observer is not None:
            self.observer.closed(now)

    @property
    def texts(self) -> tuple[str, ...]:
        """What the last extended diagnosis says, one line each."""
        if self.last is None:
            return ()
        return block_texts(self.last, self._setup.texts, dpv1=self._setup.dpv1 is not None)
