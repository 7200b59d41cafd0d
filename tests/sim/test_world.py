"""The world: time, stations that come and go, orders, faults."""

from __future__ import annotations

from functools import partial

import pytest
from support import MS, Dummy, WorldFactory, ends, wire_log

from dpstack.errors import ConfigError, UsageError
from dpstack.sim.referee import Rule
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.trace import Event, Notice
from dpstack.units import NEVER

BIT = 2_000
ASK = bytes.fromhex("10 05 02 49 50 16")
DATA = bytes.fromhex("68 05 05 68 05 02 7D AB CD FC 16")


# --- time ---
def test_run_until_ends_at_the_given_time(world: WorldFactory) -> None:
    w = world(start_ns=7)
    assert w.now == 7
    w.run_until(1_000)
    assert w.now == 1_000
    w.run_until(500)
    assert w.now == 1_000
    w.run_for(5)
    assert w.now == 1_005
    assert w.next_at() == NEVER
    with pytest.raises(UsageError, match="nothing will ever happen"):
        w.step()


def test_orders_run_in_the_order_of_their_times_and_then_as_given(world: WorldFactory) -> None:
    w = world()
    done: list[str] = []

    def say(name: str) -> None:
        done.append(f"{name}{w.now}")

    for at, name in ((5, "c"), (3, "a"), (5, "d"), (3, "b")):
        w.call_at(at, partial(say, name))
    assert w.next_at() == 3
    w.step()
    assert done == ["a3"]
    w.run_until(100)
    assert done == ["a3", "b3", "c5", "d5"]
    with pytest.raises(UsageError, match="the world's time is 100"):
        w.call_at(99, partial(say, "e"))


def test_run_stops_after_the_event_that_was_waited_for(world: WorldFactory) -> None:
    w = world()
    done: list[int] = []
    for at in (1, 2, 3):
        w.call_at(at, lambda: done.append(w.now))
    assert w.run(NEVER, lambda: len(done) == 2)
    assert (w.now, done) == (2, [1, 2])
    assert not w.run(10, lambda: False)
    assert (w.now, done) == (10, [1, 2, 3])
    assert not w.run(NEVER, lambda: False)
    assert w.now == 10


@pytest.fixture
def w(world: WorldFactory) -> World:
    return world(token_rules=False)


def test_octets_come_before_orders_and_timers_of_the_same_instant(w: World) -> None:
    order: list[str] = []

    class Watch(Dummy):
        def take_tx(self, now: int) -> bytes | None:
            order.append("timer")
            return super().take_tx(now)

        def telegram(self, telegram: object, now: int) -> None:
            order.append("octets")

    end = ends(0, ASK)
    station = Watch(5, plan=[(end, b"\xe5")])
    w.add(station)
    w.call_at(end, lambda: order.append("order"))
    w.inject(ASK)
    w.run_until(end)
    # a timer that is due is judged after the octets, in the same step
    assert order == ["octets", "timer", "order"] or order == ["octets", "order", "timer"]
    assert order[0] == "octets"


def test_a_station_is_woken_at_its_deadline_and_not_at_one_it_gave_up(world: WorldFactory) -> None:
    station = Dummy(5, plan=[(10, b"")])
    w = world(station)
    station.plan = [(3, b"")]
    w.poke(station)
    station.plan = [(20, b"")]
    w.poke(station)
    w.run_until(19)
    assert station.wakes == 0
    station.plan = []
    w.poke(station)
    w.run_until(100)
    assert station.wakes == 0
    assert w.next_at() == NEVER


# --- stations ---
def test_events_are_handed_on_as_they_happen(w: World) -> None:
    got: list[Event] = []
    station = Dummy(5)
    w.add(station, on_events=got.extend)
    notice = Notice(t_ns=0, source="x", message="y")
    station.events.append(notice)
    w.inject(ASK)
    w.run_until(ends(0, ASK) - 1)
    assert got == []
    w.run_until(ends(0, ASK))
    assert got == [notice]


def test_events_nobody_wants_are_taken_away(world: WorldFactory) -> None:
    station = Dummy(5, events=[Notice(t_ns=0, source="x", message="y")])
    world(station)
    assert station.events == []


