"""The DP-V1 keywords of a GSD file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

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


@dataclass(frozen=True, slots=True)
class DpV1:
    """The DP-V1 keywords. Lengths in octets, time-outs in 10 ms; ``alarms``: those supported, ``required``: those
    that the master has to enable.

    ``c1_read_write_required``: only a master with MS1 can use the device; ``c2_...``: only one with MS2 (class 2).
    """

    slave: bool = False
    c1_read_write: bool = False
    c1_read_write_required: bool = False
    c1_max_data_len: int = 0
    c1_response_timeout: int = 0
    c2_read_write: bool = False
    c2_read_write_required: bool = False
    c2_max_data_len: int = 0
    c2_response_timeout: int = 0
    c2_max_count_channels: int = 0
    max_initiate_pdu_length: int = 0
    alarms: tuple[str, ...] = ()
    required: tuple[str, ...] = ()
    extra_alarm_sap: bool = False
    alarm_sequence_mode_count: int = 0
    wd_base_1ms: bool = False
    check_cfg_mode: bool = False
    fail_safe_required: bool = False
    prm_block_structure: bool = False
    prm_block_structure_required: bool = False

    @property
    def reads(self) -> bool:
        """Whether the device serves Read and Write of class 1, which the master enables by DPV1_Status."""
        return self.slave and self.c1_read_write

    @property
    def c1_response_ns(self) -> int:
        """C1_Response_Timeout in ns, 0 where the file says nothing."""
        return self.c1_response_timeout * _RESPONSE_UNIT

    @property
    def c2_response_ns(self) -> int:
        """C2_Response_Timeout in ns, 0 where the file says nothing."""
        return self.c2_response_timeout * _RESPONSE_UNIT


#: of a slave without a GSD file: it may have class 2 connections, and nothing else is known
NO_GSD: Final = DpV1(c2_read_write=True)
