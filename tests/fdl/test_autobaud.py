"""The search for the baud rate: literal octets for its rules, seeded runs behind a UART for what it is worth."""

from __future__ import annotations

from random import Random

import pytest
from baud_rig import TRAFFIC, Line, exchange, found, lone_token, upside_down
from hypothesis import given
from hypothesis import strategies as st
from support import instance

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.baud_search import AutoBaud, BaudFound, BaudNotFound, Confidence, Evidence, Missing
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.machine import LineDown, LineUp, pump
from dpstack.units import BAUD_RATES, NEVER, NS_PER_MS, NS_PER_S

STATUS = bytes.fromhex("10 05 02 49 50 16")
ANSWER = bytes.fromhex("10 02 05 00 07 16")
DIAG = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")
TOKEN = bytes.fromhex("DC 02 02")
S = NS_PER_S


def heard(octets: bytes) -> Evidence:
    evidence = Evidence(stall_ns=100_000)
    evidence.receive(octets, 0)
    return evidence


# --- the confidence rule ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("octets", "confidence", "run"),
    [
        (b"", None, 0),
        (STATUS, None, 1),
        (STATUS + ANSWER, Confidence.CHECKED, 2),
        (STATUS + STATUS, Confidence.CHECKED, 2),
        (DIAG + TOKEN + DIAG, Confidence.CHECKED, 3),
        (DIAG + b"\xe5" + DIAG, Confidence.CHECKED, 3),
        (TOKEN + TOKEN, None, 2),
        (TOKEN + TOKEN + TOKEN, Confidence.TOKEN, 3),
        # a ring of two, and a master that passes to another one because the first is gone
        (bytes.fromhex("DC0502 DC0205 DC0502 DC0205 DC0502"), Confidence.TOKEN, 5),
        (bytes.fromhex("DC0502 DC0502 DC0502 DC0202"), Confidence.TOKEN, 4),
        # begun in the middle of a telegram
        (DIAG[5:] + STATUS + ANSWER, Confidence.CHECKED, 2),
        (TOKEN[1:] + TOKEN * 3, Confidence.TOKEN, 3),
        # something is left over in between
        (STATUS + b"\x00" + ANSWER, None, 1),
        (TOKEN * 2 + b"\x02" + TOKEN * 2, None, 2),
        (STATUS + DIAG[:-1] + b"\x00" + STATUS, None, 1),
        # an acknowledgement of nothing, tokens of nobody
        (STATUS + TOKEN + b"\xe5" + STATUS, None, 2),
        (b"\xe5" * 50, None, 1),
        (bytes.fromhex("DC0502 DC0704 DC0502 DC0704 DC0502 DC0704"), None, 1),
        # three of the same, but others than the same between them that do not follow
        (TOKEN + bytes.fromhex("DC0907") + TOKEN + bytes.fromhex("DC0907") + TOKEN, None, 1),
    ],
)
def test_the_telegrams_that_a_rate_is_recognised_by(octets: bytes, confidence: Confidence | None, run: int) -> None:
    evidence = heard(octets)
    assert (evidence.confidence, evidence.run) == (confidence, run)
    piecewise = Evidence(stall_ns=100_000)
    for at in range(len(octets)):
        piecewise.receive(octets[at : at + 1], 0)
    assert (piecewise.confidence, piecewise.run) == (confidence, run)


def test_clean_octets_are_no_evidence() -> None:
    evidence = heard(bytes(range(0x20, 0x60)) * 10)
    assert evidence.confidence is None
    assert not evidence.nearly_recognised
    assert evidence.unassigned == evidence.octets == 640


def test_a_telegram_that_stalls_breaks_the_run() -> None:
    evidence = heard(STATUS + DIAG[:6])
    assert evidence.nearly_recognised
    assert evidence.stall_at() == 100_000
    evidence.wake(99_999)
    assert evidence.run == 1
    evidence.wake(100_000)
    assert evidence.run == 0
    assert evidence.unassigned == 6


def test_whole_telegrams_from_the_medium_count_and_end_unfinished_ones() -> None:
    token = Telegram(Kind.SD4, 2, 2)
    evidence = Evidence(stall_ns=100_000)
    found = []
    for _ in range(3):
        evidence.telegram(token, 0)
        found.append(evidence.confidence)
    assert found == [None, None, Confidence.TOKEN]
    evidence.receive(DIAG[:6], 0)
    evidence.telegram(token, 0)
    assert evidence.run == 1
    assert evidence.confidence is None


# --- the search -------------------------------------------------------------------------------------------------------


def rates_of(search: AutoBaud, until: int) -> list[int]:
    """The rates it listens at up to ``until`` on a silent line."""
    rates = [search.baud]
    while search.wake_at() <= until and search.result is None:
        search.wake(search.wake_at())
        if search.baud != rates[-1]:
            rates.append(search.baud)
    return rates


