"""From the settings of a GSD file (``keyword = value``) to the fields of Device and DpV1."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from dpstack.gsd.blocks import octets_of, read_value
from dpstack.gsd.dpv1_keywords import ALARM_KEYWORDS, DpV1
from dpstack.gsd.lexer import Statement, first_number, number, string
from dpstack.gsd.model import Device, Findings, Speed
from dpstack.units import BAUD_RATES

#: baud rate in bit/s by the spelling in ``500_supp``, ``MaxTsdr_500``
_RATES: Final = "9.6 19.2 31.25 45.45 93.75 187.5 500 1.5m 3m 6m 12m"
RATES: Final[dict[str, int]] = dict(zip(_RATES.split(), BAUD_RATES, strict=True))

#: flags whose keyword ends with _supp
_SUPPORTED: Final = """
auto_baud set_slave_add c1_read_write c2_read_write extra_alarm_sap wd_base_1ms prm_block_structure publisher
subscriber ident_maintenance
"""
#: keyword -> field of Device or DpV1, for each field that is not called like its keyword
_RENAMED: Final = {
    "ident_number": "ident",
    "vendor_name": "vendor",
    "model_name": "model",
    "ordernumber": "order_number",
    "min_slave_intervall": "min_slave_interval",
    "min_slave_interval": "min_slave_interval",
    "modul_offset": "modul_offset",
    "module_offset": "modul_offset",
    "freeze_mode_supp": "freeze",
    "sync_mode_supp": "sync",
    "modular_station": "modular",
    "fixpresetmodules": "fix_preset_modules",
    "dpv1_slave": "slave",
    "prm_block_structure_req": "prm_block_structure_required",
    "isochron_mode_supp": "isochronous",
    "isochron_mode_required": "isochronous_required",
    **{f"{name}_supp": name for name in _SUPPORTED.split()},
}
#: lowest and highest value by keyword; numbers of other keywords may have 32 bits
_LIMITS: Final = {
    **dict.fromkeys(("gsd_revision", "revision_number", "protocol_ident", "station_type"), (0, 255)),
    **dict.fromkeys(("max_module", "modul_offset", "module_offset", "diag_update_delay"), (0, 255)),
    **dict.fromkeys(("ident_number", "min_slave_intervall", "min_slave_interval"), (0, 0xFFFF)),
    **dict.fromkeys(("c1_response_timeout", "c2_response_timeout"), (0, 0xFFFF)),
    **dict.fromkeys((f"maxtsdr_{rate}" for rate in RATES), (0, 0xFFFF)),
    **dict.fromkeys(("max_input_len", "max_output_len", "max_initiate_pdu_length"), (0, 244)),
    **dict.fromkeys(("max_user_prm_data_len", "user_prm_data_len"), (0, 237)),
    **dict.fromkeys(("c1_max_data_len", "c2_max_data_len"), (0, 240)),
    "max_data_len": (0, 488),
    "max_diag_data_len": (6, 244),
    "c2_max_count_channels": (0, 49),
    "alarm_sequence_mode_count": (0, 32),
}
_32_BITS: Final = (0, 0xFFFF_FFFF)
#: texts that files have in place of the numbers of Repeater_Ctrl_Sig and 24V_Pins (``"M24V"``)
_PINS: Final = {"not used": 0, "not connected": 0, "rs485": 1, "input": 1, "m24v": 1, "ttl": 2, "output": 2, "p24v": 2}
#: octets of the PDU of an Initiate without addresses in other networks
_LEAST_INITIATE: Final = 20


def _only_number(text: str) -> int | None:
    value, rest = first_number(text)
    return None if rest else value


class Settings:
    """Typed access to the settings of one file. A value that cannot be parsed is reported and left out."""

    def __init__(self, settings: Mapping[str, Statement], findings: Findings) -> None:
        self._settings = settings
        self._findings = findings

    def device_fields(self) -> dict[str, Any]:
        """Arguments for a Device. Fields without a keyword in the file keep their defaults."""
        for keyword, reader in _CHECKED.items():
            if keyword in self._settings:
                reader(self, keyword)
        found = self._fields(Device)
        found["speeds"] = tuple(
            Speed(baud, self._int(f"maxtsdr_{key}")) for key, baud in RATES.items() if self._flag(f"{key}_supp")
        )
        found["dpv1"] = dpv1 = DpV1(
            **self._fields(DpV1), alarms=self._alarms("supp"), required=self._alarms("required")
        )
        for keyword, text in contradictions(dpv1):
            if keyword in self._settings:
                self._warn(keyword, text)
        return found

    def _alarms(self, ending: str) -> tuple[str, ...]:
        return tuple(alarm for alarm in ALARM_KEYWORDS.values() if self._flag(f"{alarm.lower()}_{ending}"))

    def _fields(self, section: type[Device | DpV1]) -> dict[str, Any]:
        """The fields of ``section`` that are one value, as far as the file has their keywords."""
        found: dict[str, Any] = {}
        for keyword, name in _FIELDS.items():
            reader = _READERS.get(str(section.__annotations__.get(name)))
            if keyword in self._settings and reader is not None:
                value = reader(self, keyword)
                if value is not None:
                    found[name] = value
        return found

    def line(self, keyword: str) -> int:
        """The line of ``keyword``, 0 if the file does not have it."""
        found = self._settings.get(keyword)
        return found.line if found else 0

    def _warn(self, keyword: str, message: str) -> None:
        statement = self._settings[keyword]
        self._findings.warning(statement.line, message, statement.column)

    def _unreadable(self, keyword: str, problem: str) -> None:
        statement = self._settings[keyword]
        self._warn(keyword, f"{statement.written} = {statement.value[:40]} {problem}")

    def _int(self, keyword: str) -> int | None:
        if keyword not in self._settings:
            return None
        statement = self._settings[keyword]
        value = read_value(self._findings, statement, _only_number)
        if value is None:
            text = string(statement.value)[0] or ""
            value = number(text)
            if value is None and keyword in ("repeater_ctrl_sig", "24v_pins", "24v pins"):
                value = _PINS.get(text.strip().lower())
        low, high = _LIMITS.get(keyword, _32_BITS)
        if value is None:
            self._unreadable(keyword, "is no number; left out")
        elif not low <= value <= high:
            self._warn(keyword, f"{statement.written} = {value} is outside {low}..{high}")
        return value

    def _flag(self, keyword: str) -> bool | None:
        value = self._int(keyword)
        return None if value is None else value != 0

    def _text(self, keyword: str) -> str:
        statement = self._settings[keyword]
        text, rest, closed = string(statement.value)
        if text is None:
            return statement.value
        if not closed:
            self._warn(keyword, f"{statement.written}: the text has no closing quote")
        elif rest:
            message = f"{statement.written}: {rest!r} behind the text is not used"
            self._findings.info(statement.line, message, statement.column)
        return text.strip()

    def _octets(self, keyword: str) -> bytes | None:
        statement = self._settings[keyword]
        octets = read_value(self._findings, statement, octets_of)
        if octets is None:
            self._unreadable(keyword, "is no list of octets; left out")
        return octets

    def _check_family(self, keyword: str) -> None:
        """``Slave_Family = 3@group@subgroup``."""
        if number(self._settings[keyword].value.strip('"').partition("@")[0]) is None:
            self._unreadable(keyword, "begins with no number; left out")


#: type of a field, as its dataclass states it -> reader
_READERS: Final[dict[str, Callable[[Settings, str], object]]] = {
    "bool": Settings._flag,
    "int": Settings._int,
    "int | None": Settings._int,
    "str": Settings._text,
    "bytes | None": Settings._octets,
}
#: keyword -> field, of each field that is one flag, number, text or list of octets
_FIELDS: Final = {
    **{
        name: name
        for section in (Device, DpV1)
        for name, kind in section.__annotations__.items()
        if kind in _READERS and name not in _RENAMED.values()
    },
    **_RENAMED,
}
#: the keywords whose values are fields of Device or DpV1
FIELD_KEYWORDS: Final = frozenset(_FIELDS).union(
    (f"{rate}_supp" for rate in RATES),
    (f"maxtsdr_{rate}" for rate in RATES),
    (f"{alarm.lower()}_{ending}" for alarm in ALARM_KEYWORDS.values() for ending in ("supp", "required")),
)
_UNUSED_NUMBERS: Final = """
revision_number protocol_ident fms_supp redundancy repeater_ctrl_sig diag_update_delay alarm_type_mode_supp
dxb_subscribertable_block_location
tbase_dp tdp_min tdp_max t_pll_w_max tbase_io ti_min to_min
"""
#: keyword -> check of its value, of the keywords that dpstack checks and does not use
_CHECKED: Final[dict[str, Callable[[Settings, str], object]]] = {
    **dict.fromkeys(("24v_pins", "24v pins", *_UNUSED_NUMBERS.split()), Settings._int),
    **dict.fromkeys(("implementation_type", "info_text"), Settings._text),
    "slave_family": Settings._check_family,
}
#: keywords that dpstack neither uses nor checks
_OTHERS: Final = """
bitmap_device bitmap_diag bitmap_sf physical_layer user_prm_data_def alarm_supported
extra_alarm_sap_required im_0_supp max_iparameter_size area_name related_cfg_identifier io_direction length
consistency data_type publisher_allowed dp_master_allowed download_supp upload_supp act_para_brct_supp act_param_supp
max_mps_length max_lsdu_ms max_lsdu_mm min_poll_timeout las_len max_slaves_supp max_master_input_len
max_master_output_len max_master_data_len dpv1_master dpv1_conformance_class master_freeze_mode_supp
master_sync_mode_supp master_fail_safe_supp uart_family uart_family_supp slave_max_sapc0 dpv1_data_types
"""
#: the keywords of the GSD specification (PNO order 2.122), apart from those that only a block has
KEYWORDS: Final = FIELD_KEYWORDS.union(
    _CHECKED,
    _OTHERS.split(),
    (f"{t}_{rate}" for rate in RATES for t in ("trdy", "tqui", "tset", "tsdi", "transmission_delay")),
)


def contradictions(dpv1: DpV1) -> Iterator[tuple[str, str]]:
    """(keyword in lower case whose line is named, message) of each contradiction between the DP-V1 keywords.

    GSD specification (PNO order 2.122), DP extensions: a keyword that is left out means 0. ``..._supp`` is what a
    device can do, ``..._required`` what its master has to use, lengths and counts how much of it.
    """
    if not dpv1.slave and (dpv1.c1_read_write or dpv1.alarms):
        keyword = "c1_read_write_supp" if dpv1.c1_read_write else f"{dpv1.alarms[0].lower()}_supp"
        yield keyword, "without DPV1_Slave = 1: neither Read and Write nor alarms of class 1 are used"
    for name, supported, required, read_as in (
        ("C1_Read_Write", dpv1.c1_read_write, dpv1.c1_read_write_required, "read as a device without them"),
        ("C2_Read_Write", dpv1.c2_read_write, dpv1.c2_read_write_required, "read as a device without them"),
        *((a, a in dpv1.alarms, a in dpv1.required, "it is enabled all the same") for a in ALARM_KEYWORDS.values()),
    ):
        if required and not supported:
            yield f"{name.lower()}_required", f"{name}_required = 1 without {name}_supp = 1: {read_as}"
    for name, value, read_as in (
        ("C2_Max_Count_Channels", dpv1.c2_max_count_channels, "read as one connection"),
        ("C2_Max_Data_Len", dpv1.c2_max_data_len, "read as 240 octets"),
        ("C2_Response_Timeout", dpv1.c2_response_timeout, "the send time-out of a connection counts"),
    ):
        if dpv1.c2_read_write and not value:
            yield "c2_read_write_supp", f"C2_Read_Write_supp = 1 without {name}: {read_as}"
        elif not dpv1.c2_read_write and value and name != "C2_Response_Timeout":
            yield name.lower(), f"{name} = {value} without C2_Read_Write_supp = 1: read as no class 2 connections"
    if dpv1.c2_read_write and 0 < dpv1.max_initiate_pdu_length < _LEAST_INITIATE:
        text = f"Max_Initiate_PDU_Length = {dpv1.max_initiate_pdu_length}: an Initiate has {_LEAST_INITIATE} octets"
        yield "max_initiate_pdu_length", f"{text} at least; read as that"
