"""Bursts of noise and lost octets against a model that goes bit by bit, and the draws of the random numbers."""

from __future__ import annotations

import math
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.errors import ConfigError
from dpstack.params import BusParams
from dpstack.phy.line import Line
from dpstack.phy.marked import PACKET_NOTE, MarkedOctets
from dpstack.phy.neighbours import Neighbours
from dpstack.phy.noise import BitNoise, Bursts, LostOctets
from dpstack.phy.patience import ADAPTER, EXACT, Patience, slack
from dpstack.phy.uart import DATA_BITS, PARITY_BIT, START_BIT, STOP_BIT, Character, Receiver, waveform
from dpstack.units import NEVER


class Scripted(Random):
    """The begins of bursts at the given distances (P = 1/2), and the bits of a burst in turn."""

    def __init__(self, distances: list[int], bits: list[int]) -> None:
        super().__init__(0)
        self.draws = [1 - 2.0**-n for n in distances]
        self.bits = bits
        self.asked: list[int] = []

    def random(self) -> float:
        return self.draws.pop(0) if self.draws else 1 - 2.0**-52

    def getrandbits(self, k: int, /) -> int:
        self.asked.append(k)
        return self.bits.pop(0)


@examples(60)
@given(
    distances=st.lists(st.integers(0, 30), max_size=4),
    length=st.integers(1, 25),
    sizes=st.lists(st.integers(0, 4), min_size=1, max_size=4),
    seed=st.integers(0, 99),
)
def test_a_burst_goes_on_over_octets_and_telegrams(
    distances: list[int], length: int, sizes: list[int], seed: int
) -> None:
    rng = Random(seed)
    script = [rng.getrandbits(1) for _ in range(11 * sum(sizes))]
    made = Scripted(distances, list(script))
    noise = Bursts(0.5, length, made)
    begins, at = set(), 0
    for distance in [*distances, 52, 52, 52, 52]:  # 176 bits at most
        at += distance
        begins.add(at)
        at += 1
    left, used, bit = 0, 0, 0
    for size in sizes:
        expected: dict[int, int] = {}
        for number in range(size):
            for place in range(11):
                if bit in begins:
                    left = length
                if left:
                    left -= 1
                    if script[used]:
                        expected[number] = expected.get(number, 0) + 2**place
                    used += 1
                bit += 1
        assert noise.flips(size) == expected
    assert made.asked == [1] * used


def test_a_burst_that_begins_again_lasts_its_whole_time_again() -> None:
    """Begins at bits 2 and 5, six bits each: bits 2 to 10 are disturbed, all of them inverted here."""
    noise = Bursts(0.5, 6, Scripted([2, 2], [1] * 9))
    assert noise.flips(3) == {0: 0b111_1111_1100}
    assert noise.flips(1) == {}


@pytest.mark.parametrize("rate", [-0.1, 1.0])
def test_a_burst_has_a_probability(rate: float) -> None:
    with pytest.raises(ConfigError, match="is a probability per bit"):
        Bursts(rate, 5, Random(1))


def test_an_octet_is_lost_below_its_probability() -> None:
    class Draws(Random):
        def random(self) -> float:
            return draws.pop(0)

    draws = [0.25, 0.249, 0.9, 0.0, 0.1]
    lost = LostOctets(0.25, Draws(0))
    assert lost.flips(3) == {1: 1}
    assert lost.flips(0) == {}
    assert lost.flips(2) == {0: 1, 1: 1}
    assert draws == []


