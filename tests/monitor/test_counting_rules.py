"""Single rules of counting, in literal telegrams of master 2 and station 5; the recorded rotation is one that was on
the wire."""

from __future__ import annotations

import pytest
from report_kit import EPOCH, Heard
from support import MS, S

from dpstack.capture.transmission import Damage, Transmission
from dpstack.monitor.counters import Counters, State, Station
from dpstack.monitor.schedule import MOST_KEPT, MOST_TELEGRAMS, ScheduleRecorder, Use
from dpstack.units import chars_to_ns

FIRST = "68 05 05 68 85 82 6D 3C 3E EE 16"  # Slave_Diag, FCV = 0, FCB = 1
DIAG_0 = "68 05 05 68 85 82 5D 3C 3E DE 16"
DIAG_1 = "68 05 05 68 85 82 7D 3C 3E FE 16"
DIAGNOSIS = "68 0B 0B 68 82 85 08 3E 3C 02 05 00 FF 80 6A 79 16"
DX_0, DX_1 = "10 05 02 5D 64 16", "10 05 02 7D 84 16"
INPUTS = "68 04 04 68 02 05 08 33 42 16"
STATUS, IS_SLAVE = "10 05 02 49 50 16", "10 02 05 00 07 16"
TOKEN, SC = "DC 02 02", "E5"
#: damaged: an answer without its end; one without its first octet; a request and a token of master 2
PIECE, TAIL, BROKEN_REQUEST, BROKEN_TOKEN = "68 04 04 68 02", "04 04 68 02 05", "10 05 02 5D 00 16", "DC 02"


def count(*telegrams: str) -> Counters:
    counters = Counters()
    for number, octets in enumerate(telegrams):
        damage = Damage.TOO_SHORT if octets == BROKEN_TOKEN else 0
        counters.add(Transmission(bytes.fromhex(octets), (number + 1) * MS, 500_000, "", damage))
    return counters


def five(*telegrams: str) -> Station:
    return count(*telegrams).stations[5]


@pytest.mark.parametrize(
    ("telegrams", "repetitions", "depth", "polls"),
    [
        ((DX_0, INPUTS, DX_1, INPUTS, DX_0, INPUTS), 0, [0, 0], 0),
        ((DX_0, DX_0, INPUTS), 1, [1, 0], 0),
        ((DX_0, DX_0, DX_0, INPUTS, DX_1, DX_1, INPUTS), 3, [1, 1], 0),
        ((DX_0, INPUTS, DX_0, INPUTS), 1, [1, 0], 0),  # the master did not get the answer that we heard
        ((DX_0, TOKEN, DX_0, INPUTS), 1, [1, 0], 0),
        ((DX_0, STATUS, IS_SLAVE, DX_0, INPUTS), 1, [1, 0], 0),  # FDL_Status is no part of the sequence
        ((FIRST, FIRST, FIRST, DIAGNOSIS), 0, [0, 0], 2),
        ((FIRST, DIAGNOSIS, FIRST, DIAGNOSIS), 0, [0, 0], 0),
        ((FIRST, FIRST, DIAG_0, DIAGNOSIS), 0, [0, 0], 1),  # the third one is a probe with FCV = 1
        ((FIRST, DIAG_1), 0, [0, 0], 0),  # so is this
        ((FIRST, DIAGNOSIS, DIAG_1, DIAGNOSIS), 1, [1, 0], 0),  # FCB = 1 twice: the slave repeats its answer
        ((STATUS, STATUS, STATUS), 0, [0, 0], 0),
    ],
)
def test_frame_counts(telegrams: tuple[str, ...], repetitions: int, depth: list[int], polls: int) -> None:
    counters = count(*telegrams)
    station = counters.stations[5]
    assert counters.damaged == {}
    assert (station.repetitions, station.retry_depth[:2], station.repeated_polls) == (repetitions, depth, polls)


