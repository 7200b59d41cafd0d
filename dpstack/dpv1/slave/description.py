"""The description of a type of slave, as its GSD file has it; the checks of Set_Prm and Chk_Cfg follow from it.

The names in brackets are the GSD keywords. A GSD model becomes a slave by filling in a :class:`SlaveDescription`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import msgspec

from dpstack.dp.pdu.alarm_blocks import HEAD as ALARM_HEAD
from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN
from dpstack.dp.pdu.dpv1_status import ALARM_LIMITS, PRM_STRUCTURE, set_bit
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.dp.slave_params import INTERVAL_UNIT
from dpstack.dpv1.slave.alarms import AlarmSupport
from dpstack.dpv1.slave.resource_manager import check_ms2
from dpstack.errors import ConfigError, PduError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.identifiers import MAX_USER_PRM, config_for, io_lengths
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import octets_text

if TYPE_CHECKING:
    from dpstack.dpv1.slave.dxb_links import DxbSupport
    from dpstack.gsd.model import DiagText

#: the octet of Set_Prm that a first block begins with, from 1 on
_FIRST_BLOCK: Final = 11


class SlaveParameter(msgspec.Struct, frozen=True):
    """A user parameter by name [ExtUserPrmData]: its place begins in ``octet`` of the user parameters, from 0 (of a
    DP-V1 slave the octets 0..2 are DPV1_Status).

    ``type``: "Unsigned8", "Signed16" and the like with 8, 16 or 32 bits, high octet first; "Bit(3)"; "BitArea(0-3)".
    ``allowed``: ranges with both ends, empty for all values. ``texts``: value -> text. Only a GSD file of the slave
    has it; the slave itself checks its parameters by ``on_prm``.
    """

    #: name for people
    name: str
    #: first octet of its place in the user parameters, from 0
    octet: int
    type: str = "Unsigned8"
    #: default value
    default: int = 0
    allowed: tuple[tuple[int, int], ...] = ()
    texts: Mapping[int, str] = msgspec.field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SlaveModule:
    """A module of a modular slave [Module]: its identifier octets, at least one.

    For the GSD file alone: ``prm``, its octets of user parameters by default [Ext_Module_Prm_Data_Len], and
    ``parameters`` by name, with octets counted from 0 within them. Raises ConfigError.
    """

    #: name
    name: str
    #: identifier octets, at least one
    config: bytes
    #: default of its user parameters, for the GSD file alone [Ext_Module_Prm_Data_Len]
    prm: bytes = b""
    #: its user parameters by name, for the GSD file alone
    parameters: tuple[SlaveParameter, ...] = ()

    def __post_init__(self) -> None:
        if not self.config:
            raise ConfigError(f"module {self.name}: no identifier octets")
        io_lengths(self.config)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveDescription:
    """One type of slave. Fixed: ``configs``, all that it accepts, the default first. Modular: ``modules`` instead.

    ``presets``: modules of a modular slave that stand first in every configuration [FixPresetModules].

    ``ident`` [Ident_Number]; ``max_modules`` [Max_Module]; ``max_input_len``, ``max_output_len``, ``max_data_len``
    [Max_Input_Len ...] in octets, the last for both together; ``user_prm_len``: fewest and most octets of user
    parameters [Max_User_Prm_Data_Len]; ``sync``, ``freeze``, ``fail_safe``, ``set_slave_add``, ``wd_base_1ms``
    [Sync_Mode_supp ...]; ``fail_safe_required`` [Fail_Safe_required]; ``max_diag_len`` [Max_Diag_Data_Len], 6..244;
    ``dpv1`` [DPV1_Slave]: its user parameters begin with the three DPV1_Status octets; ``alarms``: kinds that it may
    raise, of "pull_plug", "process", "diagnostic", "manufacturer", "status", "update" [Pull_Plug_Alarm_supp ...];
    ``alarm_sequence``: 2..32 of them at a time in sequence mode, 0 for one of each type only
    [Alarm_Sequence_Mode_Count]; ``extra_alarm_sap`` [Extra_Alarm_SAP_supp]; ``dxb``: it publishes, subscribes, or both
    [Publisher_supp, Subscriber_supp]; ``prm_blocks`` [Prm_Block_Structure_supp]: of such a slave, structured parameters
    may follow, otherwise Prm_Structure is refused; ``prm_blocks_required``
    [Prm_Block_Structure_req]: without Prm_Structure they are refused; ``min_slave_interval_ns`` [Min_Slave_Intervall],
    for the master.

    For its GSD file alone: ``vendor`` [Vendor_Name], ``revision`` [Revision]; ``parameters``: its user parameters by
    name; ``diag_texts``: texts for its diagnosis [Unit_Diag_Bit, Channel_Diag ...]. Raises ConfigError.
    """

    #: ident number, 0..0xFFFF [Ident_Number]
    ident: int
    #: name for messages [Model_Name]
    name: str = "slave"
    #: identifier octets that a fixed slave accepts, the default first
    configs: tuple[bytes, ...] = ()
    #: modules of a modular slave, instead of ``configs``
    modules: tuple[SlaveModule, ...] = ()
    presets: tuple[SlaveModule, ...] = ()
    #: most modules of a modular slave [Max_Module]
    max_modules: int = 1
    #: most octets of inputs [Max_Input_Len]
    max_input_len: int = MAX_DATA
    #: most octets of outputs [Max_Output_Len]
    max_output_len: int = MAX_DATA
    #: most octets of inputs and outputs together [Max_Data_Len]
    max_data_len: int = 2 * MAX_DATA
    user_prm_len: tuple[int, int] = (0, MAX_USER_PRM)
    #: the slave takes part in SYNC [Sync_Mode_supp]
    sync: bool = True
    #: the slave takes part in FREEZE [Freeze_Mode_supp]
    freeze: bool = True
    #: empty outputs are taken as Clear [Fail_Safe]
    fail_safe: bool = False
    #: a master that does not send such outputs is refused [Fail_Safe_required]
    fail_safe_required: bool = False
    #: a master can change the address [Set_Slave_Add_supp]
    set_slave_add: bool = False
    #: the watchdog can count in ms [WD_Base_1ms_supp]
    wd_base_1ms: bool = False
    #: the user parameters begin with the three DPV1_Status octets [DPV1_Slave]
    dpv1: bool = False
    #: structured parameters may follow DPV1_Status [Prm_Block_Structure_supp]
    prm_blocks: bool = True
    #: parameters without structure are refused [Prm_Block_Structure_req]
    prm_blocks_required: bool = False
    #: connections of class 2, 0..49 [C2_Read_Write_supp, C2_Max_Count_Channels]
    ms2: int = 0
    #: most octets in one service of class 2 [C2_Max_Data_Len]
    ms2_max_len: int = MAX_RECORD
    #: most octets of an Initiate [Max_Initiate_PDU_Length]
    ms2_max_initiate: int = MAX_DATA
    alarms: tuple[str, ...] = ()
    alarm_sequence: int = 0
    #: alarms can be acknowledged over SAP 50, too [Extra_Alarm_SAP_supp]
    extra_alarm_sap: bool = False
    #: data exchange broadcast [Publisher_supp, Subscriber_supp ...]; None without it
    dxb: DxbSupport | None = None
    #: most octets of a whole diagnosis, 6..244 [Max_Diag_Data_Len]
    max_diag_len: int = MAX_LEN
    #: MaxTsdr in bit times by baud rate in bit/s; empty for all rates
    rates: Mapping[int, int] = field(default_factory=dict)
    #: shortest time between two polls, in ns [Min_Slave_Intervall]
    min_slave_interval_ns: int = 0
    #: maker, for the GSD file alone [Vendor_Name]
    vendor: str = ""
    #: revision of the device, for the GSD file alone [Revision]
    revision: str = ""
    parameters: tuple[SlaveParameter, ...] = ()
    diag_texts: tuple[DiagText, ...] = ()

    @classmethod
    def simple(
        cls,
        ident: int,
        *,
        inputs: int,
        outputs: int,
        name: str = "slave",
        dpv1: bool = False,
        ms2: int = 0,
        alarms: tuple[str, ...] = (),
    ) -> SlaveDescription:
        """A slave with one configuration of so many octets each way, as seen from the master. Raises ConfigError."""
        config = config_for(inputs, outputs)
        return cls(ident=ident, name=name, configs=(config,), dpv1=dpv1, ms2=ms2, alarms=alarms)

    def __post_init__(self) -> None:
        if not 0 <= self.ident <= 0xFFFF:
            raise self._wrong(f"ident {self.ident:#x} does not fit two octets")
        if bool(self.configs) is bool(self.modules):
            raise self._wrong("give configs (a fixed slave) or modules (a modular one)")
        if self.presets and not self.modules:
            raise self._wrong("presets without modules: give configs that begin with them")
        for config in self.configs:
            reason = self._too_long(config)
            if reason is not None:
                raise self._wrong(reason)
        least, most = self.user_prm_len
        if not 0 <= least <= most <= MAX_USER_PRM:
            raise self._wrong(f"user_prm_len {self.user_prm_len} is not within 0..{MAX_USER_PRM}")
        if self.dpv1 and most < DPV1_STATUS_LEN:
            raise self._wrong(f"user_prm_len {self.user_prm_len} has no room for the three DPV1_Status octets of dpv1")
        if not self.dpv1 and (self.alarms or self.alarm_sequence or self.extra_alarm_sap):
            raise self._wrong("alarms without dpv1: they are a part of DP-V1")
        if self.dxb is not None and not self.dpv1:
            raise self._wrong("dxb without dpv1: Publisher_Enable and the filter stand in DPV1_Status")
        if self.dxb is not None and self.max_diag_len < FIXED_LEN + ALARM_HEAD + 2 * self.dxb.links:
            raise self._wrong(f"max_diag_len {self.max_diag_len} has no room for the status of {self.dxb.links} links")
        try:
            support = self.alarm_support
        except ConfigError as error:
            raise self._wrong(str(error)) from None
        if support.kinds and self.max_diag_len < FIXED_LEN + ALARM_HEAD:
            raise self._wrong(f"max_diag_len {self.max_diag_len} has no room for an alarm of {ALARM_HEAD} octets")
        if not FIXED_LEN <= self.max_diag_len <= MAX_LEN:
            raise self._wrong(f"max_diag_len {self.max_diag_len} is outside {FIXED_LEN}..{MAX_LEN}")
        check_ms2(f"slave {self.name}", self.ms2, self.ms2_max_len, self.ms2_max_initiate)
        if self.modules and self.max_modules < 1:
            raise self._wrong(f"max_modules {self.max_modules}: a modular slave has room for 1 at least")

    def _wrong(self, what: str) -> ConfigError:
        return ConfigError(f"slave {self.name}: {what}")

    # --- what follows from it -----------------------------------------------------------------------------------

    @property
    def default_config(self) -> bytes:
        """The identifier octets until a Chk_Cfg brings others: the first it accepts, its presets or first module."""
        if self.configs:
            return self.configs[0]
        return b"".join(preset.config for preset in self.presets) or self.modules[0].config

    @property
    def alarm_support(self) -> AlarmSupport:
        """Its alarms. Raises ConfigError."""
        return AlarmSupport(frozenset(self.alarms), self.alarm_sequence, self.extra_alarm_sap)

    def check_prm(self, user_prm: bytes) -> str | None:
        """A reason to refuse the user parameters of Set_Prm, or None: their length, the lengths of their blocks."""
        least, most = self.user_prm_len
        if not least <= len(user_prm) <= most:
            wanted = least if least == most else f"{least}..{most}"
            return f"{len(user_prm)} octets of user parameters, {wanted} are expected"
        try:
            self.blocks(user_prm)
        except PduError as error:
            return str(error)
        return None

    def blocks(self, user_prm: bytes) -> tuple[PrmBlock, ...]:
        """The structured parameters behind DPV1_Status; none if Prm_Structure is not set. Raises PduError."""
        if not self.dpv1:
            return ()
        if len(user_prm) < DPV1_STATUS_LEN or not user_prm[2] & PRM_STRUCTURE:
            if self.prm_blocks_required:
                raise PduError("octet 10 bit 3: Prm_Structure is not set, this device needs structured parameters")
            return ()
        if not self.prm_blocks and not self.prm_blocks_required:
            raise PduError("octet 10 bit 3: Prm_Structure is set, this device has no structured parameters")
        return parse_blocks(user_prm[DPV1_STATUS_LEN:], _FIRST_BLOCK)

    def check_cfg(self, config: bytes) -> str | None:
        """A reason to refuse the identifier octets of Chk_Cfg, or None. Raises ConfigError if they are invalid."""
        if self.configs:
            if config in self.configs:
                return None
            known = " or ".join(known.hex(" ").upper() for known in self.configs)
            return f"configuration {config.hex(' ').upper() or 'without octets'} is not {known}"
        return self._check_modules(config) or self._too_long(config)

    def table(self, address: int, config: bytes | None = None) -> dict[str, object]:
        """The [[slave]] table of a master for this slave at ``address``, as ``open_bus(slaves=[...])`` takes it.

        Its alarms are enabled there, as many at a time as it can.

        ``config``: identifier octets, default the first of ``configs``. Raises ConfigError for a modular slave without.
        """
        if config is None:
            if not self.configs:
                raise self._wrong("it is modular; say which configuration the master shall ask for")
            config = self.configs[0]
        return {
            "name": self.name,
            "address": address,
            "ident": self.ident,
            "config": config.hex(" "),
            "user_prm": self._least_prm().hex(" "),
            "fail_safe": self.fail_safe,
            "min_slave_interval": -(-self.min_slave_interval_ns // INTERVAL_UNIT),
            **({"dpv1": self._dpv1_table()} if self.dpv1 else {}),
        }

    # --- inside -------------------------------------------------------------------------------------------------

    def _least_prm(self) -> bytes:
        octets = bytearray(max(self.user_prm_len[0], DPV1_STATUS_LEN * self.dpv1))
        if self.dpv1 and self.prm_blocks_required:
            set_bit(octets, 2, PRM_STRUCTURE, True)
        return bytes(octets)

    def _dpv1_table(self) -> object:
        if not self.alarms:
            return True
        mode = max(mode for mode, limit in enumerate(ALARM_LIMITS) if limit <= self.alarm_sequence)
        return {"alarms": list(self.alarms), "alarm_mode": mode}

    def _too_long(self, config: bytes) -> str | None:
        inputs, outputs = io_lengths(config)
        if inputs > self.max_input_len:
            return f"{octets_text(inputs)} of inputs, {self.max_input_len} are possible"
        if outputs > self.max_output_len:
            return f"{octets_text(outputs)} of outputs, {self.max_output_len} are possible"
        if inputs + outputs > self.max_data_len:
            return f"{inputs} input and {outputs} output octets, {self.max_data_len} together are possible"
        return None

    def _check_modules(self, config: bytes) -> str | None:
        """Whether ``config`` is ``presets`` and a row of modules, each any number of times, ``max_modules`` together at
        most.
        """
        first = b"".join(preset.config for preset in self.presets)
        if not config.startswith(first):
            return f"the configuration does not begin with {first.hex(' ').upper()}, the fixed presets of this slave"
        known = {module.config for module in self.modules}  # there may be more than a thousand
        lengths = {len(octets) for octets in known}
        fewest: list[int | None] = [None] * (len(config) + 1)  # modules that make up the octets until here
        fewest[len(first)] = len(self.presets)
        reached = 0
        for at, count in enumerate(fewest):
            if count is None:
                continue
            reached = at
            for end in (at + length for length in lengths):
                if end <= len(config) and config[at:end] in known:
                    before = fewest[end]
                    fewest[end] = count + 1 if before is None else min(before, count + 1)
        count = fewest[-1]
        if count is None:
            return f"octet {reached + 1} ({config[reached]:02X}) of the configuration begins no module of this slave"
        if not count:
            return "a configuration without any module"
        if count > self.max_modules:
            return f"{count} modules, {self.max_modules} are possible"
        return None
