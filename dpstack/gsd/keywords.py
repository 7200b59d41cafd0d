"""The keywords of the GSD specification (PNO order 2.122) in lower case, and which of them open and close blocks.

The parser keeps a keyword that is not listed as it stands and reports it. Nothing else depends on the list.
"""

from __future__ import annotations

from typing import Final

#: baud rate in bit/s by the spelling in ``500_supp``, ``MaxTsdr_500``
RATES: Final[dict[str, int]] = {
    "9.6": 9_600,
    "19.2": 19_200,
    "31.25": 31_250,
    "45.45": 45_450,
    "93.75": 93_750,
    "187.5": 187_500,
    "500": 500_000,
    "1.5m": 1_500_000,
    "3m": 3_000_000,
    "6m": 6_000_000,
    "12m": 12_000_000,
}

#: opening keyword -> closing keyword, as files write it, of the blocks that dpstack uses
BLOCKS: Final[dict[str, str]] = {
    "prmtext": "EndPrmText",
    "extuserprmdata": "EndExtUserPrmData",
    "module": "EndModule",
    "slotdefinition": "EndSlotDefinition",
    "unit_diag_area": "Unit_Diag_Area_End",
    "x_unit_diag_area": "X_Unit_Diag_Area_End",
    "unitdiagtype": "EndUnitDiagType",
}
#: the same of the blocks that are kept raw
RAW_BLOCKS: Final[dict[str, str]] = {
    "data_area_beg": "Data_Area_End",
    "physical_interface": "End_Physical_Interface",
    "version_firmware_download": "end_version_firmware_download",
    "jokerblock_type": "endjokerblock_type",
}
#: closing keyword in lower case -> as files write it
CLOSING: Final = {end.lower(): end for end in (*BLOCKS.values(), *RAW_BLOCKS.values())}

#: alarms of DP-V1 by their keyword (``Diagnostic_Alarm_supp``, ``Diagnostic_Alarm_required``)
ALARMS: Final = (
    "Diagnostic_Alarm",
    "Process_Alarm",
    "Pull_Plug_Alarm",
    "Status_Alarm",
    "Update_Alarm",
    "Manufacturer_Specific_Alarm",
)

_OTHERS: Final = """
gsd_revision vendor_name model_name revision revision_number ident_number protocol_ident station_type fms_supp
hardware_release software_release redundancy repeater_ctrl_sig 24v_pins implementation_type bitmap_device bitmap_diag
bitmap_sf physical_layer ordernumber info_text freeze_mode_supp sync_mode_supp auto_baud_supp set_slave_add_supp
user_prm_data_len user_prm_data user_prm_data_def min_slave_intervall min_slave_interval modular_station max_module
max_input_len max_output_len max_data_len fail_safe fail_safe_required diag_update_delay max_diag_data_len modul_offset
module_offset slave_family max_user_prm_data_len ext_module_prm_data_len ext_user_prm_data_ref
ext_user_prm_data_const fixpresetmodules preset prm_text_ref prmtextref text changeable visible slot value value_help
x_value x_value_help unit_diag_bit unit_diag_bit_help unit_diag_not_bit unit_diag_not_bit_help x_unit_diag_bit
x_unit_diag_bit_help x_unit_diag_not_bit x_unit_diag_not_bit_help channel_diag channel_diag_help x_channel_diag
x_channel_diag_help dpv1_slave c1_read_write_supp c2_read_write_supp c1_max_data_len c2_max_data_len
c1_response_timeout c2_response_timeout c1_read_write_required c2_read_write_required c2_max_count_channels
max_initiate_pdu_length alarm_supported extra_alarm_sap_supp extra_alarm_sap_required alarm_sequence_mode_count
alarm_type_mode_supp wd_base_1ms_supp check_cfg_mode prm_block_structure_supp prm_block_structure_req
ident_maintenance_supp im_0_supp publisher_supp subscriber_supp isochron_mode_supp isochron_mode_required
dxb_max_link_count dxb_max_data_length dxb_subscribertable_block_location tbase_dp tdp_min tdp_max t_pll_w_max
tbase_io ti_min to_min max_iparameter_size unsigned8 unsigned16 unsigned32 signed8 signed16 signed32 bit bitarea
area_name related_cfg_identifier io_direction length consistency data_type publisher_allowed dp_master_allowed
download_supp upload_supp act_para_brct_supp act_param_supp max_mps_length max_lsdu_ms max_lsdu_mm min_poll_timeout
las_len max_slaves_supp max_master_input_len max_master_output_len max_master_data_len dpv1_master
dpv1_conformance_class master_freeze_mode_supp master_sync_mode_supp master_fail_safe_supp
uart_family uart_family_supp slave_max_sapc0 dpv1_data_types
"""

#: spellings that several makers use
_SPELLINGS: Final = ("24v pins", "unit_diag_!bit", "unit_diag_!bit_help")

KNOWN: Final = frozenset(_OTHERS.split()).union(
    _SPELLINGS,
    BLOCKS,
    RAW_BLOCKS,
    CLOSING,
    *(
        (f"{rate}_supp", *(f"{t}_{rate}" for t in ("maxtsdr", "trdy", "tqui", "tset", "tsdi", "transmission_delay")))
        for rate in RATES
    ),
    *((f"{alarm.lower()}_supp", f"{alarm.lower()}_required") for alarm in ALARMS),
)


def may_open(keyword: str, endings: frozenset[str]) -> str | None:
    """The closing keyword that an unknown ``keyword`` has among the file's ``endings``; None where it has none."""
    for ending in (f"end{keyword}", f"end_{keyword}", f"{keyword}_end", f"{keyword.removesuffix('_beg')}_end"):
        if ending in endings:
            return ending
    return None
