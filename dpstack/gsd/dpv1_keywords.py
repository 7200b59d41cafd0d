"""The DP-V1 keywords of a GSD file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from msgspec import Struct

from dpstack.units import NS_PER_MS

#: kinds of alarms of DP-V1: the name in configurations, and the keyword without _supp and _required
ALARM_KEYWORDS: Final = {
    "pull_plug": "Pull_Plug_Alarm",
    "process": "Process_Alarm",
    "diagnostic": "Diagnostic_Alarm",
    "manufacturer": "Manufacturer_Specific_Alarm",
    "status": "Status_Alarm",
    "update": "Update_Alarm",
}
#: response time-outs count in 10 ms
_RESPONSE_UNIT: Final = 10 * NS_PER_MS


def alarm_kinds(keywords: Iterable[str]) -> tuple[str, ...]:
    """The names of the kinds of alarms whose keywords are among ``keywords``."""
    return tuple(kind for kind, keyword in ALARM_KEYWORDS.items() if keyword in keywords)


class DpV1(Struct, frozen=True):
    """The DP-V1 keywords. Lengths in octets, time-outs in 10 ms."""

    #: DPV1_Slave
    slave: bool = False
    #: C1_Read_Write_supp: the device serves Read and Write of class 1
    c1_read_write: bool = False
    #: C1_Read_Write_required: only a master with MS1 can use the device
    c1_read_write_required: bool = False
    #: C1_Max_Data_Len in octets
    c1_max_data_len: int = 0
    #: C1_Response_Timeout in 10 ms
    c1_response_timeout: int = 0
    #: C2_Read_Write_supp: the device serves connections of class 2
    c2_read_write: bool = False
    #: C2_Read_Write_required: only a master with MS2 can use the device
    c2_read_write_required: bool = False
    #: C2_Max_Data_Len in octets
    c2_max_data_len: int = 0
    #: C2_Response_Timeout in 10 ms
    c2_response_timeout: int = 0
    #: C2_Max_Count_Channels: connections of class 2 at a time
    c2_max_count_channels: int = 0
    #: Max_Initiate_PDU_Length in octets
    max_initiate_pdu_length: int = 0
    #: kinds of alarms that the device may raise
    alarms: tuple[str, ...] = ()
    #: kinds of alarms that the master has to enable
    required: tuple[str, ...] = ()
    #: Extra_Alarm_SAP_supp: acknowledgements over SAP 50
    extra_alarm_sap: bool = False
    #: Alarm_Sequence_Mode_Count: alarms at a time in sequence mode; 0 without it
    alarm_sequence_mode_count: int = 0
    #: WD_Base_1ms_supp: the watchdog counts in ms
    wd_base_1ms: bool = False
    #: Check_Cfg_Mode: the device can be lenient about its configuration
    check_cfg_mode: bool = False
    #: Fail_Safe_required: only a master that sends empty outputs in Clear can use the device
    fail_safe_required: bool = False
    #: Ident_Maintenance_supp: the device has I&M records
    ident_maintenance: bool = False
    #: Prm_Block_Structure_supp: the device takes structured parameters
    prm_block_structure: bool = False
    #: Prm_Block_Structure_req: the device takes structured parameters only
    prm_block_structure_required: bool = False

    @property
    def reads(self) -> bool:
        """Whether the device serves Read and Write of class 1, which the master enables by DPV1_Status."""
        return self.slave and self.c1_read_write

    @property
    def c1_response_ns(self) -> int:
        """C1_Response_Timeout in ns, 0 if the file says nothing."""
        return self.c1_response_timeout * _RESPONSE_UNIT

    @property
    def c2_response_ns(self) -> int:
        """C2_Response_Timeout in ns, 0 if the file says nothing."""
        return self.c2_response_timeout * _RESPONSE_UNIT


#: of a slave without a GSD file: it may have class 2 connections, and nothing else is known
NO_GSD: Final = DpV1(c2_read_write=True)
