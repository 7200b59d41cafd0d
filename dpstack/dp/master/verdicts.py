"""What a diagnosis means to a master that did not write the slave: owner, deviations, verdicts by the table of bits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import reduce
from operator import or_
from typing import Final

from dpstack.dp.master.events import Fault, FaultKind, SlaveState
from dpstack.dp.master.slave_states import Ev
from dpstack.dp.pdu.diag_bits import FLAG, FLAGS, Does, SetBy, weightiest
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.params import MAX_STATION

#: what the master does -> what the state table calls it
_EVENT: Final = {
    Does.TELLS: Ev.DIAG_READY,
    Does.WAITS: Ev.DIAG_WAIT,
    Does.PARAMETERISES: Ev.DIAG_PRM_REQ,
    Does.REFUSES: Ev.DIAG_REFUSED,
}
#: the master's own bits, octets 1 and 2: a slave's are not believed
_MASTERS: Final = tuple(
    reduce(or_, (flag.mask for flag in FLAGS if flag.octet == octet and flag.set_by is SetBy.MASTER))
    for octet in (1, 2)
)
#: which of them a fault sets
_BY_FAULT: Final = {
    FaultKind.ABSENT: "station_non_existent",
    FaultKind.LOST: "station_non_existent",
    FaultKind.WRONG_LENGTH: "invalid_slave_response",
    FaultKind.LOCKED: "master_lock",
}


def foreign_owner(diagnosis: Diagnosis, own: int) -> int | None:
    """The other class 1 master that owns the slave, or None.

    A slave that wants parameters (Prm_Req) has no owner whatever octet 4 says; some report own + 128 or whoever asked
    (protocol facts, section I).
    """
    master = diagnosis.master
    if master is None or diagnosis.prm_req or master & 0x7F == own or master > MAX_STATION:
        return None
    return master


def deviations(diagnosis: Diagnosis, own: int) -> Iterator[str]:
    """What in the diagnosis is against the standard and tolerated, one line each (section I)."""
    if not diagnosis.always_one:
        yield "its diagnosis lacks the bit that is always 1 (octet 2 bit 2); tolerated"
    if diagnosis.master is not None and diagnosis.master == own + 128:
        yield f"its diagnosis gives the master address as {diagnosis.master}; tolerated"
    for flag in diagnosis.findings:
        if flag.set_by is SetBy.MASTER:
            yield f"its diagnosis sets {flag.name} (octet {flag.octet}), which only a master may; ignored"
    if diagnosis.ext_finding is not None:
        yield f"its extended diagnosis lies about its lengths: {diagnosis.ext_finding}; the rest is kept as it came"


def verdict_exchanging(diagnosis: Diagnosis) -> Ev:
    """What a diagnosis of the right device, ours, means while in data exchange (B1)."""
    return _EVENT[weightiest(tuple(flag.exchange for flag in diagnosis.findings))]


def verdict_ready(diagnosis: Diagnosis, *, cfg_sent: bool) -> Ev:
    """What a diagnosis of the right device means after Set_Prm and, when ``cfg_sent``, Chk_Cfg (B1, B6)."""
    verdict = _EVENT[weightiest(tuple(flag.bring_up for flag in diagnosis.findings))]
    if not cfg_sent and verdict in (Ev.DIAG_WAIT, Ev.DIAG_READY):
        return Ev.DIAG_NO_CFG
    return verdict


def masters_view(read: Diagnosis | None, state: SlaveState, fault: Fault | None) -> Diagnosis | None:
    """The diagnosis that a master keeps for its user: the one read last with the master's own bits, None before
    anything is known. (A station that never answered: ident 0, no master.)
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
    return replace(basis, status1=status[1], status2=status[2])
