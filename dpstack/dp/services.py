"""The services of MS0 at a slave: their names and SAPs, the octets of Set_Prm, and which answers are positive."""

from __future__ import annotations

from collections.abc import Container
from typing import TYPE_CHECKING, Final

from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave_params import SlaveParams, WatchdogTime
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    Kind,
    Req,
    Resp,
    Telegram,
)
from dpstack.params import BROADCAST

if TYPE_CHECKING:
    from dpstack.fdl.services.orders import FdlRequest

#: FC status values that carry data: DL and DH
DATA_STATUS: Final = frozenset((int(Resp.DL), int(Resp.DH)))
#: how a slave without inputs may answer Data_Exchange besides SC
EMPTY_STATUS: Final = DATA_STATUS | {int(Resp.OK)}

SERVICE_NAMES: Final = {
    SAP_GLOBAL_CONTROL: "Global_Control",
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


def set_prm(setup: SlaveParams, ident: int, watchdog: WatchdogTime | None) -> bytes:
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


def planned_prm(setup: SlaveParams, watchdog: WatchdogTime | None) -> str:
    """The octets of :func:`set_prm` in hex, ``....`` if the ident number will be that of the slave's diagnosis."""
    octets = set_prm(setup, setup.ident or 0, watchdog).hex()
    first, behind = 2 * _IDENT_AT, 2 * (_IDENT_AT + 2)
    return octets if setup.ident is not None else octets[:first] + "...." + octets[behind:]


def unlock_prm(setup: SlaveParams, ident: int) -> bytes:
    """The octets of Set_Prm that unlock the slave."""
    return SetPrm(ident=ident, lock=False, unlock=True, min_tsdr=setup.min_tsdr).build()


def positive(dsap: int | None, answer: Telegram) -> bool:
    """Whether ``answer`` to the service at ``dsap`` is positive: an acknowledgement of a writing service, data of
    another one."""
    status = answer.fc & 0x0F if answer.fc >= 0 else -1
    if dsap in _ACKNOWLEDGED:
        return answer.kind is Kind.SC or status in EMPTY_STATUS
    return status in DATA_STATUS


def refusal_text(answer: Telegram) -> str:
    """The name of a negative answer: RS, UE, RR ..."""
    if answer.kind is Kind.SC:
        return "a bare acknowledgement"
    status = answer.fc & 0x0F
    return Resp(status).name if status in Resp.__members__.values() else f"status {status}"


#: services that only read, by DSAP: open to every master beside the one that owns the slave
#: (docs/reference/protocol.md#services-by-state)
_READING: Final = frozenset((SAP_SLAVE_DIAG, SAP_GET_CFG, SAP_RD_INP, SAP_RD_OUTP))
_ASKING: Final = frozenset((Req.FDL_STATUS, Req.IDENT, Req.LSAP_STATUS))
_SRD: Final = frozenset((Req.SRD_LOW, Req.SRD_HIGH))
_EXCHANGES: Final = _SRD | {Req.MSRD}


def reading_only(request: Request) -> str | None:
    """The reason why ``request`` may not be sent on a read-only bus; None if it only reads."""
    if request.function in _ASKING:
        return None
    if request.function in _SRD and request.dsap in _READING and not request.data:
        return None
    dsap = request.dsap
    if dsap is not None:
        name = SERVICE_NAMES.get(dsap, f"a service at SAP {dsap}")
    else:
        name = "Data_Exchange" if request.function in _EXCHANGES else request.function.name
    return f"{name} to station {request.da} was not sent: this bus is read-only; please report it, nothing may try"


#: SAPs of DP, at a slave and at a master, and the one that reaches all SAPs of a station
_DP_SAPS: Final = range(48, 64)


def fdl_refusal(order: FdlRequest, slaves: Container[int], *, read_only: bool) -> str | None:
    """The reason why a program may not send ``order`` beside the DP master of this station; None if it may.

    ``slaves``: addresses of the master's slaves. SAPs 48 to 62 are those of DP; 63 reaches all SAPs of a station.
    """
    name = f"{order.service.value} to station {order.address} is refused beside the DP master of this station"
    if order.address == BROADCAST:
        return f"{name}: a telegram to all stations reaches its slaves (Global_Control is one)"
    for sap in (order.dsap, order.ssap):
        if sap in _DP_SAPS and order.service.value != "LSAP_STATUS":
            return f"{name}: SAPs 48 to 63 are those of DP; use bus.slave(...) and bus.class2 for its services"
    exchanges = order.service.value in ("SDA", "SDN", "SRD", "MSRD")
    if exchanges and order.dsap is None and order.address in slaves:
        return f"{name}: the default SAP of its slave is Data_Exchange; set bus.slave({order.address}).outputs instead"
    if exchanges and read_only:
        return (
            f"{order.service.value} to station {order.address} is refused: this bus is read-only; leave read_only out"
        )
    return None