def test_commands_act_at_once(w: World) -> None:
    class Obeys(Dummy):
        def command(self, command: object, now: int) -> None:
            assert isinstance(command, bytes)
            self.plan.append((now, command))

    station = Obeys(2)
    w.add(station)
    w.run_until(MS)
    w.command(station, ASK)
    assert station.ends == [MS + 66 * BIT]


def test_names_in_the_log(w: World) -> None:
    w.add(Dummy(2, plan=[(0, ASK)]), name="master")
    w.add(Dummy(3, plan=[(MS, ASK)]))
    w.run_until(2 * MS)
    assert [entry.sender for entry in w.log] == ["master", "3"]
    assert "FDL_Status request 2 -> 5" in wire_log(w)


def test_misuse_raises_with_a_reason(world: WorldFactory) -> None:
    w = world()
    station = Dummy(5)
    with pytest.raises(UsageError, match=r"is not on this bus: add\(\) it first"):
        w.command(station, None)
    w.add(station)
    with pytest.raises(UsageError, match="on this bus already"):
        w.add(station)
    w.add(Dummy(6, baud=9_600))
    with pytest.raises(UsageError, match="say at which one"):
        w.inject(ASK)


def test_a_machine_that_sends_while_it_sends_is_a_defect(world: WorldFactory) -> None:
    w = world(Dummy(2, plan=[(0, ASK), (BIT, ASK)]), token_rules=False)
    with pytest.raises(RuntimeError, match=r"station 2 sends .* while it is still sending"):
        w.run_until(MS)


def test_a_station_unplugged_in_the_middle_of_its_telegram(world: WorldFactory) -> None:
    sender = Dummy(2, plan=[(0, DATA), (MS, DATA)])
    receiver = Dummy(5)
    w = world(receiver, sender, token_rules=False)
    w.run_until(4 * 11 * BIT + 100)
    w.remove(sender)
    w.run_until(2 * MS)
    assert receiver.text == DATA[:4]
    assert not receiver.heard
    (entry,) = w.log
    assert entry.octets == DATA[:4]
    assert entry.note == "cut off after 4 of 11 octets"
    w.add(sender)  # and back
    w.run_until(3 * MS)
    assert len(receiver.heard) == 1


def test_a_receiver_unplugged_while_it_would_hear(world: WorldFactory) -> None:
    receiver = Dummy(5)
    w = world(receiver, token_rules=False)
    w.inject(DATA)
    w.call_at(10 * BIT, lambda: w.remove(receiver))
    w.run_until(MS)
    assert not receiver.heard


def test_a_station_plugged_in_during_a_telegram_does_not_hear_it(world: WorldFactory) -> None:
    w = world(Dummy(2, plan=[(0, ASK), (MS, ASK)]), token_rules=False)
    late = Dummy(5)
    w.call_at(10 * BIT, lambda: w.add(late))
    w.run_until(2 * MS)
    assert [at for at, _ in late.heard] == [ends(MS, ASK)]


# --- faults ---
def from_2(tx: Transmission) -> bool:
    return tx.sender == "2"


def sending(w: World, count: int = 3, until: int = 0) -> Dummy:
    """Station 2 sends DATA to 5 every ms; returns the receiver, at ``until``."""
    receiver = Dummy(5)
    w.add(receiver)
    w.add(Dummy(2, hears_all=True, plan=[(number * MS, DATA) for number in range(count)]))
    if until:
        w.run_until(until)
    return receiver


def test_no_station_hears_a_dropped_transmission(w: World) -> None:
    w.faults.drop(from_2, times=2)
    receiver = sending(w, until=3 * MS)
    assert [at for at, _ in receiver.heard] == [ends(2 * MS, DATA)]
    assert receiver.edges == [0, 2 * MS][1:]
    assert [entry.note for entry in w.log] == ["dropped", "dropped", ""]
    assert not w.faults.armed


def test_a_chosen_octet_is_damaged(w: World) -> None:
    w.faults.damage(lambda tx: tx.octets == DATA, octet=-2)
    w.faults.damage(lambda tx: tx.octets == DATA, octet=7, flips=0b110)
    receiver = sending(w, until=MS - 1)
    assert receiver.text == bytes.fromhex("68 05 05 68 05 02 7D A8 CD 16")
    assert receiver.octets[-1][0] == ends(0, DATA)
    w.run_until(3 * MS)
    assert len(receiver.heard) == 2


