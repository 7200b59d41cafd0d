"""The master's handling of one slave as a table: (state, what happened) -> state, with the clause.

Start-up order: docs/protocol.md#slave-handler. What real slaves do instead: docs/protocol.md#how-real-devices-deviate.
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


_FCB: Final = "docs/protocol.md#frame-count-bit"
_FC: Final = "docs/protocol.md#function-code"
_DIAG: Final = "docs/protocol.md#slave_diag"
_MEANS: Final = "docs/protocol.md#what-a-diagnosis-means"
_SERVICES: Final = "docs/protocol.md#services-by-state"
_HANDLER: Final = "docs/protocol.md#slave-handler"
_ANSWERS: Final = "docs/protocol.md#answers-to-data_exchange"
_REFUSALS: Final = "docs/decisions/master.md#refusals"


class Row(NamedTuple):
    """A row of the table: the next state and where the rule comes from."""

    next: S
    clause: str


TABLE: Final[dict[tuple[S, Ev], Row]] = {
    (S.OFFLINE, Ev.SILENT): Row(S.OFFLINE, f"{_FCB}: one attempt a round while non-operational"),
    (S.OFFLINE, Ev.DIAG_FREE): Row(S.SET_PRM, f"{_HANDLER}: diagnosis, then Set_Prm"),
    (S.OFFLINE, Ev.DIAG_LOCKED): Row(S.FAULT, f"{_DIAG}: octet 4, a slave of another master is never parameterised"),
    (S.OFFLINE, Ev.DIAG_OTHER): Row(S.FAULT, f"{_DIAG}: octets 5 and 6, ident number"),
    (S.OFFLINE, Ev.REFUSED): Row(S.FAULT, f"{_SERVICES}: Slave_Diag is always served"),
    (S.DIAGNOSIS, Ev.SILENT): Row(S.OFFLINE, f"{_FCB}: no answer makes a station non-operational"),
    (S.DIAGNOSIS, Ev.DIAG_FREE): Row(S.SET_PRM, f"{_HANDLER}: diagnosis, then Set_Prm"),
    (S.DIAGNOSIS, Ev.DIAG_LOCKED): Row(S.FAULT, f"{_DIAG}: octet 4"),
    (S.DIAGNOSIS, Ev.DIAG_OTHER): Row(S.FAULT, f"{_DIAG}: octets 5 and 6"),
    (S.DIAGNOSIS, Ev.REFUSED): Row(S.FAULT, f"{_SERVICES}: Slave_Diag is always served"),
    (S.SET_PRM, Ev.ACK): Row(S.CHK_CFG, f"{_HANDLER}: Set_Prm, then Chk_Cfg"),
    (S.SET_PRM, Ev.SILENT): Row(S.WAIT_READY, f"{_REFUSALS}: silence may be one, the diagnosis says why"),
    (S.SET_PRM, Ev.REFUSED): Row(S.FAULT, f"{_FC}: RS, UE, RR"),
    (S.CHK_CFG, Ev.ACK): Row(S.WAIT_READY, f"{_HANDLER}: Chk_Cfg, then diagnosis"),
    (S.CHK_CFG, Ev.SILENT): Row(S.WAIT_READY, f"{_REFUSALS}: silence may be one, the diagnosis says why"),
    (S.CHK_CFG, Ev.REFUSED): Row(S.FAULT, f"{_FC}: RS, UE, RR"),
    (S.WAIT_READY, Ev.SILENT): Row(S.OFFLINE, _FCB),
    (S.WAIT_READY, Ev.DIAG_WAIT): Row(S.WAIT_READY, f"{_MEANS}: Station_Not_Ready, Stat_Diag: keep asking"),
    (S.WAIT_READY, Ev.DIAG_READY): Row(S.DATA_EXCHANGE, _HANDLER),
    (S.WAIT_READY, Ev.DIAG_NO_CFG): Row(S.CHK_CFG, f"{_REFUSALS}: the acknowledgement of Set_Prm was lost"),
    (S.WAIT_READY, Ev.DIAG_PRM_REQ): Row(S.SET_PRM, f"{_MEANS}: Prm_Req, go back to Set_Prm"),
    (S.WAIT_READY, Ev.DIAG_REFUSED): Row(S.FAULT, f"{_MEANS}: Prm_Fault, Cfg_Fault, Not_Supported"),
    (S.WAIT_READY, Ev.DIAG_LOCKED): Row(S.FAULT, f"{_DIAG}: octet 4"),
    (S.WAIT_READY, Ev.DIAG_OTHER): Row(S.FAULT, f"{_DIAG}: octets 5 and 6"),
    (S.WAIT_READY, Ev.REFUSED): Row(S.FAULT, f"{_SERVICES}: Slave_Diag is always served"),
    (S.WAIT_READY, Ev.TOO_LONG): Row(S.FAULT, f"{_REFUSALS}: one report instead of a loop"),
    (S.DATA_EXCHANGE, Ev.DIAG_READY): Row(S.DATA_EXCHANGE, f"{_ANSWERS}: DH, diagnosis fetched"),
    (S.DATA_EXCHANGE, Ev.DIAG_WAIT): Row(S.DATA_EXCHANGE, f"{_MEANS}: Stat_Diag, inputs not valid, keep asking"),
    (S.DATA_EXCHANGE, Ev.SILENT): Row(S.OFFLINE, _FCB),
    (S.DATA_EXCHANGE, Ev.NOT_EXCHANGING): Row(S.DIAGNOSIS, f"{_ANSWERS}: RS, the slave left data exchange"),
    (S.DATA_EXCHANGE, Ev.DIAG_PRM_REQ): Row(S.DIAGNOSIS, f"{_MEANS}: Prm_Req"),
    (S.DATA_EXCHANGE, Ev.DIAG_REFUSED): Row(S.FAULT, f"{_MEANS}: Prm_Fault, Cfg_Fault"),
    (S.DATA_EXCHANGE, Ev.DIAG_LOCKED): Row(S.FAULT, f"{_DIAG}: octet 4, unlocked and taken by another master"),
    (S.DATA_EXCHANGE, Ev.DIAG_OTHER): Row(S.FAULT, f"{_DIAG}: octets 5 and 6, exchanged for another device"),
    (S.DATA_EXCHANGE, Ev.REFUSED): Row(S.DIAGNOSIS, f"{_FC}: busy for too long"),
    (S.DATA_EXCHANGE, Ev.WRONG_LENGTH): Row(S.FAULT, f"{_ANSWERS}: a wrong length is an error"),
    # design: refused ones are asked for their diagnosis again after 1 to 10 s
    (S.FAULT, Ev.SILENT): Row(S.OFFLINE, _FCB),
    (S.FAULT, Ev.DIAG_FREE): Row(S.SET_PRM, f"{_HANDLER}: diagnosis, then Set_Prm"),
    (S.FAULT, Ev.DIAG_LOCKED): Row(S.FAULT, f"{_DIAG}: octet 4"),
    (S.FAULT, Ev.DIAG_OTHER): Row(S.FAULT, f"{_DIAG}: octets 5 and 6"),
    (S.FAULT, Ev.REFUSED): Row(S.FAULT, f"{_SERVICES}: Slave_Diag is always served"),
    (S.DEACTIVATED, Ev.ACTIVATE): Row(S.OFFLINE, f"{_DIAG}: Deactivated, by order"),
    **{(s, Ev.DEACTIVATE): Row(S.DEACTIVATED, f"{_DIAG}: Deactivated, by order") for s in S if s is not S.DEACTIVATED},
}
