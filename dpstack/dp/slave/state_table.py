"""The states of a DP slave as tables: who may use which service, and what leads where, with the clause per row.

Sources: protocol facts B2, B3, B5, J; "p734" is the scanned EN 50170-2 page on Set_Prm, "SPC3" and "DPC31" are
Siemens's hardware descriptions of their slave chips, "VPC3+" and "TR" the manuals behind section J.

Decisions where the sources are silent:

- Set_Prm of another master while locked, and Chk_Cfg of a master that did not parameterise the slave, are acknowledged
  with SC like any other and change nothing: the layer below acknowledges before anybody judges (J), and the diagnosis
  names the owner.
- Data_Exchange that is not accepted (state, sender, length) is answered with RS.
- The watchdog is re-armed by every new request of the owner to this station that is served, not by broadcasts and not
  by repetitions (SPC3 hardware description 5.4: telegrams to the own address; response monitoring of Master_Add).
- Leaving to Wait_Prm, for whatever reason, gives up the lock: the diagnosis shows 255.
- Set_Slave_Add is acknowledged with SC where it is open, also when ident number or address are wrong; whoever sent it
  looks for the slave at the new address (Acromag, "Introduction to ProfiBus DP"). After No_Add_Chg the SAP is closed
  as on a slave that does not have it, until an initial reset.
- An exception in the device ends data exchange (RS, outputs cleared). The slave can be parameterised again but stays
  in Wait_Cfg with Station_Not_Ready and Stat_Diag until it is restarted: no endless loop of bring-ups.
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


class Access(NamedTuple):
    """In which states a service is open, and whether only the master that locked the slave may use it.

    What is not open is answered with RS (an SDN is dropped).
    """

    name: str
    states: frozenset[SlaveAppState]
    owner_only: bool
    clause: str


#: Access by DSAP (None: Data_Exchange). SAPs that are not here are not active: RS.
ACCESS: Final[dict[int | None, Access]] = {
    None: Access("Data_Exchange", _EXCHANGING, True, "B5: RS while not ready"),
    SAP_RD_INP: Access("RD_Inp", _EXCHANGING, False, "B5; any master, also of class 2"),
    SAP_RD_OUTP: Access("RD_Outp", _EXCHANGING, False, "B5; any master, also of class 2"),
    SAP_GLOBAL_CONTROL: Access("Global_Control", _EXCHANGING, True, "DPC31: only in Data_Exch, only from Master_Add"),
    SAP_GET_CFG: Access("Get_Cfg", _ALL, False, "B5: always"),
    SAP_SLAVE_DIAG: Access("Slave_Diag", _ALL, False, "B5: always"),
    SAP_SET_PRM: Access("Set_Prm", _ALL, False, "J: SC whatever comes, the diagnosis tells what came of it"),
    SAP_SET_SLAVE_ADD: Access("Set_Slave_Add", _WAITING, False, "B5, B8: in Wait_Prm, where the device has it"),
    SAP_MS1: Access("MS1", _EXCHANGING, True, "C3, J: with its own master, where DPV1_Enable is set"),
    SAP_MS2_RM: Access("MS2 resource manager", _ALL, False, "C3: any master of class 2, where the device has them"),
    SAP_MS1_ALARM: Access("Alarm_Ack", _EXCHANGING, True, "J: where the device has Extra_Alarm_SAP; over MS1, too"),
    SAP_CHK_CFG: Access("Chk_Cfg", _ALL, False, "J: SC whatever comes, the diagnosis tells what came of it"),
}


#: of the server SAPs 0..48: open while a connection of class 2 is, for its master
CONNECTION: Final = Access("MS2", _ALL, False, "C3: class 2 needs no parameters; the connection itself says for whom")


class AppEv(Enum):
    """What happened to a slave application."""

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
    """A row: the next state, and where the rule comes from."""

    next: SlaveAppState
    clause: str


TABLE: Final[dict[tuple[SlaveAppState, AppEv], AppRow]] = {
    (_PRM, AppEv.PRM_GOOD): AppRow(_CFG, "B5"),
    (_PRM, AppEv.PRM_BAD): AppRow(_PRM, "J: SC, Prm_Fault in the diagnosis"),
    (_PRM, AppEv.PRM_KEEP): AppRow(_PRM, "p734: min T_SDR only, even with a wrong ident number"),
    (_PRM, AppEv.UNLOCK): AppRow(_PRM, "B2: 01 and 11 release; it was free"),
    (_PRM, AppEv.CFG_FOREIGN): AppRow(_PRM, "B5: no Chk_Cfg before Set_Prm; Prm_Req stays in the diagnosis"),
    (_PRM, AppEv.ADDRESS): AppRow(_PRM, "B8: another address, waiting as before"),
    (_PRM, AppEv.FAILED): AppRow(_PRM, "design: a broken device never stops the bus"),
    (_PRM, AppEv.POWER_ON): AppRow(_PRM, "B5"),
    (_CFG, AppEv.PRM_GOOD): AppRow(_CFG, "B5: parameters again"),
    (_CFG, AppEv.PRM_BAD): AppRow(_PRM, "J: back to Wait_Prm"),
    (_CFG, AppEv.PRM_KEEP): AppRow(_CFG, "p734: min T_SDR only"),
    (_CFG, AppEv.UNLOCK): AppRow(_PRM, "B5: Unlock"),
    (_CFG, AppEv.PRM_FOREIGN): AppRow(_CFG, "B2: locked, the first master keeps it"),
    (_CFG, AppEv.CFG_GOOD): AppRow(_DATA, "B5"),
    (_CFG, AppEv.CFG_BAD): AppRow(_PRM, "J: SC, Cfg_Fault in the diagnosis, back to Wait_Prm"),
    (_CFG, AppEv.CFG_HELD): AppRow(_CFG, "B1: Station_Not_Ready and Stat_Diag until restarted"),
    (_CFG, AppEv.CFG_FOREIGN): AppRow(_CFG, "B2: locked"),
    (_CFG, AppEv.WATCHDOG): AppRow(_PRM, "B5: WD expiry"),
    (_CFG, AppEv.FAILED): AppRow(_PRM, "design: a broken device never stops the bus"),
    (_CFG, AppEv.POWER_ON): AppRow(_PRM, "B5"),
    (_DATA, AppEv.PRM_GOOD): AppRow(_CFG, "B5: new parameters want a new Chk_Cfg"),
    (_DATA, AppEv.PRM_BAD): AppRow(_PRM, "B5: bad Set_Prm"),
    (_DATA, AppEv.PRM_KEEP): AppRow(_DATA, "p734: min T_SDR only"),
    (_DATA, AppEv.UNLOCK): AppRow(_PRM, "B5: Unlock"),
    (_DATA, AppEv.PRM_FOREIGN): AppRow(_DATA, "B2: locked, the first master keeps it"),
    (_DATA, AppEv.CFG_GOOD): AppRow(_DATA, "VPC3+: stays; another configuration is taken up afresh"),
    (_DATA, AppEv.CFG_BAD): AppRow(_PRM, "J: back to Wait_Prm"),
    (_DATA, AppEv.CFG_FOREIGN): AppRow(_DATA, "B2: locked"),
    (_DATA, AppEv.LENGTH): AppRow(_PRM, "J: wrong output length, Cfg_Fault, back to Wait_Prm"),
    (_DATA, AppEv.WATCHDOG): AppRow(_PRM, "B5: WD expiry"),
    (_DATA, AppEv.FAILED): AppRow(_PRM, "design: a broken device never stops the bus"),
    (_DATA, AppEv.POWER_ON): AppRow(_PRM, "B5"),
}