@pytest.mark.parametrize("rate", [1e-9, 0.001, 0.3, 0.9])
def test_the_distance_to_an_error_is_geometric(rate: float) -> None:
    """The number of sound bits is that of a draw u with (1 - P)^n >= 1 - u > (1 - P)^(n + 1)."""
    noise = BitNoise(rate, Random(5))
    again, at, expected = Random(5), -1, set()
    bits = min(int(20 / rate), 11 * 2_000)
    while at < bits:
        u = again.random()
        n = max(0, int(math.log(1 - u) / math.log(1 - rate)) - 2)
        while math.log1p(-rate) * (n + 1) >= math.log1p(-u):
            n += 1
        at += 1 + n
        expected.add(at)
    found = noise.flips(bits // 11)
    places = {11 * number + bit for number, mask in found.items() for bit in range(11) if mask >> bit & 1}
    assert places == {place for place in expected if place < bits // 11 * 11}
    assert noise.per_bit == rate


def test_no_noise_draws_no_number() -> None:
    class Never(Random):
        def random(self) -> float:
            raise AssertionError

    noise = BitNoise(0, Never(0))
    assert (noise.per_bit, noise.flips(5)) == (0, {})


def test_the_masks_of_a_character() -> None:
    assert (START_BIT, DATA_BITS, PARITY_BIT, STOP_BIT) == (1, 0b1_1111_1110, 1 << 9, 1 << 10)
    for bit in range(11):
        levels = bytearray(b"00000000001")
        levels[bit] ^= 1
        assert waveform(b"\x00", {0: 1 << bit}) == bytes(levels)
    assert waveform(b"", {}) == waveform(b"") == b""
    assert waveform(b"\x00", {}) == b"00000000001"


# --- the line, and receivers at their edges --------------------------------------------------------------------------
def test_the_times_of_a_line() -> None:
    """A bit is 2 us: T_ID1 37, T_ID2 100, T_SL 200, min T_SDR 11, T_TO (6 + 2 n) T_SL, 33 bits to stall."""
    line = Line(BusParams.preset(500_000, address=4), 9)
    times = (line.t_id1_ns, line.t_id2_ns, line.t_sl_ns, line.t_sdr_ns, line.t_to_ns, line.t_stall_ns)
    assert times == (74_000, 200_000, 400_000, 22_000, 14 * 400_000, 66_000)
    assert line.idle_since == 9
    line.note_activity(8)
    assert line.idle_since == 9
    line.note_activity(10)
    assert line.idle_since == 10
    line.set_params(BusParams.preset(500_000, address=0).replace(min_tsdr=20))
    assert (line.t_sdr_ns, line.t_to_ns, line.idle_since) == (40_000, 6 * 400_000, 10)


def test_a_receiver_that_is_switched_on_at_a_bit() -> None:
    """0x0F then 0x55 at 500 kbit/s; an edge counts from the time on at which the receiver listens."""
    levels = waveform(b"\x0f\x55")
    for since, octets in ((0, b"\x0f\x55"), (-5, b"\x0f\x55"), (20_000, b"\x55"), (21_999, b"\x55"), (44_000, b"")):
        receiver = Receiver(500_000, since)
        assert bytes(c.octet for c in receiver.sample(0, levels, 500_000)) == octets
        assert receiver.due == NEVER


def test_a_line_that_is_mark_has_no_character() -> None:
    receiver = Receiver(500_000)
    assert receiver.sample(0, b"11111", 500_000) == []
    assert receiver.sample(10_000, b"", 500_000) == []
    assert receiver.due == NEVER
    # mark first, and a start bit as the third one
    (only,) = receiver.sample(20_000, b"11" + waveform(b"\x41"), 500_000)
    assert only == (20_000 + 4_000 + 22_000, 0x41, False, False)


# --- slack -----------------------------------------------------------------------------------------------------------
def test_defaults_of_slack_and_neighbours() -> None:
    assert Patience() == EXACT
    assert slack(0) == Patience(unknown_divisor=100)
    with pytest.raises(AttributeError):
        ADAPTER.known_ns = 1  # type: ignore[misc]
    with pytest.raises(AttributeError):
        Neighbours(BusParams.preset(500_000), EXACT).lowest = 1  # type: ignore[misc]
    with pytest.raises(TypeError):
        Patience(1)  # type: ignore[call-arg]


# --- Octets that a port has marked as damaged: the marks move with the octets; and the UART between two transmissions


@st.composite
def pieces(draw: st.DrawFn) -> tuple[bytes, list[bool], bool | None]:
    """Octets, a mark for each, and whether whole packets are marked (None: plain octets)."""
    octets = draw(st.binary(max_size=4))
    packets = draw(st.sampled_from([None, False, True]))
    marks = [packets is not None and draw(st.booleans()) for _ in octets]
    return octets, marks, packets


@examples(50)
@given(st.lists(pieces(), min_size=1, max_size=5), st.booleans())
def test_joined_octets_keep_their_marks(parts: list[tuple[bytes, list[bool], bool | None]], from_left: bool) -> None:
    made = [
        octets
        if packets is None
        else MarkedOctets(octets, tuple(n for n, mark in enumerate(marks) if mark), packets=packets)
        for octets, marks, packets in parts
    ]
    joined = made[0]
    if from_left:
        for piece in made[1:]:
            joined = joined + piece
    else:
        joined = made[-1]
        for piece in reversed(made[:-1]):
            joined = piece + joined
    assert bytes(joined) == b"".join(octets for octets, _, _ in parts)
    marks = [mark for _, some, _ in parts for mark in some]
    kinds = [packets for _, _, packets in parts if packets is not None]
    assert isinstance(joined, MarkedOctets) is bool(kinds)
    if isinstance(joined, MarkedOctets):
        assert joined.marks == tuple(n for n, mark in enumerate(marks) if mark)
        assert joined.packets is any(kinds)


def test_marks_by_themselves() -> None:
    marked = MarkedOctets(b"\x01\x02", (1,))
    assert (marked, marked.marks, marked.packets) == (b"\x01\x02", (1,), False)
    plain = bytearray(b"\x00")
    plain += marked
    assert plain == b"\x00\x01\x02"
    with pytest.raises(TypeError):
        "x" + marked  # type: ignore[operator]
    assert PACKET_NOTE == (
        "the port marks whole packets: at least one octet of this packet was damaged, perhaps not here"
    )


def test_a_receiver_without_a_character() -> None:
    receiver = Receiver(500_000)
    assert (receiver.baud, receiver.due, receiver.idle(10**9)) == (500_000, NEVER, [])
    assert receiver.sample(1_000, waveform(b"\x55"), 500_000) == [Character(23_000, 0x55, False, False)]
    assert receiver.idle(10**9) == []
    receiver.sample(50_000, waveform(b"\x00"), 3_000_000)
    assert receiver.due == 72_000
    receiver.reset()
    assert (receiver.due, receiver.idle(10**9)) == (NEVER, [])


@pytest.mark.parametrize(
    ("octet", "parity_error", "framing_error", "good"),
    [(5, False, False, True), (5, True, False, False), (5, False, True, False)],
)
def test_a_good_character_has_no_error(octet: int, parity_error: bool, framing_error: bool, good: bool) -> None:
    assert Character(7, octet, parity_error, framing_error).good is good


@examples(50)
@given(st.lists(st.tuples(st.binary(min_size=1, max_size=3), st.integers(0, 60)), min_size=1, max_size=5))
def test_transmissions_one_after_the_other_are_heard_as_sent(parts: list[tuple[bytes, int]]) -> None:
    """At the sender's rate, with pauses in bits."""
    receiver, at, heard = Receiver(9_600), 0, []
    for octets, pause in parts:
        start = (at * 10**9 + 4_800) // 9_600
        heard += receiver.sample(start, waveform(octets), 9_600)
        at += 11 * len(octets) + pause
    heard += receiver.idle(10**15)
    assert bytes(character.octet for character in heard) == b"".join(octets for octets, _ in parts)
    assert all(character.good for character in heard)


def test_a_line_has_the_rate_of_its_parameters() -> None:
    line = Line(BusParams.preset(9_600))
    assert (line.idle_since, line._baud) == (0, 9_600)
