"""The states of a DP slave as tables: access to each service, and the transitions, with the clause of each row.

Facts: docs/reference/protocol.md#slave-states, docs/reference/protocol.md#services-by-state; the manuals named here:
docs/reference/protocol.md#sources. Decisions on points that the sources leave open:
docs/reference/decisions/slave.md#states-of-a-slave.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from dpstack.fdl.telegram import (
    SAP_CHK_CFG,
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
)


class SlaveAppState(Enum):
    """States of a slave application; the values are those of ``dpstack scan``."""

    WAIT_PRM = "wait_prm"
    WAIT_CFG = "wait_cfg"
    DATA_EXCH = "data_exchange"


_PRM, _CFG, _DATA = SlaveAppState.WAIT_PRM, SlaveAppState.WAIT_CFG, SlaveAppState.DATA_EXCH
_ALL: Final = frozenset(SlaveAppState)
_EXCHANGING: Final = frozenset((_DATA,))
_WAITING: Final = frozenset((_PRM,))


_STATES: Final = "docs/reference/protocol.md#slave-states"
_BY_STATE: Final = "docs/reference/protocol.md#services-by-state"
_ACKED: Final = "docs/reference/protocol.md#refused-parameters-are-acknowledged"
_SET_PRM: Final = "docs/reference/protocol.md#set_prm"
_LOCK: Final = "docs/reference/protocol.md#lock-and-unlock"
_ADDRESS: Final = "docs/reference/protocol.md#set_slave_add"
_MS2: Final = "docs/reference/protocol.md#ms2"
_DECIDED: Final = "docs/reference/decisions/slave.md#states-of-a-slave"


class Access(NamedTuple):
    """In which states a service is open, and whether only the master that locked the slave may use it.

    The slave answers RS to a service that is not open, and drops an SDN.
    """

    name: str
    states: frozenset[SlaveAppState]
    owner_only: bool
    clause: str


#: Access by DSAP (None: Data_Exchange). SAPs that are not here are not active: RS.
ACCESS: Final[dict[int | None, Access]] = {
    None: Access("Data_Exchange", _EXCHANGING, True, f"{_BY_STATE}: RS while not ready"),
    SAP_RD_INP: Access("RD_Inp", _EXCHANGING, False, f"{_BY_STATE}: any master, also of class 2"),
    SAP_RD_OUTP: Access("RD_Outp", _EXCHANGING, False, f"{_BY_STATE}: any master, also of class 2"),
    SAP_GLOBAL_CONTROL: Access("Global_Control", _EXCHANGING, True, f"{_BY_STATE}: only from Master_Add (DPC31)"),
    SAP_GET_CFG: Access("Get_Cfg", _ALL, False, f"{_BY_STATE}: always"),
    SAP_SLAVE_DIAG: Access("Slave_Diag", _ALL, False, f"{_BY_STATE}: always"),
    SAP_SET_PRM: Access("Set_Prm", _ALL, False, f"{_ACKED}: the diagnosis tells what came of it"),
    SAP_SET_SLAVE_ADD: Access("Set_Slave_Add", _WAITING, False, f"{_ADDRESS}: in Wait_Prm, where the device has it"),
    SAP_MS1: Access("MS1", _EXCHANGING, True, "docs/reference/protocol.md#ms1: with its own master, with DPV1_Enable"),
    SAP_MS2_RM: Access("MS2 resource manager", _ALL, False, f"{_MS2}: any class 2 master"),
    SAP_MS1_ALARM: Access("Alarm_Ack", _EXCHANGING, True, "docs/reference/protocol.md#alarm_ack: with Extra_Alarm_SAP"),
    SAP_CHK_CFG: Access("Chk_Cfg", _ALL, False, f"{_ACKED}: the diagnosis tells what came of it"),
}


#: of the server SAPs 0..48: open while a connection of class 2 is, for its master
CONNECTION: Final = Access("MS2", _ALL, False, f"{_MS2}: class 2 needs no parameters; the connection says for whom")


class AppTrigger(Enum):
    """The events that move a slave application from state to state."""

    PRM_GOOD = "Set_Prm with Lock_Req accepted"
    PRM_BAD = "Set_Prm refused"
    PRM_KEEP = "Set_Prm without Lock_Req and Unlock_Req"
    UNLOCK = "Set_Prm with Unlock_Req"
    PRM_FOREIGN = "Set_Prm of another master while locked"
    CFG_GOOD = "Chk_Cfg accepted"
    CFG_BAD = "Chk_Cfg refused"
    CFG_HELD = "Chk_Cfg while the device is broken"
    CFG_FOREIGN = "Chk_Cfg of a master that has not parameterised the slave"
    ADDRESS = "Set_Slave_Add accepted"
    LENGTH = "Data_Exchange with outputs of the wrong length"
    WATCHDOG = "watchdog expired"
    FAILED = "exception in the device"
    POWER_ON = "switched off and on"


class AppRow(NamedTuple):
    """A row: the next state, and if the rule comes from."""

    next: SlaveAppState
    clause: str


TABLE: Final[dict[tuple[SlaveAppState, AppTrigger], AppRow]] = {
    (_PRM, AppTrigger.PRM_GOOD): AppRow(_CFG, _STATES),
    (_PRM, AppTrigger.PRM_BAD): AppRow(_PRM, f"{_ACKED}: Prm_Fault in the diagnosis"),
    (_PRM, AppTrigger.PRM_KEEP): AppRow(_PRM, f"{_SET_PRM}: min T_SDR only, even with a wrong ident number"),
    (_PRM, AppTrigger.UNLOCK): AppRow(_PRM, f"{_LOCK}: 01 and 11 release; it was free"),
    (_PRM, AppTrigger.CFG_FOREIGN): AppRow(_PRM, f"{_BY_STATE}: no Chk_Cfg before Set_Prm; Prm_Req stays set"),
    (_PRM, AppTrigger.ADDRESS): AppRow(_PRM, f"{_ADDRESS}: another address, waiting as before"),
    (_PRM, AppTrigger.FAILED): AppRow(_PRM, f"{_DECIDED}: a broken device never stops the bus"),
    (_PRM, AppTrigger.POWER_ON): AppRow(_PRM, _STATES),
    (_CFG, AppTrigger.PRM_GOOD): AppRow(_CFG, f"{_STATES}: parameters again"),
    (_CFG, AppTrigger.PRM_BAD): AppRow(_PRM, f"{_ACKED}: back to Wait_Prm"),
    (_CFG, AppTrigger.PRM_KEEP): AppRow(_CFG, f"{_SET_PRM}: min T_SDR only"),
    (_CFG, AppTrigger.UNLOCK): AppRow(_PRM, f"{_STATES}: Unlock"),
    (_CFG, AppTrigger.PRM_FOREIGN): AppRow(_CFG, f"{_LOCK}: locked, the first master keeps it"),
    (_CFG, AppTrigger.CFG_GOOD): AppRow(_DATA, _STATES),
    (_CFG, AppTrigger.CFG_BAD): AppRow(_PRM, f"{_ACKED}: Cfg_Fault in the diagnosis, back to Wait_Prm"),
    (_CFG, AppTrigger.CFG_HELD): AppRow(_CFG, f"{_DECIDED}: Station_Not_Ready and Stat_Diag until restarted"),
    (_CFG, AppTrigger.CFG_FOREIGN): AppRow(_CFG, f"{_LOCK}: locked"),
    (_CFG, AppTrigger.WATCHDOG): AppRow(_PRM, f"{_STATES}: the watchdog expired"),
    (_CFG, AppTrigger.FAILED): AppRow(_PRM, f"{_DECIDED}: a broken device never stops the bus"),
    (_CFG, AppTrigger.POWER_ON): AppRow(_PRM, _STATES),
    (_DATA, AppTrigger.PRM_GOOD): AppRow(_CFG, f"{_STATES}: new parameters want a new Chk_Cfg"),
    (_DATA, AppTrigger.PRM_BAD): AppRow(_PRM, f"{_STATES}: bad Set_Prm"),
    (_DATA, AppTrigger.PRM_KEEP): AppRow(_DATA, f"{_SET_PRM}: min T_SDR only"),
    (_DATA, AppTrigger.UNLOCK): AppRow(_PRM, f"{_STATES}: Unlock"),
    (_DATA, AppTrigger.PRM_FOREIGN): AppRow(_DATA, f"{_LOCK}: locked, the first master keeps it"),
    (_DATA, AppTrigger.CFG_GOOD): AppRow(_DATA, "VPC3+: stays; another configuration is taken up afresh"),
    (_DATA, AppTrigger.CFG_BAD): AppRow(_PRM, f"{_ACKED}: back to Wait_Prm"),
    (_DATA, AppTrigger.CFG_FOREIGN): AppRow(_DATA, f"{_LOCK}: locked"),
    (_DATA, AppTrigger.LENGTH): AppRow(_PRM, f"{_STATES}: wrong output length, Cfg_Fault, back to Wait_Prm"),
    (_DATA, AppTrigger.WATCHDOG): AppRow(_PRM, f"{_STATES}: the watchdog expired"),
    (_DATA, AppTrigger.FAILED): AppRow(_PRM, f"{_DECIDED}: a broken device never stops the bus"),
    (_DATA, AppTrigger.POWER_ON): AppRow(_PRM, _STATES),
}
