"""The referee is shown every fault it knows, made by scripted stations; and that it is silent when all is well.

Times at 500 kbit/s: a bit is 2 us. Preset there: T_SL 200, T_ID1 37, T_ID2 100, T_TO of station 2 is 10 T_SL = 2000.
"""

from __future__ import annotations

import pytest
from support import Dummy, WorldFactory

from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.params import BusParams
from dpstack.sim.referee import RefereeError
from dpstack.sim.token_watch import Rule, TokenWatch
from dpstack.sim.world import World
from dpstack.units import chars_to_ns

BIT = 2_000
T_TO_2 = 2_000
PARAMS = BusParams.preset(500_000, address=2)

TOKEN = bytes.fromhex("DC 02 02")
ASK = bytes.fromhex("10 05 02 49 50 16")
ANSWER = bytes.fromhex("10 02 05 00 07 16")
SDN = bytes.fromhex("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16")


class Script:
    """Transmissions one after another, each ``pause`` bits after the one before has ended; then the verdict."""

    def __init__(self, world: WorldFactory, *, seed: int = 0, know: bool = True) -> None:
        self.world: World = world(seed=seed)
        assert self.world.referee is not None
        self.referee = self.world.referee
        self.stations: dict[object, Dummy] = {}
        self.at = 0
        if know:
            self.referee.know(PARAMS)

    def send(self, sender: object, pause: int, octets: bytes) -> None:
        """``sender`` is any name; a name of its own is a station of its own."""
        station = self.stations.get(sender)
        if station is None:
            station = self.stations[sender] = Dummy(octets[2] & 0x7F if len(octets) > 2 else 5)
            self.world.add(station, name=str(sender))
        self.at += pause * BIT
        station.plan.append((self.at, octets))
        self.world.poke(station)
        self.at += chars_to_ns(len(octets), 500_000)
        self.world.run_until(self.at)

    def claim(self, sender: object = "m2") -> None:
        self.send(sender, T_TO_2, TOKEN)

    def verdict(self) -> list[Rule]:
        """What was found; the fixture's check has nothing left to complain of."""
        self.world.run_for(1_000_000)
        found = [violation.rule for violation in self.referee.violations]
        self.referee.violations.clear()
        return found


@pytest.fixture
def script(world: WorldFactory) -> Script:
    return Script(world)


# --- all is well ---
def test_a_lone_master_within_the_rules(script: Script) -> None:
    script.claim()
    script.send("m2", 37, TOKEN)
    script.send("m2", 37, ASK)
    script.send("s5", 11, ANSWER)
    script.send("m2", 37, SDN)
    script.send("m2", 100, TOKEN)
    script.send("m2", 37, ASK)  # nobody answers
    script.send("m2", 200, ASK)
    script.send("s5", 199, ANSWER)
    script.send("m2", 37, TOKEN)
    assert script.verdict() == []


def test_a_ring_of_three_within_the_rules(script: Script) -> None:
    script.claim()
    script.send("m2", 37, TOKEN)
    script.send("m2", 37, encode_token(4, 2))
    script.send("m4", 37, encode_token(2, 4))
    script.send("m2", 37, encode_token(4, 2))
    script.send("m4", 37, encode_token(9, 4))
    script.send("m9", 37, encode_sd1(5, 9, 0x49))
    script.send("s5", 20, encode_sd1(9, 5, 0x00))
    script.send("m9", 37, encode_token(2, 9))
    script.send("m2", 37, encode_token(4, 2))
    assert script.referee.tokens.ring == {2, 4, 9}
    # 4 is dead: three attempts, then the next one
    script.send("m2", 200, encode_token(4, 2))
    script.send("m2", 200, encode_token(4, 2))
    script.send("m2", 200, encode_token(9, 2))
    script.send("m9", 37, encode_token(2, 9))
    assert script.referee.tokens.ring == {2, 9}
    assert script.verdict() == []


def test_a_short_acknowledgement_answers(script: Script) -> None:
    script.claim()
    script.send("m2", 37, encode_sd2(5, 2, 0x5D, b"\x01"))
    script.send("s5", 11, b"\xe5")
    script.send("m2", 37, TOKEN)
    assert script.verdict() == []


