"""When the answer of a passive station begins, to the nanosecond, and what prevents it."""

from __future__ import annotations

import pytest

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.commands import AtStation
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Resp
from dpstack.machine import LineDown, LineUp
from dpstack.phy.patience import Patience
from dpstack.units import BAUD_RATES, NEVER
from tests.fdl.passive_kit import (
    BIT,
    DIAG_FIRST,
    DX_5D,
    DX_7D,
    DX_ANSWER,
    DX_FIRST,
    DX_TO_5,
    GC_ALL,
    SC,
    STATUS,
    TOKEN,
    build,
    times,
)

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
