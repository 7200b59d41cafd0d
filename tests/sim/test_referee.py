"""The referee is shown every fault it knows, made by scripted stations; and that it is silent when all is well.

Times at 500 kbit/s: a bit is 2 us. Preset there: T_SL 200, T_ID1 37, T_ID2 100, T_TO of station 2 is 10 T_SL = 2000.
"""

from __future__ import annotations

from referee_kit import ANSWER, ASK, BIT, PARAMS, TOKEN, Script
from support import Dummy, WorldFactory

from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.sim.token_watch import Rule

SDN = bytes.fromhex("68 07 07 68 FF 82 46 3A 3E 00 00 3F 16")


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


# --- telegrams ---
def test_a_gap_inside_a_telegram(script: Script) -> None:
    script.claim()
    script.send("m2", 37, ASK[:4])
    script.send("m2", 1, ASK[4:])
    assert script.verdict() == [Rule.BROKEN, Rule.BROKEN]
