"""The recorded rotation is one that was on the wire, telegram by telegram; memory does not grow."""

from __future__ import annotations

from report_kit import EPOCH, Heard
from support import MS, S

from dpstack.capture.transmission import Damage, Transmission
from dpstack.monitor.schedule import MOST_KEPT, MOST_TELEGRAMS, ScheduleRecorder, Use
from dpstack.units import chars_to_ns


def test_a_rotation_is_that_of_the_wire() -> None:
    heard = Heard(addresses=(3, 4, 5))
    heard.world.run_for(S // 2)
    rotation = heard.recorder.typical()
    assert rotation is not None
    end_ns = rotation.begun_ns + rotation.duration_ns
    sent = [one for one in heard.world.log if rotation.begun_ns <= one.start_ns + EPOCH < end_ns]
    assert [slot.start_ns + rotation.begun_ns - EPOCH for slot in rotation.slots] == [one.start_ns for one in sent]
    assert [slot.duration_ns for slot in rotation.slots] == [one.end_ns - one.start_ns for one in sent]
    assert [(slot.use, slot.sa, slot.da) for slot in rotation.slots[:6]] == [
        (Use.REQUEST, 2, 3), (Use.ANSWER, 3, 2), (Use.REQUEST, 2, 4), (Use.ANSWER, 4, 2), (Use.REQUEST, 2, 5),
        (Use.ANSWER, 5, 2),
    ]  # fmt: skip
    assert Use.TOKEN in {slot.use for slot in rotation.slots}
    assert sum(rotation.used_ns(use) for use in Use) + rotation.idle_ns == rotation.duration_ns
    assert abs(rotation.duration_ns - heard.counters.masters[2].rotation_ns.quantile_ns(0.5)) < MS


def test_a_bus_without_data_exchange_shows_the_rotation_of_its_token() -> None:
    heard = Heard(addresses=(3,), silent=(3,))
    heard.world.run_for(6 * S // 5)
    rotation = heard.recorder.typical()
    assert rotation is not None
    assert rotation.by_token
    assert rotation.slots[0].use is Use.TOKEN


def test_a_repetition_begins_no_rotation() -> None:
    poll = bytes.fromhex("68 05 05 68 03 02 7d 01 02 85 16")
    assert _rotation([poll, poll, poll.replace(b"\x7d", b"\x5d").replace(b"\x85\x16", b"\x65\x16")]) == [0, 1_000_000]


def _rotation(octets: list[bytes]) -> list[int]:
    recorder = ScheduleRecorder()
    for number, one in enumerate(octets):
        recorder.add(Transmission(one, S + number * MS, 500_000))
    rotation = recorder.typical()
    return [] if rotation is None else [slot.start_ns for slot in rotation.slots]


def test_damaged_octets_are_part_of_a_rotation() -> None:
    recorder = ScheduleRecorder()
    first = bytes.fromhex("68 05 05 68 03 02 7d 01 02 85 16")
    other = bytes.fromhex("68 05 05 68 03 02 5d 01 02 65 16")
    recorder.add(Transmission(first, S, 500_000))
    recorder.add(Transmission(b"\x68\x05", S + MS, 500_000, "", Damage.TOO_SHORT))
    recorder.add(Transmission(other, S + 2 * MS, 500_000))
    rotation = recorder.typical()
    assert rotation is not None
    assert [slot.use for slot in rotation.slots] == [Use.REQUEST, Use.DAMAGED]
    assert rotation.used_ns(Use.DAMAGED) == chars_to_ns(2, 500_000)


def test_memory_does_not_grow() -> None:
    recorder = ScheduleRecorder()
    polls = [bytes.fromhex("68 05 05 68 03 02 7d 01 02 85 16"), bytes.fromhex("68 05 05 68 03 02 5d 01 02 65 16")]
    for number in range(20_000):
        recorder.add(Transmission(polls[number % 2], S + number * 50 * MS, 500_000))
        assert len(recorder._kept) < MOST_KEPT
    rotation = recorder.typical()
    assert rotation is not None
    assert rotation.duration_ns == 50 * MS
    # octets without end that begin no rotation
    recorder = ScheduleRecorder()
    for number in range(5 * MOST_TELEGRAMS):
        recorder.add(Transmission(polls[0], S + number * MS, 500_000))
        assert len(recorder._current or ()) <= MOST_TELEGRAMS


def test_octets_without_times_give_no_rotation() -> None:
    recorder = ScheduleRecorder()
    for _ in range(10):
        recorder.add(Transmission(bytes.fromhex("dc 02 02"), None, 500_000))
    assert recorder.typical() is None