@pytest.mark.parametrize(
    ("telegrams", "answers", "damaged", "no_answer", "late", "unattributed", "strays"),
    [
        ((DX_0, INPUTS), 1, 0, 0, 0, 0, 0),
        ((DX_0, TOKEN), 0, 0, 1, 0, 0, 0),
        ((DX_0, PIECE, TOKEN), 0, 1, 0, 0, 0, 0),
        ((DX_0, PIECE, TAIL, TOKEN), 0, 1, 0, 0, 1, 0),
        ((DX_0, PIECE, INPUTS), 1, 0, 0, 0, 1, 0),
        ((DX_0, INPUTS, PIECE), 1, 0, 0, 0, 1, 0),
        ((DX_0, BROKEN_REQUEST, DX_0, INPUTS), 1, 0, 1, 0, 1, 0),
        ((DX_0, BROKEN_TOKEN, TOKEN), 0, 0, 1, 0, 1, 0),
        ((DX_0, TOKEN, INPUTS), 0, 0, 1, 1, 0, 0),
        ((DX_0, TOKEN, SC), 0, 0, 1, 1, 0, 0),
        ((DX_0, INPUTS, INPUTS), 1, 0, 0, 1, 0, 0),
        ((DX_0, INPUTS, SC), 1, 0, 0, 0, 0, 1),
        ((STATUS, SC, TOKEN), 0, 0, 1, 0, 0, 1),  # no FDL_Status is answered with SC
        ((STATUS, INPUTS, TOKEN), 0, 0, 1, 1, 0, 0),  # nor with data
        ((DIAG_0, INPUTS, DIAGNOSIS), 1, 0, 0, 1, 0, 0),  # SAPs that do not fit: of the exchange before
        ((DX_0, INPUTS, BROKEN_REQUEST, INPUTS), 1, 0, 0, 0, 1, 1),  # a request that we alone did not get
    ],
)
def test_ends_of_requests(
    telegrams: tuple[str, ...], answers: int, damaged: int, no_answer: int, late: int, unattributed: int, strays: int
) -> None:
    counters = count(*telegrams)
    one = counters.stations[5]
    assert (one.answers, one.damaged, one.no_answer, one.late) == (answers, damaged, no_answer, late)
    assert (counters.unattributed, counters.strays) == (unattributed, strays)
    assert one.requests == answers + damaged + no_answer


def test_a_request_before_a_gap_is_not_counted_and_what_follows_begins_anew() -> None:
    counters = count(DX_0, INPUTS, DX_1)
    counters.gap()
    for number, octets in enumerate((INPUTS, DX_1, INPUTS), 10):
        counters.add(Transmission(bytes.fromhex(octets), number * MS, 500_000))
    one = counters.stations[5]
    assert (one.requests, one.answers, one.no_answer, one.repetitions, one.late) == (2, 2, 0, 0, 0)
    assert counters.strays == 1


def test_a_set_prm_of_another_master_takes_no_slave_away() -> None:
    foreign = "68 0C 0C 68 85 83 5D 3D 3E 88 14 05 0B 06 96 01 29 16"
    one = five(DX_0, INPUTS, foreign, SC, DX_1, INPUTS)
    assert (one.state, one.master, one.lost, one.syncs) == (State.DATA_EXCHANGE, 2, 0, 0)
    own = "68 0C 0C 68 85 82 7D 3D 3E 88 14 05 0B 06 96 01 48 16"
    one = five(DX_0, INPUTS, own, SC)
    assert (one.state, one.master, one.lost) == (State.SET_PRM, 2, 1)


def test_the_causes_of_damage() -> None:
    counters = count(PIECE, TAIL, BROKEN_REQUEST, DX_0[:-2] + "17", DX_0 + " 00")
    counters.add(Transmission(bytes.fromhex(DX_0), 90 * MS, 500_000, "", Damage.PARITY_OR_FRAMING))
    assert counters.damaged == {"short": 1, "start": 1, "fcs": 2, "octets": 1, "parity": 1}


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
