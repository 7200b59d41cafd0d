"""From the settings of a file (``keyword = value``) to the fields of a device, each value judged once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dpstack.gsd.dpv1_check import oddities
from dpstack.gsd.findings import Findings
from dpstack.gsd.keywords import ALARMS, RATES
from dpstack.gsd.lexer import Statement, first_number, number, string
from dpstack.gsd.model import DpV1, Isochronous, Speed
from dpstack.gsd.module_block import octets_of

#: field of Device -> (keywords, lowest, highest value)
_INTS: Final[dict[str, tuple[tuple[str, ...], int, int]]] = {
    "ident": (("ident_number",), 0, 0xFFFF),
    "gsd_revision": (("gsd_revision",), 0, 255),
    "revision_number": (("revision_number",), 0, 255),
    "protocol_ident": (("protocol_ident",), 0, 255),
    "station_type": (("station_type",), 0, 255),
    "min_slave_interval": (("min_slave_intervall", "min_slave_interval"), 0, 0xFFFF),
    "max_module": (("max_module",), 0, 255),
    "modul_offset": (("modul_offset", "module_offset"), 0, 255),
    "max_input_len": (("max_input_len",), 0, 244),
    "max_output_len": (("max_output_len",), 0, 244),
    "max_data_len": (("max_data_len",), 0, 488),
    "max_diag_data_len": (("max_diag_data_len",), 6, 244),
    "diag_update_delay": (("diag_update_delay",), 0, 255),
    "max_user_prm_data_len": (("max_user_prm_data_len",), 0, 237),
    "user_prm_data_len": (("user_prm_data_len",), 0, 237),
}
_NUMBERS: Final = {"repeater_ctrl_sig": ("repeater_ctrl_sig",), "pins_24v": ("24v_pins", "24v pins")}
#: what Repeater_Ctrl_Sig and 24V_Pins are in files that write a text (``"M24V"``)
_WORDS: Final = {"not used": 0, "not connected": 0, "rs485": 1, "input": 1, "m24v": 1, "ttl": 2, "output": 2, "p24v": 2}
_FLAGS: Final = {
    "fms": "fms_supp",
    "freeze": "freeze_mode_supp",
    "sync": "sync_mode_supp",
    "auto_baud": "auto_baud_supp",
    "set_slave_add": "set_slave_add_supp",
    "fail_safe": "fail_safe",
    "redundancy": "redundancy",
    "modular": "modular_station",
    "fix_preset_modules": "fixpresetmodules",
}
_TEXTS: Final = {
    "vendor": "vendor_name",
    "model": "model_name",
    "revision": "revision",
    "hardware_release": "hardware_release",
    "software_release": "software_release",
    "implementation_type": "implementation_type",
    "order_number": "ordernumber",
    "info": "info_text",
}
_V1_FLAGS: Final = {
    "slave": "dpv1_slave",
    "c1_read_write": "c1_read_write_supp",
    "c1_read_write_required": "c1_read_write_required",
    "c2_read_write": "c2_read_write_supp",
    "c2_read_write_required": "c2_read_write_required",
    "extra_alarm_sap": "extra_alarm_sap_supp",
    "alarm_type_mode": "alarm_type_mode_supp",
    "wd_base_1ms": "wd_base_1ms_supp",
    "check_cfg_mode": "check_cfg_mode",
    "fail_safe_required": "fail_safe_required",
    "prm_block_structure": "prm_block_structure_supp",
    "prm_block_structure_required": "prm_block_structure_req",
    "ident_maintenance": "ident_maintenance_supp",
}
#: keyword -> highest value
_V1_INTS: Final = {
    "c1_max_data_len": 240,
    "c1_response_timeout": 0xFFFF,
    "c2_max_data_len": 240,
    "c2_response_timeout": 0xFFFF,
    "c2_max_count_channels": 49,
    "max_initiate_pdu_length": 244,
    "alarm_sequence_mode_count": 32,
}
_ISO_FLAGS: Final = {
    "supported": "isochron_mode_supp",
    "required": "isochron_mode_required",
    "publisher": "publisher_supp",
    "subscriber": "subscriber_supp",
}
_ISO_INTS: Final = (
    "dxb_max_link_count",
    "dxb_max_data_length",
    "dxb_subscribertable_block_location",
    "tbase_dp",
    "tdp_min",
    "tdp_max",
    "t_pll_w_max",
    "tbase_io",
    "ti_min",
    "to_min",
)
_MOST: Final = 0xFFFF_FFFF


class Settings:
    """Typed access to the settings of one file; what cannot be read is told, with its place, and left out."""

    def __init__(self, settings: Mapping[str, tuple[Statement, int]], findings: Findings) -> None:
        self._settings = settings
        self._findings = findings

    def device_fields(self) -> dict[str, Any]:
        """Arguments for a Device. Fields without a keyword in the file keep their defaults."""
        fields: dict[str, Any] = {}
        for field, (keywords, low, high) in _INTS.items():
            for keyword in keywords:
                self._into(fields, field, self._int(keyword, low, high))
        for field, keywords in _NUMBERS.items():
            for keyword in keywords:
                self._into(fields, field, self._word(keyword))
        for field, keyword in _FLAGS.items():
            self._into(fields, field, self._flag(keyword))
        for field, keyword in _TEXTS.items():
            self._into(fields, field, self._text(keyword))
        self._into(fields, "user_prm_data", self._octets("user_prm_data"))
        fields["speeds"] = self._speeds()
        fields["dpv1"] = self._dpv1()
        fields["isochronous"] = self._isochronous()
        fields |= self._family()
        return fields

    def line(self, keyword: str) -> int:
        """Where ``keyword`` stands, 0 when it does not."""
        found = self._settings.get(keyword)
        return found[1] if found else 0

    @staticmethod
    def _into(fields: dict[str, Any], field: str, value: object) -> None:
        if value is not None:
            fields[field] = value

    def _int(self, keyword: str, low: int = 0, high: int = _MOST) -> int | None:
        found = self._settings.get(keyword)
        if found is None:
            return None
        statement, line = found
        value, rest = first_number(statement.value)
        if value is None or rest:
            text, _, _ = string(statement.value)
            value = number(text) if text else None
        if value is None:
            self._wrong(keyword, "is no number; left out")
        elif not low <= value <= high:
            self._findings.warning(line, statement.column, f"{statement.written} = {value} is outside {low}..{high}")
        return value

    def _flag(self, keyword: str) -> bool | None:
        value = self._int(keyword)
        return None if value is None else value != 0

    def _word(self, keyword: str) -> int | None:
        found = self._settings.get(keyword)
        text = string(found[0].value)[0] if found else None
        if text is not None and text.strip().lower() in _WORDS:
            return _WORDS[text.strip().lower()]
        return self._int(keyword)

    def _text(self, keyword: str) -> str | None:
        found = self._settings.get(keyword)
        if found is None:
            return None
        statement, line = found
        text, rest, closed = string(statement.value)
        if text is None:
            return statement.value
        if not closed:
            self._findings.warning(line, statement.column, f"{statement.written}: the text has no closing quote")
        elif rest:
            self._findings.info(line, statement.column, f"{statement.written}: {rest!r} behind the text is not used")
        return text.strip()

    def _octets(self, keyword: str) -> bytes | None:
        found = self._settings.get(keyword)
        if found is None:
            return None
        octets = octets_of(found[0].value)
        if octets is None:
            self._wrong(keyword, "is no list of octets; left out")
        return octets

    def _wrong(self, keyword: str, what: str) -> None:
        statement, line = self._settings[keyword]
        self._findings.warning(line, statement.column, f"{statement.written} = {statement.value[:40]} {what}")

    def _speeds(self) -> tuple[Speed, ...]:
        return tuple(
            Speed(baud, self._int(f"maxtsdr_{key}", 0, 65_535))
            for key, baud in RATES.items()
            if self._flag(f"{key}_supp")
        )

    def _dpv1(self) -> DpV1:
        fields: dict[str, Any] = {}
        for field, keyword in _V1_FLAGS.items():
            self._into(fields, field, self._flag(keyword))
        for keyword, highest in _V1_INTS.items():
            self._into(fields, keyword, self._int(keyword, 0, highest))
        for field, ending in (("alarms", "supp"), ("required", "required")):
            fields[field] = tuple(alarm for alarm in ALARMS if self._flag(f"{alarm.lower()}_{ending}"))
        dpv1 = DpV1(**fields)
        for keyword, text in oddities(dpv1):
            if keyword in self._settings:
                statement, line = self._settings[keyword]
                self._findings.warning(line, statement.column, text)
        return dpv1

    def _isochronous(self) -> Isochronous:
        fields: dict[str, Any] = {}
        for field, keyword in _ISO_FLAGS.items():
            self._into(fields, field, self._flag(keyword))
        for keyword in _ISO_INTS:
            self._into(fields, keyword, self._int(keyword))
        return Isochronous(**fields)

    def _family(self) -> dict[str, Any]:
        """``Slave_Family = 3@group@subgroup``."""
        found = self._settings.get("slave_family")
        if found is None:
            return {}
        main, *path = found[0].value.strip('"').split("@")
        value = number(main)
        if value is None:
            self._wrong("slave_family", "begins with no number; only its path is kept")
        return {"slave_family": value, "slave_family_path": tuple(part.strip() for part in path if part.strip())}