def test_from_the_fastest_to_the_slowest_and_again() -> None:
    down = sorted(BAUD_RATES, reverse=True)
    assert rates_of(AutoBaud(0), 8 * S)[:22] == down + down
    assert rates_of(AutoBaud(0, rates=(19_200, 500_000, 93_750)), 8 * S)[:4] == [500_000, 93_750, 19_200, 500_000]


def test_the_dwell_scales_with_the_rate_and_the_ports_lateness() -> None:
    search = AutoBaud(0, rates=(500_000, 9_600), slack_ns=50 * NS_PER_MS, settle_ns=5 * NS_PER_MS)
    assert search.wake_at() == (55 + 24) * NS_PER_MS  # 12 000 bits of 2 us
    search.wake(search.wake_at())
    assert search.baud == 9_600
    assert search.wake_at() == (55 + 24 + 55 + 1250) * NS_PER_MS


def test_a_dwell_with_a_telegram_in_it_is_extended_once() -> None:
    search = AutoBaud(0, rates=(500_000, 9_600))
    search.receive(STATUS, 20 * NS_PER_MS)
    search.wake(24 * NS_PER_MS)
    assert search.baud == 500_000
    assert search.wake_at() == 48 * NS_PER_MS
    search.wake(48 * NS_PER_MS)
    assert search.baud == 9_600


def test_three_hundred_octets_without_a_telegram_end_the_dwell() -> None:
    search = AutoBaud(0)
    search.receive(bytes(299), 1)
    assert search.baud == 12_000_000
    search.receive(bytes(1), 2)
    assert search.baud == 6_000_000
    assert search.tried == 2


def test_the_result_is_reported_once_and_nothing_is_sent() -> None:
    search = AutoBaud(0, rates=(500_000,))

    def transmit(octets: bytes, now: int) -> int:
        raise AssertionError(f"sent {octets.hex(' ')} at {now}")

    assert pump(search, STATUS + ANSWER, 1000, transmit) == NEVER
    wanted = BaudFound(t_ns=1000, baud=500_000, listened_ns=1000, confidence=Confidence.CHECKED, telegrams=2, tried=1)
    assert search.result == wanted
    assert search.take_events() == [wanted]
    assert search.take_events() == []
    assert "500 kbit/s" in wanted.text
    for late in (STATUS, ANSWER):
        search.receive(late, 2000)
    search.telegram(Telegram(Kind.SD4, 2, 2), 2000)
    search.wake(3000)
    assert search.result == wanted


def test_octets_that_were_under_way_when_the_rate_changed_are_not_judged() -> None:
    search = AutoBaud(0, rates=(500_000,), settle_ns=5000)
    search.receive(STATUS + ANSWER, 4999)
    search.telegram(Telegram(Kind.SD1, 5, 2, 0x49), 4999)
    assert search.result is None
    search.receive(STATUS + ANSWER, 5000)
    assert search.result is not None


def test_a_rate_that_the_port_refuses_is_left_out() -> None:
    search = AutoBaud(0, rates=(12_000_000, 500_000, 9_600))
    search.refused(0)
    assert (search.baud, search.tried) == (500_000, 1)
    search.wake(search.wake_at())
    search.refused(0)
    assert search.baud == 500_000
    with pytest.raises(ConfigError, match="none of the rates"):
        search.refused(0)


def test_a_line_that_vanishes_begins_the_dwell_anew() -> None:
    search = AutoBaud(0, rates=(500_000,))
    search.receive(STATUS, 1000)
    search.command(LineDown("unplugged"), 2000)
    search.command(LineUp(), S)
    search.receive(ANSWER, S + 1000)
    assert search.result is None
    assert search.tried == 1
    with pytest.raises(UsageError, match="knows no str"):
        search.command("faster", 0)


@pytest.mark.parametrize("rates", [(), (115_200,), (9_600, 1)])
def test_impossible_rates(rates: tuple[int, ...]) -> None:
    with pytest.raises(ConfigError, match="give some of"):
        AutoBaud(0, rates=rates)


@given(st.lists(st.tuples(st.binary(max_size=40), st.integers(0, 300 * NS_PER_MS)), max_size=40))
def test_nothing_on_the_line_makes_it_raise_or_stand_still(steps: list[tuple[bytes, int]]) -> None:
    search = AutoBaud(0, silence_ns=5 * S, limit_ns=20 * S)
    now = 0
    for chunk, pause in steps:
        now += pause
        search.receive(chunk, now)
        while search.wake_at() <= now:
            before = search.wake_at()
            search.wake(now)
            assert search.wake_at() > before
        assert search.baud in BAUD_RATES
    while search.result is None:
        search.wake(search.wake_at())


# --- giving up --------------------------------------------------------------------------------------------------------


def give_up(search: AutoBaud) -> BaudNotFound:
    while search.result is None:
        search.wake(search.wake_at())
    return instance(search.result, BaudNotFound)


