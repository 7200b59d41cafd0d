"""The octets of alarm and status blocks and of Alarm_Ack, literally, and blocks that lie."""

from __future__ import annotations

import contextlib
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import instance

from dpstack.dp.pdu.alarm_blocks import (
    Alarm,
    AlarmType,
    ModuleState,
    Specifier,
    Status,
    StatusType,
    alarm_name,
    module_status,
    parse_block,
    status_name,
)
from dpstack.dp.pdu.redundancy import PrmFunction, RedState, Redundancy
from dpstack.dpv1.pdu.read_write import AlarmAck
from dpstack.errors import PduError

BLOCKS: list[tuple[Alarm | Status, str, str]] = [
    (
        Alarm(AlarmType.DIAGNOSIS, 3, Specifier.APPEARS, 5, b"\x83\x46\xa6"),
        "07 01 03 29 83 46 A6",
        "diagnosis alarm, slot 3, appears, slot disturbed",
    ),
    (Alarm(AlarmType.PROCESS, 254, sequence=31), "04 02 FE F8", "process alarm, slot 254"),
    (Alarm(AlarmType.PULL, 1, add_ack=True), "04 03 01 04", "pull alarm, slot 1"),
    (
        Alarm(AlarmType.PLUG, 1, Specifier.DISAPPEARS),
        "04 04 01 02",
        "plug alarm, slot 1, disappears, slot is good",
    ),
    (
        Alarm(AlarmType.STATUS, 0, Specifier.DISAPPEARS_OTHERS),
        "04 05 00 03",
        "status alarm, slot 0, disappears, slot still disturbed",
    ),
    (Alarm(AlarmType.UPDATE, 2), "04 06 02 00", "update alarm, slot 2"),
    (Alarm(126, 2, data=bytes(59)), "3F 7E 02 00" + " 00" * 59, "vendor alarm 126, slot 2"),
    # FPBA-01 manual p85: its status message
    (Status(StatusType.MESSAGE, 0, data=b"\x01"), "05 81 00 00 01", "status message, slot 0"),
    (
        Status(StatusType.MODULES, 0, data=b"\x39"),
        "05 82 00 00 39",
        "module status: slot 1 data invalid, slot 2 wrong module, slot 3 no module",
    ),
    (Status(StatusType.PRM_CMD_ACK, 0, reserved=2, data=b"\x01"), "05 9E 00 08 01", "PrmCmdAck, slot 0"),
    (Status(StatusType.RED_STATE, 0), "04 9F 00 00", "Red_State, slot 0"),
    (Status(32, 9, Specifier.APPEARS), "04 A0 09 01", "vendor status 32, slot 9, appears, slot disturbed"),
]


@pytest.mark.parametrize(("pdu", "octets", "text"), BLOCKS)
def test_blocks(pdu: Alarm | Status, octets: str, text: str) -> None:
    assert pdu.build() == bytes.fromhex(octets)
    assert parse_block(bytes.fromhex(octets)) == pdu
    assert pdu.text == text


@pytest.mark.parametrize(
    ("octets", "what"),
    [
        ("", "octet 1 (header) is missing"),
        ("03 01 03", "octet 4 (sequence) is missing"),
        ("05 01 03 29", "octet 1 says 5 octets, there are 4"),
        ("40 01 03 29" + " 00" * 60, "64 octets, a device related block has 63 at most"),  # 40: no device related block
        ("04 00 01 00", "0 is no type of alarm"),
        ("04 07 01 00", "7 is no type of alarm"),
        ("04 7F 01 00", "127 is no type of alarm"),
        ("04 84 01 00", "4 is no type of status"),
        ("04 01 FF 00", "there is no slot 255"),
    ],
)
def test_invalid_blocks(octets: str, what: str) -> None:
    with pytest.raises(PduError, match=re.escape(what)):
        parse_block(bytes.fromhex(octets))


