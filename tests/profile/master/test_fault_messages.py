"""Faults and warnings by number: words of the telegram, parameters over PKW and over record 47, texts and patterns.

944 counts changes of the fault buffer, 945 and 947 have codes and numbers of the present faults from element 0 on
(PROFIdrive); 2122 has the present warnings of SINAMICS.
"""

from __future__ import annotations

import pytest
from drive_bench import PluginBench
from profidrive_kit import DRIVE, NO_REPLY, PPO1, READY, STD1, Core, RecordBench, over_pkw, over_records

from dpstack.profile import FAULT_CODES, PAGED_PKW, MessageParameter, TelegramSpec, Word, profidrive_states
from dpstack.profile.core_description import describe_core

FAULT = "00 48 00 00"
WARNS = "00 C0 00 00"


class Sinamics(Core):
    table = profidrive_states.table(
        Word("control word", profidrive_states.CONTROL_BITS),
        Word("status word", {**profidrive_states.STATUS_BITS, "warning": 7}),
    )
    dialect = PAGED_PKW
    fault_parameter = FAULT_CODES
    fault_names = {30001: "F30001 overcurrent"}
    unknown_fault = "F{:05d}"
    warning_parameter = MessageParameter(number=2122)
    warning_numbers = True
    warning_names = {7012: "A07012 motor temperature"}
    unknown_warning = "A{:05d}"


def told(bench: PluginBench, name: str) -> object:
    return [event[name] for event in bench.events if event["type"] == "status"][-1]


# -- by parameter --------------------------------------------------------------------------------------------------


def test_present_faults_are_read_over_record_47_and_again_if_the_buffer_changed() -> None:
    bench = over_records(Sinamics)
    bench.see(FAULT)
    assert told(bench, "faults") == ["not yet named"]
    many = "01 01 06 08 75 31 1B 63 00 00 00 00 00 00 00 00 00 00 00 00"
    bench.answer(
        "01 01 01 01 06 01 00 05",
        "02 01 01 01 06 08 75 31 00 00 00 00 00 00 00 00 00 00 00 00 00 00",
        "03 01 01 01 06 01 00 06",  # 944 has changed meanwhile
        "04 01 01 01 06 01 00 06",
        f"05 01 {many}",
        "06 01 01 01 06 01 00 06",
    )
    assert bench.requests[:2] == ["01 01 01 01 10 00 03 B0 00 00", "02 01 01 01 10 08 03 B1 00 00"]
    assert told(bench, "faults") == ["F30001 overcurrent", "F07011"]
    # gone, and the next trip is read anew
    bench.see(READY)
    assert told(bench, "faults") == []
    bench.see(FAULT)
    assert told(bench, "faults") == ["not yet named"]


def test_present_faults_are_read_one_by_one_over_pkw() -> None:
    bench = over_pkw(Sinamics)
    bench.see(NO_REPLY + FAULT)
    orders = []
    for order, reply in (
        ("13 B0 00 00", "13 B0 00 00 00 00 00 01"),
        ("63 B1 00 00", "43 B1 00 00 00 00 75 31"),
        ("63 B1 01 00", "43 B1 01 00 00 00 00 00"),
        ("13 B0 00 00", "13 B0 00 00 00 00 00 01"),
    ):
        bench.see(NO_REPLY + FAULT, 3)
        orders.append(bench.out()[:11])
        assert orders[-1] == order
        bench.see(f"{reply} {FAULT}")
    bench.see(NO_REPLY + FAULT, 3)
    assert told(bench, "faults") == ["F30001 overcurrent"]


def test_a_buffer_that_is_filled_later_is_read_until_it_has_a_number() -> None:
    bench = over_records(Sinamics)
    bench.see(FAULT)
    empty = "01 01 06 08" + " 00" * 16
    bench.answer("01 01 01 01 06 01 00 05", f"02 01 {empty}", "03 01 01 01 06 01 00 05")
    assert told(bench, "faults") == ["not yet named"]
    bench.run(100)
    bench.answer("04 01 01 01 06 01 00 05", "05 01 01 01 06 08 75 31" + " 00" * 14, "06 01 01 01 06 01 00 05")
    assert told(bench, "faults") == ["F30001 overcurrent"]


def test_a_drive_without_the_parameter_says_why_the_fault_has_no_name() -> None:
    bench = over_records(Sinamics)
    bench.see(FAULT)
    bench.answer("01 81 01 01 44 01 00 00")
    assert told(bench, "faults") == ["without a name: parameter 944: error 0, illegal parameter number"]


def test_a_telegram_without_any_channel_says_so() -> None:
    bench = PluginBench(Sinamics(DRIVE, "belt", STD1, {"check_settings": False}), FAULT)
    assert told(bench, "faults") == ["without a name: telegram STD1 does not carry it, and it has no parameter channel"]


def test_start_of_a_tripped_drive_names_the_fault_by_its_parameter() -> None:
    bench = over_records(Sinamics)
    bench.see(FAULT)
    token = bench.order("start")
    bench.answer(
        "01 01 01 01 06 01 00 05",
        "02 01 01 01 06 08 1B 63 00 00 00 00 00 00 00 00 00 00 00 00 00 00",
        "03 01 01 01 06 01 00 05",
    )
    bench.run(40)
    assert bench.text(token, "fault") == "fault F07011; acknowledge it first"


def test_warnings_are_read_while_the_status_bit_is_set() -> None:
    bench = over_records(Sinamics)
    bench.see(WARNS)
    assert told(bench, "warnings") == []
    bench.answer("01 01 01 01 06 08 1B 64 1E 61 00 00 00 00 00 00 00 00 00 00 00 00")
    assert bench.requests == ["01 01 01 01 10 08 08 4A 00 00"]
    assert told(bench, "warnings") == ["A07012 motor temperature", "A07777"]
    bench.see(READY)
    assert told(bench, "warnings") == []


# -- by word -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "unknown", "word", "expected"),
    [
        (True, "A{:05d}", "1B 64", ["A07012 motor temperature"]),
        (True, "A{:05d}", "00 05", ["A00005"]),
        (True, "", "00 05", ["number 5"]),
        (True, "", "00 00", []),
        (False, "", "00 05", ["bit 0", "bit 2"]),
        (False, "warning {}", "80 00", ["warning 15"]),
    ],
)
def test_the_warning_word_is_bits_or_a_number(numbers: bool, unknown: str, word: str, expected: list[str]) -> None:
    class Words(Sinamics):
        inputs = ("status", "speed", "warning", "fault")
        warning_numbers = numbers
        unknown_warning = unknown

    telegram = TelegramSpec(name="T", config=b"\xf3", outputs=4, inputs=8)
    bench = PluginBench(Words(DRIVE, "belt", telegram, {"check_settings": False}), f"{FAULT} {word} 00 07")
    assert told(bench, "warnings") == expected
    assert told(bench, "faults") == ["F00007"]  # the word goes before the parameter


def test_words_in_the_telegram_leave_the_parameters_alone() -> None:
    class Words(Sinamics):
        inputs = ("status", "fault")

    bench = over_records(Words)
    assert isinstance(bench, RecordBench)
    bench.see("00 48 75 31", 20)
    assert (bench.requests, told(bench, "faults")) == ([], ["F30001 overcurrent"])


def test_the_sheet_lists_warnings_by_number() -> None:
    found = describe_core(Sinamics(DRIVE, "belt", PPO1, {}), 5, "kit", {})
    assert [one.code for one in found.warnings] == ["7012"]
