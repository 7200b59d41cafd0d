"""What the referee says of tokens: requests without one, claims, members passed over."""

from __future__ import annotations

from referee_kit import ANSWER, ASK, PARAMS, T_TO_2, TOKEN, Script

from dpstack.fdl.codec import encode_sd1, encode_token
from dpstack.sim.token_watch import Rule, TokenWatch


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
