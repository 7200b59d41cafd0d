"""The medium: who hears what, when, in which order. Octets and times by hand (500 kbit/s: a bit is 2000 ns)."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from support import MS, Dummy, WorldFactory, ends

from dpstack.fdl.telegram import Kind, Telegram
from dpstack.sim.referee import Rule
from dpstack.sim.world import World
from dpstack.trace import WireEntry
from dpstack.units import NEVER

BIT = 2_000
#: FDL status request 2 -> 5, and the answer of a slave (FCS by hand: 05 + 02 + 49 = 50, 02 + 05 + 00 = 07)
ASK = bytes.fromhex("10 05 02 49 50 16")
ANSWER = bytes.fromhex("10 02 05 00 07 16")
#: SRD request 2 -> 5 with two octets
DATA = bytes.fromhex("68 05 05 68 05 02 7D AB CD FC 16")
#: Global_Control Operate 2 -> 127
ALL = bytes.fromhex("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16")
TOKEN = bytes.fromhex("DC 02 02")

ASKED = Telegram(Kind.SD1, 5, 2, 0x49)


def test_a_telegram_reaches_its_addressee_whole(world: WorldFactory) -> None:
    asking = Dummy(2, hears_all=True, plan=[(MS, ASK)])
    asked, other, listener = Dummy(5), Dummy(6), Dummy(7, hears_all=True)
    w = world(asking, asked, other, listener, token_rules=False)
    w.run_until(2 * MS)
    end = MS + 66 * BIT
    assert asking.ends == [end]
    assert asked.heard == listener.heard == [(end, ASKED)]
    assert asked.edges == listener.edges == [MS]
    assert not other.heard
    assert not other.edges
    assert not asking.heard  # half duplex: nobody hears himself
    assert not asking.edges
    assert not any(station.octets for station in (asking, asked, other, listener))
    assert list(w.log) == [WireEntry(MS, end, ASK, "2", "")]


def test_a_broadcast_reaches_all_but_the_sender(world: WorldFactory) -> None:
    sender = Dummy(2, hears_all=True, plan=[(0, ALL)])
    others = [Dummy(5), Dummy(6), Dummy(3, hears_all=True), Dummy(6)]
    w = world(sender, *others, token_rules=False)
    w.run_until(MS)
    expected = [(13 * 11 * BIT, Telegram(Kind.SD2, 127, 2, 0x46, 58, 62, b"\x00\x00"))]
    assert [station.heard for station in others] == [expected] * 4
    assert not sender.heard


def test_two_stations_with_one_address_both_hear_and_collide_when_they_answer(world: WorldFactory) -> None:
    master = Dummy(2, hears_all=True, plan=[(0, ASK)])
    twins = [Dummy(5, reply=(11 * BIT, ANSWER)), Dummy(5, reply=(11 * BIT, ANSWER))]
    w = world(master, *twins, token_rules=False, expect=[Rule.COLLISION])
    w.run_until(MS)
    assert [len(twin.heard) for twin in twins] == [1, 1]
    assert not master.heard
    assert master.text != ANSWER
    assert ["collision" in entry.note for entry in w.log] == [False, True, True]


def test_a_station_that_changes_its_address_is_found_at_the_new_one(world: WorldFactory) -> None:
    master = Dummy(2, hears_all=True, plan=[(0, ASK), (MS, ASK)])
    station = Dummy(6)
    w = world(master, station, token_rules=False)
    w.run_until(MS // 2)
    assert not station.heard
    station.address = 5
    w.poke(station)
    w.run_until(2 * MS)
    assert [telegram for _, telegram in station.heard] == [ASKED]
    assert list(w.log)[-1].sender == "2"


def test_octets_that_are_no_telegram_go_one_by_one_to_everybody(world: WorldFactory) -> None:
    stations = [Dummy(2, hears_all=True), Dummy(5)]
    w = world(*stations)
    w.run_until(MS)
    w.inject(b"\x10\x05\xff")
    w.run_until(2 * MS)
    for station in stations:
        assert station.octets == [(MS + 22_000, b"\x10"), (MS + 44_000, b"\x05"), (MS + 66_000, b"\xff")]
        assert not station.heard
    assert stations[0].edges == [MS]


def test_an_injected_telegram_is_heard_like_a_stations(world: WorldFactory) -> None:
    station = Dummy(5)
    w = world(station)
    w.inject(ASK, sender="foreign")
    w.run_until(MS)
    assert station.heard == [(66 * BIT, ASKED)]
    assert [entry.sender for entry in w.log] == ["foreign"]


def test_another_rate_gets_what_it_samples_of_the_waveform_whatever_the_seed(world: WorldFactory) -> None:
    texts = []
    for seed in (1, 2):
        sender = Dummy(2, plan=[(number * MS, DATA) for number in range(20)], hears_all=True)
        right, wrong = Dummy(5), Dummy(5, baud=1_500_000)
        w = world(sender, right, wrong, seed=seed, token_rules=False)
        w.run_until(20 * MS)
        assert len(right.heard) == 20
        assert not wrong.heard
        assert wrong.octets
        texts.append(wrong.octets)
    assert texts[0] == texts[1]
    # at three times the rate: 68 gives a break and FC with a bad stop bit; 05 is 0 1 0 1: space for start, d0 and d1,
    # mark to d4, space to d7 and mark for parity and stop: 1C, 7333 ns after its start edge; the second 05 as well
    assert texts[0][:2] == [(MS + 29_333, b"\x1c"), (MS + 51_333, b"\x1c")]


def test_a_station_whose_rate_changes_hears_at_the_new_one(world: WorldFactory) -> None:
    station = Dummy(5, baud=1_500_000)
    w = world(station)
    w.inject(ASK, baud=500_000)
    w.run_until(MS)
    assert not station.heard
    station.baud = 500_000
    w.poke(station)
    w.inject(ASK)
    w.run_until(2 * MS)
    assert station.heard == [(MS + 66 * BIT, ASKED)]


def test_a_collision_leaves_complete_octets_and_garbles_the_rest(world: WorldFactory) -> None:
    first = Dummy(2, plan=[(0, DATA)])
    second = Dummy(5, plan=[(3 * 11 * BIT + 5, ANSWER)])
    listener = Dummy(9, hears_all=True)
    w = world(listener, first, second, seed=5, token_rules=False, expect=[Rule.COLLISION])
    w.run_until(MS)
    assert not listener.heard
    # three octets were complete; the listener gets them when the collision begins
    assert listener.octets[0] == (3 * 11 * BIT + 5, DATA[:3])
    garbled = listener.octets[1:]
    assert garbled
    assert len(garbled) <= 8
    assert all(at <= ends(0, DATA) for at, _ in garbled)
    assert listener.edges == [0, 3 * 11 * BIT + 5]
    assert ["collision" in entry.note for entry in w.log] == [True, True]


def test_a_third_transmission_prolongs_the_collision(world: WorldFactory) -> None:
    senders = Dummy(2, plan=[(0, ASK)]), Dummy(3, plan=[(BIT, ASK)]), Dummy(4, plan=[(60 * BIT, DATA * 3)])
    listener = Dummy(9, hears_all=True)
    w = world(*senders, listener, seed=1, token_rules=False, expect=[Rule.COLLISION])
    w.run_until(MS)
    assert not listener.heard
    assert 150 * BIT < listener.octets[-1][0] <= (60 + 33 * 11) * BIT


def test_a_start_edge_at_the_same_instant_holds_no_station_back(world: WorldFactory) -> None:
    stations = [Dummy(address, hears_all=True, plan=[(MS, TOKEN)]) for address in (2, 3, 4)]
    w = world(*stations, token_rules=False, expect=[Rule.COLLISION])
    w.run_until(2 * MS)
    assert [station.ends for station in stations] == [[MS + 33 * BIT]] * 3
    assert [station.edges for station in stations] == [[]] * 3  # all three were sending already


def test_a_station_does_not_hear_while_it_sends(world: WorldFactory) -> None:
    sender = Dummy(5, hears_all=True, plan=[(0, DATA)])
    w = world(sender, token_rules=False)
    w.call_at(10 * BIT, lambda: w.inject(ASK))
    w.run_until(MS)
    assert not sender.heard
    assert not sender.octets


def test_looking_up_a_receiver_does_not_cost_more_with_more_slaves(world: WorldFactory) -> None:
    def touched(slaves: int) -> int:
        w = world(Dummy(2, hears_all=True, plan=[(MS, ASK), (2 * MS, DATA)]), token_rules=False)
        stations = [_Counting(address) for address in range(5, 5 + slaves)]
        for station in stations:
            w.add(station)
        for station in stations:
            station.touches = 0
        w.run_until(3 * MS)
        return sum(station.touches for station in stations)

    assert touched(100) == touched(1) > 0


class _Counting(Dummy):
    """Counts every call the world makes."""

    touches = 0

    def __getattribute__(self, name: str) -> object:
        if name in ("wake_at", "wake", "telegram", "activity", "receive", "take_tx", "take_events", "hears_all"):
            self.touches += 1
        return super().__getattribute__(name)


def test_a_station_is_found_under_its_new_address_at_once(world: WorldFactory) -> None:
    class Obeys(Dummy):
        def telegram(self, telegram: Telegram, now: int) -> None:
            super().telegram(telegram, now)
            self.address = 5

    station = Obeys(6)
    w = world(station, token_rules=False)
    w.inject(bytes.fromhex("10 06 02 49 51 16"))
    w.run_until(MS)
    w.inject(ASK)
    w.run_until(2 * MS)
    assert [telegram.da for _, telegram in station.heard] == [6, 5]


@given(
    starts=st.lists(st.tuples(st.integers(0, 2_000), st.integers(0, 3)), max_size=12),
    seed=st.integers(0, 3),
)
def test_a_telegram_arrives_whole_if_and_only_if_it_was_not_disturbed(starts: list[tuple[int, int]], seed: int) -> None:
    octets = (ASK, DATA, ALL, TOKEN)
    # one sender each, so that only the medium decides
    sent = sorted((at * 500, ends(at * 500, octets[which]), octets[which]) for at, which in starts)
    w = World(seed=seed, referee=False)
    listener = Dummy(9, hears_all=True)
    w.add(listener)
    for number, (at, _, text) in enumerate(sent):
        w.add(Dummy(10 + number, plan=[(at + 1, text)]))
    w.run_until(10 * MS)
    alone = [
        end + 1
        for number, (at, end, _) in enumerate(sent)
        if not any(a < end and at < e for other, (a, e, _) in enumerate(sent) if other != number)
    ]
    assert [at for at, _ in listener.heard] == sorted(alone)
    assert len(w.log) == len(sent)
    assert all(at <= max(end for _, end, _ in sent) + 1 for at, _ in listener.octets)
    assert w.next_at() == NEVER