def test_damage_anywhere_is_decided_by_the_seed(world: WorldFactory) -> None:
    heard = []
    for seed in (1, 1, 2, 3):
        w = world(seed=seed, token_rules=False)
        w.faults.damage(from_2, times=None)
        receiver = sending(w, 10, until=10 * MS)
        assert not receiver.heard
        heard.append(receiver.octets)
    assert heard[0] == heard[1]
    assert heard[1] != heard[2] != heard[3]


def test_a_delayed_transmission_begins_later(w: World) -> None:
    w.faults.delay(from_2, 300 * BIT)
    receiver = sending(w, until=3 * MS)
    assert [at for at, _ in receiver.heard] == [ends(300 * BIT, DATA), ends(MS, DATA), ends(2 * MS, DATA)]
    assert next(iter(w.log)).note == "delayed"


def test_a_truncated_transmission_has_its_first_octets_only(w: World) -> None:
    w.faults.truncate(from_2, octets=4)
    receiver = sending(w, 4, until=MS - 1)
    assert receiver.text == DATA[:4]
    assert receiver.octets[-1][0] == ends(0, DATA[:4])
    w.faults.truncate(from_2, times=None)
    w.run_until(5 * MS)
    assert not receiver.heard
    cut = [entry for entry in w.log if "cut off after" in entry.note]
    assert len(cut) == 4
    assert all(DATA.startswith(entry.octets) and entry.octets not in (b"", DATA) for entry in cut)


def test_a_repeated_transmission_is_on_the_wire_twice(w: World) -> None:
    w.faults.repeat(from_2, 40 * BIT)
    receiver = sending(w, 2, until=3 * MS)
    first = ends(0, DATA)
    assert [at for at, _ in receiver.heard] == [first, ends(first + 40 * BIT, DATA), ends(MS, DATA)]
    assert [entry.note for entry in w.log] == ["", "repeated", ""]


def test_lost_octets_leave_the_others_in_their_places(world: WorldFactory) -> None:
    w = world(seed=3, token_rules=False)
    w.faults.lose_octets(0.2)
    receiver = sending(w, 500, until=500 * MS)
    got = sum(len(chunk) for _, chunk in receiver.octets)
    # eleven octets each; those of a telegram that lost none arrive as a whole: 0.8 ** 11 = 0.086
    assert 0.05 < len(receiver.heard) / 500 < 0.13
    assert 0.77 < (got + len(DATA) * len(receiver.heard)) / (500 * len(DATA)) < 0.83
    w.faults.lose_octets(0)
    assert not w.faults.armed


def test_bursts_damage_neighbouring_octets(world: WorldFactory) -> None:
    w = world(seed=3, token_rules=False)
    seen: list[dict[int, int]] = []
    w.faults.bursts(1e-3, 40)

    def see(tx: Transmission) -> bool:
        seen.append(tx.flips)
        return False

    w.faults.drop(see, times=None)
    sending(w, 2_000)
    w.run_until(2_000 * MS)
    # a burst begins in one telegram of 121 bits in eight, and half of its bits are wrong
    damaged = [flips for flips in seen if flips]
    assert 150 < len(damaged) < 450
    wrong = sum(mask.bit_count() for flips in damaged for mask in flips.values())
    assert 0.3 < wrong / (2_000 * 121 * 1e-3 * 40 / 2) < 1.2
    assert sum(max(flips) - min(flips) > 4 for flips in damaged) < len(damaged) / 5
    w.faults.bursts(0, 1)
    w.faults.clear()
    assert not w.faults.armed


