"""Judgement of diagnoses and of answers to Data_Exchange without good data.

A diagnosis: its owner, its deviations from the standard, the verdict by the table of bits, and between Set_Prm and data
exchange the next request (docs/reference/protocol.md#slave-handler). Answers without good data: their number up to a
fault, and the trigger that follows (docs/reference/protocol.md#answers-to-data_exchange).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce
from operator import or_
from typing import Final

from msgspec.structs import replace

from dpstack.dp.master import fault_texts
from dpstack.dp.master.events import Fault, FaultKind, SlaveState
from dpstack.dp.master.slave_states import Trigger
from dpstack.dp.pdu.diag_bits import FLAG, FLAGS, Reaction, SetBy, weightiest
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.services import SERVICE_NAMES
from dpstack.dp.slave_params import IsochronousDemand, SlaveParams
from dpstack.fdl.telegram import SAP_SET_PRM, Kind, Resp, Telegram
from dpstack.params import MAX_STATION
from dpstack.phy.patience import Lateness
from dpstack.units import NS_PER_S

_MAX_WRONG: Final = 3
_MAX_BUSY: Final = 5
_DATA: Final = (int(Resp.DL), int(Resp.DH))


class OddAnswers:
    """Counts answers to Data_Exchange without good data since the last good one; ``none``: no good one yet."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Reset the counts, after a good exchange or in a new state."""
        self.none = True
        self._wrong = self._busy = 0

    def judge(self, answer: Telegram) -> Trigger | None:
        """The trigger for ``answer``: WRONG_LENGTH, NOT_EXCHANGING (RS) or REFUSED; None: ask again next round."""
        self.none = False
        status = answer.fc & 0x0F
        if answer.kind is Kind.SC or status in _DATA:
            self._wrong += 1
            return None if self._wrong < _MAX_WRONG else Trigger.WRONG_LENGTH
        if status == Resp.RS:
            return Trigger.NOT_EXCHANGING
        self._busy += 1  # UE, RR, NR, RDL, RDH
        return None if self._busy < _MAX_BUSY else Trigger.REFUSED


#: reaction of the master to a bit -> trigger of the state table
_EVENT: Final = {
    Reaction.REPORTS: Trigger.DIAG_READY,
    Reaction.WAITS: Trigger.DIAG_WAIT,
    Reaction.PARAMETERISES: Trigger.DIAG_PRM_REQ,
    Reaction.REFUSES: Trigger.DIAG_REFUSED,
}
#: bits that only a master sets, octets 1 and 2: ignored in the diagnosis of a slave
_MASTERS: Final = tuple(
    reduce(or_, (flag.mask for flag in FLAGS if flag.octet == octet and flag.set_by is SetBy.MASTER))
    for octet in (1, 2)
)
#: the bit that a fault sets
_BY_FAULT: Final = {
    FaultKind.ABSENT: "station_non_existent",
    FaultKind.LOST: "station_non_existent",
    FaultKind.WRONG_LENGTH: "invalid_slave_response",
    FaultKind.LOCKED: "master_lock",
}


def foreign_owner(diagnosis: Diagnosis, own: int) -> int | None:
    """The other class 1 master that owns the slave, or None.

    A slave that wants parameters (Prm_Req) has no owner, even if octet 4 names one. Some slaves report ``own`` + 128,
    or the station that asked (docs/reference/protocol.md#how-real-devices-deviate).
    """
    master = diagnosis.master
    if master is None or diagnosis.prm_req or master & 0x7F == own or master > MAX_STATION:
        return None
    return master


def deviations(diagnosis: Diagnosis, own: int) -> Iterator[str]:
    """Tolerated deviations of the diagnosis from the standard, one line each
    (docs/reference/protocol.md#always-1-bit)."""
    if not diagnosis.always_one:
        yield "its diagnosis lacks the bit that is always 1 (octet 2 bit 2); tolerated"
    if diagnosis.master is not None and diagnosis.master == own + 128:
        yield f"its diagnosis gives the master address as {diagnosis.master}; tolerated"
    for flag in diagnosis.findings:
        if flag.set_by is SetBy.MASTER:
            yield f"its diagnosis sets {flag.name} (octet {flag.octet}), which only a master may; ignored"
    if diagnosis.ext_finding is not None:
        yield f"its extended diagnosis has wrong lengths: {diagnosis.ext_finding}; the rest is kept as it came"


def verdict_exchanging(diagnosis: Diagnosis) -> Trigger:
    """The trigger for a diagnosis of a slave of this master in data exchange
    (docs/reference/protocol.md#what-a-diagnosis-means)."""
    return _EVENT[weightiest(tuple(flag.exchange for flag in diagnosis.findings))]


