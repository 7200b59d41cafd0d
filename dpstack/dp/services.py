"""The acyclic services of DP-V0 at a slave (MS0): names, requests, positive answers."""

from __future__ import annotations

from typing import Final

from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave_params import SlaveSetup, WatchdogTime
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    Kind,
    Resp,
    Telegram,
)

#: FC status values that carry data: DL and DH
DATA_STATUS: Final = frozenset((int(Resp.DL), int(Resp.DH)))
#: how a slave without inputs may answer Data_Exchange besides SC
EMPTY_STATUS: Final = DATA_STATUS | {int(Resp.OK)}

SERVICE_NAMES: Final = {
    SAP_SLAVE_DIAG: "Slave_Diag",
    SAP_SET_PRM: "Set_Prm",
    SAP_CHK_CFG: "Chk_Cfg",
    SAP_GET_CFG: "Get_Cfg",
    SAP_RD_INP: "RD_Inp",
    SAP_RD_OUTP: "RD_Outp",
    SAP_SET_SLAVE_ADD: "Set_Slave_Add",
}
#: index of Ident_Number in Set_Prm
_IDENT_AT: Final = 4
#: services that write, and are acknowledged only
_ACKNOWLEDGED: Final = frozenset((SAP_SET_PRM, SAP_CHK_CFG, SAP_SET_SLAVE_ADD))


def set_prm(setup: SlaveSetup, ident: int, watchdog: WatchdogTime | None) -> bytes:
    """The octets of Set_Prm that lock ``setup``'s slave to this master."""
    return SetPrm(
        ident=ident,
        user_prm=setup.user_octets(watchdog),
        sync=setup.sync,
        freeze=setup.freeze,
        watchdog=watchdog.factors if watchdog else None,
        min_tsdr=setup.min_tsdr,
        group_mask=setup.group_mask,
    ).build()


def planned_prm(setup: SlaveSetup, watchdog: WatchdogTime | None) -> str:
    """The octets of :func:`set_prm` in hex, ``....`` where the ident number will be that of the slave's diagnosis."""
    octets = set_prm(setup, setup.ident or 0, watchdog).hex()
    first, behind = 2 * _IDENT_AT, 2 * (_IDENT_AT + 2)
    return octets if setup.ident is not None else octets[:first] + "...." + octets[behind:]


def unlock_prm(setup: SlaveSetup, ident: int) -> bytes:
    """The octets of Set_Prm that give the slave free."""
    return SetPrm(ident=ident, lock=False, unlock=True, min_tsdr=setup.min_tsdr).build()


def positive(dsap: int | None, answer: Telegram) -> bool:
    """Whether ``answer`` is a positive one to the service at ``dsap``: what writes is acknowledged, the others are
    answered with data."""
    status = answer.fc & 0x0F if answer.fc >= 0 else -1
    if dsap in _ACKNOWLEDGED:
        return answer.kind is Kind.SC or status in EMPTY_STATUS
    return status in DATA_STATUS


def refusal_text(answer: Telegram) -> str:
    """How a negative answer is called: RS, UE, RR ..."""
    if answer.kind is Kind.SC:
        return "a bare acknowledgement"
    status = answer.fc & 0x0F
    return Resp(status).name if status in Resp.__members__.values() else f"status {status}"
