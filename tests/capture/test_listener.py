"""Octets in chunks of any size are cut into the same transmissions; a listening station on the virtual wire delivers
what the world put on the line, to the nanosecond, and sends nothing."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from bus_kit import SimBus
from hypothesis import given
from hypothesis import strategies as st
from support import MS, S

from dpstack.capture import cutter as cutting
from dpstack.capture.cutter import Cutter, split
from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Damage, Transmission
from dpstack.errors import UsageError
from dpstack.fdl.baud_search import BaudFound
from dpstack.fdl.codec import parse
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import BusParams
from dpstack.phy.marked import PACKET_NOTE, MarkedOctets
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry
from dpstack.units import NEVER, bits_to_ns, chars_to_ns

TOKEN = bytes.fromhex("DC 02 05")
REQUEST = bytes.fromhex("68 05 05 68 83 82 6D 3C 3E EC 16")
POLL = bytes.fromhex("10 05 02 49 50 16")
ACK = b"\xe5"
BAUD = 500_000
_telegrams = st.sampled_from([TOKEN, REQUEST, POLL, ACK, bytes.fromhex("A2 05 02 08 01 02 03 04 05 06 07 08 33 16")])


def test_telegrams_in_one_chunk_lie_before_its_arrival_without_gaps() -> None:
    cutter = Cutter(BAUD, 1_000)
    now = 10_000_000
    pieces = cutter.feed(TOKEN + POLL + ACK, now)
    starts = [now - chars_to_ns(size, BAUD) for size in (10, 7, 1)]
    assert pieces == [
        Transmission(octets, start, BAUD) for octets, start in zip((TOKEN, POLL, ACK), starts, strict=True)
    ]
    assert cutter.stall_at() == NEVER


def test_a_telegram_in_two_chunks_ends_with_the_second() -> None:
    cutter = Cutter(BAUD, 1_000_000)
    assert cutter.feed(REQUEST[:4], 1_000_000) == []
    assert cutter.stall_at() == 2_000_000
    (piece,) = cutter.feed(REQUEST[4:], 1_500_000)
    assert (piece.octets, piece.t_ns) == (REQUEST, 1_500_000 - chars_to_ns(len(REQUEST), BAUD))


def test_the_rest_of_a_telegram_does_not_come() -> None:
    cutter = Cutter(BAUD, 1_000_000)
    cutter.feed(REQUEST[:9], 1_000_000)
    (piece,) = cutter.give_up()
    assert (piece.octets, piece.damage) == (REQUEST[:9], Damage.TOO_SHORT)
    assert cutter.feed(POLL, 9_000_000)[0].octets == POLL


def test_the_length_of_a_damaged_telegram_hides_acknowledgements_but_no_telegram_with_fcs() -> None:
    damaged = bytearray(REQUEST)
    damaged[6] = 0xE5
    assert split(bytes(damaged) + POLL) == [bytes(damaged), POLL]
    assert split(bytes(damaged[:8]) + POLL + ACK) == [bytes(damaged[:8]), POLL, ACK]


def test_octets_that_are_no_telegram_are_kept_in_pieces_of_bounded_size() -> None:
    pieces = split(bytes(5_000))
    assert sum(map(len, pieces)) == 5_000
    assert max(map(len, pieces)) <= 1_024


def test_after_a_silence_only_a_check_sequence_joins_octets() -> None:
    """DC 02 before it and 10 05 02 after it would make a token to station 2 from station 16."""
    cutter = Cutter(BAUD, 1_000_000)
    cutter.feed(TOKEN[:2], 1_000_000)
    pieces = cutter.feed(POLL, 9_000_000)
    assert [(one.octets, bool(one.damage)) for one in pieces] == [(TOKEN[:2], True), (POLL, False)]
    assert pieces[0].t_ns == 1_000_000 - chars_to_ns(2, BAUD)
    late = Cutter(BAUD, 1_000_000)  # here the computer was late: the check sequence says so
    late.feed(REQUEST[:4], 1_000_000)
    assert [one.octets for one in late.feed(REQUEST[4:], 90_000_000)] == [REQUEST]


def test_a_long_telegram_in_slow_pieces_is_no_silence() -> None:
    """At 9600 bit/s 62 octets last 71 ms: longer than the silence that ends a telegram, but nobody is silent."""
    long = b"\x68\xf9\xf9\x68" + bytes(249) + b"\0\x16"
    cutter = Cutter(9_600, 50_000_000)
    now, pieces = 0, []
    for at in range(0, len(long), 62):
        now += chars_to_ns(62, 9_600)
        pieces += cutter.feed(long[at : at + 62], now)
    assert [one.octets for one in pieces] == [long]


def test_the_length_of_a_damaged_telegram_is_forgotten_in_a_silence() -> None:
    """1024 octets without telegram are delivered at once; the length claimed by the last of them goes beyond them."""
    garbage = bytes(1_023) + b"\x68"
    for chunks in ([garbage + b"\xf9\x01", TOKEN], [garbage, b"\xf9\x01", TOKEN]):
        cutter = Cutter(BAUD, 1_000_000)
        pieces = []
        for number, chunk in enumerate(chunks):
            pieces += cutter.feed(chunk, 10_000_000 * (number + 1))
        assert [one.octets for one in pieces if not one.damage] == [TOKEN]
        assert cutter.stall_at() == NEVER


@given(st.lists(st.tuples(st.binary(max_size=40) | _telegrams, st.integers(-3_000_000, 3_000_000)), max_size=30))
def test_times_never_run_backwards_even_if_arrivals_do(arrivals: list[tuple[bytes, int]]) -> None:
    cutter = Cutter(BAUD, 100_000, 7)
    pieces: list[Transmission] = []
    now = 100_000_000
    for chunk, step in arrivals:
        now += step
        pieces += cutter.feed(chunk, now)
    pieces += cutter.give_up()
    times = [piece.t_ns for piece in pieces if piece.t_ns is not None]
    assert times == sorted(times)
    assert b"".join(piece.octets for piece in pieces) == b"".join(chunk for chunk, _ in arrivals)


@pytest.mark.parametrize(
    "garbage", ["68", "68 f9 f9 68", "68 f9 f9 68" + " 00" * 250, "10 02 02", "a2", "dc 05", "00", "e5 68"]
)
@pytest.mark.parametrize("size", [1, 7, 4_096])
def test_garbage_costs_a_look_an_octet_and_holds_a_bounded_number(
    garbage: str, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = 0

    def counted(*args: Any) -> Any:
        nonlocal looks
        looks += 1
        return parse(*args)

    monkeypatch.setattr(cutting, "parse", counted)
    stream = (bytes.fromhex(garbage) * 20_000)[:20_000]
    cutter = Cutter(BAUD, 1 << 50)
    held = total = 0
    for at in range(0, len(stream), size):
        total += sum(len(one.octets) for one in cutter.feed(stream[at : at + size], at))
        held = max(held, at + size - total)
    assert looks <= len(stream) * 2.1 + 100
    assert held <= 1_279


_stream = st.lists(_telegrams | st.binary(max_size=12), max_size=25).map(b"".join)


@given(_stream, st.lists(st.integers(1, 30), min_size=1))
def test_no_octet_is_lost_and_chunks_make_no_difference(stream: bytes, sizes: list[int]) -> None:
    cutter = Cutter(BAUD, 1_000_000)
    pieces: list[Transmission] = []
    now = at = turn = 0
    while at < len(stream):
        chunk = stream[at : at + sizes[turn % len(sizes)]]
        turn += 1
        at += len(chunk)
        now += chars_to_ns(len(chunk), BAUD) + 1_000 * (turn % 3)
        pieces += cutter.feed(chunk, now)
    pieces += cutter.give_up()
    assert b"".join(piece.octets for piece in pieces) == stream
    assert [piece.octets for piece in pieces] == split(stream)
    times = [piece.t_ns for piece in pieces if piece.t_ns is not None]
    assert all(early <= late for early, late in pairwise(times))


def _marked(chunk: bytes, *marks: int, packets: bool = False) -> list[Transmission]:
    cutter = Cutter(BAUD, 1_000)
    return [*cutter.feed(MarkedOctets(chunk, marks, packets=packets), 10_000_000), *cutter.give_up()]


def test_marked_octets_stay_at_their_place() -> None:
    changed = POLL[:3] + b"\x48" + POLL[4:]
    token, poll, ack = _marked(TOKEN + changed + ACK, 6, 7)
    assert (token.damage, ack.damage) == (0, 0)
    assert (poll.octets, poll.damage) == (changed, Damage.FCS | Damage.PARITY_OR_FRAMING)
    assert poll.note == "damaged by mark of the port: octets 4, 5"


def test_a_telegram_whose_parity_alone_was_damaged_is_damaged() -> None:
    (poll,) = _marked(POLL, 5)
    assert (poll.octets, poll.damage) == (POLL, Damage.PARITY_OR_FRAMING)


def test_marks_of_a_whole_packet_do_not_make_checked_telegrams_damaged() -> None:
    stream = POLL + ACK + REQUEST[:5]
    poll, ack, rest = _marked(stream, *range(len(stream)), packets=True)
    assert (poll.damage, poll.note) == (0, PACKET_NOTE)
    assert ack.damage == Damage.PARITY_OR_FRAMING
    assert rest.damage == Damage.PARITY_OR_FRAMING | Damage.TOO_SHORT
    assert rest.note == f"damaged by mark of the port: octets 1, 2, 3, 4 and 1 more; {PACKET_NOTE}"


@given(st.lists(st.tuples(st.binary(max_size=30), st.sets(st.integers(0, 29)))))
def test_every_mark_is_in_the_transmission_with_its_octet(chunks: list[tuple[bytes, set[int]]]) -> None:
    cutter = Cutter(BAUD, 1_000)
    pieces: list[Transmission] = []
    wanted: list[int] = []
    at = now = 0
    for chunk, places in chunks:
        marks = tuple(sorted(place for place in places if place < len(chunk)))
        wanted += [at + place for place in marks]
        at += len(chunk)
        now += 1_000_000
        pieces += cutter.feed(MarkedOctets(chunk, marks) if marks else chunk, now)
    pieces += cutter.give_up()
    begin = 0
    for piece in pieces:
        end = begin + len(piece.octets)
        assert bool(piece.damage & Damage.PARITY_OR_FRAMING) == any(begin <= place < end for place in wanted)
        begin = end
    assert begin == at


EPOCH = 1_800_000_000 * S


@pytest.mark.parametrize("baud", [19_200, 500_000, 12_000_000])
def test_every_transmission_of_a_bus_with_its_time(baud: int) -> None:
    world = World(keep=100_000)
    bus = SimBus(world, BusParams.preset(baud, address=2), [3, 4])
    assert world.run(world.now + 60 * S, lambda: bus.exchanging)
    heard: list[Transmission] = []
    world.add(Listener(world.now, heard.append, baud=baud, epoch_ns=EPOCH), name="listener")
    begun = world.now
    world.run_for(bits_to_ns(100_000, baud))
    sent = [entry for entry in world.log if entry.start_ns >= begun]
    assert len(sent) > 20
    assert heard == [Transmission(entry.octets, entry.start_ns + EPOCH, baud) for entry in sent]
    assert not any(entry.sender == "listener" for entry in sent)


def test_damaged_telegrams_are_delivered_with_their_damage_and_nothing_else_is() -> None:
    world = World(seed=5, keep=100_000, referee=False)
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4])
    assert world.run(world.now + 60 * S, lambda: bus.exchanging)
    heard: list[Transmission] = []
    world.add(Listener(world.now, heard.append, baud=500_000), name="listener")
    begun = world.now
    world.faults.noise(1e-3)
    world.run_for(200 * MS)
    intact = {entry.octets for entry in _since(world, begun)}
    assert sum(not one.damage for one in heard) > 100
    assert all(one.octets in intact for one in heard if not one.damage)
    damaged = [one for one in heard if one.damage]
    assert {one.damage for one in damaged} >= {Damage.TOO_SHORT, Damage.START_DELIMITER}
    ends = [(one.t_ns, one.t_ns + chars_to_ns(len(one.octets), 500_000)) for one in heard if one.t_ns is not None]
    assert all(end <= start for (_, end), (start, _) in pairwise(ends))


def _since(world: World, begun: int) -> list[WireEntry]:
    return [entry for entry in world.log if entry.start_ns >= begun]


def test_the_rate_is_found_and_found_again_where_the_bus_changes_it() -> None:
    world = World(keep=100_000, referee=False)
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3])
    heard: list[Transmission] = []
    events: list[Event] = []
    listener = Listener(world.now, heard.append)
    world.add(listener, name="listener", on_events=events.extend)
    assert world.run(world.now + 5 * S, lambda: bool(heard))
    assert listener.found == 500_000
    world.remove(bus.station)
    SimBus(world, BusParams.preset(1_500_000, address=2), [4])
    count = len(heard)
    assert world.run(world.now + 60 * S, lambda: heard[-1].baud == 1_500_000)
    assert len(heard) > count
    assert [event.baud for event in events if isinstance(event, BaudFound)] == [500_000, 1_500_000]


def test_a_lost_port_and_refused_rates() -> None:
    heard: list[Transmission] = []
    fixed = Listener(0, heard.append, baud=9600)
    fixed.receive(bytes.fromhex("68 05 05"), 10 * MS)
    fixed.command(LineDown("unplugged"), 20 * MS)
    fixed.command(LineUp(), 2 * S)
    assert [(one.octets.hex(), one.damage) for one in heard] == [("680505", Damage.TOO_SHORT)]
    with pytest.raises(UsageError, match="cannot do 9600"):
        fixed.command(RateRefused("the adapter cannot do 9600"), 3 * S)
    searching = Listener(0, heard.append)
    first = searching.baud
    searching.command(RateRefused("too fast"), 0)
    assert searching.baud < first
    with pytest.raises(UsageError, match="only listens"):
        fixed.command(object(), 0)


@pytest.mark.parametrize(
    "octets",
    [
        "68 03 03 68 02 05 08 0F 16",  # LE = 3
        "A2 05 02 6D 01 02 03 04 05 06 07 08 98 16",  # SD3
        "68 06 06 68 85 82 6D 3C 3E 01 EF 16",
        "10 05 02 49 50 16",
        "DC 02 02",
        "E5",
    ],
)
def test_every_kind_of_telegram_is_delivered_as_it_was_sent(octets: str) -> None:
    world = World(referee=False)
    heard: list[Transmission] = []
    world.add(Listener(0, heard.append, baud=500_000), name="listener")
    world.inject(bytes.fromhex(octets))
    world.run_for(10 * MS)
    assert [(one.octets, one.damage) for one in heard] == [(bytes.fromhex(octets), 0)]