def test_a_silent_bus() -> None:
    result = give_up(AutoBaud(7, silence_ns=5 * S))
    assert (result.why, result.t_ns, result.octets, result.complete) == (Missing.SILENCE, 5 * S + 7, 0, True)
    assert "silence: no octet in 5.0 s" in result.text
    assert "no turn" not in result.text


def test_too_short_for_all_rates() -> None:
    result = give_up(AutoBaud(0, limit_ns=S))
    assert not result.complete
    assert "the rates below 19.2 kbit/s had no turn" in result.text


def test_a_few_octets_at_one_rate_are_no_proof_of_a_silent_bus() -> None:
    search = AutoBaud(0, silence_ns=S // 2)
    search.receive(b"\x00", 400 * NS_PER_MS)
    search.wake(S // 2)
    assert search.result is None  # it is not the end of the silence, which begins anew
    result = give_up(search)
    assert (result.why, result.octets, result.t_ns) == (Missing.NOISE, 1, 900 * NS_PER_MS)


@pytest.mark.parametrize("rate", [9_600, 45_450, 500_000, 12_000_000])
def test_a_reversed_cable(rate: int) -> None:
    rng = Random(rate)
    line = Line(rate, exchange(rng), rng, wiring=upside_down)
    search = AutoBaud(line.begun_ns, limit_ns=S // 2)
    line.listen(search)
    assert isinstance(search.result, BaudNotFound)
    assert search.result.why is Missing.NOISE
    assert "reversed" in search.result.text


# --- what it is worth -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", BAUD_RATES)
@pytest.mark.parametrize("seeds", [range(16), pytest.param(range(1000), marks=pytest.mark.soak)], ids=str)
def test_every_rate_from_any_traffic(rate: int, seeds: range) -> None:
    """The right rate, with at most 50 telegrams passing for each rate tried."""
    for seed in seeds:
        traffic = TRAFFIC[seed % len(TRAFFIC)]
        search, line = found(rate, traffic, seed)
        where = f"{traffic.__name__} at {rate}, seed {seed}"
        assert isinstance(search.result, BaudFound), where
        assert search.result.baud == rate, where
        assert line.telegrams <= 50 * search.tried, where


#: from twice the true rate up nothing can be read at all (tests/phy)
PAIRS = [(rate, wrong) for rate in BAUD_RATES for wrong in BAUD_RATES if wrong != rate and wrong < 2 * rate]


@pytest.mark.parametrize(("rate", "wrong"), PAIRS)
@pytest.mark.parametrize(
    "seeds",
    [range(len(PAIRS) % 5, len(PAIRS) % 5 + 2), pytest.param(range(250), marks=pytest.mark.soak)],
    ids=str,
)
def test_a_wrong_rate_is_never_recognised(rate: int, wrong: int, seeds: range) -> None:
    """Listening at ``wrong`` only, the search recognises nothing however long."""
    for seed in seeds:
        traffic = TRAFFIC[seed % len(TRAFFIC)]
        rng = Random(f"{rate} {wrong} {seed}")
        line = Line(rate, traffic(rng), rng)
        search = AutoBaud(line.begun_ns, rates=(wrong,))
        line.listen(search, most=min(3000, max(200, 40 * rate // wrong)))
        assert search.result is None, f"{traffic.__name__} at {rate} heard at {wrong}, seed {seed}"


@pytest.mark.soak
@pytest.mark.parametrize(("rate", "wrong"), [pair for pair in PAIRS if pair[0] < 64 * pair[1]])
def test_no_lone_token_of_any_master_is_read_at_a_wrong_rate(rate: int, wrong: int) -> None:
    """The weakest of the rules, exhausted: every address, idle times as masters have them, exact clocks."""
    for address in range(126):
        for idle in (33, 37, 38, 76, 100):
            line = Line(rate, iter([(idle, bytes((0xDC, address, address)))] * 2000), Random(1))
            line.baud = rate
            search = AutoBaud(line.begun_ns, rates=(wrong,))
            line.listen(search, most=max(60, 30 * rate // wrong))
            assert search.result is None, f"token of {address}, idle {idle}, at {rate} heard at {wrong}"


@pytest.mark.parametrize("rate", [9_600, 500_000, 12_000_000])
def test_noise_on_the_line_delays_it_only(rate: int) -> None:
    for seed in range(5):
        search, _ = found(rate, exchange, seed, flip_rate=1e-3)
        assert instance(search.result, BaudFound).baud == rate


@pytest.mark.parametrize("rate", [93_750, 500_000, 12_000_000])
def test_a_bus_that_begins_later_is_found_in_a_later_sweep(rate: int) -> None:
    rng = Random(rate)
    line = Line(rate, lone_token(rng), rng)
    rates = (93_750, 500_000, 12_000_000)
    search = AutoBaud(line.begun_ns - 10 * S, rates=rates)
    while search.wake_at() < line.begun_ns:
        search.wake(search.wake_at())
    line.listen(search)
    assert instance(search.result, BaudFound).baud == rate
    assert search.tried > len(rates)
