"""DP-V1 in Set_Prm: DPV1_Status_1 to 3, and the structured parameters that follow them
(docs/reference/protocol.md#dpv1_status).

The three octets are the first of its user parameters. GSD files mostly hold them as constants, the first as 00: the
master sets what it uses (DPV1_Enable, Fail_Safe, WD_Base_1ms) and leaves the other bits as they stand there.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from msgspec import Struct

from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.errors import ConfigError, PduError
from dpstack.params import DPV1_STATUS_LEN

#: DPV1_Status_1
DPV1_ENABLE: Final = 0x80
FAIL_SAFE: Final = 0x40
PUBLISHER_ENABLE: Final = 0x20
WD_BASE_1MS: Final = 0x04
#: DPV1_Status_2: kinds of alarms by name, and Check_Cfg_Mode
ALARMS: Final = {
    "pull_plug": 0x80,
    "process": 0x40,
    "diagnostic": 0x20,
    "manufacturer": 0x10,
    "status": 0x08,
    "update": 0x04,
}
CHECK_CFG_MODE: Final = 0x01
#: DPV1_Status_3
PRM_CMD: Final = 0x80
ISOM_REQ: Final = 0x10
PRM_STRUCTURE: Final = 0x08
ALARM_MODE: Final = 0x07
#: alarms at a time by Alarm_Mode; 0: one of each type
ALARM_LIMITS: Final = (0, 2, 4, 8, 12, 16, 24, 32)


class Dpv1(Struct, frozen=True, kw_only=True):
    """DP-V1 of one slave: DPV1_Enable and the bits beside it; None leaves bits as the parameters have them.

    ``alarms``: kinds that the slave may raise, keys of :data:`ALARMS`; ``alarm_mode`` 0 one of each kind at a time,
    1..7 2, 4, 8, 12, 16, 24, 32 in all. ``blocks``: appended, and Prm_Structure is set; with ``structured`` [GSD:
    Prm_Block_Structure_req] it is without them, too. ``c1_response_timeout_ns``: in which the slave answers Read and
    Write, 0: not known; ``c1_max_data_len``: octets of the longest record, 0..240.
    ``extra_alarm_sap``: alarms are acknowledged at SAP 50, not 51. ``required_alarms``: kinds that are enabled if
    ``alarms`` is None, beside those that the parameters enable. Raises ConfigError.
    """

    check_cfg_mode: bool | None = None
    prm_cmd: bool | None = None
    alarms: tuple[str, ...] | None = None
    alarm_mode: int | None = None
    blocks: tuple[PrmBlock, ...] = ()
    c1_response_timeout_ns: int = 0
    c1_max_data_len: int = MAX_RECORD
    extra_alarm_sap: bool = False
    required_alarms: tuple[str, ...] = ()
    structured: bool = False

    def __post_init__(self) -> None:
        check_alarm_kinds(self.alarms or ())
        if self.alarm_mode is not None and not 0 <= self.alarm_mode <= ALARM_MODE:
            raise ConfigError(f"alarm_mode {self.alarm_mode} is outside 0..7")
        if not 0 <= self.c1_max_data_len <= MAX_RECORD:
            raise ConfigError(f"records of {self.c1_max_data_len} octets; {MAX_RECORD} are possible")

    def apply(self, octets: bytearray) -> None:
        """Write DP-V1 into the user parameters, whose first three octets are DPV1_Status. Raises ConfigError."""
        set_bit(octets, 0, DPV1_ENABLE, True)
        if self.alarms is None:
            for name in self.required_alarms:
                set_bit(octets, 1, ALARMS[name], True)
        else:
            for name, bit in ALARMS.items():
                set_bit(octets, 1, bit, name in self.alarms)
        set_bit(octets, 1, CHECK_CFG_MODE, self.check_cfg_mode)
        set_bit(octets, 2, PRM_CMD, self.prm_cmd)
        if self.alarm_mode is not None:
            octets[2] = octets[2] & ~ALARM_MODE | self.alarm_mode
        if self.blocks or self.structured:
            self._structure(octets)

    def _structure(self, octets: bytearray) -> None:
        """With Prm_Structure only blocks follow DPV1_Status: other octets become a block of type 0x81 (user_prm).

        Octets that stand there with the bit set, and those of a GSD file that requires the structure, are blocks.
        """
        rest = bytes(octets[DPV1_STATUS_LEN:])
        if self.structured or octets[2] & PRM_STRUCTURE:
            try:
                parse_blocks(rest, DPV1_STATUS_LEN + 1)
            except PduError as error:
                why = "its GSD file says Prm_Block_Structure_req = 1" if self.structured else "Prm_Structure is set"
                raise ConfigError(f"user_prm: {error}; {why}: blocks have to follow DPV1_Status") from None
        elif rest:
            from dpstack.dp.pdu.prm_contents import BlockType  # here, as few slaves have structured parameters

            octets[DPV1_STATUS_LEN:] = PrmBlock(BlockType.USER_PRM, 0, rest).octets
        set_bit(octets, 2, PRM_STRUCTURE, True)
        for block in self.blocks:
            octets += block.octets


def check_alarm_kinds(kinds: Iterable[str]) -> None:
    """Raise ConfigError for a name that is no key of :data:`ALARMS`."""
    for kind in kinds:
        if kind not in ALARMS:
            raise ConfigError(f"there is no {kind!r} alarm; there are: {', '.join(ALARMS)}")


def set_bit(octets: bytearray, at: int, bit: int, on: bool | None) -> None:
    """Set or clear ``bit`` of octet ``at``; None leaves it."""
    if on is not None:
        octets[at] = octets[at] | bit if on else octets[at] & ~bit
