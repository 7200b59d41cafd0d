"""Clock synchronisation at octets that are not ours: a public test vector, AUMA's tables, VPC3+S's figures."""

from __future__ import annotations

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.decode.words import describe_octets
from dpstack.dp.pdu.alarm_blocks import Alarm, parse_block
from dpstack.dp.pdu.clock import (
    RESOLUTIONS_MS,
    ClockValue,
    StampedEvent,
    TimeStampedAlarm,
    parse_record,
    parse_time,
    time_octets,
)
from dpstack.errors import PduError
from dpstack.fdl.codec import decode
from dpstack.units import NS_PER_S

VECTOR = bytes.fromhex("68 15 15 68 7f 02 c0 e8 1b 2c 80 80 00 00 00 e8 1b 2c 76 80 00 00 00 00 00 95 16")


def ns(text: str) -> int:
    return int(datetime.datetime.fromisoformat(text).replace(tzinfo=datetime.UTC).timestamp()) * NS_PER_S


def test_the_public_vector() -> None:
    telegram = decode(VECTOR)
    assert telegram is not None
    assert telegram.is_clock_value
    clock = ClockValue.parse(telegram.data)
    assert clock == ClockValue(ns("2023-05-26 13:02:56") + NS_PER_S // 2, ns("2023-05-26 13:02:46") + NS_PER_S // 2)
    assert clock.build() == telegram.data
    assert describe_octets(VECTOR) == (
        "Clock_Value 2 -> all, 18 octets: 2023-05-26 13:02:56.500 UTC, resolution 1 ms (FC 0xc0)"
    )


def test_both_eras() -> None:
    # VPC3+S, figure 7-28: from 1900, and from 2036-02-07 06:28:16 for values below 9DFF4400h
    assert parse_time(bytes.fromhex("FFFFFFFF 00000000")) == ns("2036-02-07 06:28:15")
    assert parse_time(bytes.fromhex("00000000 00000000")) == ns("2036-02-07 06:28:16")
    assert parse_time(bytes.fromhex("9DFF4400 00000000")) == ns("1984-01-01 00:00:00")
    assert parse_time(bytes.fromhex("9DFF43FF 00000000")) == ns("2120-02-07 06:28:15")


def test_status_bits() -> None:
    # VPC3+S, figure 7-29, and AUMA, table 37: C bit 7, CV bits 6 to 2; ANH 7, SWT 6, CR 4 and 3, SYF 0
    clock = ClockValue.parse(VECTOR[7:23] + bytes((0x80 | 5 << 2, 0x80 | 0x40 | 2 << 3 | 1)))
    assert clock.correction == -5
    assert (clock.announced_hour, clock.summer_time, clock.resolution_ms, clock.synchronised) == (
        True,
        True,
        100,
        False,
    )
    assert clock.text == (
        "2023-05-26 13:02:56.500 UTC, resolution 100 ms, correction -2:30 h (local time), summer time, "
        "summer time changes within an hour, clock not synchronised"
    )


@pytest.mark.parametrize("octets", [b"", bytes(17), bytes(19)])
def test_wrong_lengths(octets: bytes) -> None:
    with pytest.raises(PduError, match="18 octets"):
        ClockValue.parse(octets)


def test_a_clock_value_that_is_cut_off_is_explained() -> None:
    short = bytes.fromhex("68 05 05 68 7f 02 c0 01 02 44 16")
    assert "cannot be read (Clock_Value has 18 octets, not 2 octets)" in describe_octets(short)


@pytest.mark.parametrize("seconds", [0, -1, ns("1983-12-31 23:59:59") // NS_PER_S, 1 << 40])
def test_years_without_octets(seconds: int) -> None:
    with pytest.raises(PduError, match="1984 to"):
        time_octets(seconds * NS_PER_S)


_TIMES = st.integers(ns("1984-01-01 00:00:00"), ns("2119-12-31 00:00:00"))


@given(_TIMES)
def test_times_come_back_to_the_nanosecond(t_ns: int) -> None:
    assert abs(parse_time(time_octets(t_ns)) - t_ns) <= 1


@given(_TIMES, st.none() | _TIMES, st.integers(-31, 31), st.booleans(), st.booleans(), st.sampled_from(RESOLUTIONS_MS))
def test_octets_come_back(t: int, before: int | None, cv: int, summer: bool, locked: bool, resolution: int) -> None:
    octets = ClockValue(t, before, cv, not summer, summer, resolution, locked).build()
    assert ClockValue.parse(octets).build() == octets or cv == 0


def test_a_time_stamped_process_alarm() -> None:
    # ET 200M operating instructions (12/2008), table 8-1: the interrupt part of a diagnosis of an IM 153-2
    alarm = parse_block(bytes.fromhex("08 02 02 20 00 67 01 0D"))
    assert isinstance(alarm, Alarm)
    assert (alarm.slot, alarm.sequence, alarm.time_stamps) == (2, 4, TimeStampedAlarm(False, False, 103, 1))
    assert alarm.time_stamps is not None
    assert alarm.time_stamps.octets == alarm.data
    assert alarm.full_text == "process alarm, slot 2, 1 time-stamped event in record 103"


@pytest.mark.parametrize(
    ("state", "overrun", "restarted"),
    # ET 200iSP, table 7-46: 0 buffer to be fetched, 1 and 2 overflow, 3 and 4 redundancy, 5 reset, 7 synchronised
    [(0x01, False, False), (0x02, True, False), (0x04, True, False), (0x20, False, True), (0x98, False, False)],
)
def test_the_state_of_time_stamps(state: int, overrun: bool, restarted: bool) -> None:
    found = TimeStampedAlarm.of(bytes((state, 100, 20, 0x0D)))
    assert found == TimeStampedAlarm(overrun, restarted, 100, 20)
    assert TimeStampedAlarm.of(found.octets) == found


@pytest.mark.parametrize("data", ["", "01 64 03", "01 63 03 0D", "01 74 03 0D", "01 64 03 0E", "01 64 03 0D 00"])
def test_other_process_alarms(data: str) -> None:
    assert TimeStampedAlarm.of(bytes.fromhex(data)) is None


def test_a_record_of_events() -> None:
    # AUMA, table 39: kind, slot, signal, active, two unused, seconds, fraction
    octets = bytes.fromhex("01 00 02 01 00 00 E81B2C80 80000000  85 00 00 00 00 00 E81B2C76 00000000")
    time = ns("2023-05-26 13:02:56") + NS_PER_S // 2
    events = parse_record(octets)
    assert events[0] == StampedEvent(1, 0, 2, 1, time)
    assert [event.kind_text for event in events] == ["change", "buffer overrun"]
    assert [event.state_text for event in events] == ["active", ""]
    assert events[0].as_dict() == {
        "time": "2023-05-26T13:02:56.500Z",
        "slot": 0,
        "signal": 2,
        "state": 1,
        "state_text": "active",
        "kind": 1,
        "kind_text": "change",
    }
    for wrong in (octets[:-1], octets * 9):
        with pytest.raises(PduError, match="entries of 14 octets"):
            parse_record(wrong)


def test_a_record_of_an_interface_module() -> None:
    # ET 200M, tables 8-6 to 8-8: slot, channel, state in bit 7, unassigned, seconds from 1900, fraction; slot 2: own
    octets = bytes.fromhex(
        "04 0F 80 00 C355F7A6 80000000  0B 00 00 00 C355F7A6 00000000  02 03 01 00 C355F7A7 00000000"
    )
    time = ns("2003-11-07 10:51:18")
    assert [
        (one.slot, one.signal, one.state_text, one.kind_text, one.time_ns - time) for one in parse_record(octets)
    ] == [
        (4, 15, "active", "change", NS_PER_S // 2),
        (11, 0, "not active", "change", 0),
        (2, 3, "", "special message 3", NS_PER_S),
    ]
    assert parse_record(b"") == []


def test_84_octets_are_read_by_their_kinds() -> None:
    long, short = bytes.fromhex("01 00 02 01 00 00 E81B2C80 80000000"), bytes.fromhex("04 0F 80 00 C355F7A6 80000000")
    assert [one.slot for one in parse_record(long * 6)] == [0] * 6
    assert [one.slot for one in parse_record(short * 7)] == [4] * 7


@given(st.binary(max_size=300))
def test_any_octets_are_whole_entries_or_refused(octets: bytes) -> None:
    lengths = [one for one, most in ((14, 17), (12, 20)) if not len(octets) % one and len(octets) <= one * most]
    if not lengths:
        with pytest.raises(PduError, match="entries of 14 octets"):
            parse_record(octets)
        return
    events = parse_record(octets)
    assert len(octets) in [one * len(events) for one in lengths]
    assert all(one.as_dict()["kind_text"] for one in events)
