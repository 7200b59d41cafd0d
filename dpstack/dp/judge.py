"""What a diagnosis means to a master that did not write the slave: owner, deviations, verdict in data exchange."""

from __future__ import annotations

from collections.abc import Iterator

from dpstack.dp.bringup import Ev
from dpstack.dp.diagnosis import Diagnosis
from dpstack.params import MAX_STATION


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
    if not diagnosis.status2 & 0x04:
        yield "its diagnosis lacks the bit that is always 1 (octet 2 bit 2); tolerated"
    if diagnosis.master is not None and diagnosis.master == own + 128:
        yield f"its diagnosis gives the master address as {diagnosis.master}; tolerated"


def verdict_exchanging(diagnosis: Diagnosis) -> Ev:
    """What a diagnosis of the right device, ours, means while in data exchange (B1)."""
    if diagnosis.prm_fault or diagnosis.cfg_fault:
        return Ev.DIAG_REFUSED
    if diagnosis.prm_req:
        return Ev.DIAG_PRM_REQ
    return Ev.DIAG_WAIT if diagnosis.stat_diag else Ev.DIAG_READY


def verdict_ready(diagnosis: Diagnosis, *, cfg_sent: bool) -> Ev:
    """What a diagnosis of the right device means after Set_Prm and, when ``cfg_sent``, Chk_Cfg (B1, B6)."""
    if diagnosis.prm_fault or diagnosis.cfg_fault or diagnosis.not_supported:
        return Ev.DIAG_REFUSED
    if diagnosis.prm_req:
        return Ev.DIAG_PRM_REQ
    if not cfg_sent:
        return Ev.DIAG_NO_CFG
    return Ev.DIAG_WAIT if diagnosis.not_ready or diagnosis.stat_diag else Ev.DIAG_READY
