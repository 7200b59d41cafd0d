"""Keywords of the GSD specification (PNO order 2.122) in lower case: rates, alarms, and those that have no use here."""

from __future__ import annotations

from typing import Final

from dpstack.units import BAUD_RATES

#: baud rate in bit/s by the spelling in ``500_supp``, ``MaxTsdr_500``
_RATES: Final = "9.6 19.2 31.25 45.45 93.75 187.5 500 1.5m 3m 6m 12m"
RATES: Final[dict[str, int]] = dict(zip(_RATES.split(), BAUD_RATES, strict=True))

#: alarms of DP-V1 by their keyword (``Diagnostic_Alarm_supp``, ``Diagnostic_Alarm_required``)
ALARMS: Final = (
    "Diagnostic_Alarm",
    "Process_Alarm",
    "Pull_Plug_Alarm",
    "Status_Alarm",
    "Update_Alarm",
    "Manufacturer_Specific_Alarm",
)

#: opening keyword -> closing keyword, as files write it, of the blocks that dpstack only keeps
RAW_BLOCKS: Final[dict[str, str]] = {
    "data_area_beg": "Data_Area_End",
    "physical_interface": "End_Physical_Interface",
    "version_firmware_download": "end_version_firmware_download",
    "jokerblock_type": "endjokerblock_type",
}

_OTHERS: Final = """
bitmap_device bitmap_diag bitmap_sf physical_layer user_prm_data_def slave_family alarm_supported
extra_alarm_sap_required im_0_supp max_iparameter_size area_name related_cfg_identifier io_direction length
consistency data_type publisher_allowed dp_master_allowed download_supp upload_supp act_para_brct_supp act_param_supp
max_mps_length max_lsdu_ms max_lsdu_mm min_poll_timeout las_len max_slaves_supp max_master_input_len
max_master_output_len max_master_data_len dpv1_master dpv1_conformance_class master_freeze_mode_supp
master_sync_mode_supp master_fail_safe_supp uart_family uart_family_supp slave_max_sapc0 dpv1_data_types
"""
#: the keywords that neither a block (``handlers``) nor a field of the device (``settings.KEYWORDS``) has
OTHERS: Final = frozenset(_OTHERS.split()).union(
    (f"{rate}_supp" for rate in RATES),
    (f"{t}_{rate}" for rate in RATES for t in ("maxtsdr", "trdy", "tqui", "tset", "tsdi", "transmission_delay")),
    (f"{alarm.lower()}_{ending}" for alarm in ALARMS for ending in ("supp", "required")),
)


def may_open(keyword: str, endings: frozenset[str]) -> str | None:
    """The closing keyword that an unknown ``keyword`` has among the file's ``endings``; None where it has none."""
    for ending in (f"end{keyword}", f"end_{keyword}", f"{keyword}_end", f"{keyword.removesuffix('_beg')}_end"):
        if ending in endings:
            return ending
    return None
