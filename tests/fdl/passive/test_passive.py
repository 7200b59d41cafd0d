"""The passive station, spoken to in literal octets and in whole telegrams: what it answers, what its user is asked."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.commands import AtStation
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Req, Resp
from dpstack.machine import LineDown, LineUp
from dpstack.params import BusParams
from dpstack.phy.patience import Patience
from dpstack.trace import Notice
from dpstack.units import BAUD_RATES, NEVER
from tests.fdl.passive_kit import (
    BAUD,
    BIT,
    DIAG_FIRST,
    DX_5D,
    DX_7D,
    DX_ANSWER,
    DX_FIRST,
    DX_TO_5,
    GC_ALL,
    HOWS,
    SC,
    STATUS,
    TOKEN,
    build,
    times,
)

DX_7D_FROM_4 = "68 04 04 68 03 04 7D 11 95 16"
DX_4D = "68 04 04 68 03 02 4D 11 63 16"  # no frame count at all
DX_SD3_5D = "A2 03 02 5D 01 02 03 04 05 06 07 08 86 16"
DIAG_ANSWER = "68 06 06 68 82 83 08 3E 3C 77 FE 16"
PRM_5D = "68 06 06 68 83 82 5D 3D 3E 88 65 16"
GC_TO_3 = "68 07 07 68 83 82 46 3A 3E 02 00 C5 16"
STATUS_ANSWER = "10 02 03 00 05 16"
IDENT = "10 03 02 4E 53 16"
LSAP = "10 03 02 4F 54 16"
MSRD_57 = "10 03 02 57 5C 16"
RS_ANSWER = "10 02 03 03 08 16"


# --- what is answered how ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("request_octets", "reply", "answer"),
    [
        (DX_FIRST, Reply(Resp.DL, b"\x99"), DX_ANSWER),
        (DX_FIRST, Reply(Resp.DH, b"\x99"), "68 04 04 68 02 03 0A 99 A8 16"),
        (DX_FIRST, SC_REPLY, SC),
        (DX_FIRST, Reply(Resp.OK), STATUS_ANSWER),
        (DX_FIRST, Reply(Resp.DL), "10 02 03 08 0D 16"),
        (DX_FIRST, RS_REPLY, RS_ANSWER),
        (DX_FIRST, Reply(Resp.UE), "10 02 03 01 06 16"),
        (DX_FIRST, Reply(Resp.RR), "10 02 03 02 07 16"),
        (DX_FIRST, Reply(Resp.NR), "10 02 03 09 0E 16"),
        (DIAG_FIRST, Reply(Resp.DL, b"\x77"), DIAG_ANSWER),  # SAPs crosswise
        (DIAG_FIRST, Reply(Resp.DL), "68 05 05 68 82 83 08 3E 3C 87 16"),
        (DIAG_FIRST, RS_REPLY, RS_ANSWER),  # a negative acknowledgement carries nothing, SAPs neither
        (PRM_5D, SC_REPLY, SC),
        (DX_SD3_5D, Reply(Resp.DL, b"\x99"), DX_ANSWER),
        (IDENT, Reply(Resp.DL, b"AB"), "68 05 05 68 02 03 08 41 42 90 16"),
        # SAP 0 is a SAP, here and there
        ("68 04 04 68 83 02 6D 00 F2 16", Reply(Resp.DL, b"\x99"), "68 05 05 68 02 83 08 00 99 26 16"),
        ("68 05 05 68 83 82 6D 05 00 77 16", Reply(Resp.DL, b"\x99"), "68 06 06 68 82 83 08 00 05 99 AB 16"),
    ],
)
def test_answers(how: str, request_octets: str, reply: Reply, answer: str) -> None:
    bench, application = build(how, [reply])
    assert bench.answers(request_octets, 1_000_000) == [answer]
    assert len(application.served) == 1
    assert application.served[0] == decode(bytes.fromhex(request_octets))


def test_fdl_status_is_answered_without_the_application(how: str) -> None:
    bench, application = build(how)
    assert bench.answers(STATUS, 1_000_000) == [STATUS_ANSWER]
    assert application.served == []
    assert bench.station.stats.status == 1


@pytest.mark.parametrize("octets", [LSAP, MSRD_57])
def test_request_kinds_without_a_service_are_refused(how: str, octets: str) -> None:
    bench, application = build(how)
    assert bench.answers(octets, 1_000_000) == [RS_ANSWER]
    assert application.served == []


@pytest.mark.parametrize(
    "octets",
    [
        TOKEN,
        "DC 03 02",  # a token to a passive station
        SC,
        DX_TO_5,
        "10 05 02 49 50 16",
        "10 03 02 00 05 16",  # a response to it
        "68 04 04 68 03 02 08 11 1E 16",
        "10 03 03 49 4F 16",  # its own address as sender
        "68 04 04 68 03 03 5D 11 74 16",
        "10 03 02 41 46 16",  # reserved function
        "10 03 02 4A 4F 16",
        "10 03 02 40 45 16",  # time event
        "10 03 02 C0 C5 16",  # clock value
        "68 04 04 68 7F 02 6D 11 FF 16",  # SRD to all
        "10 7F 02 49 CA 16",
        "68 05 05 68 83 02 5D 41 11 34 16",  # to a station in another segment
        "68 05 05 68 03 82 5D 41 11 34 16",  # from one
    ],
)
def test_telegrams_to_other_stations_are_ignored(how: str, octets: str) -> None:
    bench, application = build(how)
    assert bench.answers(octets, 1_000_000) == []
    assert application.served == []
    assert application.indicated == []
    assert bench.port.take_events() == []


def test_sdn_is_handed_on_and_not_answered(how: str) -> None:
    bench, application = build(how)
    for octets, at in zip((GC_ALL, GC_TO_3), times(), strict=False):
        assert bench.answers(octets, at) == []
    assert [telegram.da for telegram in application.indicated] == [127, 3]
    assert [telegram.dsap for telegram in application.indicated] == [58, 58]
    assert bench.station.stats.indications == 2


def test_silence_is_an_answer(how: str) -> None:
    bench, application = build(how, [None, Reply(Resp.DL, b"\x99")])
    at = iter(times())
    assert bench.answers(DX_5D, next(at)) == []
    assert bench.answers(DX_5D, next(at)) == []  # the repetition of a request that was met with silence
    assert len(application.served) == 1
    assert bench.answers(DX_7D, next(at)) == [DX_ANSWER]


# --- FCB --------------------------------------------------------------------------------------------------------------
# (request, what the application is to be asked: True = asked, False = the kept answer)
FCB_RUNS: list[list[tuple[str, bool]]] = [
    [(DX_FIRST, True), (DX_5D, True), (DX_7D, True), (DX_5D, True)],  # FCB toggles
    [(DX_FIRST, True), (DX_5D, True), (DX_5D, False), (DX_5D, False), (DX_7D, True)],  # retries
    [(DX_FIRST, True), (DX_7D, False)],  # the first request stored FCB = 1
    [(DX_FIRST, True), (DX_FIRST, True), (DX_FIRST, True)],  # FCV = 0 restarts, never repeats
    [(DX_FIRST, True), (DX_5D, True), (DX_FIRST, True), (DX_5D, True)],  # taken up again
    [(DX_7D, True), (DX_7D, False), (DX_5D, True)],  # a master that never sends 6D
    [(DX_7D, True), (DX_7D_FROM_4, True), (DX_7D_FROM_4, False)],  # another SA is not checked
    [(DX_7D, True), (DX_7D_FROM_4, True), (DX_7D, True)],  # and the first one's FCB is forgotten
    [(DX_7D, True), (DX_4D, True), (DX_7D, True)],  # no frame count: nothing to keep
    [(DX_7D, True), (DX_TO_5, False), (DX_7D, False)],  # other stations' requests change nothing
    [(DX_7D, True), (GC_ALL, False), (DX_7D, False)],  # nor do broadcasts
    [(DX_7D, True), (TOKEN, False), (DX_7D, False)],
    [(DX_7D, True), (STATUS, False), (DX_7D, True)],  # kept until the next frame addressed to it
    [(DX_7D, True), (GC_TO_3, False), (DX_7D, True)],
    [(DX_7D, True), ("10 03 02 79 7E 16", False), (DX_7D, True)],  # FDL status is never a repetition
]


@pytest.mark.parametrize("run", FCB_RUNS)
def test_frame_count_bit(how: str, run: list[tuple[str, bool]]) -> None:
    bench, application = build(how, [Reply(Resp.DL, bytes((n,))) for n in range(1, 9)])
    last: list[str] = []
    repeats = 0
    for (octets, asked), at in zip(run, times(), strict=False):
        before = len(application.served)
        answers = bench.answers(octets, at)
        assert len(application.served) - before == asked
        if octets in (DX_FIRST, DX_5D, DX_7D, DX_7D_FROM_4, DX_4D):
            assert len(answers) == 1
            if not asked:
                assert answers == last
                repeats += 1
            last = answers
    assert bench.station.stats.repeats == repeats


def test_a_repeated_request_gets_rs_again(how: str) -> None:
    bench, application = build(how, [RS_REPLY])
    at = iter(times())
    assert bench.answers(DX_7D, next(at)) == [RS_ANSWER]
    assert bench.answers(DX_7D, next(at)) == [RS_ANSWER]
    assert len(application.served) == 1
    assert bench.station.stats.refused == 1


class Model:
    """EN 50170-2 p. 131 written down a second time, by what must be answered: n = n-th new request, None = silence."""

    def __init__(self) -> None:
        self.memory: tuple[int, int] | None = None  # SA and FCB of the last frame addressed to the station
        self.count = 0

    def hears(self, sa: int, fc: int) -> int | None:
        function, fcb, fcv = fc & 0x0F, fc >> 5 & 1, fc >> 4 & 1
        if function in (0x3, 0x5, 0xC, 0xD):
            if not (fcv and self.memory == (sa, fcb)):
                self.count += 1
            self.memory = (sa, fcb) if fcv or fcb else None
            return self.count
        self.memory = None
        return 0 if function == 0x9 else None


def sd1(da: int, sa: int, fc: int) -> str:
    return bytes((0x10, da, sa, fc, (da + sa + fc) % 256, 0x16)).hex(" ")


frame_counts = st.sampled_from([0x00, 0x20, 0x10, 0x30, 0x10, 0x30])
functions = st.sampled_from([0x4D, 0x4C, 0x45, 0x43, 0x4D, 0x4D, 0x49, 0x46])
conversations = st.lists(
    st.tuples(st.sampled_from([3, 3, 3, 5, 127]), st.sampled_from([2, 2, 4]), functions, frame_counts), max_size=12
)


@given(conversations, st.sampled_from(HOWS))
def test_any_conversation_goes_by_the_standard(talk: list[tuple[int, int, int, int]], how: str) -> None:
    bench, application = build(how, [Reply(Resp.DL, bytes((n,))) for n in range(1, 20)])
    model = Model()
    for (da, sa, function, count), at in zip(talk, times(), strict=False):
        fc = function | (0 if function in (0x49, 0x46) else count)
        answers = bench.answers(sd1(da, sa, fc), at)
        expected = model.hears(sa, fc) if da == 3 else None
        if expected is None:
            assert answers == []
        elif not expected:
            assert bytes.fromhex(answers[0]) == bytes((0x10, sa, 3, 0, sa + 3, 0x16))
        else:
            body = bytes((sa, 3, 8, expected))
            assert bytes.fromhex(answers[0]) == b"\x68\x04\x04\x68" + body + bytes((sum(body), 0x16))
        assert len(application.served) == model.count


# --- the rest ---------------------------------------------------------------------------------------------------------
def test_a_new_address_leaves_the_answer_under_way_alone(how: str) -> None:
    bench, application = build(how)
    application.move_to = 5
    at = iter(times())
    assert bench.answers(DX_7D, next(at)) == [DX_ANSWER]
    application.move_to = None
    assert bench.station.address == 5
    assert bench.answers(DX_7D, next(at)) == []
    assert bench.answers(DX_TO_5, next(at)) == ["68 04 04 68 02 05 08 99 A8 16"]
    for wrong in (-1, 127):
        with pytest.raises(ConfigError, match=r"0\.\.126"):
            bench.station.set_address(wrong)
        with pytest.raises(ConfigError, match=r"0\.\.126"):
            PassiveStation(wrong, application, BusParams.preset(BAUD))


def test_the_application_gets_its_time(how: str) -> None:
    bench, application = build(how)
    application.due = 5_000
    bench.poke()
    assert bench.port.wake_at() == 5_000
    bench.run_until(4_999)
    assert application.ticks == []
    bench.run_until(6_000)
    assert application.ticks == [5_000]
    application.due = 10**6 + 5 * BIT  # while an answer waits
    bench.poke()
    bench.say(DX_7D, 10**6)
    bench.run_until(10**8)
    assert application.ticks == [5_000, 10**6 + 5 * BIT]
    assert bench.sent == [(10**6 + 11 * BIT, DX_ANSWER)]


def test_events_of_station_and_application_come_out(how: str) -> None:
    bench, application = build(how)
    notice = Notice(t_ns=1, source="device", message="hello")
    application.events.append(notice)
    at = iter(times())
    empty_5d = "68 03 03 68 03 02 5D 62 16"
    assert bench.answers(empty_5d, next(at)) == [DX_ANSWER]
    first, second = bench.port.take_events()
    assert "LE = 3" in first.text
    assert "station 2" in first.text
    assert second is notice
    assert application.served[0].data == b""
    bench.answers("68 03 03 68 03 02 7D 82 16", next(at))  # told once
    assert bench.port.take_events() == []


def test_another_baud_rate_forgets_and_moves_the_gates(how: str) -> None:
    bench, _ = build(how, t_sdr=20)
    bench.say(DX_7D, 10**6)
    bench.port.set_params(BusParams.preset(1_500_000))
    assert bench.station.baud == 1_500_000
    assert bench.station.answer_at() == NEVER
    assert bench.port.wake_at() == NEVER
    bench.octet_ns = 7_333
    bench.say(DX_7D, 10**8)
    assert bench.station.answer_at() == 10**8 + 13_333


def test_the_attributes_that_a_medium_reads(how: str) -> None:
    bench, application = build(how)
    assert not bench.station.hears_all
    assert bench.station.baud == BAUD
    assert bench.station.responder is application
    assert repr(bench.station) == "<PassiveStation 3>"


def test_every_request_function_is_known() -> None:
    # a new function code must be given a place: served, refused, status, indicated or ignored
    known = {Req.SDA_LOW, Req.SDA_HIGH, Req.SRD_LOW, Req.SRD_HIGH, Req.IDENT, Req.MSRD, Req.LSAP_STATUS}
    known |= {Req.FDL_STATUS, Req.SDN_LOW, Req.SDN_HIGH, Req.TIME_EVENT, Req.CLOCK_VALUE}
    assert set(Req) == known


# --- When the answer of a passive station begins, to the nanosecond, and what prevents it ---------------------------


PORTS = ["octets", "multidrop"]
HEARS_EDGES = ["octets", "bytewise", "telegram"]


# --- time -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("baud", BAUD_RATES)
@pytest.mark.parametrize("t_sdr", [None, 11, 12, 37, 60])
@pytest.mark.parametrize("octets", [DX_FIRST, STATUS, DIAG_FIRST])
def test_the_gate_opens_to_the_nanosecond(how: str, baud: int, t_sdr: int | None, octets: str) -> None:
    bench, _ = build(how, t_sdr=t_sdr, baud=baud)
    end = 10**9
    bench.say(octets, end)
    exact = end + round((t_sdr or 11) * 10**9 / baud)
    assert bench.port.wake_at() == exact
    assert bench.station.answer_at() == exact
    assert bench.port.take_tx(exact - 1) is None
    bench.run_until(end + 10**8)
    assert [at for at, _ in bench.sent] == [exact]


def test_a_wake_too_early_does_nothing(how: str) -> None:
    bench, _ = build(how)
    bench.say(DX_FIRST, 10**6)
    for early in (0, 1, 11 * BIT - 1):
        bench.port.wake(10**6 + early)
        assert bench.port.take_tx(10**6 + early) is None
    assert bench.port.take_tx(10**6 + 11 * BIT) is not None
    assert bench.port.take_tx(10**6 + 11 * BIT) is None
    assert bench.port.wake_at() == NEVER


def test_set_prm_moves_the_gate(how: str) -> None:
    bench, application = build(how, t_sdr=20)
    control = application.station
    assert control is bench.station
    expected = {0: 20, 11: 20, 20: 20, 21: 21, 255: 255, 1: 20}
    for (bits, gate), at in zip(expected.items(), times(), strict=False):
        control.set_min_tsdr(bits)
        bench.say(DX_FIRST, at)
        assert bench.station.answer_at() == at + gate * BIT
        if bits == 21:
            control.set_min_tsdr(0)  # keeps
            assert bench.station.answer_at() == at + 21 * BIT
        bench.run_until(at + 1_000 * BIT)


def test_a_response_time_under_11_bits_is_misuse() -> None:
    with pytest.raises(ConfigError, match="t_sdr = 10"):
        build("octets", t_sdr=10)


# --- answers that are not sent ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("second", [TOKEN, DX_TO_5, SC, "10 02 05 00 07 16", GC_ALL])
def test_an_answer_is_dropped_when_another_station_sends(how: str, second: str) -> None:
    bench, application = build(how, t_sdr=500)
    bench.say(DX_FIRST, 10**6)
    assert bench.answers(second, 10**6 + 400 * BIT) == []
    assert len(application.served) == 1
    assert bench.station.stats.dropped == 1


def test_a_repetition_before_the_answer_is_answered_once(how: str) -> None:
    bench, application = build(how, t_sdr=500)
    bench.say(DX_7D, 10**6)
    bench.say(DX_7D, 10**6 + 400 * BIT)
    bench.run_until(10**8)
    assert bench.sent == [(10**6 + 900 * BIT, DX_ANSWER)]
    assert len(application.served) == 1
    assert bench.station.stats.repeats == 1


def test_a_chunk_with_several_telegrams_is_answered_once() -> None:
    bench, application = build("octets", [Reply(Resp.DL, b"\x98"), Reply(Resp.DL, b"\x99")])
    assert bench.answers(f"{DX_5D} {DX_7D}", 10**6) == [DX_ANSWER]
    assert len(application.served) == 2
    assert bench.answers(f"{DX_5D} {TOKEN}", 10**8) == []


@pytest.mark.parametrize("how", HEARS_EDGES)
def test_a_start_edge_before_the_answer_drops_it(how: str) -> None:
    bench, _ = build(how, t_sdr=500)
    bench.say(DX_7D, 10**6)
    bench.station.activity(10**6 + 400 * BIT)
    bench.run_until(10**8)
    assert bench.sent == []
    # the kept answer is there when it is asked for again
    assert bench.answers(DX_7D, 2 * 10**8) == [DX_ANSWER]


@pytest.mark.parametrize("how", HEARS_EDGES)
def test_a_start_edge_before_a_request_means_nothing(how: str) -> None:
    bench, _ = build(how)
    bench.station.activity(10**6 - 110 * BIT)
    assert bench.answers(DX_7D, 10**6) == [DX_ANSWER]


def test_the_line_going_down_forgets_the_answer_and_the_frame_count(how: str) -> None:
    bench, application = build(how)
    for command, at in ((LineDown("gone"), 10**6), (LineUp(), 10**8)):
        bench.say(DX_7D, at)
        bench.port.command(command, at + 1)
        bench.run_until(at + 10**7)
    assert bench.sent == []
    assert bench.answers(DX_7D, 2 * 10**8) == [DX_ANSWER]
    assert len(application.served) == 3
    with pytest.raises(UsageError, match="knows no str"):
        bench.port.command("jump", 0)


def test_an_action_at_the_station_keeps_answer_and_frame_count(how: str) -> None:
    bench, application = build(how)
    times: list[int] = []
    bench.say(DX_7D, 10**6)
    bench.port.command(AtStation(times.append), 10**6 + 1)
    bench.run_until(10**7)
    assert [octets for _, octets in bench.sent] == [DX_ANSWER]
    assert bench.answers(DX_7D, 2 * 10**7) == [DX_ANSWER]  # repeated, not done again
    assert len(application.served) == 1
    assert times == [10**6 + 1]


# --- noise ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("how", PORTS)
def test_noise_behind_the_request_moves_the_gate(how: str) -> None:
    bench, _ = build(how)
    bench.say(DX_7D, 10**6)
    bench.say("00", 10**6 + 5 * BIT)
    bench.run_until(10**8)
    assert bench.sent == [(10**6 + 16 * BIT, DX_ANSWER)]


@pytest.mark.parametrize("how", PORTS)
def test_an_unfinished_telegram_holds_the_answer_until_it_stalls(how: str) -> None:
    bench, _ = build(how)
    bench.say(DX_7D, 10**6)
    bench.say("68", 10**6 + 5 * BIT)
    bench.run_until(10**8)
    assert bench.sent == [(10**6 + (5 + 33) * BIT, DX_ANSWER)]
    assert bench.port.decoder_stats.stalled == 1


@pytest.mark.parametrize("how", PORTS)
def test_an_answer_held_longer_than_the_slot_time_is_not_sent(how: str) -> None:
    bench, _ = build(how, patience=Patience(stall_ns=50_000_000))
    bench.say(DX_7D, 10**6)
    bench.say("68", 10**6 + 5 * BIT)
    bench.run_until(10**9)
    assert bench.sent == []
    assert bench.station.stats.dropped == 1


@pytest.mark.parametrize("how", PORTS)
def test_a_request_is_found_behind_a_telegram_that_stalls(how: str) -> None:
    bench, _ = build(how)
    bench.say("68 C8 C8 68 " + DX_7D, 10**6)
    bench.run_until(10**8)
    assert bench.sent == [(10**6 + 33 * BIT, DX_ANSWER)]  # T_SDR is over when it is found


def test_a_whole_telegram_ends_an_unfinished_one() -> None:
    bench, application = build("telegram")
    bench.station.receive(bytes.fromhex("68 C8 C8"), 10**6)
    assert bench.answers(DX_7D, 10**6 + 10 * BIT) == [DX_ANSWER]
    assert bench.port.decoder_stats.stalled == 1
    bench.station.receive(bytes.fromhex("68 C8 C8 68 " + DX_5D), 10**9)
    assert bench.answers(DX_7D, 10**9 + 10 * BIT) == [DX_ANSWER]
    assert len(application.served) == 3


def test_receiving_while_sending_implies_sent(how: str) -> None:
    bench, _ = build(how)
    bench.say(DX_5D, 10**6)
    bench.run_until(10**6 + 11 * BIT)
    assert len(bench.sent) == 1
    bench.port.sent(10**12)  # a port that guesses badly
    at = 10**6 + 1_000 * BIT
    assert bench.answers(DX_7D, at) == [DX_ANSWER]
    assert bench.sent[-1][0] == at + 11 * BIT


def test_damaged_requests_are_not_answered(how: str) -> None:
    if how == "telegram":
        return  # a medium never hands those over whole
    raw = bytes.fromhex(DX_7D)
    for bit in range(len(raw) * 8):
        damaged = bytearray(raw)
        damaged[bit // 8] ^= 1 << bit % 8
        bench, application = build(how)
        assert bench.answers(damaged.hex(), 10**6) == []
        assert application.served == []
        assert bench.port.decoder_stats.bad > 0
        assert bench.answers(DX_7D, 10**8) == [DX_ANSWER]