# --- collision ---
def test_two_transmissions_overlap(world: WorldFactory) -> None:
    w = world()
    assert w.referee is not None
    w.referee.token_rules = False
    w.add(Dummy(2, plan=[(1_000, ASK)]))
    w.add(Dummy(3, plan=[(1_000 + 30 * BIT, ASK)]))
    w.run_until(1_000_000)
    (violation,) = w.referee.violations
    assert violation.rule is Rule.COLLISION
    assert violation.sender == "3"
    assert violation.text == "begins 36 bits before 2 ends"
    w.referee.violations.clear()


# --- answers ---
def test_an_answer_too_early(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 10, ANSWER)
    assert script.verdict() == [Rule.EARLY]


def test_an_answer_after_the_slot_time(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 200, ANSWER)
    assert script.verdict() == [Rule.LATE]


def test_an_answer_nobody_asked_for(script: Script) -> None:
    script.claim()
    script.send("s5", 37, ANSWER)
    script.send("s5", 37, b"\xe5")
    assert script.verdict() == [Rule.UNASKED, Rule.UNASKED]


def test_an_answer_of_another_station(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s6", 20, encode_sd1(2, 6, 0x00))
    assert script.verdict() == [Rule.UNASKED]


def test_an_answer_to_another_master(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 20, encode_sd1(3, 5, 0x00))
    assert script.verdict() == [Rule.UNASKED]


def test_a_second_answer(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 20, ANSWER)
    script.send("s5", 20, ANSWER)
    assert script.verdict() == [Rule.UNASKED]


def test_an_answer_to_an_sdn(script: Script) -> None:
    script.claim()
    script.send("m2", 37, SDN)
    script.send("s5", 20, ANSWER)
    assert script.verdict() == [Rule.UNASKED]


# --- idle times ---
def test_t_syn_holds_for_masters_the_referee_does_not_know(world: WorldFactory) -> None:
    script = Script(world, know=False)
    script.claim()
    script.send("m2", 33, ASK)
    script.send("s5", 11, ANSWER)
    script.send("m2", 33, SDN)
    script.send("m2", 33, TOKEN)
    script.send("m2", 32, TOKEN)
    assert script.verdict() == [Rule.IDLE]


def test_t_id1_before_a_token_and_a_request(script: Script) -> None:
    script.claim()
    script.send("m2", 36, TOKEN)
    script.send("m2", 36, ASK)
    script.send("s5", 11, ANSWER)
    script.send("m2", 36, ASK)
    assert script.verdict() == [Rule.IDLE] * 3


def test_t_id2_after_an_sdn(script: Script) -> None:
    script.claim()
    script.send("m2", 37, SDN)
    script.send("m2", 99, ASK)
    assert script.verdict() == [Rule.IDLE]


def test_extra_idle_time_is_part_of_t_id1(world: WorldFactory) -> None:
    script = Script(world, know=False)
    script.referee.know(PARAMS.replace(extra_idle=100))
    script.claim()
    script.send("m2", 137, ASK)
    script.send("s5", 11, ANSWER)
    script.send("m2", 136, ASK)
    assert script.verdict() == [Rule.IDLE]


def test_a_request_repeated_before_the_slot_time_is_over(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("m2", 199, ASK)
    assert script.verdict() == [Rule.SLOT]


def test_a_token_repeated_before_the_slot_time_is_over(script: Script) -> None:
    script.claim()
    script.send("m2", 37, encode_token(4, 2))
    script.send("m2", 199, encode_token(4, 2))
    assert script.verdict() == [Rule.SLOT]


# --- the token ---
def test_a_request_before_any_token(script: Script) -> None:
    script.send("m2", 5_000, ASK)
    assert script.verdict() == [Rule.RIGHT]


def test_a_request_of_a_station_that_has_not_the_token(script: Script) -> None:
    script.claim()
    script.send("m3", 37, encode_sd1(5, 3, 0x49))
    assert script.verdict() == [Rule.RIGHT]


def test_a_request_after_the_token_was_passed_on(script: Script) -> None:
    script.claim()
    script.send("m2", 37, encode_token(4, 2))
    script.send("m2", 200, ASK)
    assert script.verdict() == [Rule.RIGHT]


def test_a_second_token(script: Script) -> None:
    script.claim()
    script.send("m9", 37, encode_token(2, 9))
    assert script.verdict() == [Rule.TWO_TOKENS]


def test_a_second_station_with_the_holders_address(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("twin", 200, ASK)
    assert script.verdict() == [Rule.TWO_TOKENS]


def test_a_claim_before_t_to(script: Script) -> None:
    script.send("m2", T_TO_2 - 1, TOKEN)
    assert script.verdict() == [Rule.CLAIM]


def test_a_claim_while_another_station_has_the_token(script: Script) -> None:
    script.claim()
    script.referee.know(PARAMS.replace(address=4))
    script.send("m2", 37, ASK)
    script.send("m4", 500, encode_token(4, 4))
    assert script.verdict() == [Rule.CLAIM]


def test_a_claim_after_the_holder_fell_silent_is_in_order(script: Script) -> None:
    script.claim()
    script.referee.know(PARAMS.replace(address=4))
    script.send("m2", 37, ASK)
    script.send("m4", (6 + 2 * 4) * 200, encode_token(4, 4))
    script.send("m4", 37, encode_token(4, 4))
    assert script.verdict() == []
    script.send("m2", 200, ASK)  # it comes back and goes on as if nothing had been
    assert script.verdict() == [Rule.RIGHT]


def test_a_member_of_the_ring_passed_over(script: Script) -> None:
    script.claim()
    script.send("m2", 37, encode_token(4, 2))
    script.send("m4", 37, encode_token(2, 4))
    script.send("m2", 37, encode_token(9, 2))
    assert script.verdict() == [Rule.ORDER]


def test_a_token_to_oneself_while_others_are_in_the_ring(script: Script) -> None:
    script.claim()
    script.send("m2", 37, encode_token(4, 2))
    script.send("m4", 37, encode_token(2, 4))
    script.send("m2", 37, TOKEN)
    assert script.verdict() == [Rule.ORDER]


def test_a_successor_given_up_too_soon(script: Script) -> None:
    script.claim()
    script.send("m2", 37, encode_token(4, 2))
    script.send("m2", 200, encode_token(4, 2))
    script.send("m2", 200, TOKEN)
    assert script.verdict() == [Rule.ORDER]


def test_the_ring_wraps() -> None:
    watch = TokenWatch()
    assert watch.token(100, 100, None) is None
    assert watch.token(100, 3, None) is None
    assert watch.token(3, 100, None) is None
    assert watch.ring == {3, 100}
    finding = watch.token(100, 7, None)
    assert finding is not None
    assert finding.text == "station 100 passes the token to 7, over 3"


def test_token_rules_can_be_left_alone(script: Script) -> None:
    script.referee.token_rules = False
    script.send("m2", 5_000, ASK)
    script.send("s5", 11, ANSWER)
    script.send("m3", 37, encode_token(9, 3))
    assert script.verdict() == []


# --- telegrams ---
def test_a_gap_inside_a_telegram(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK[:4])
    script.send("m2", 1, ASK[4:])
    assert script.verdict() == [Rule.BROKEN, Rule.BROKEN]


# --- what was ordered ---
def test_what_is_injected_is_nobodys_fault_but_counts(script: Script) -> None:
    script.claim()
    script.world.run_for(37 * BIT)
    script.world.add(Dummy(9))
    script.world.inject(encode_token(4, 2))
    script.world.run_for(33 * BIT)
    script.at = script.world.now
    script.send("m4", 37, encode_sd1(5, 4, 0x49))
    script.send("s5", 10, encode_sd1(4, 5, 0x00))
    assert script.verdict() == [Rule.EARLY]


def test_what_a_fault_delayed_is_nobodys_fault(script: Script) -> None:
    script.claim()
    script.world.faults.delay(lambda tx: tx.sender == "s5", 300 * BIT)
    script.send("m2", 37, ASK)
    script.send("s5", 20, ANSWER)
    script.world.run_for(400 * BIT)
    script.at = script.world.now
    script.send("m2", 300, ASK)
    assert script.verdict() == []


@pytest.mark.parametrize(("pause", "found"), [(22, []), (21, [Rule.IDLE])])
def test_after_damage_silence_counts_from_the_last_octet_that_could_be_heard(
    script: Script, pause: int, found: list[Rule]
) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.world.faults.damage(lambda tx: tx.sender == "s5", octet=-1)
    script.send("s5", 20, ANSWER)
    script.send("m2", pause, ASK)
    assert script.verdict() == found


@pytest.mark.parametrize(("bits", "found"), [(22 + 32, [Rule.COLLISION]), (22 + 33, [])])
def test_who_heard_nothing_for_t_syn_may_begin(world: WorldFactory, bits: int, found: list[Rule]) -> None:
    w = world()
    assert w.referee is not None
    w.referee.token_rules = False
    for octet in (2, 3, 4, 5):
        w.faults.damage(lambda tx: tx.sender == "2", octet=octet)
    w.add(Dummy(2, plan=[(1_000, ASK)]))
    w.add(Dummy(3, plan=[(1_000 + bits * BIT, ASK)]))
    w.run_until(1_000_000)
    assert [violation.rule for violation in w.referee.violations] == found
    w.referee.violations.clear()


def test_a_token_that_noise_made_another_one_of_is_nobodys_fault(script: Script) -> None:
    script.claim()
    # 2 -> 2 becomes 2 -> 3: bit 0 of DA and its parity bit
    script.world.faults.damage(lambda tx: tx.octets == TOKEN, octet=1, flips=0x202)
    script.send("m2", 37, TOKEN)
    assert "heard as the token 2 -> 3" in list(script.world.log)[-1].note
    script.send("m3", 37, encode_sd1(5, 3, 0x49))
    assert script.verdict() == []
    script.at += 258 * 200 * BIT
    script.send("m3", 37, encode_sd1(5, 3, 0x49))
    assert script.verdict() == []
    script.send("m2", 37, ASK)
    assert script.verdict() == [Rule.RIGHT]


def test_allowed_violations_are_kept_apart(script: Script) -> None:
    script.referee.allow(Rule.RIGHT, times=1)
    script.referee.allow(Rule.EARLY)
    script.send("m2", 5_000, ASK)
    script.send("s5", 5, ANSWER)
    script.send("m3", 37, encode_sd1(5, 3, 0x49))
    script.send("s5", 5, encode_sd1(3, 5, 0))
    assert [violation.rule for violation in script.referee.allowed] == [Rule.RIGHT, Rule.EARLY, Rule.EARLY]
    assert script.verdict() == [Rule.RIGHT]


def test_check_tells_the_violations_and_the_wire(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 10, ANSWER)
    with pytest.raises(RefereeError) as caught:
        script.referee.check()
    text = str(caught.value)
    assert "1 violations on the wire" in text
    assert "s5: answer too early: 10 bits after the request; min T_SDR is 11" in text
    assert "FDL_Status request 2 -> 5" in text
    assert "[ANSWER TOO EARLY]" in text
    script.verdict()


def test_check_shows_a_violation_that_fell_out_of_the_log(world: WorldFactory) -> None:
    script = Script(world)
    script.send("m2", 5_000, ASK)
    for _ in range(500):
        script.send("m2", 250, ASK)
    with pytest.raises(RefereeError, match="up to the first violation:"):
        script.referee.check()
    assert script.verdict() == [Rule.RIGHT]


def test_many_violations_are_not_all_printed(script: Script) -> None:
    script.claim()
    for _ in range(30):
        script.send("s5", 37, ANSWER)
    with pytest.raises(RefereeError, match=r"\.\.\. and 10 more"):
        script.referee.check()
    assert script.verdict() == [Rule.UNASKED] * 30


def test_what_was_expected_must_happen(script: Script) -> None:
    script.referee.expect(Rule.EARLY)
    with pytest.raises(RefereeError, match="expected, but never happened: answer too early"):
        script.referee.check()
    script.claim()
    script.send("m2", 37, ASK)
    script.send("s5", 10, ANSWER)
    script.referee.check()


def test_a_world_without_referee() -> None:
    made = World(referee=False)
    made.add(Dummy(2, plan=[(0, ASK), (500_000, ASK)]))
    made.run_until(1_000_000)
    assert made.referee is None
    assert made.transmissions == len(made.log) == 2
