"""What may be sent on a read-only bus: a guard for the link layer (:mod:`dpstack.fdl.active.request_filter`)."""

from __future__ import annotations

from typing import Final

from dpstack.dp.services import SERVICE_NAMES
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import (
    SAP_GET_CFG,
    SAP_GLOBAL_CONTROL,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SLAVE_DIAG,
    Req,
)

#: services that only read, by DSAP: open to every master beside the one that owns the slave
#: (docs/protocol.md#services-by-state)
_READING: Final = frozenset((SAP_SLAVE_DIAG, SAP_GET_CFG, SAP_RD_INP, SAP_RD_OUTP))
_ASKING: Final = frozenset((Req.FDL_STATUS, Req.IDENT))
_SRD: Final = frozenset((Req.SRD_LOW, Req.SRD_HIGH))
_NAMES: Final = {**SERVICE_NAMES, SAP_GLOBAL_CONTROL: "Global_Control"}


def reading_only(request: Request) -> str | None:
    """Why ``request`` may not be sent on a read-only bus; None for what only reads."""
    if request.function in _ASKING:
        return None
    if request.function in _SRD and request.dsap in _READING and not request.data:
        return None
    dsap = request.dsap
    if dsap is not None:
        name = _NAMES.get(dsap, f"a service at SAP {dsap}")
    else:
        name = "Data_Exchange" if request.function in _SRD else request.function.name
    return f"{name} to station {request.da} was not sent: this bus is read-only; please report it, nothing may try"
