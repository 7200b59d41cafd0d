"""Names of the services of the link layer and of DP, by function code and service access point.

Facts: docs/reference/protocol.md#saps.
"""

from __future__ import annotations

from typing import Final

from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_EXT_USER_PRM,
    SAP_GET_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_MS1,
    SAP_MS1_ALARM,
    SAP_MS2_RM,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    SSAP_MASTER_MASTER,
    SSAP_MS2,
    Kind,
    Req,
    Telegram,
)

_BY_SAP: Final[dict[int, str]] = {
    SAP_MS2_RM: "MS2 resource manager",
    SAP_MS1_ALARM: "MS1 alarm",
    SAP_MS1: "MS1",
    SAP_EXT_USER_PRM: "Ext_User_Prm",
    SSAP_MASTER_MASTER: "master-master",
    SAP_SET_SLAVE_ADD: "Set_Slave_Add",
    SAP_RD_INP: "RD_Inp",
    SAP_RD_OUTP: "RD_Outp",
    SAP_GLOBAL_CONTROL: "Global_Control",
    SAP_GET_CFG: "Get_Cfg",
    SAP_SLAVE_DIAG: "Slave_Diag",
    SAP_SET_PRM: "Set_Prm",
    SAP_CHK_CFG: "Chk_Cfg",
}

#: services that have a function code of their own
BY_FUNCTION: Final[dict[int, str]] = {
    Req.TIME_EVENT: "Time_Event",
    Req.MSRD: "MSRD",
    Req.FDL_STATUS: "FDL_Status",
    Req.IDENT: "Ident",
    Req.LSAP_STATUS: "LSAP_Status",
}


def service(telegram: Telegram) -> str:
    """The name of the service a telegram belongs to: ``Set_Prm``, ``Data_Exchange``, ``token``, ``SC`` ...

    A response without SAPs and data can belong to any request: ``acknowledgement``.
    """
    if telegram.kind is Kind.SC:
        return "SC"
    if telegram.kind is Kind.SD4:
        return "token"
    if telegram.is_request:
        named = BY_FUNCTION.get(telegram.function)
        if named is not None:
            return "Clock_Value" if telegram.fc & 0x80 else named
        return _by_saps(telegram.dsap, telegram.ssap)
    if telegram.dsap is None and telegram.ssap is None and not telegram.data:
        return "acknowledgement"
    return _by_saps(telegram.ssap, telegram.dsap)


def request_name(request: Request) -> str:
    """The name of the service of a request."""
    return BY_FUNCTION.get(request.function) or _by_saps(request.dsap, request.ssap)


def _by_saps(slave: int | None, master: int | None) -> str:
    """The service between a slave's SAP and a master's."""
    if slave is None:
        return "Data_Exchange" if master is None else f"SAP none/{master}"
    named = _BY_SAP.get(slave)
    if named is None and slave < SAP_MS2_RM and master == SSAP_MS2:
        return f"MS2 connection {slave}"
    return named or f"SAP {slave}"
