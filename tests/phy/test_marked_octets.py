"""Octets that a port has marked as damaged: the marks move with the octets; and the UART between two transmissions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples

from dpstack.params import BusParams
from dpstack.phy.line import Line
from dpstack.phy.marked import PACKET_NOTE, MarkedOctets
from dpstack.phy.uart import Character, Receiver, waveform
from dpstack.units import NEVER


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