def test_a_module_status_counts_slots_from_one() -> None:
    states = (ModuleState.OK, ModuleState.MISSING, ModuleState.OK, ModuleState.OK, ModuleState.WRONG)
    assert module_status(states).build() == bytes.fromhex("06 82 00 00 0C 02")
    assert module_status(states).modules == (*states, *[ModuleState.OK] * 3)
    assert [state.text for state in ModuleState] == ["ok", "data invalid", "wrong module", "no module"]
    assert module_status(()).text == "module status: all modules ok"
    assert Status(StatusType.MESSAGE, 0, data=b"\xff").modules == ()


def test_the_acknowledgement_repeats_slot_type_and_specifier() -> None:
    alarm = instance(parse_block(bytes.fromhex("07 01 03 2D 83 46 A6")), Alarm)
    assert AlarmAck.of(alarm).build() == bytes.fromhex("5C 03 01 2D")
    assert AlarmAck.parse(bytes.fromhex("5C 03 01 2D")) == AlarmAck(3, 1, Specifier.APPEARS, 5, add_ack=True)
    for octets, what in (
        ("5C 03 01", "octet 4 (specifier) is missing"),
        ("5E 03 01 00", "octet 1 is 0x5E"),
        ("5C 03 01 00 00", "octet 4 is the last one"),
    ):
        with pytest.raises(PduError, match=re.escape(what)):
            AlarmAck.parse(bytes.fromhex(octets))


def test_values_that_do_not_fit() -> None:
    for pdu, what in (
        (Alarm(1, 255), "slot 255"),
        (Alarm(127, 1), "127 is no type"),
        (Alarm(1, 1, sequence=32), "sequence"),
        (Alarm(1, 1, data=bytes(60)), "60 octets"),
        (Status(1, 255), "slot 255"),
    ):
        with pytest.raises(PduError, match=re.escape(what)):
            pdu.build()


def test_names_of_every_type() -> None:
    assert alarm_name(7) == "alarm of reserved type 7"
    assert status_name(4) == "status of reserved type 4"
    assert len({alarm_name(n) for n in range(127)}) == len({status_name(n) for n in range(127)}) == 127


@given(st.binary(max_size=70))
def test_any_octets_are_a_block_or_an_error(octets: bytes) -> None:
    with contextlib.suppress(PduError):
        pdu = parse_block(octets)
        assert pdu.build() == octets
        assert pdu.text
    with contextlib.suppress(PduError):
        assert AlarmAck.parse(octets).build() == octets


PRIMARY = "primary, data exchange, baud rate found"


@pytest.mark.parametrize(
    ("octets", "found", "told"),
    [
        (  # AUMA AC 01.2 manual p46, table 34
            "08 9E 00 18 02 2A 21 00",
            Redundancy(3, PrmFunction.PRIMARY_REQUEST, RedState(0x2A), RedState(0x21)),
            "PrmCmdAck, slot 0, sequence number 3, function: primary request; "
            f"this side: {PRIMARY}; the other side: backup, baud rate found",
        ),
        (
            "08 9F 00 F8 00 45 12 00",
            Redundancy(31, PrmFunction(0), RedState(0x45), RedState(0x12)),
            "Red_State, slot 0, sequence number 31, function: none; "
            "this side: backup, hardware defect, output hold time; the other side: primary, master state clear",
        ),
        (
            "07 9E 00 00 DC 88 00",
            Redundancy(0, PrmFunction(0xDC), RedState(0x88), RedState(0)),
            "PrmCmdAck, slot 0, sequence number 0, function: stop ms1, start ms1, check properties, "
            "master state clear, 0x80 (reserved); this side: data exchange, 0x80 (reserved); the other side: none",
        ),
        ("06 9E 00 08 02 2A", None, "PrmCmdAck, slot 0, data 02 2a"),
        ("08 81 00 00 02 2A 21 00", None, "status message, slot 0, data 02 2a 21 00"),
    ],
)
def test_status_of_a_redundant_slave(octets: str, found: Redundancy | None, told: str) -> None:
    status = instance(parse_block(bytes.fromhex(octets)), Status)
    assert status.redundancy == found
    assert status.full_text == told
    assert status.build() == bytes.fromhex(octets)
    if found is not None and len(status.data) == 4:
        assert found.octets == status.data
