"""The promises of docs/explanation/security.md and the tests that show them. Run this file to run all of them:
``--list`` prints them, other arguments go to pytest."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
PAGE: Final = ROOT / "docs" / "explanation" / "security.md"
_PROMISE: Final = re.compile(r"^- \*\*([A-Z]\d+)\*\* (.+?)(?=^- |^$)", re.MULTILINE | re.DOTALL)

_CONTROL: Final = "api/control/test_control.py::"
_TRUST: Final = "api/control/test_control_trust.py::"
_RIGHTS: Final = "web/test_web_rights.py::"
_SERVER: Final = "web/test_web_server.py::"
_OPCUA: Final = "bridge_opcua/test_opcua_connector.py::"
_FLEET: Final = "bridge_mqtt/"
_JSON: Final = "bridge_mqtt/test_json_node.py::"
_EPICS: Final = "bridge_epics/test_epics_connector.py::"
_HOUSE: Final = "bridge_mqtt/test_home_assistant.py::"
_IMPORT: Final = "cli/looking/test_import_command.py::"
_LOSS: Final = "bridge/test_connector_loss.py::"
_CODE: Final = "security/test_no_code.py::"
#: for each promise the tests that show it, below tests/
PROMISES: Final[dict[str, tuple[str, ...]]] = {
    "W1": (
        "fdl/active/test_active_fuzz.py::test_anything_settles_and_comes_back",
        "fdl/test_decoder.py::test_garbage_never_raises_and_every_octet_is_accounted_for",
        "dpv1/master/test_corrupt_slave.py::test_any_octets_from_a_slave",
        "drives/test_attacked_devices.py::test_any_octets_to_any_sap",
    ),
    "W2": (
        "fdl/test_residual_errors.py::test_damage_to_one_octet_gives_no_wrong_data",
        "fdl/test_residual_errors.py::test_errors_of_four_bits_pass_as_often_as_computed",
    ),
    "W3": ("dp/slave/test_slave_octet_master.py::test_requests_of_another_master_change_nothing",),
    "W4": ("dp/master/test_master_faults.py::test_slave_of_another_master_is_never_parameterised",),
    "W5": (
        "test_events.py::test_a_slave_that_deviates_in_another_way_each_time_fills_no_log",
        "drives/test_attacked_devices.py::test_garbage_of_one_master_fills_no_log",
        "ports/test_open_port.py::test_a_backlog_is_handed_over_up_to_its_bound_and_the_rest_counted",
    ),
    "W6": ("ports/test_listening_port.py::test_it_is_opened_for_reading_only_and_writes_nothing",),
    "W7": (
        "security/test_read_only_octets.py::test_no_call_and_no_order_of_a_read_only_bus_sends_anything_that_writes",
        "security/test_read_only_octets.py::test_the_judge_of_octets_knows_writes",
        "api/bus/test_both_drivers.py::test_a_read_only_bus",
    ),
    "W8": (
        "profile/channel/test_stored_writes.py::test_a_hundred_writes_at_once_then_one_a_minute",
        "profile/channel/test_stored_writes.py::test_each_drive_spares_its_eeprom",
    ),
    "W9": (
        "api/bus/test_refuse_master.py::test_a_bus_with_it_is_refused_with_file_and_reason",
        "api/bus/test_refuse_master.py::test_it_is_not_added_to_a_running_bus",
        "api/bus/test_refuse_master.py::test_a_read_only_bus_takes_it_and_never_parameterises_it",
        _IMPORT + "test_run_drive_and_acyclic_refuse_slaves_with_f_modules",
    ),
    "W10": (
        "api/fdl/test_fdl_beside_dp.py::test_nobody_works_behind_the_masters_back",
        "api/fdl/test_fdl_beside_dp.py::test_a_slave_added_later_is_the_masters_too",
        "cli/link/test_fdl_command.py::test_wrong_use",
    ),
    "P1": ("security/test_listeners.py::test_no_command_listens_on_a_network",),
    "P2": (
        "security/test_listeners.py::test_the_page_listens_on_this_computer_alone",
        "web/test_web_runs.py::test_the_web_server_opens_no_port_and_only_this_computer_reaches_it",
    ),
    "P3": (
        "web/test_web_processes.py::test_nothing_else_listens_on_a_network",
        _CODE + "test_the_places_in_the_source",
    ),
    "P4": (_CONTROL + "test_the_socket_is_the_users_alone_and_goes_with_the_program",),
    "P5": (
        _TRUST + "test_a_directory_that_another_user_has_planted_in_the_temporary_directory",
        _TRUST + "test_a_runtime_directory_of_another_user",
        _TRUST + "test_a_directory_of_ours_that_others_can_write_to",
        _TRUST + "test_a_directory_on_the_way_that_others_can_write_to",
        _TRUST + "test_links_on_the_way",
        _TRUST + "test_the_directory_itself_is_no_link",
    ),
    "P6": (
        "security/test_other_account.py::test_another_account_reaches_nothing",
        "security/test_other_account.py::test_shared_memory_is_for_its_user_alone",
    ),
    "P7": (
        _TRUST + "test_an_order_of_another_user_is_refused",
        _TRUST + "test_a_program_of_another_user_behind_our_socket_is_told_nothing",
        _TRUST + "test_a_socket_of_another_user_in_our_directory",
    ),
    "P8": (
        "security/test_other_account.py::test_shared_memory_is_for_its_user_alone",
        "security/test_listeners.py::test_no_command_listens_on_a_network",
    ),
    "P9": (
        "drivers/process/test_messages.py::test_any_octets_in_a_frame",
        "drivers/process/test_messages.py::test_garbage_is_an_error_of_the_bus",
        _CODE + "test_the_places_in_the_source",
    ),
    "P10": (
        _CONTROL + "test_a_line_without_end_is_cut",
        _CONTROL + "test_the_seventeenth_client_pushes_out_the_one_that_was_idle_longest",
        _CONTROL + "test_a_client_that_asks_nothing_for_long_is_told_and_dropped",
        _CONTROL + "test_a_client_that_does_not_read_is_dropped_and_the_others_are_served",
    ),
    "P11": (_CONTROL + "test_a_defect_is_told_and_survived", "api/control/test_control_json.py::test_any_request"),
    "B1": (
        "web/test_web_orders.py::test_no_order_without_confirmation_or_without_rights",
        _RIGHTS + "test_tokens_without_control_only_look",
        _RIGHTS + "test_the_secret_of_a_start_gives_orders_and_without_it_one_may_look",
    ),
    "B2": (_RIGHTS + "test_an_address_of_others_needs_tokens_and_with_control_tls", _RIGHTS + "test_a_page_over_tls"),
    "B3": (
        _RIGHTS + "test_a_wrong_file_of_tokens_is_one_line_without_a_token",
        _RIGHTS + "test_a_file_of_tokens_that_cannot_be_read",
        _RIGHTS + "test_a_token_gives_its_name_and_a_wrong_one_nothing",
        "web/test_web_orders.py::test_a_defect_ends_no_page_and_tells_no_secret",
    ),
    "B4": (_SERVER + "test_a_websocket_of_another_page_is_refused", _RIGHTS + "test_hosts_and_origins"),
    "B5": (_SERVER + "test_a_request_for_another_host_is_refused", _RIGHTS + "test_hosts_and_origins"),
    "B6": (_SERVER + "test_files_have_strict_headers_and_nothing_else_is_served",),
    "B7": (
        _RIGHTS + "test_wrong_tokens_of_one_address_wait_for_one_another",
        _RIGHTS + "test_the_addresses_of_one_computer_wait_together",
        _RIGHTS + "test_tokens_of_one_network_do_not_pile_up",
        _RIGHTS + "test_addresses_of_wrong_tokens_are_bounded",
    ),
    "B8": (
        _SERVER + "test_connections_without_a_request_are_closed_and_their_number_is_bounded",
        _RIGHTS + "test_connections_without_a_handshake_are_closed_and_their_number_is_bounded",
        _RIGHTS + "test_one_network_does_not_take_all_places_before_hello",
    ),
    "B9": (
        "web/test_web_pages.py::test_a_page_may_err_twenty_times_and_others_do_not_notice",
        "web/test_web_pages.py::test_wrong_frames_end_their_own_connection_only",
        "web/test_web_orders.py::test_requests_under_way_are_bounded_and_end_with_their_page",
        "web/test_web_orders.py::test_a_page_that_asks_too_often_is_told_and_goes_on",
        "web/test_web_pages.py::test_a_page_that_never_reads_is_disconnected_and_disturbs_no_other",
    ),
    "B10": ("web/test_web_orders.py::test_other_commands_of_the_control_socket_are_no_orders_and_no_asks",),
    "B11": ("api/commissioning/test_commissioning.py::test_nothing_outside_the_folder_is_read",),
    "B12": ("web/test_web_runs.py::test_another_run_on_the_port_gets_no_order_of_this_page",),
    "B13": (
        "web/test_web_runs.py::test_the_web_server_opens_no_port_and_only_this_computer_reaches_it",
        "web/test_web_runs.py::test_a_run_that_the_server_started_ends_with_it_and_a_joined_one_goes_on",
    ),
    "G1": (
        "bridge/test_orders.py::test_only_what_is_listed_is_carried_out",
        "bridge/test_orders.py::test_a_run_that_only_reads_refuses_all",
        "bridge/test_publishing.py::test_what_cannot_begin_is_an_error_before_anything_is_sent",
    ),
    "G2": (
        "bridge/test_orders.py::test_the_age_is_judged_when_it_comes_and_when_its_turn_has_come",
        "bridge/test_orders.py::test_no_order_is_carried_out_twice",
        "bridge/test_orders.py::test_an_absent_slave_gets_no_order_but_a_stop",
        "bridge/test_orders.py::test_a_stop_waits_for_nobody_and_nothing_that_waits_comes_after_it",
    ),
    "G3": (
        "bridge/test_orders.py::test_types_and_ranges_are_judged_by_plant_and_run",
        "bridge/test_orders.py::test_orders_that_wait_are_bounded_and_one_slave_holds_up_no_other",
        "bridge/test_publishing.py::test_values_go_out_and_orders_come_back",
    ),
    "G4": (
        "bridge/test_publishing.py::test_outputs_keep_their_safe_end_whatever_a_connector_does",
        "bridge/test_gateway.py::test_connectors_that_fail_in_every_way_end_alone",
        "bridge/test_gateway.py::test_a_connector_that_never_ends_is_left",
    ),
    "G5": ("cli/commands/test_what_commands_load.py::test_a_run_loads_what_it_uses",),
    "G6": (
        "bridge_metrics/test_metrics_server.py::test_a_request_that_is_none_is_refused_and_the_next_is_served",
        "bridge_metrics/test_metrics_server.py::test_an_address_that_others_reach_is_told_and_takes_every_host",
        "bridge_metrics/test_metrics_values.py::test_the_table_of_the_configuration",
    ),
    "G7": (
        "bridge_metrics/test_metrics_server.py::test_a_request_that_is_none_is_refused_and_the_next_is_served",
        "bridge_metrics/test_metrics_server.py::test_silent_clients_lose_their_place_and_a_thousand_are_bounded",
    ),
    "G8": (
        "bridge_metrics/test_metrics_values.py::test_hostile_and_equal_names_become_labels_that_are_different",
        "bridge_metrics/test_metrics_values.py::test_causes_and_classes_of_a_hostile_stream_are_bounded",
    ),
    "G9": (
        _OPCUA + "test_wrong_passwords_certificates_and_channels_are_refused",
        _OPCUA + "test_orders_need_the_list_the_user_and_the_type",
    ),
    "G10": (
        _OPCUA + "test_orders_need_the_list_the_user_and_the_type",
        "bridge_opcua/test_opcua_users.py::test_wrong_passwords_wait_longer_and_longer",
    ),
    "G11": (
        _OPCUA + "test_a_slave_that_is_lost_leaves_its_last_value_and_an_alarm_until_it_is_acknowledged",
        _OPCUA + "test_a_client_that_reads_nothing_holds_little",
        _OPCUA + "test_garbage_ends_its_connection_alone",
        _OPCUA + "test_a_request_for_much_gets_little",
        _OPCUA + "test_a_session_reaches_nothing_of_others_and_is_one_of_its_connection",
        "bridge_opcua/test_hostile_clients.py::test_a_length_or_depth_that_is_believed_costs_little",
        "bridge_opcua/test_hostile_clients.py::test_a_hostile_request_ends_its_connection_alone",
        "bridge_opcua/test_hostile_clients.py::test_a_client_that_does_not_read_is_cut_off_also_by_a_message_that_it_did_not_ask_for",
    ),
    "G12": (
        _OPCUA + "test_wrong_passwords_certificates_and_channels_are_refused",
        "bridge_opcua/test_opcua_users.py::test_a_file_that_others_can_read_or_that_has_no_user_is_refused",
    ),
    "G13": (
        _FLEET + "test_fleet.py::test_it_publishes_nothing_and_comes_back",
        _FLEET + "test_fleet.py::test_bounds",
        _FLEET + "test_fleet.py::test_no_message_raises_and_an_old_status_is_never_shown_as_alive",
        _FLEET + "test_fleet.py::test_an_end_that_is_told_after_a_death_hides_no_death",
        _FLEET + "test_fleet.py::test_a_kept_status_without_expiry_is_as_old_as_it_says_where_the_clocks_agree",
        _FLEET + "test_fleet.py::test_after_a_sleep_of_the_computer_an_old_status_is_silent",
        _FLEET + "test_segment_status.py::test_texts_are_printable",
    ),
    "G14": (
        "bridge_mqtt/test_history_file.py::test_others_cannot_read_it_whatever_the_umask",
        "bridge_mqtt/test_history_file.py::test_a_folder_or_file_that_cannot_be_used_is_told",
        "bridge_mqtt/test_history_file.py::test_the_oldest_go_first_and_the_file_keeps_its_limit",
        "bridge_mqtt/test_history_keeper.py::test_a_full_disk_is_told_once_and_what_memory_holds_comes_later",
        "bridge_mqtt/test_history_keeper.py::test_a_slow_disk_delays_nobody_and_the_end_takes_no_longer_than_its_limit",
    ),
    "G15": (
        _JSON + "test_what_is_kept_or_not_listed_is_refused",
        _JSON + "test_an_order_that_cannot_be_is_refused_with_its_reason",
        _JSON + "test_an_order_that_is_listed",
        _JSON + "test_a_flood_of_orders_is_bounded_and_values_do_not_wait_for_it",
        _JSON + "test_garbage_is_no_order",
        "bridge/test_orders.py::test_an_absent_slave_gets_no_order_but_a_stop",
        "bridge/test_orders.py::test_the_age_is_judged_when_it_comes_and_when_its_turn_has_come",
    ),
    "G16": (
        _FLEET + "test_mqtt_broker.py::test_no_secret_is_published_and_a_will_has_the_number_of_its_session",
        _FLEET + "test_mqtt_broker.py::test_an_address_that_is_none_is_refused_and_no_text_holds_a_password",
        _FLEET + "test_mqtt_broker.py::test_passwords_come_from_the_environment_or_from_a_file_of_ones_own",
    ),
    "G17": (
        _LOSS + "test_what_a_connector_ordered_becomes_safe_when_it_ends_by_a_fault",
        _LOSS + "test_the_connectors_hang",
        _LOSS + "test_drives_that_were_moved_from_outside_stop",
        _LOSS + "test_a_bus_process_goes_to_clear_while_the_program_hangs",
        "bridge/test_orders.py::test_the_age_is_judged_when_it_comes_and_when_its_turn_has_come",
    ),
    "G18": (
        "bridge/test_connector_tables.py::test_epics_is_for_this_computer_without_listen",
        _EPICS + "test_beacons_go_where_the_user_says_and_else_to_this_computer_alone",
    ),
    "G19": (
        _EPICS + "test_puts_give_typed_orders_and_a_read_behind_one_sees_its_value",
        _EPICS + "test_a_refused_put_is_an_error_with_its_reason_and_is_reported",
        _EPICS + "test_a_run_that_only_reads_gives_no_rights",
    ),
    "G20": (
        _EPICS + "test_a_client_that_does_not_read_holds_up_nobody_and_is_cut_off",
        _EPICS + "test_octets_that_are_no_message_end_their_connection_alone",
        _EPICS + "test_one_address_has_a_bounded_number_of_connections",
        _EPICS + "test_variables_that_nobody_uses_make_room_for_others",
    ),
    "G21": (
        _EPICS + "test_alarms_follow_quality_and_states_and_a_number_stays_beside_its_alarm",
        _EPICS + "test_the_end_of_the_bus_is_invalid_and_then_the_connection_ends",
        _EPICS + "test_a_fault_of_the_connector_ends_all_connections",
        _EPICS + "test_a_slave_that_is_removed_ends_its_channels_alone",
    ),
    "G22": (
        _HOUSE + "test_without_allow_commands_nothing_can_be_ordered",
        _HOUSE + "test_orders_that_are_listed_have_the_time_and_are_not_retained",
        _HOUSE + "test_no_name_ends_the_literal_in_a_template",
        _HOUSE + "test_messages_of_earlier_runs_are_taken_away_and_no_others",
        _HOUSE + "test_more_entities_than_there_is_room_for_are_reported",
        _HOUSE + "test_home_assistant_that_begins_gets_all_messages_again_at_most_every_10_s",
    ),
    "A1": (
        "cli/assistants/test_assistant_fence.py::test_only_reading_within_the_folders_the_port_and_control_sockets_are_left",
        "cli/assistants/test_assistant_tools.py::test_the_run_is_asked_for_what_it_knows_and_for_nothing_else",
        "api/control/test_unasked.py::test_the_wire_is_the_same_with_and_without_the_questions",
    ),
    "A2": (
        "cli/assistants/test_assistant_folders.py::test_what_is_refused_in_one_line",
        "cli/assistants/test_assistant_folders.py::test_any_name_gives_a_file_within_or_an_error",
        "cli/assistants/test_assistant_tools.py::test_a_part_of_a_recording_that_leads_out_is_refused",
    ),
    "A3": (
        "cli/assistants/test_assistant_tools.py::test_texts_of_others_stand_in_foreign_only",
        "cli/assistants/test_assistant_tools.py::test_every_string_of_every_schema_is_foreign_or_of_a_fixed_form",
    ),
    "A4": (
        "cli/assistants/test_assistant_tools.py::test_a_large_file_and_a_slow_one_are_bounded",
        "cli/assistants/test_assistant_tools.py::test_an_answer_that_does_not_fit_its_type_is_not_sent",
        "cli/assistants/test_assistant_tools.py::test_decode_pages",
    ),
    "F1": (
        _CODE + "test_crafted_files_run_nothing_and_lead_nowhere",
        "api/slave_side/test_inputs_over_time.py::test_code_needs_a_word_for_it",
    ),
    "F2": (_CODE + "test_the_places_in_the_source",),
    "F3": (_CODE + "test_the_places_in_the_source",),
    "F4": (
        _CODE + "test_crafted_files_run_nothing_and_lead_nowhere",
        "profile/test_registry.py::test_names_that_are_not_there",
    ),
    "F5": (_CODE + "test_matplotlib_reads_no_settings_of_the_working_directory",),
    "F6": (
        "cli/test_files.py::test_a_path_that_is_no_ordinary_file_is_refused_at_once",
        "cli/test_files.py::test_a_pipe_in_place_of_the_file_that_was_looked_at",
        "cli/test_files.py::test_one_octet_more_than_the_limit_is_read",
        "api/config/test_toml_limits.py::test_a_file_that_is_too_long",
    ),
    "F7": (
        "api/config/test_toml_limits.py::test_twice_the_text_takes_twice_the_steps",
        "gsd/test_hostile.py::test_work_grows_with_the_size_only",
        "capture/test_pcapng.py::test_a_length_that_lies_is_no_reason_to_keep_octets",
    ),
    "F8": (
        "api/config/test_toml_limits.py::test_any_text_is_read_or_refused",
        "gsd/test_hostile.py::test_any_octets",
        "capture/test_pcapng.py::test_any_octets_end_with_a_line_or_an_end",
        "capture/test_waveforms.py::test_a_bad_file_gets_one_line_that_says_what_to_do",
        "decode/test_log_text.py::test_any_lines_end_in_octets_or_a_report",
        "record/test_recordings_read.py::test_files_that_are_no_recordings",
    ),
    "F9": (
        "cli/test_files.py::test_a_new_file_is_never_written_over",
        "cli/test_files.py::test_a_link_laid_beforehand_is_not_followed",
        "cli/test_files.py::test_dump_replaces_its_own_file_only",
        "api/listen/test_capture_file.py::test_only_an_empty_file_is_taken",
        "api/recording/test_record_files.py::test_an_existing_file_stays",
        "cli/test_files.py::test_a_link_to_a_file_that_stays_open_is_not_followed",
        "cli/test_files.py::test_a_file_has_one_writer",
        "api/recording/test_record_files.py::test_a_log_goes_on_only_in_a_log",
        "api/lists/test_parameter_list.py::test_a_link_is_not_followed",
    ),
    "F10": (
        "test_text.py::test_any_text",
        "test_text.py::test_errors_are_printable_wherever_they_are_shown",
        "test_text.py::test_events_are_printable_and_their_fields_are_as_they_came",
        "cli/terminal/test_hostile_text.py::test_a_gsd_file_for_people",
        "cli/terminal/test_hostile_text.py::test_comments_of_a_capture",
        "cli/terminal/test_hostile_text.py::test_answers_of_another_program",
        "cli/terminal/test_hostile_text.py::test_every_command_is_in_the_list",
        _SERVER + "test_octets_of_strangers_reach_no_terminal",
    ),
    "F11": ("api/recording/test_record_files.py::test_the_lines_of_a_log", "test_text.py::test_shown_to_people"),
    "F12": ("monitor/test_acceptance_report.py::test_foreign_text_is_text_and_nothing_else",),
    "F13": (
        "devices/test_bad_files.py::test_a_device_file_names_no_code_but_what_a_package_has_registered",
        "devices/test_bad_files.py::test_a_configuration_names_no_code_by_a_device_file",
    ),
    "F14": (
        "devices/test_bad_files.py::test_contents_that_are_no_text",
        "devices/test_bad_files.py::test_a_pipe_is_not_opened",
        "devices/test_bad_files.py::test_a_chain_of_bases_has_an_end",
        "devices/test_bad_files.py::test_a_mistake_has_its_line_and_a_remedy",
    ),
    "F15": (
        _CODE + "test_crafted_files_run_nothing_and_lead_nowhere",
        _IMPORT + "test_into_a_new_file_with_remarks_on_standard_error",
        _IMPORT + "test_what_is_no_export_is_one_line",
        _IMPORT + "test_a_file_that_was_cut_is_imported_and_ends_with_1",
        _IMPORT + "test_500_slaves",
        "importers/test_step7_cfg.py::test_another_code_page_is_given_by_hand",
    ),
    "F16": (
        "importers/test_step7_plant.py::test_the_bus_as_in_the_export_and_read_only",
        "importers/test_step7_plant.py::test_the_address_is_one_that_no_station_has_and_that_the_masters_look_for",
        "cli/terminal/test_hostile_text.py::test_texts_of_an_export",
    ),
    "E1": (
        "profile/test_registry.py::test_known_drives_in_spite_of_broken_packages",
        "profile/test_registry.py::test_the_entry_points_of_this_project_load",
        "cli/devices/test_device_show.py::test_a_file_with_mistakes_is_listed_with_the_reason",
    ),
    "E2": (
        "api/bus/test_bus.py::test_a_plugin_that_raises_stops_its_drive_only",
        "api/slave_side/test_inputs_over_time.py::test_an_ill_function_is_told_once_and_the_last_inputs_stay",
    ),
    "E3": (_CODE + "test_children_take_no_modules_of_the_working_directory",),
    "E4": (
        "cli/commands/test_doctor.py::test_fix_prints_the_steps_and_changes_nothing",
        "cli/commands/test_doctor.py::test_the_set_up_script_says_what_it_would_do",
    ),
    "E5": ("cli/listening/test_wireshark.py::test_files_of_others_are_left",),
    "E6": ("web/test_web_processes.py::test_a_killed_web_server_leaves_no_run_behind",),
}


def promises() -> dict[str, str]:
    """The promises of the page by their number."""
    found = _PROMISE.findall(PAGE.read_text(encoding="utf-8") + "\n\n")
    return {number: " ".join(text.split()) for number, text in found}


def main(arguments: list[str]) -> int:
    if arguments == ["--list"]:
        for number, text in promises().items():
            print(f"{number:4}{text}")
            print("".join(f"        tests/{test}\n" for test in PROMISES[number]), end="")
        return 0
    tests = dict.fromkeys(f"tests/{test}" for of_one in PROMISES.values() for test in of_one)
    command = [sys.executable, "-m", "pytest", "-m", "soak or not soak", *tests, *arguments]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
