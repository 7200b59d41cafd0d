"""The master's handling of one slave as a table: (state, what happened) -> state, with the clause.

Start-up order: docs/reference/protocol.md#slave-handler. What real slaves do instead:
docs/reference/protocol.md#how-real-devices-deviate.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final

from msgspec import Struct

from dpstack.dp.master.events import SlaveState as S


class Trigger(Enum):
    """Results of requests to a slave, and orders, that the table knows."""

    SILENT = "no answer"
    DIAG_FREE = "diagnosis: may be parameterised"
    DIAG_LOCKED = "diagnosis: owned by another master"
    DIAG_OTHER = "diagnosis: another device"
    DIAG_MEASURING = "diagnosis: demands isochronous mode, the port is not measured yet"
    DIAG_ISOCHRONOUS = "diagnosis: demands isochronous mode"
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


_FCB: Final = "docs/reference/protocol.md#frame-count-bit"
_FC: Final = "docs/reference/protocol.md#function-code"
_DIAG: Final = "docs/reference/protocol.md#slave_diag"
_MEANS: Final = "docs/reference/protocol.md#what-a-diagnosis-means"
_SERVICES: Final = "docs/reference/protocol.md#services-by-state"
_HANDLER: Final = "docs/reference/protocol.md#slave-handler"
_ANSWERS: Final = "docs/reference/protocol.md#answers-to-data_exchange"
_ISOCHRONOUS: Final = "docs/reference/decisions/clock.md#isochronous-mode"
_REFUSALS: Final = "docs/reference/decisions/master.md#refusals"


class Row(Struct, frozen=True):
    """A row of the table: the next state and if the rule comes from."""

    next: S
    clause: str


#: states in which the slave is asked for its diagnosis before Set_Prm; a refusing one again after 1 to 10 s
_ASKING: Final = (S.OFFLINE, S.DIAGNOSIS, S.FAULT)
_DIAGNOSED: Final = (*_ASKING, S.WAIT_READY, S.DATA_EXCHANGE)
_ANY_BUT_DEACTIVATED: Final = tuple(state for state in S if state is not S.DEACTIVATED)

_RULES: Final[tuple[tuple[tuple[S, ...], Trigger, S, str], ...]] = (
    (_DIAGNOSED, Trigger.SILENT, S.OFFLINE, f"{_FCB}: no answer makes a station non-operational: one attempt a round"),
    (_ASKING, Trigger.DIAG_FREE, S.SET_PRM, f"{_HANDLER}: diagnosis, then Set_Prm"),
    (_DIAGNOSED, Trigger.DIAG_LOCKED, S.FAULT, f"{_DIAG}: octet 4, never parameterise a slave of another master"),
    (_DIAGNOSED, Trigger.DIAG_OTHER, S.FAULT, f"{_DIAG}: octets 5 and 6, ident number"),
    ((S.OFFLINE, S.DIAGNOSIS), Trigger.DIAG_MEASURING, S.DIAGNOSIS, f"{_ISOCHRONOUS}: its answers measure the port"),
    (_ASKING, Trigger.DIAG_ISOCHRONOUS, S.FAULT, f"{_ISOCHRONOUS}: refused with the figure of this port"),
    ((*_ASKING, S.WAIT_READY), Trigger.REFUSED, S.FAULT, f"{_SERVICES}: Slave_Diag is always served"),
    ((S.SET_PRM,), Trigger.ACK, S.CHK_CFG, f"{_HANDLER}: Set_Prm, then Chk_Cfg"),
    ((S.CHK_CFG,), Trigger.ACK, S.WAIT_READY, f"{_HANDLER}: Chk_Cfg, then diagnosis"),
    (
        (S.SET_PRM, S.CHK_CFG),
        Trigger.SILENT,
        S.WAIT_READY,
        f"{_REFUSALS}: silence may be one, the diagnosis says why",
    ),
    ((S.SET_PRM, S.CHK_CFG), Trigger.REFUSED, S.FAULT, f"{_FC}: RS, UE, RR"),
    ((S.WAIT_READY,), Trigger.DIAG_WAIT, S.WAIT_READY, f"{_MEANS}: Station_Not_Ready, Stat_Diag: keep asking"),
    ((S.WAIT_READY,), Trigger.DIAG_READY, S.DATA_EXCHANGE, _HANDLER),
    ((S.WAIT_READY,), Trigger.DIAG_NO_CFG, S.CHK_CFG, f"{_REFUSALS}: the acknowledgement of Set_Prm was lost"),
    ((S.WAIT_READY,), Trigger.DIAG_PRM_REQ, S.SET_PRM, f"{_MEANS}: Prm_Req, go back to Set_Prm"),
    ((S.WAIT_READY,), Trigger.DIAG_REFUSED, S.FAULT, f"{_MEANS}: Prm_Fault, Cfg_Fault, Not_Supported"),
    ((S.WAIT_READY,), Trigger.TOO_LONG, S.FAULT, f"{_REFUSALS}: one report instead of a loop"),
    ((S.DATA_EXCHANGE,), Trigger.DIAG_READY, S.DATA_EXCHANGE, f"{_ANSWERS}: DH, diagnosis fetched"),
    (
        (S.DATA_EXCHANGE,),
        Trigger.DIAG_WAIT,
        S.DATA_EXCHANGE,
        f"{_MEANS}: Stat_Diag, inputs not valid, keep asking",
    ),
    ((S.DATA_EXCHANGE,), Trigger.NOT_EXCHANGING, S.DIAGNOSIS, f"{_ANSWERS}: RS, the slave left data exchange"),
    ((S.DATA_EXCHANGE,), Trigger.DIAG_PRM_REQ, S.DIAGNOSIS, f"{_MEANS}: Prm_Req"),
    ((S.DATA_EXCHANGE,), Trigger.DIAG_REFUSED, S.FAULT, f"{_MEANS}: Prm_Fault, Cfg_Fault"),
    ((S.DATA_EXCHANGE,), Trigger.REFUSED, S.DIAGNOSIS, f"{_FC}: busy for too long"),
    ((S.DATA_EXCHANGE,), Trigger.WRONG_LENGTH, S.FAULT, f"{_ANSWERS}: a wrong length is an error"),
    ((S.DEACTIVATED,), Trigger.ACTIVATE, S.OFFLINE, f"{_DIAG}: Deactivated, by order"),
    (_ANY_BUT_DEACTIVATED, Trigger.DEACTIVATE, S.DEACTIVATED, f"{_DIAG}: Deactivated, by order"),
)


def table(rules: Sequence[tuple[tuple[S, ...], Trigger, S, str]]) -> dict[tuple[S, Trigger], Row]:
    """A row for each of the states of a rule, in the order of the states. Raises ValueError if a pair has two."""
    rows: dict[tuple[S, Trigger], Row] = {}
    for state in S:
        for states, trigger, to, clause in rules:
            if state not in states:
                continue
            if (state, trigger) in rows:
                raise ValueError(
                    f"two rows for {trigger.name} in {state.name}: {rows[state, trigger].clause}; {clause}"
                )
            rows[state, trigger] = Row(to, clause)
    return rows


#: A pair without a row is ignored, and the first ones of a slave are reported as remarks.
TABLE: Final = table(_RULES)