def test_a_delayed_transmission_of_a_station_that_went_never_begins(w: World) -> None:
    receiver = sending(w, 1)
    sender = Dummy(3, plan=[(0, ASK)])
    w.faults.delay(lambda tx: tx.sender == "3", MS)
    w.add(sender)
    w.run_until(MS // 2)
    w.remove(sender)
    w.run_until(3 * MS)
    assert [at for at, _ in receiver.heard] == [ends(0, DATA)]


def test_a_silenced_station_believes_to_send(world: WorldFactory) -> None:
    sender = Dummy(2, plan=[(number * MS, DATA) for number in range(3)])
    receiver = Dummy(5)
    w = world(receiver, sender, token_rules=False)
    w.run_until(MS // 2)
    w.silence(sender, MS)
    w.run_until(3 * MS)
    assert len(sender.ends) == 3
    assert [at for at, _ in receiver.heard] == [ends(0, DATA), ends(2 * MS, DATA)]


def test_a_deaf_station_does_not_hear_either(w: World) -> None:
    receiver = sending(w, until=MS // 2)
    w.silence(receiver, MS, deaf=True)
    w.run_until(3 * MS)
    assert [at for at, _ in receiver.heard] == [ends(0, DATA), ends(2 * MS, DATA)]


def test_an_unplugged_station_is_cut_in_the_middle_and_its_time_goes_on(world: WorldFactory) -> None:
    sender = Dummy(2, plan=[(number * MS, DATA) for number in range(4)])
    receiver = Dummy(5)
    w = world(receiver, sender, token_rules=False)
    w.run_until(MS + 10_000)
    w.unplug(sender)
    w.unplug(receiver)
    w.run_until(2 * MS + 500_000)
    assert len(sender.ends) == 3  # it believes that it has sent
    w.plug(sender)
    w.plug(receiver)
    w.run_until(4 * MS)
    assert [at for at, _ in receiver.heard] == [ends(0, DATA), ends(3 * MS, DATA)]
    assert "cut off after 0 of 11 octets" in wire_log(w)


def test_noise_damages_as_many_telegrams_as_it_should(world: WorldFactory) -> None:
    w = world(seed=1, token_rules=False)
    count = 2_000
    receiver = sending(w, count)
    w.faults.noise(1e-3)
    w.run_until(count * MS)
    # 121 bits each: (1 - 1e-3) ** 121 = 0.886
    assert 0.86 < len(receiver.heard) / count < 0.91
    w.faults.noise(0)
    assert not w.faults.armed


def test_noise_with_a_seed_is_the_same_noise(world: WorldFactory) -> None:
    logs = []
    for seed in (7, 7, 8):
        w = world(seed=seed, token_rules=False)
        w.faults.noise(2e-3)
        receiver = sending(w, 200, until=200 * MS)
        logs.append((list(w.log), receiver.octets, receiver.heard))
    assert logs[0] == logs[1]
    assert logs[1] != logs[2]


def test_impossible_faults_are_refused(world: WorldFactory) -> None:
    faults = world().faults
    for wrong in (-0.1, 0.6):
        with pytest.raises(ConfigError, match=r"0 to 0\.5"):
            faults.noise(wrong)
    with pytest.raises(ConfigError, match="at least one must be inverted"):
        faults.damage(from_2, flips=0)
    with pytest.raises(ConfigError, match="give 1 or more"):
        faults.drop(from_2, times=0)
    with pytest.raises(ConfigError, match="before its time"):
        faults.delay(from_2, -1)
    with pytest.raises(ConfigError, match="or drop the transmission"):
        faults.truncate(from_2, octets=0)
    with pytest.raises(ConfigError, match="cannot begin before the end"):
        faults.repeat(from_2, -1)
    for bits, per_bit in ((0, 0.1), (10, 0.6)):
        with pytest.raises(ConfigError, match=r"0 to 0\.5"):
            faults.bursts(per_bit, bits)
    with pytest.raises(ConfigError, match=r"0 to 0\.5"):
        faults.lose_octets(0.6)
    assert not faults.armed


def test_faults_can_be_ended(w: World) -> None:
    w.faults.noise(0.5)
    w.faults.drop(from_2, times=None)
    w.faults.clear()
    receiver = sending(w, until=3 * MS)
    assert len(receiver.heard) == 3


def test_faults_hit_injected_octets_too(world: WorldFactory) -> None:
    receiver = Dummy(5)
    w = world(receiver, token_rules=False)
    w.faults.drop(lambda tx: tx.sender == "injected")
    w.inject(ASK)
    w.run_until(MS)
    w.faults.delay(lambda tx: tx.sender == "injected", MS)
    w.inject(ASK)
    w.run_until(3 * MS)
    assert [at for at, _ in receiver.heard] == [ends(2 * MS, ASK)]


def test_injecting_into_a_telegram_is_no_violation(w: World) -> None:
    receiver = sending(w, 1)
    w.call_at(50 * BIT, lambda: w.inject(b"\x00"))
    w.run_until(MS)
    assert not receiver.heard
    assert w.referee is not None
    assert not w.referee.allowed
    assert Rule.COLLISION not in {violation.rule for violation in w.referee.violations}