def verdict_ready(diagnosis: Diagnosis, *, cfg_sent: bool) -> Trigger:
    """The trigger for a diagnosis after Set_Prm and, with ``cfg_sent``, Chk_Cfg
    (docs/reference/protocol.md#slave-handler)."""
    verdict = _EVENT[weightiest(tuple(flag.bring_up for flag in diagnosis.findings))]
    if not cfg_sent and verdict in (Trigger.DIAG_WAIT, Trigger.DIAG_READY):
        return Trigger.DIAG_NO_CFG
    return verdict


def masters_view(read: Diagnosis | None, state: SlaveState, fault: Fault | None) -> Diagnosis | None:
    """The last diagnosis with the bits that a master sets, for the application; None before the first diagnosis and
    fault. For a station that never answered: ident 0, no master.
    """
    name = _BY_FAULT.get(fault.kind) if fault is not None and state is not SlaveState.DATA_EXCHANGE else None
    if state is SlaveState.DEACTIVATED:
        name = "deactivated"
    if read is None and name is None:
        return None
    basis = read or Diagnosis(0, 0, 0, None, 0)
    status = [0, basis.status1 & ~_MASTERS[0], basis.status2 & ~_MASTERS[1]]
    if name is not None:
        flag = FLAG[name]
        status[flag.octet] |= flag.mask
    if read is not None and (read.status1, read.status2) == (status[1], status[2]):
        return read
    return replace(basis, status1=status[1], status2=status[2])


_READY_LIMIT: Final = 10 * NS_PER_S
_UNACKED_LIMIT: Final = NS_PER_S
_MAX_PRM_ROUNDS: Final = 3
_SET_PRM: Final = SERVICE_NAMES[SAP_SET_PRM]


class Readiness:
    """Progress of the bring-up of one slave between Set_Prm and data exchange.

    ``cfg_sent``: Chk_Cfg was sent; ``unacked``: the service that the slave did not acknowledge; ``prm_sent``: the
    octets of the last Set_Prm; ``shown_ident``: the ident number in the diagnosis before that. ``isochronous``: the
    fault of a slave that demands isochronous mode.
    """

    def __init__(self) -> None:
        self.cfg_sent = False
        self.unacked = ""
        self.prm_sent = b""
        self.shown_ident = 0
        self._prm_rounds = 0
        self.isochronous: Fault | None = None
        self._is_measured = False

    def demands(self, demand: IsochronousDemand, lateness: Lateness | None) -> Fault:
        """The refusal of a slave that demands isochronous mode, with the lateness of the port. It keeps the first
        figure that was measured, so that it is reported once."""
        measured = lateness is not None and lateness.answers > 0
        if self.isochronous is None or (measured and not self._is_measured):
            self.isochronous, self._is_measured = fault_texts.isochronous(demand, lateness), measured
        return self.isochronous

    def entered(self, state: SlaveState) -> None:
        """The master's handling reached ``state``."""
        if state in (SlaveState.DATA_EXCHANGE, SlaveState.FAULT):
            self._prm_rounds = 0
        if state in (SlaveState.DATA_EXCHANGE, SlaveState.SET_PRM):
            self.unacked = ""
        if state is SlaveState.SET_PRM:
            self.cfg_sent = False

    def judge(self, setup: SlaveParams, diagnosis: Diagnosis, waited_ns: int) -> tuple[Trigger, Fault | None]:
        """The trigger for ``diagnosis`` ``waited_ns`` after the last step, and the fault."""
        verdict = verdict_ready(diagnosis, cfg_sent=self.cfg_sent)
        if verdict is Trigger.DIAG_WAIT:
            if self.unacked and waited_ns > _UNACKED_LIMIT:
                return Trigger.TOO_LONG, self._silent(setup)
            if waited_ns > _READY_LIMIT:
                seconds = _READY_LIMIT / NS_PER_S
                if diagnosis.stat_diag:
                    return Trigger.TOO_LONG, fault_texts.statically_ill(seconds)
                return Trigger.TOO_LONG, fault_texts.not_ready(setup, seconds)
        elif verdict is Trigger.DIAG_PRM_REQ:
            if self._prm_rounds >= _MAX_PRM_ROUNDS:
                if self.unacked:
                    return Trigger.REFUSED, self._silent(setup)
                return Trigger.REFUSED, fault_texts.not_taken(setup)
            self._prm_rounds += 1
        elif verdict is Trigger.DIAG_REFUSED:
            return verdict, fault_texts.refusal(setup, diagnosis, self.prm_sent)
        return verdict, None

    def _silent(self, setup: SlaveParams) -> Fault:
        return fault_texts.prm_silent(self.prm_sent) if self.unacked == _SET_PRM else fault_texts.cfg_silent(setup)
