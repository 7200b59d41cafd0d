"""Slack of ports, counted by hand: time-outs, bus time of silent polls, and the T_SL that other masters need."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.errors import ConfigError
from dpstack.params import BusParams
from dpstack.phy.neighbours import Neighbours, t_sl_of_answers
from dpstack.phy.noise import BitNoise
from dpstack.phy.patience import ADAPTER, EXACT, HOST, Patience, measured, slack
from dpstack.phy.uart import flipped

MS = 1_000_000
PARAMS = BusParams.preset(500_000, address=4)  # a bit is 2 us; T_SL 200, T_ID1 37, max T_SDR 100


def test_the_slack_of_the_kinds_of_port() -> None:
    assert (EXACT.known_ns, EXACT.unknown_ns, EXACT.unknown_divisor, EXACT.stall_ns, EXACT.sending_ns) == (0,) * 5
    assert (HOST.known_ns, HOST.unknown_ns, HOST.unknown_divisor) == (50 * MS, 2 * MS, 100)
    assert (HOST.stall_ns, HOST.sending_ns) == (50 * MS, 0)
    assert (ADAPTER.known_ns, ADAPTER.unknown_ns, ADAPTER.unknown_divisor) == (60 * MS, 20 * MS, 100)
    assert (ADAPTER.stall_ns, ADAPTER.sending_ns) == (20 * MS, MS)


@pytest.mark.parametrize(
    ("p999_ns", "known_ns", "unknown_ns"),
    [
        (0, 20 * MS, 2 * MS),
        (2 * MS, 20 * MS, 2 * MS),
        (2 * MS + 1, 20 * MS, 2 * MS + 1),
        (7 * MS, 21 * MS, 7 * MS),
        (20 * MS, 60 * MS, 20 * MS),
        (20 * MS + 1, 60 * MS, 20 * MS),
        (500 * MS, 60 * MS, 20 * MS),
    ],
)
def test_the_slack_of_a_measured_adapter(p999_ns: int, known_ns: int, unknown_ns: int) -> None:
    found = measured(p999_ns)
    assert found == Patience(
        known_ns=known_ns, unknown_ns=unknown_ns, unknown_divisor=100, stall_ns=20 * MS, sending_ns=MS
    )


def test_the_slack_that_a_user_sets() -> None:
    for port, sending_ns in ((EXACT, 0), (ADAPTER, MS)):
        assert slack(9 * MS, port) == Patience(
            known_ns=9 * MS, unknown_ns=9 * MS, unknown_divisor=100, stall_ns=9 * MS, sending_ns=sending_ns
        )
    assert slack(9 * MS).sending_ns == 0


def test_the_time_out_of_a_silent_poll() -> None:
    assert HOST.silent_ns(PARAMS) == (200 + 11) * 2_000 + 2 * MS


@pytest.mark.parametrize(
    ("unknown_divisor", "polls", "cost_ns", "divisor"),
    [
        (0, 126, MS, 0),  # no limit
        (100, 126, MS, 23),  # 126 ms in 3 s
        (100, 300, MS, 10),
        (100, 301, MS, 10),  # a tenth of the bus at most
        (100, 6, MS, 100),  # 6 ms in 3 s would be 1/500
        (100, 0, MS, 100),
        (100, 3, 0, 100),
        (5, 6, MS, 10),
    ],
)
def test_the_bus_time_of_gap_polls(unknown_divisor: int, polls: int, cost_ns: int, divisor: int) -> None:
    assert Patience(unknown_divisor=unknown_divisor).gap_divisor(polls, cost_ns) == divisor


# --- other masters ---------------------------------------------------------------------------------------------------
LATE = Patience(known_ns=4 * MS, unknown_ns=1 * MS + 1, sending_ns=MS)


@pytest.mark.parametrize(
    ("patience", "lowest", "t_sl"),
    [
        (HOST, 0, 0),  # programs on ports without a wire
        (Patience(sending_ns=1), 0, 100 + 15),  # max T_SDR
        (LATE, 0, 501 + 100 + 15),  # 1 ms and 1 ns are 501 bits; 5 T_SL > 5 ms: 501 bits
        (Patience(known_ns=9 * MS, unknown_ns=MS, sending_ns=MS), 0, 1001),  # 5 T_SL > 10 ms: 5000 bits / 5 + 1
        (Patience(known_ns=9 * MS, unknown_ns=MS, sending_ns=MS), 1, 5000 // 7 + 1),
        (Patience(known_ns=9 * MS, unknown_ns=MS, sending_ns=MS), 9, 615),
    ],
)
def test_the_slot_time_that_other_masters_need(patience: Patience, lowest: int, t_sl: int) -> None:
    assert Neighbours(PARAMS, patience, lowest).t_sl == t_sl


def test_answers_need_the_longer_of_idle_time_and_station_delay() -> None:
    assert t_sl_of_answers(PARAMS.replace(extra_idle=100), Patience(sending_ns=1)) == 137 + 15
    assert t_sl_of_answers(PARAMS, Patience(unknown_ns=2_000, sending_ns=1)) == 1 + 100 + 15
    assert t_sl_of_answers(PARAMS, Patience(unknown_ns=2_000)) == 0


def test_silence_and_claim_of_the_lowest_master() -> None:
    neighbours = Neighbours(PARAMS, LATE, 3)
    assert neighbours.silence_ns == 200 * 2_000 + 5 * MS + 1
    assert neighbours.t_to_ns == (6 + 2 * 3) * 200 * 2_000
    assert Neighbours(PARAMS, LATE).lowest == 0


def test_the_fastest_rate_that_leaves_room_for_other_masters() -> None:
    """T_SL is 16383 bits at most: 20 ms of delay are 10 000 bits at 500 kbit/s and 30 000 at 1.5 Mbit/s."""
    assert Neighbours(BusParams.preset(12_000_000, address=4), ADAPTER).fastest() == 500_000
    assert Neighbours(PARAMS, Patience(unknown_ns=10**10, sending_ns=1)).fastest() == 0
    there = Neighbours(PARAMS, ADAPTER, 2).at(1_500_000)
    assert (there.params.baud, there.params.address, there.lowest) == (1_500_000, 4, 2)
    assert there.patience is ADAPTER


@pytest.mark.parametrize(
    ("params", "patience", "lowest", "advice"),
    [
        (PARAMS, Patience(unknown_ns=85 * 2_000, sending_ns=1), 0, ""),  # 85 + 100 + 15 = T_SL
        (
            PARAMS,
            Patience(unknown_ns=86 * 2_000, sending_ns=1),
            0,
            "other masters need t_sl = 201 (0.402 ms at 500 kbit/s) or more, this one has 200: over this port the first"
            " octet after a token comes up to 0.172 ms late (measured, or host_slack_ms), where they wait 0.4 ms; set "
            "t_sl on all of them",
        ),
        (
            PARAMS,
            Patience(known_ns=2 * MS, unknown_ns=172_000, sending_ns=1),
            0,
            "other masters need t_sl = 218 (0.436 ms at 500 kbit/s) or more, this one has 200: over this port the first"
            " octet after a token comes up to 0.172 ms late (measured, or host_slack_ms), where they wait 0.4 ms, and "
            "while it waits 2.57 ms for a silent station master 0 claims the token after 2.4 ms; set t_sl on all of "
            "them",
        ),
        (
            BusParams.preset(1_500_000, address=4),
            ADAPTER,
            5,
            "no other master can share the bus at 1.5 Mbit/s: over this port the first octet after a token comes up to "
            "20 ms late (assumed until it is measured), where they wait 0.2 ms, and while it waits 80.2 ms for a silent"
            " station master 5 claims the token after 3.2 ms; take an adapter that is faster, or 500 kbit/s at most",
        ),
        (
            PARAMS,
            Patience(unknown_ns=10**10, sending_ns=1),
            100,
            "no other master can share the bus at 500 kbit/s: over this port the first octet after a token comes up to "
            "10000 ms late (measured, or host_slack_ms), where they wait 0.4 ms, and while it waits 10000 ms for a "
            "silent station master 100 claims the token after 82.4 ms; take an adapter that is faster",
        ),
    ],
)
def test_the_advice(params: BusParams, patience: Patience, lowest: int, advice: str) -> None:
    assert Neighbours(params, patience, lowest).advice() == advice


# --- noise -----------------------------------------------------------------------------------------------------------
def test_no_noise_flips_nothing() -> None:
    assert BitNoise(0, Random(1)).flips(100_000) == {}


@pytest.mark.parametrize("rate", [-1e-9, 1.0, 1.5])
def test_a_rate_is_a_probability(rate: float) -> None:
    with pytest.raises(ConfigError) as refused:
        BitNoise(rate, Random(1))
    assert str(refused.value) == f"error rate {rate} is a probability per bit: 0 <= P < 1, for instance 1e-4"


class _Draws(Random):
    """The next draws are the distances of the errors: with P = 1/2 a draw of 1 - 2^-n is the distance n."""

    def __init__(self, *distances: int) -> None:
        super().__init__(0)
        self.draws = [1 - 2.0**-n for n in distances]

    def random(self) -> float:
        return self.draws.pop(0) if self.draws else 1 - 2.0**-50


@pytest.mark.parametrize("sizes", [[9], [1, 1, 1, 6], [2, 0, 7]])
def test_errors_lie_where_they_were_drawn_however_the_octets_are_divided(sizes: list[int]) -> None:
    """3 sound bits and an error (bit 3), 7 (bit 11), 0 (12), 9 (22), 32 (55)."""
    noise = BitNoise(0.5, _Draws(3, 7, 0, 9, 32))
    found: dict[int, int] = {}
    before = 0
    for size in sizes:
        found.update({number + before: mask for number, mask in noise.flips(size).items()})
        before += size
    assert found == {0: 1 << 3, 1: 1 << 0 | 1 << 1, 2: 1 << 0, 5: 1 << 0}


@given(st.integers(0, 255), st.integers(0, 0x7FF))
def test_the_octet_that_a_receiver_with_parity_keeps(octet: int, flips: int) -> None:
    """A character is start 0, eight data bits with the lowest first, even parity, stop 1."""
    bits = [0, *(octet >> n & 1 for n in range(8)), octet.bit_count() & 1, 1]
    noisy = [bit ^ flips >> n & 1 for n, bit in enumerate(bits)]
    kept = noisy[0] == 0 and noisy[10] == 1 and sum(noisy[1:10]) % 2 == 0
    assert flipped(octet, flips) == (sum(bit << n for n, bit in enumerate(noisy[1:9])) if kept else None)
