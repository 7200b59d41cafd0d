"""The UART model by hand-counted bits: waveform, sampling at another rate, errors, characters across transmissions."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.phy.uart import Character, Receiver, waveform
from dpstack.units import BAUD_RATES, NEVER, chars_to_ns

TOKEN = b"\xdc\x02\x05"
RATES = st.sampled_from(BAUD_RATES)


def heard(octets: bytes, tx: int, rx: int) -> list[Character]:
    """What a receiver has of one transmission, its last character included."""
    receiver = Receiver(rx)
    return receiver.sample(0, waveform(octets), tx) + receiver.idle(receiver.due)


def test_the_bits_of_an_octet() -> None:
    #                                        start  data LSB first  even parity  stop
    assert waveform(b"\xdc") == b"00011101111"
    assert waveform(b"\x00\xff") == b"0000000000101111111101"
    assert waveform(b"\x01") == b"01000000011"


def test_noise_inverts_bits() -> None:
    assert waveform(b"\x00\x00", {1: 0b100_0000_0010}) == b"0000000000101000000000"


@pytest.mark.parametrize("rate", BAUD_RATES)
def test_at_the_senders_rate_all_octets_come_at_the_end_of_their_stop_bits(rate: int) -> None:
    octets = bytes(range(256))
    expected = [Character(chars_to_ns(n + 1, rate), n, False, False) for n in range(256)]
    for got, wanted in zip(heard(octets, rate, rate), expected, strict=True):
        assert got[1:] == wanted[1:]
        assert abs(got.at_ns - wanted.at_ns) <= 1  # the start edge is rounded, and so is the character


@pytest.mark.parametrize("off", [0.96, 0.98, 1.02, 1.04])
def test_a_clock_that_is_off_by_four_percent_reads_right(off: float) -> None:
    # 4.5 % is half a bit in eleven
    octets = bytes(range(256))
    assert bytes(c.octet for c in heard(octets, 500_000, round(500_000 * off)) if c.good) == octets


def test_double_rate_by_hand() -> None:
    # 00 sends 0 00000000 0 1: ten bits of space, twenty of the receiver: start, 8 x 0, parity 0, and no stop bit
    assert heard(b"\x00", 500_000, 1_000_000) == [Character(11_000, 0, False, True)]
    # FF: 0 11111111 0 1: start and d0 are space, d1..d7 and parity mark: seven bits and the parity bit, stop mark;
    # then, behind six more of mark, the parity bit: again d0 space and the rest idle
    assert heard(b"\xff", 500_000, 1_000_000) == [
        Character(11_000, 0xFE, False, False),
        Character(29_000, 0xFE, False, False),
    ]


def test_half_the_rate_by_hand() -> None:
    # FF 00 at 1 M: 0 11111111 0 1 0 00000000 0 1, sampled from bit 1 on at every second one: start? bit 1 is mark
    # already, so this was no start bit; the parity bit of FF neither; 00 is space for ten bits, which are five here
    assert heard(b"\xff\x00", 1_000_000, 500_000) == [Character(33_000, 0b1111_0000, True, False)]


def test_a_rate_ten_times_as_fast_sees_nothing_but_breaks() -> None:
    got = heard(bytes(range(16)), 9_600, 187_500)
    assert got
    assert all(c.framing_error and c.octet == 0 for c in got)


def test_after_a_bad_stop_bit_the_receiver_waits_for_mark() -> None:
    # 00 00 at 9600, heard at 19200: space to bit 20 of the receiver, mark to 22, then the second octet
    bit = 10**9 / 19_200
    got = heard(b"\x00\x00", 9_600, 19_200)
    assert [c.framing_error for c in got] == [True, True]
    assert [round(c.at_ns / bit) for c in got] == [11, 22 + 11]


def test_a_wrong_parity_bit() -> None:
    receiver = Receiver(500_000)
    got = receiver.sample(0, waveform(b"\x68\x16", {0: 0x200}), 500_000)
    assert [(c.octet, c.parity_error, c.framing_error, c.good) for c in got] == [
        (0x68, True, False, False),
        (0x16, False, False, True),
    ]


def test_a_character_reaches_beyond_the_end_of_a_transmission() -> None:
    receiver = Receiver(500_000)  # a bit is 2000 ns
    assert receiver.sample(0, waveform(b"\x00"), 3_000_000) == []  # space for 3333 ns, so start, d0, then idle
    assert receiver.due == 22_000
    assert receiver.idle(21_999) == []
    assert receiver.idle(22_000) == [Character(22_000, 0xFE, False, False)]
    assert receiver.due == NEVER


def test_a_transmission_falls_into_a_character_that_is_under_way() -> None:
    receiver = Receiver(500_000)
    assert receiver.sample(0, waveform(b"\x00"), 3_000_000) == []
    # samples at 5, 7, 9 ... us; the second 00 is space from 8 to 11.333 us: d3 and d4
    assert receiver.sample(8_000, waveform(b"\x00"), 3_000_000) == []
    assert receiver.idle(22_000) == [Character(22_000, 0b1110_0110, False, False)]
    # long over: the next one is for itself
    assert receiver.sample(100_000, waveform(TOKEN), 500_000)[0].octet == 0xDC


def test_a_short_dent_is_no_start_bit_and_a_second_one_in_time_makes_it_one() -> None:
    receiver = Receiver(9_600)  # looks 52 083 ns after the edge
    assert receiver.sample(0, waveform(TOKEN), 12_000_000) == []
    assert receiver.due == NEVER
    assert receiver.idle(10**9) == []
    assert receiver.sample(1_000_000, waveform(b"\x00"), 12_000_000) == []  # idle at the half bit of the first
    # space for 52 us around the half bit of the edge at 1 ms
    assert receiver.sample(1_040_000, waveform(b"\x00"), 500_000) == []
    assert receiver.due == 1_000_000 + 1_145_833
    receiver.reset()
    assert receiver.due == NEVER


def test_switched_on_in_the_middle_of_a_transmission() -> None:
    receiver = Receiver(500_000, since_ns=22_001)  # within the start bit of FF, whose edge is past
    # the parity bit of FF passes for a start bit; its stop bit, the start bit of 10 and 0000 1000 follow
    assert receiver.sample(0, waveform(b"\x68\xff\x10"), 500_000) == [Character(62_000, 0b0100_0001, False, True)]
    assert receiver.sample(200_000, waveform(b"\x10"), 500_000) == [Character(222_000, 0x10, False, False)]


@given(octets=st.binary(min_size=1, max_size=40), tx=RATES, rx=RATES)
def test_any_rate_hears_in_order_and_no_more_than_time_allows(octets: bytes, tx: int, rx: int) -> None:
    receiver = Receiver(rx)
    got = receiver.sample(0, waveform(octets), tx)
    got += receiver.idle(receiver.due)
    times = [c.at_ns for c in got]
    assert times == sorted(times)
    assert len(got) <= chars_to_ns(len(octets), tx) // (chars_to_ns(1, rx) * 21 // 22) + 1
    assert all(b - a >= chars_to_ns(1, rx) * 21 // 22 - 2 for a, b in pairwise(times))


@given(octets=st.binary(min_size=1, max_size=60))
def test_no_start_octet_is_ever_read_at_twice_the_rate_and_above(octets: bytes) -> None:
    """Each start octet has a single bit between two others: at double rate every bit is sampled twice at least."""
    for tx, rx in ((9_600, 19_200), (45_450, 93_750), (187_500, 500_000), (500_000, 1_500_000)):
        assert not {c.octet for c in heard(octets, tx, rx)} & {0x10, 0x68, 0xA2, 0xDC, 0xE5}
