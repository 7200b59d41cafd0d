"""The services of a slave that are not cyclic: reading, Set_Prm, Chk_Cfg, Set_Slave_Add.

Each function carries out one service. In which state and for which master a service is open:
:mod:`dpstack.dp.slave.state_table`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from dpstack.dp.error_origin import DEVICE_CALL
from dpstack.dp.pdu.requests import SetPrm, SetSlaveAdd
from dpstack.dp.slave.cyclic_data import CyclicData
from dpstack.dp.slave.device import Leave
from dpstack.dp.slave.extension import Handler
from dpstack.dp.slave.prm_cfg_check import (
    Refusal,
    judge_cfg,
    judge_prm,
    real_cfg,
    watchdog_time,
)
from dpstack.dp.slave.state import SlaveCore
from dpstack.dp.slave.state_table import AppTrigger
from dpstack.errors import PduError
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SET_SLAVE_ADD,
    SAP_SLAVE_DIAG,
    Resp,
    Telegram,
)

_DL: Final = Resp.DL


def handlers(core: SlaveCore) -> dict[int | None, Handler]:
    """The services of a slave application by DSAP, those of its device included."""
    by_sap: dict[int | None, Handler] = {sap: partial(serve, core) for sap, serve in _SERVICES.items()}
    for service in core.services:
        by_sap.update(service.handlers())
    return by_sap


def _slave_diag(core: SlaveCore, request: Telegram, now: int) -> Reply:
    user = core.user_diag(now)
    octets = core.build_diagnosis(user).build()
    if request.sa == core.master:
        core.diag.offer(user)
    return Reply(_DL, octets)


def _get_cfg(core: SlaveCore, request: Telegram, now: int) -> Reply:
    data = core.data
    return _data_reply(core.device.configs[0] if data is None else data.config)


# --- Set_Prm ------------------------------------------------------------------------------------------------------


def _set_prm(core: SlaveCore, request: Telegram, now: int) -> Reply:
    sa = request.sa
    if core.master is not None and sa != core.master:
        core.refuse_foreign("Set_Prm", sa, AppTrigger.PRM_FOREIGN, now)
        return SC_REPLY
    try:
        prm = SetPrm.parse(request.data)
        refusal = judge_prm(core.device, prm, ask_device=core.failure is None) or _refused_by_services(core, prm)
    except PduError as error:
        _prm_bad(core, sa, Refusal(str(error)), now)
        return SC_REPLY
    except Exception as error:
        core.fail("Set_Prm", error, now)
        return SC_REPLY
    if refusal is not None:
        _prm_bad(core, sa, refusal, now)
    elif prm.unlock:
        core.diag.clear_faults()
        core.step(AppTrigger.UNLOCK, now, Leave.UNLOCK)
    elif prm.lock:
        _prm_good(core, sa, prm, now)
    else:
        core.set_min_tsdr(prm.min_tsdr)
        core.step(AppTrigger.PRM_KEEP, now)
    return SC_REPLY


def _refused_by_services(core: SlaveCore, prm: SetPrm) -> Refusal | None:
    if not prm.lock or prm.unlock:
        return None
    reasons = (service.refuse_prm(prm) for service in core.services)
    reason = next((one for one in reasons if one is not None), None)
    return None if reason is None else Refusal(f"octet 8 on: {reason}")


def _prm_bad(core: SlaveCore, sa: int, refusal: Refusal, now: int) -> None:
    # Not_Supported is more exact than Prm_Fault
    core.diag.clear_faults()
    core.diag.not_supported = refusal.not_supported
    core.diag.prm_fault = not refusal.not_supported
    core.report.refused("Set_Prm", sa, refusal.reason, now)
    core.step(AppTrigger.PRM_BAD, now, Leave.NEW_PARAMETERS)


def _prm_good(core: SlaveCore, sa: int, prm: SetPrm, now: int) -> None:
    core.diag.clear_faults()
    core.diag.new_owner()
    core.diag.ident = prm.ident
    core.set_min_tsdr(prm.min_tsdr)
    core.master = sa
    core.group = prm.group_mask
    core.watchdog.arm(watchdog_time(core.device, prm), now)
    for service in core.services:
        service.parameterised(prm)
    core.step(AppTrigger.PRM_GOOD, now, Leave.NEW_PARAMETERS)


# --- Chk_Cfg ------------------------------------------------------------------------------------------------------


def _chk_cfg(core: SlaveCore, request: Telegram, now: int) -> Reply:
    config = real_cfg(core.device, request.data)
    if request.sa != core.master:
        core.refuse_foreign("Chk_Cfg", request.sa, AppTrigger.CFG_FOREIGN, now)
    elif core.failure is not None:
        core.step(AppTrigger.CFG_HELD, now)
    elif core.data is not None and config == core.data.config:
        core.step(AppTrigger.CFG_GOOD, now)
    else:
        _judge_cfg(core, request.sa, config, now)
    return SC_REPLY


def _judge_cfg(core: SlaveCore, sa: int, config: bytes, now: int) -> None:
    try:
        verdict = judge_cfg(core.device, config)
        if not isinstance(verdict, Refusal):
            reasons = (service.refuse_cfg(config) for service in core.services)
            reason = next((one for one in reasons if one is not None), None)
            verdict = verdict if reason is None else Refusal(reason)
    except Exception as error:
        core.fail("Chk_Cfg", error, now)
        return
    if isinstance(verdict, Refusal):
        core.diag.cfg_fault = True
        core.report.refused("Chk_Cfg", sa, verdict.reason, now)
        core.step(AppTrigger.CFG_BAD, now, Leave.NEW_CONFIGURATION)
    else:
        _cfg_good(core, config, *verdict, now)


def _cfg_good(core: SlaveCore, config: bytes, inputs: int, outputs: int, now: int) -> None:
    if not core.leave(Leave.NEW_CONFIGURATION, now):
        return
    try:
        data = CyclicData(core.device, config, inputs, outputs)
        with DEVICE_CALL:
            core.device.enter(config, now)
    except Exception as error:
        core.fail("Chk_Cfg", error, now)
        return
    core.diag.cfg_fault = False
    core.data = data
    for service in core.services:
        service.entered()
    if core.broadcast is not None:
        data.overlay = core.broadcast.begin(config, now)
    core.report.report_again()
    core.step(AppTrigger.CFG_GOOD, now)


# --- Set_Slave_Add ------------------------------------------------------------------------------------------------


def _set_slave_add(core: SlaveCore, request: Telegram, now: int) -> Reply | None:
    if not core.set_address.open:
        return None
    try:
        wanted = SetSlaveAdd.parse(request.data)
        reason = core.set_address.judge(wanted)
        if reason is None:
            core.set_address.change(wanted, request.sa, now)
            core.end_services("the slave has another address", now)
            core.step(AppTrigger.ADDRESS, now)
    except PduError as error:
        reason = str(error)
    except Exception as error:
        core.fail("Set_Slave_Add", error, now)
        return SC_REPLY
    if reason is not None:
        core.report.refused("Set_Slave_Add", request.sa, reason, now)
    return SC_REPLY


def _data_reply(octets: bytes) -> Reply:
    """Data, or NR if none exist (docs/reference/protocol.md#function-code)."""
    return Reply(_DL, octets) if octets else Reply(Resp.NR)


_SERVICES: Final[Mapping[int, Callable[[SlaveCore, Telegram, int], Reply | None]]] = {
    SAP_SLAVE_DIAG: _slave_diag,
    SAP_SET_PRM: _set_prm,
    SAP_CHK_CFG: _chk_cfg,
    SAP_GET_CFG: _get_cfg,
    SAP_RD_INP: lambda core, request, now: _data_reply(core.inputs),
    SAP_RD_OUTP: lambda core, request, now: _data_reply(core.outputs),
    SAP_SET_SLAVE_ADD: _set_slave_add,
}
