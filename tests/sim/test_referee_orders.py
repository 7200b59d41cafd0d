"""What was ordered is nobody's fault, what is allowed is kept apart, and how the referee tells what it found."""

from __future__ import annotations

import pytest
from referee_kit import ANSWER, ASK, BIT, TOKEN, Script
from support import Dummy, WorldFactory

from dpstack.fdl.codec import encode_sd1, encode_token
from dpstack.sim.referee import RefereeError
from dpstack.sim.token_watch import Rule
from dpstack.sim.world import World


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
