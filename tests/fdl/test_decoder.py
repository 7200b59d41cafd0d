"""The incremental decoder: every way of cutting the stream, damage, noise, stalls, counters."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dpstack.fdl.codec import Flaw
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.interface import DecoderStats
from dpstack.fdl.telegram import SHORT_ACK, Kind, Telegram, token
from dpstack.units import NEVER

STALL = 1_000

DIAG = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4C 16")
DIAG_T = Telegram(Kind.SD2, 2, 99, 0x6D, 60, 62)
ANSWER = bytes.fromhex("68 0B 0B 68 E3 82 08 3E 3C 02 05 00 FF 0C DA D3 16")
ANSWER_T = Telegram(Kind.SD2, 99, 2, 0x08, 62, 60, b"\x02\x05\x00\xff\x0c\xda")
STATUS = bytes.fromhex("10 02 63 49 AE 16")
STATUS_T = Telegram(Kind.SD1, 2, 99, 0x49)
SD3 = bytes.fromhex("A2 03 02 7D 01 02 03 04 05 06 07 08 A6 16")
SD3_T = Telegram(Kind.SD3, 3, 2, 0x7D, data=bytes(range(1, 9)))
TOKEN = bytes.fromhex("DC 03 02")
TOKEN_T = token(3, 2)
SC = b"\xe5"
EMPTY = bytes.fromhex("68 03 03 68 02 03 08 0D 16")
EMPTY_T = Telegram(Kind.SD2, 2, 3, 0x08)
# data that holds an SC, a token, and starts of everything
NASTY = bytes.fromhex("68 0D 0D 68 03 02 7D E5 DC 01 02 10 68 A2 E5 DC 05 26 16")
NASTY_T = Telegram(Kind.SD2, 3, 2, 0x7D, data=bytes.fromhex("E5 DC 01 02 10 68 A2 E5 DC 05"))

ALL: list[tuple[bytes, Telegram]] = [
    (DIAG, DIAG_T),
    (ANSWER, ANSWER_T),
    (STATUS, STATUS_T),
    (SD3, SD3_T),
    (TOKEN, TOKEN_T),
    (SC, SHORT_ACK),
    (EMPTY, EMPTY_T),
    (NASTY, NASTY_T),
]
STREAM = b"".join(octets for octets, _ in ALL)
STREAM_T = [telegram for _, telegram in ALL]


def fresh() -> Decoder:
    return Decoder(stall_ns=STALL)


def counted(stats: DecoderStats) -> dict[str, int]:
    """The counters that are not zero."""
    return {name: count for name, count in stats.as_dict().items() if count}


def cut(octets: bytes, cuts: list[int]) -> list[bytes]:
    at = [0, *sorted(c % (len(octets) + 1) for c in cuts), len(octets)]
    return [octets[a:b] for a, b in pairwise(at)]


def whole(octets: bytes) -> list[bytes]:
    return [octets]


def bytewise(octets: bytes) -> list[bytes]:
    return [octets[at : at + 1] for at in range(len(octets))]


def feed_all(decoder: Decoder, chunks: list[bytes], now: int = 0) -> list[Telegram]:
    return [telegram for chunk in chunks for telegram in decoder.feed(chunk, now)]


# --- good telegrams ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("octets", "telegram"), ALL, ids=lambda x: "")
def test_a_telegram_whole_bytewise_in_two_pieces_and_followed_by_another(octets: bytes, telegram: Telegram) -> None:
    assert fresh().feed(octets, 0) == [telegram]
    assert feed_all(fresh(), bytewise(octets)) == [telegram]
    for end in range(1, len(octets)):
        decoder = fresh()
        assert decoder.feed(octets[:end], 5) == []
        assert decoder.pending
        assert decoder.stall_at() == 5 + STALL
        assert decoder.feed(octets[end:], 6) == [telegram]
        assert decoder.stall_at() == NEVER
        assert decoder.stats.bad == 0
        assert decoder.stats.octets == len(octets)
        assert decoder.stats.telegrams == 1
    for other, other_t in ALL:
        assert fresh().feed(octets + other, 0) == [telegram, other_t]


@pytest.mark.parametrize(("octets", "telegram"), ALL, ids=lambda x: "")
def test_octets_before_and_behind_a_telegram_are_counted(octets: bytes, telegram: Telegram) -> None:
    for noise in (b"\x00", b"\xff", b"\x16"):
        decoder = fresh()
        assert decoder.feed(noise + octets + noise, 0) == [telegram]
        assert not decoder.pending
        assert decoder.stats.bad_start == 2
        assert decoder.stats.bad == 2
        assert decoder.stats.skipped == 2


@given(st.lists(st.integers(0, 1000), max_size=12))
def test_cuts_do_not_matter(cuts: list[int]) -> None:
    decoder = fresh()
    assert feed_all(decoder, cut(STREAM, cuts)) == STREAM_T
    assert counted(decoder.stats) == {"octets": len(STREAM), "telegrams": len(ALL), "empty_le3": 1}


@pytest.fixture
def decoder() -> Decoder:
    return fresh()


def test_le3_is_an_empty_answer_and_counted(decoder: Decoder) -> None:
    (telegram,) = decoder.feed(EMPTY, 0)
    assert telegram.empty_le3
    assert telegram.data == b""
    assert decoder.feed(EMPTY[:4], 0) == []
    assert decoder.feed(EMPTY[4:], 0) == [EMPTY_T]
    assert decoder.stats.empty_le3 == 2
    assert decoder.stats.bad == 0


def test_bytearray_and_memoryview_are_not_kept() -> None:
    # a driver may reuse its buffer
    buffer = bytearray(ANSWER)
    (telegram,) = fresh().feed(bytes(buffer), 0)
    decoder = fresh()
    decoder.feed(bytes(buffer[:8]), 0)
    buffer[:] = bytes(len(buffer))
    assert telegram == ANSWER_T
    assert decoder.feed(ANSWER[8:], 0) == [ANSWER_T]


def test_empty_chunk(decoder: Decoder) -> None:
    assert decoder.feed(b"", 0) == []
    decoder.feed(DIAG[:3], 0)
    assert decoder.feed(b"", 0) == []
    assert decoder.pending


# --- damage -----------------------------------------------------------------------------------------------------------
DAMAGED: list[tuple[str, dict[str, int]]] = [
    ("68 05 05 68 82 E3 6D 3C 3E 4D 16", {"bad_fcs": 1, "skipped": 11}),
    ("68 05 05 68 82 E3 6D 3C 3E 4C 17", {"bad_ed": 1, "skipped": 11}),
    ("68 05 07 68 82 E3 6D 3C 3E 4C 16", {"le_mismatch": 1, "skipped": 11}),
    ("68 05 05 6A 82 E3 6D 3C 3E 4C 16", {"bad_second_sd": 1, "skipped": 11}),
    ("68 FF FF 68 82 E3 6D 3C 3E 4C 16", {"le_range": 1, "skipped": 11}),
    ("68 04 04 68 02 7F 08 00 89 16", {"bad_address": 1, "skipped": 10}),
    ("68 05 05 68 82 03 08 BE 3C 87 16", {"bad_extension": 1, "skipped": 11}),
    ("68 04 04 68 03 02 9D 01 A3 16", {"bad_fc": 1, "skipped": 10}),
    ("10 02 63 49 AF 16", {"bad_fcs": 1, "skipped": 6}),
    ("10 02 63 49 AE 61", {"bad_ed": 1, "skipped": 6}),
    ("10 82 63 49 2E 16", {"bad_address": 1, "skipped": 6}),
    ("A2 03 02 7D 01 02 03 04 05 06 07 08 A7 16", {"bad_fcs": 1, "skipped": 14}),
    ("DC 80 02", {"bad_address": 1, "skipped": 3}),
    ("DC 03 7F", {"bad_address": 1, "skipped": 3}),
    ("00 00 00", {"bad_start": 3, "skipped": 3}),
]


@pytest.mark.parametrize(("octets", "counters"), DAMAGED)
@pytest.mark.parametrize("cut_up", [whole, bytewise])
def test_damage_counts_once_and_the_next_telegram_is_found(
    decoder: Decoder, octets: str, counters: dict[str, int], cut_up: Callable[[bytes], list[bytes]]
) -> None:
    stream = bytes.fromhex(octets) + DIAG
    assert feed_all(decoder, cut_up(stream)) == [DIAG_T]
    assert counted(decoder.stats) == {"octets": len(stream), "telegrams": 1, **counters}
    assert decoder.stats.bad == sum(counters.values()) - counters["skipped"]


def test_a_rejected_frame_hides_no_telegram_inside(decoder: Decoder) -> None:
    # the rest of a frame that was cut off, then a whole one that the first one's length would swallow
    assert decoder.feed(ANSWER[:6] + STATUS + bytes(8), 0) == [STATUS_T]
    assert decoder.stats.bad_ed == 1
    assert fresh().feed(DIAG[:5] + STATUS, 0) == [STATUS_T]  # the ED of one is where the other's would be
    assert fresh().feed(b"\x68\x68" + DIAG, 0) == [DIAG_T]
    assert fresh().feed(b"\x68" + DIAG, 0) == [DIAG_T]
    assert fresh().feed(b"\x10" + DIAG, 0) == [DIAG_T]
    assert fresh().feed(b"\xa2" + DIAG + DIAG, 0) == [DIAG_T, DIAG_T]


def test_no_acknowledgement_or_token_out_of_a_damaged_telegram() -> None:
    for bit in range(len(NASTY) * 8):
        damaged = bytearray(NASTY)
        damaged[bit // 8] ^= 1 << bit % 8
        decoder = fresh()
        found = decoder.feed(bytes(damaged), 0)
        found += decoder.stalled(STALL)
        if bit // 8:
            assert found == [], damaged.hex(" ")
        # the line was silent: the next acknowledgement counts
        assert decoder.feed(SC, 3 * STALL) == [SHORT_ACK]
    for missing in range(1, len(NASTY)):
        decoder = fresh()
        found = decoder.feed(NASTY[:missing] + NASTY[missing + 1 :], 0)
        found += decoder.stalled(STALL)
        assert found == []
        assert decoder.stats.bad == 1


def test_an_impossible_le_waits_for_ler_however_the_octets_arrive() -> None:
    damaged = bytes.fromhex("68 00 20 68 82 E3 6D 3C 3E") + bytes(2) + SC + TOKEN  # LEr says 38 octets
    for size in (1, 2, 3, len(damaged)):
        decoder = fresh()
        assert feed_all(decoder, [damaged[at : at + size] for at in range(0, len(damaged), size)]) == []
        assert decoder.stats.by_cause() == {"skipped": len(damaged), "le_range": 1, "doubtful": 2}


def test_doubt_ends_with_a_checked_telegram_with_the_length_and_with_silence() -> None:
    broken = bytes.fromhex("68 05 05 68 82 E3 6D 3C 3E 4D 16")
    assert fresh().feed(broken + SC + TOKEN, 0) == [SHORT_ACK, TOKEN_T]
    long = bytes.fromhex("68 20 05 68 82 E3 6D")  # may reach 38 octets
    decoder = fresh()
    assert decoder.feed(long + SC + TOKEN, 0) == []
    assert decoder.stats.doubtful == 2
    assert decoder.feed(STATUS + SC, 0) == [STATUS_T, SHORT_ACK]
    decoder = fresh()
    assert decoder.feed(long + SC, 0) == []
    assert decoder.feed(SC, STALL - 1) == []
    assert decoder.feed(SC, 2 * STALL - 1) == [SHORT_ACK]
    decoder = fresh()
    assert decoder.feed(long + bytes(38 - 7), 0) == []
    assert decoder.feed(SC, 0) == [SHORT_ACK]


def test_an_acknowledgement_after_a_glitch_counts() -> None:
    # adapters that turn round the line make such octets
    assert fresh().feed(b"\x00\xff" + SC, 0) == [SHORT_ACK]
    assert fresh().feed(b"\xff" + TOKEN, 0) == [TOKEN_T]


# --- stalls -----------------------------------------------------------------------------------------------------------
def test_a_stalled_telegram_is_given_up(decoder: Decoder) -> None:
    decoder.feed(ANSWER[:7], 10)
    decoder.feed(ANSWER[7:9], 20)
    assert decoder.stall_at() == 20 + STALL
    assert decoder.stalled(20 + STALL) == []
    assert not decoder.pending
    assert decoder.stall_at() == NEVER
    assert counted(decoder.stats) == {"octets": 9, "stalled": 1, "skipped": 9}
    assert decoder.stalled(5_000) == []
    assert decoder.feed(DIAG, 5_000) == [DIAG_T]
    assert decoder.stats.stalled == 1


def test_a_stalled_start_gives_the_telegrams_behind_it(decoder: Decoder) -> None:
    assert decoder.feed(b"\x68\xc8\xc8\x68\x03\x02" + STATUS + DIAG, 0) == []
    assert decoder.stalled(STALL) == [STATUS_T, DIAG_T]
    assert counted(decoder.stats) == {"octets": 23, "telegrams": 2, "stalled": 1, "skipped": 6}


def test_nothing_waits_after_a_stall(decoder: Decoder) -> None:
    assert decoder.feed(b"\x68\xc8\xc8\x68\x03\x02" + STATUS + ANSWER[:8] + b"\x10", 0) == []
    assert decoder.stalled(STALL) == [STATUS_T]
    assert not decoder.pending


def test_late_pieces_of_a_telegram_are_put_together(decoder: Decoder) -> None:
    # a host that slept: who is late reads before it judges
    decoder.feed(ANSWER[:7], 0)
    assert decoder.feed(ANSWER[7:], 50 * STALL) == [ANSWER_T]


def test_reset_forgets(decoder: Decoder) -> None:
    decoder.feed(ANSWER[:7], 0)
    decoder.reset()
    assert not decoder.pending
    assert decoder.feed(SC, 1) == [SHORT_ACK]
    assert decoder.stats.bad == 0


# --- a line that is never silent --------------------------------------------------------------------------------------
GARBAGE: dict[str, bytes] = {f"{value:02X} repeated": bytes([value]) * 4_000 for value in range(256)}
GARBAGE["random"] = random.Random(7).randbytes(4_000)


def calls(work: Callable[[], object]) -> int:
    """Calls of functions, Python's and built-in ones: a measure of work that is the same on every computer."""
    count = 0

    def counted_call(_frame: object, event: str, _argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(counted_call)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.usefixtures("no_collection")
@pytest.mark.parametrize("name", ["random", *(f"{value:02X} repeated" for value in (0, 0x10, 0x16, 0x55, *Kind))])
def test_garbage_takes_at_most_a_call_an_octet(name: str) -> None:
    # one call an octet would be parse() alone; before runs were skipped it was four to seven
    garbage = GARBAGE[name]
    decoder = fresh()
    assert calls(lambda: [decoder.feed(garbage[at : at + 400], at) for at in range(0, len(garbage), 400)]) < 4_000


@pytest.mark.parametrize("garbage", GARBAGE.values(), ids=GARBAGE)
def test_runs_are_counted_as_octet_by_octet(garbage: bytes) -> None:
    at_once, single = fresh(), fresh()
    found = at_once.feed(garbage[:1_000], 0)
    assert feed_all(single, bytewise(garbage[:1_000])) == found
    assert single.stats == at_once.stats
    assert at_once.stats.skipped + 3 * len(found) + len(at_once.pending) >= 1_000 or found[0] is SHORT_ACK


def test_of_repeated_start_octets_each_claimed_length_counts_once(decoder: Decoder) -> None:
    decoder.feed(b"\x10" * 606, 0)  # an SD1 claims 6 octets; the last 5 may still become one
    assert counted(decoder.stats) == {"octets": 606, "skipped": 601, "bad_ed": 101}
    decoder = fresh()
    decoder.feed(b"\xdc" * 300, 0)  # a token from 220 to 220; the two behind it are no tokens of their own
    assert counted(decoder.stats) == {"octets": 300, "skipped": 300, "bad_address": 100, "doubtful": 200}


def test_a_telegram_behind_a_run_of_start_octets_is_found() -> None:
    for start in (0x10, 0x16, 0xA2, 0x55):
        decoder = fresh()
        assert decoder.feed(bytes([start]) * 1_000 + ANSWER, 0) == [ANSWER_T], hex(start)


def test_a_frame_that_lost_its_first_octet_is_known_by_any_le(decoder: Decoder) -> None:
    # LE = DC, the start octet of a token, inside a damaged SD3; an SC within the 220 octets counts as doubtful
    assert decoder.feed(bytes.fromhex("A2 00 00 00 00 00 00 00 00 00 DC DC 68") + bytes(60) + SC, 0) == []
    assert counted(decoder.stats) == {"octets": 74, "skipped": 74, "bad_ed": 1, "doubtful": 3}


# --- anything ---------------------------------------------------------------------------------------------------------
interesting = st.sampled_from([*Kind, 0x16, 0x03, 0x04, 0x05, 0xFF]) | st.integers(0, 255)
garbage = st.lists(interesting, max_size=60).map(bytes)


@given(st.lists(st.tuples(garbage, st.booleans()), max_size=8))
def test_garbage_never_raises_and_every_octet_is_accounted_for(parts: list[tuple[bytes, bool]]) -> None:
    decoder = fresh()
    now = 0
    for octets, stall in parts:
        decoder.feed(octets, now)
        if stall:
            now += STALL
            decoder.stalled(now)
            assert not decoder.pending
    decoder.stalled(now)
    stats = decoder.stats
    assert stats.octets == sum(len(octets) for octets, _ in parts)
    assert stats.skipped <= stats.octets
    assert (stats.skipped == stats.octets) == (stats.telegrams == 0)


@given(garbage, st.lists(st.integers(0, 1000), max_size=6))
@example(b"\x10\x10\xdc\x10\x10", [231])
def test_cuts_do_not_matter_in_garbage(octets: bytes, cuts: list[int]) -> None:
    at_once, pieces = fresh(), fresh()
    expected = at_once.feed(octets, 0) + at_once.stalled(0)
    assert feed_all(pieces, cut(octets, cuts)) + pieces.stalled(0) == expected
    assert pieces.stats == at_once.stats


@given(garbage, st.sampled_from([pair for pair in ALL if len(pair[0]) > 3]))
def test_a_telegram_after_a_silence_is_always_found(octets: bytes, pair: tuple[bytes, Telegram]) -> None:
    decoder = fresh()
    decoder.feed(octets, 0)
    decoder.stalled(STALL)
    assert decoder.feed(pair[0], 3 * STALL) == [pair[1]]


def test_every_flaw_has_its_counter() -> None:
    names = set(DecoderStats().as_dict())
    assert {flaw.value for flaw in Flaw} <= names


@pytest.mark.parametrize("inside", ["DC 02 03", "E5", "E5 DC 02 03 E5"], ids=lambda x: x)
@pytest.mark.parametrize("lost", [(0,), (1,), (2,), (3,), (0, 1), (0, 4), (5,)], ids=str)
@pytest.mark.parametrize("cut_up", [whole, bytewise])
def test_data_of_a_telegram_with_a_damaged_head_are_no_token_and_no_acknowledgement(
    inside: str, lost: tuple[int, ...], cut_up: Callable[[bytes], list[bytes]]
) -> None:
    data = bytes(10) + bytes.fromhex(inside) + bytes(3)
    body = bytes([2, 5, 8]) + data
    le = len(body)
    frame = bytes([0x68, le, le, 0x68]) + body + bytes([sum(body) & 0xFF, 0x16])
    arrived = bytes(octet for number, octet in enumerate(frame) if number not in lost)
    decoder = fresh()
    assert feed_all(decoder, cut_up(arrived)) == []
    assert decoder.stalled(STALL) == []
    assert decoder.stats.bad >= 1
    assert decoder.stats.doubtful >= 1
    # silence ends the doubt
    assert decoder.feed(TOKEN, 2 * STALL) == [TOKEN_T]


def test_a_length_that_looks_like_a_start_octet() -> None:
    frame = bytes.fromhex("68 10 10 68 02 05 08 00 00 00 00 00 00 00 00 E5 DC 02 03 00 D5 16")  # LE 16 is SD1
    assert fresh().feed(frame, 0) != []
    decoder = fresh()
    assert feed_all(decoder, bytewise(frame[1:])) == []
    assert decoder.stalled(STALL) == []


@pytest.mark.parametrize("end", ["stalled", "reset"])
def test_skipped_octets_say_nothing_about_the_next_ones(end: str) -> None:
    """A frame with LE = 0 claims nine octets; the octets skipped before it are no LE of a lost head."""
    decoder = Decoder(stall_ns=1_000)
    decoder.feed(b"\x44\x44\x10\x05", 0)
    if end == "stalled":
        assert decoder.stalled(10) == []
    else:
        decoder.reset()
    assert decoder.feed(b"\x68\x00\x00" + bytes(6) + b"\xe5", 20) == [SHORT_ACK]
    assert decoder.stats.doubtful == 0
