"""Reading the diagnoses of one slave: parsed, told when they are new, deviations told once."""

from __future__ import annotations

from collections.abc import Callable

from dpstack.dp.diag_texts import block_texts
from dpstack.dp.diagnosis import Diagnosis
from dpstack.dp.events import SlaveDiagnosis
from dpstack.dp.findings import Findings
from dpstack.dp.judge import deviations
from dpstack.dp.setup import SlaveSetup
from dpstack.trace import Event


class Diagnoses:
    """``last`` is the diagnosis read last. ``ident``: the one the device must have, None until the first is taken."""

    __slots__ = ("_emit", "_findings", "_own", "_setup", "ident", "last")

    def __init__(self, setup: SlaveSetup, own: int, findings: Findings, emit: Callable[[Event], None]) -> None:
        self.last: Diagnosis | None = None
        self.ident = setup.ident
        self._setup = setup
        self._own = own
        self._findings = findings
        self._emit = emit

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

    @property
    def texts(self) -> tuple[str, ...]:
        """What the last extended diagnosis says, one line each."""
        return () if self.last is None else block_texts(self.last, self._setup.texts)
