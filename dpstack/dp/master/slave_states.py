"""The master's handling of one slave as a table: (state, what happened) -> state, with the clause.

Sources: protocol facts B6 (start-up order diagnosis, Set_Prm, Chk_Cfg, diagnosis, Data_Exchange; peers and the
scanned EN 50170 page "slave handler"), section I for what real slaves do instead.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from dpstack.dp.master.events import SlaveState as S


class Ev(Enum):
    """What a request to a slave ended in, as far as the handling is concerned."""

    SILENT = "no answer"
    DIAG_FREE = "diagnosis: may be parameterised"
    DIAG_LOCKED = "diagnosis: owned by another master"
    DIAG_OTHER = "diagnosis: another device"
    DIAG_PRM_REQ = "diagnosis: wants parameters"
    DIAG_NO_CFG = "diagnosis: parameterised, no Chk_Cfg sent yet"
    DIAG_REFUSED = "diagnosis: Prm_Fault, Cfg_Fault or Not_Supported"
    DIAG_WAIT = "diagnosis: not ready yet"
    DIAG_READY = "diagnosis: ready"
    ACK = "acknowledged"
    REFUSED = "refused (RS, UE, RR) too often"
    NOT_EXCHANGING = "refuses Data_Exchange"
    WRONG_LENGTH = "data of the wrong length, repeatedly"
    TOO_LONG = "waited too long"
    DEACTIVATE = "order: take it out of service"
    ACTIVATE = "order: bring it up again"


class Row(NamedTuple):
    """A row of the table: the next state and where the rule comes from."""

    next: S
    clause: str


TABLE: Final[dict[tuple[S, Ev], Row]] = {
    (S.OFFLINE, Ev.SILENT): Row(S.OFFLINE, "A4: one attempt a round while non-operational"),
    (S.OFFLINE, Ev.DIAG_FREE): Row(S.SET_PRM, "B6: diagnosis, then Set_Prm"),
    (S.OFFLINE, Ev.DIAG_LOCKED): Row(S.FAULT, "B1 octet 4: a slave of another master is never parameterised"),
    (S.OFFLINE, Ev.DIAG_OTHER): Row(S.FAULT, "B1 octets 5-6: ident number"),
    (S.OFFLINE, Ev.REFUSED): Row(S.FAULT, "Slave_Diag is served always (B5)"),
    (S.DIAGNOSIS, Ev.SILENT): Row(S.OFFLINE, "SP p131: no answer makes a station non-operational"),
    (S.DIAGNOSIS, Ev.DIAG_FREE): Row(S.SET_PRM, "B6: diagnosis, then Set_Prm"),
    (S.DIAGNOSIS, Ev.DIAG_LOCKED): Row(S.FAULT, "B1 octet 4"),
    (S.DIAGNOSIS, Ev.DIAG_OTHER): Row(S.FAULT, "B1 octets 5-6"),
    (S.DIAGNOSIS, Ev.REFUSED): Row(S.FAULT, "Slave_Diag is served always (B5)"),
    (S.SET_PRM, Ev.ACK): Row(S.CHK_CFG, "B6: Set_Prm, then Chk_Cfg"),
    (S.SET_PRM, Ev.SILENT): Row(S.WAIT_READY, "I: silence may be a refusal, the diagnosis says why"),
    (S.SET_PRM, Ev.REFUSED): Row(S.FAULT, "A3: RS, UE, RR"),
    (S.CHK_CFG, Ev.ACK): Row(S.WAIT_READY, "B6: Chk_Cfg, then diagnosis"),
    (S.CHK_CFG, Ev.SILENT): Row(S.WAIT_READY, "I: silence may be a refusal, the diagnosis says why"),
    (S.CHK_CFG, Ev.REFUSED): Row(S.FAULT, "A3: RS, UE, RR"),
    (S.WAIT_READY, Ev.SILENT): Row(S.OFFLINE, "SP p131"),
    (S.WAIT_READY, Ev.DIAG_WAIT): Row(S.WAIT_READY, "B1: Station_Not_Ready, Stat_Diag: keep asking"),
    (S.WAIT_READY, Ev.DIAG_READY): Row(S.DATA_EXCHANGE, "B6"),
    (S.WAIT_READY, Ev.DIAG_NO_CFG): Row(S.CHK_CFG, "I: the acknowledgement of Set_Prm was lost"),
    (S.WAIT_READY, Ev.DIAG_PRM_REQ): Row(S.SET_PRM, "B1: Prm_Req, go back to Set_Prm"),
    (S.WAIT_READY, Ev.DIAG_REFUSED): Row(S.FAULT, "B1: Prm_Fault, Cfg_Fault, Not_Supported"),
    (S.WAIT_READY, Ev.DIAG_LOCKED): Row(S.FAULT, "B1 octet 4"),
    (S.WAIT_READY, Ev.DIAG_OTHER): Row(S.FAULT, "B1 octets 5-6"),
    (S.WAIT_READY, Ev.REFUSED): Row(S.FAULT, "Slave_Diag is served always (B5)"),
    (S.WAIT_READY, Ev.TOO_LONG): Row(S.FAULT, "typed, rate-limited failure instead of a loop (B6)"),
    (S.DATA_EXCHANGE, Ev.DIAG_READY): Row(S.DATA_EXCHANGE, "B6: DH, diagnosis fetched"),
    (S.DATA_EXCHANGE, Ev.DIAG_WAIT): Row(S.DATA_EXCHANGE, "B1: Stat_Diag, inputs not valid, keep asking"),
    (S.DATA_EXCHANGE, Ev.SILENT): Row(S.OFFLINE, "SP p131"),
    (S.DATA_EXCHANGE, Ev.NOT_EXCHANGING): Row(S.DIAGNOSIS, "B6: RS, the slave left data exchange"),
    (S.DATA_EXCHANGE, Ev.DIAG_PRM_REQ): Row(S.DIAGNOSIS, "B1: Prm_Req"),
    (S.DATA_EXCHANGE, Ev.DIAG_REFUSED): Row(S.FAULT, "B1: Prm_Fault, Cfg_Fault"),
    (S.DATA_EXCHANGE, Ev.DIAG_LOCKED): Row(S.FAULT, "B1 octet 4: unlocked and taken by another master"),
    (S.DATA_EXCHANGE, Ev.DIAG_OTHER): Row(S.FAULT, "B1 octets 5-6: exchanged for another device"),
    (S.DATA_EXCHANGE, Ev.REFUSED): Row(S.DIAGNOSIS, "A3: busy for too long"),
    (S.DATA_EXCHANGE, Ev.WRONG_LENGTH): Row(S.FAULT, "B6: wrong length is an error"),
    # design: refused ones are asked for their diagnosis again after 1 to 10 s
    (S.FAULT, Ev.SILENT): Row(S.OFFLINE, "SP p131"),
    (S.FAULT, Ev.DIAG_FREE): Row(S.SET_PRM, "B6: diagnosis, then Set_Prm"),
    (S.FAULT, Ev.DIAG_LOCKED): Row(S.FAULT, "B1 octet 4"),
    (S.FAULT, Ev.DIAG_OTHER): Row(S.FAULT, "B1 octets 5-6"),
    (S.FAULT, Ev.REFUSED): Row(S.FAULT, "Slave_Diag is served always (B5)"),
    (S.DEACTIVATED, Ev.ACTIVATE): Row(S.OFFLINE, "B1: Deactivated, by order"),
    **{(s, Ev.DEACTIVATE): Row(S.DEACTIVATED, "B1: Deactivated, by order") for s in S if s is not S.DEACTIVATED},
}
