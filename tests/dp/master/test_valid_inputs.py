"""The rule for valid inputs: in data exchange, and no older than the watchdog, 1 s without one, or two polls."""

from __future__ import annotations

import pytest
from scripted_link import exchanging, setup

from dpstack.dp.master import fault_texts
from dpstack.dp.process_image import inputs_are_valid, inputs_limit_ns
from dpstack.machine import InDoubt

MS = 1_000_000


@pytest.mark.parametrize(
    ("watchdog_ms", "poll_ms", "limit_ms"),
    [
        (200, 4, 200),  # its watchdog
        (0, 4, 1000),  # off: 1 s
        (60_000, 4, 60_000),
        (200, 150, 300),  # every n-th cycle, many slaves, a slow rate: two polls
        (200, 100, 200),
        (0, 700, 1400),
        (0, 500, 1000),
    ],
)
def test_the_greatest_age_of_valid_inputs(watchdog_ms: int, poll_ms: int, limit_ms: int) -> None:
    assert inputs_limit_ns(watchdog_ms * MS, poll_ms * MS) == limit_ms * MS


@pytest.mark.parametrize(
    ("exchanging", "age_ms", "valid"),
    [(True, 0, True), (True, 200, True), (True, 201, False), (False, 0, False), (True, None, False)],
)
def test_inputs_are_valid_up_to_that_age(exchanging: bool, age_ms: int | None, valid: bool) -> None:
    age_ns = None if age_ms is None else age_ms * MS
    assert inputs_are_valid(exchanging=exchanging, age_ns=age_ns, limit_ns=200 * MS) is valid


def test_inputs_in_doubt_are_not_valid_until_the_next_exchange() -> None:
    """The adapter's driver counted damaged octets after the answer was delivered."""
    bus = exchanging(setup())
    image = bus.image
    bus.send(InDoubt(0))  # nothing arrived after now
    valid = [image.valid]
    bus.send(InDoubt(bus.now - image.input_time + 1))
    assert [*valid, image.valid] == [True, False]
    exchanges = bus.master.handlers[3].exchanges
    bus.hold()
    assert (bus.master.handlers[3].exchanges, image.valid) == (exchanges + 1, True)
    bus.send(InDoubt(bus.now))
    bus.hold()
    assert bus.remarks(3) == [fault_texts.IN_DOUBT]  # once
