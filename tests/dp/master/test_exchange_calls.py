"""The way of an exchange through the master alone is short: a bound on its Python calls, at a medium without cost."""

from __future__ import annotations

import sys
from collections import Counter
from types import FrameType

import pytest

from bench.null_medium import NullBus

EXCHANGES = 400
#: calls of dpstack's functions in an exchange of Data_Exchange, with the share of the token and of the round's ends;
#: 59.5 with changing outputs at commit 364aac1, counted by this test's function
MOST_CALLS = 32.5
pytestmark = pytest.mark.usefixtures("no_collection")


def calls_of(bus: NullBus) -> Counter[str]:
    """The calls of functions of dpstack in ``EXCHANGES`` exchanges, by name."""
    calls: Counter[str] = Counter()

    def count(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and "dpstack" in frame.f_globals["__name__"]:
            calls[frame.f_code.co_qualname] += 1

    before = sys.getprofile()
    sys.setprofile(count)
    try:
        bus.run(EXCHANGES)
    finally:
        sys.setprofile(before)
    return calls


@pytest.mark.parametrize("changing", [True, False])
def test_an_exchange_of_the_master_alone_needs_few_calls(changing: bool) -> None:
    bus = NullBus(10, changing=changing)
    bus.bring_up()
    bus.run(100)
    calls = calls_of(bus)
    assert sum(calls.values()) / EXCHANGES <= MOST_CALLS, calls.most_common()


def test_a_request_is_encoded_once_and_an_answer_decoded_once() -> None:
    bus = NullBus(10)
    bus.bring_up()
    bus.run(100)
    calls = calls_of(bus)
    tokens = calls["StateMachine.hold"]
    assert calls["request_octets"] <= EXCHANGES + tokens  # a Global_Control at most in each round
    assert calls["Decoder.whole"] == EXCHANGES
    assert calls["decode"] <= EXCHANGES  # none for the octets of the last answer
