"""``dpstack doctor --measure``: nothing is sent unasked, no telegram is begun, the figures are those of the loop."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from cli_kit import Cli
from far_ends import PtyFarEnd

from dpstack.api import measure as measuring
from dpstack.api.measure import measure
from dpstack.errors import UsageError


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "_LISTEN_S", 0.0)
    monkeypatch.setattr(measuring, "_LOST_S", 0.05)
    monkeypatch.setattr(measuring, "_BLOCK_NS", 2_000_000)


@contextmanager
def answering(far: PtyFarEnd, answer: Callable[[bytes], bytes]) -> Iterator[bytearray]:
    """The other end of the line is a thread; yields the octets that it got."""
    got, over = bytearray(), threading.Event()

    def run() -> None:
        while not over.wait(0.0002):
            octets = far.take()
            got.extend(octets)
            if octets:
                os.write(far.fd, answer(octets))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield got
    finally:
        over.set()
        thread.join()


@pytest.fixture
def far() -> Iterator[PtyFarEnd]:
    end = PtyFarEnd()
    kept = os.open(end.path, os.O_RDWR | os.O_NOCTTY)  # the pty has an opener between two of the measurement
    yield end
    os.close(kept)
    end.hang_up()


def test_an_echo_gives_turn_around_and_rate_and_begins_no_telegram(far: PtyFarEnd) -> None:
    with answering(far, lambda octets: octets) as got:
        found = measure(far.path, "", rounds=10, rates=(187_500, 500_000))
    assert (found["loop"], found["rounds"], found["refused"], found["marks"]) == ("echo", 10, {}, None)
    rates = found["rates"]
    assert isinstance(rates, list)
    assert [one["baud"] for one in rates] == [187_500, 500_000]
    for one in rates:
        assert one["lost"] == 0
        assert 0 < one["turn_around_us"]["p50"] <= one["turn_around_us"]["p999"]
        assert one["octets_per_s"] > 0
    assert rates[0]["wanted_octets_per_s"] == 17_045
    # SD1, SD2, SD3, SD4, SC begin no telegram here
    assert got
    assert not set(got) & {0x10, 0x68, 0xA2, 0xDC, 0xE5}


def test_a_line_that_gives_nothing_back_has_no_figures(far: PtyFarEnd) -> None:
    found = measure(far.path, "", rounds=10, rates=(500_000,))
    assert found["rates"] == [
        {
            "baud": 500_000,
            "turn_around_us": None,
            "lost": 4,
            "octets_per_s": None,
            "wanted_octets_per_s": 45_455,
        }
    ]


def test_without_a_loop_nothing_is_sent(far: PtyFarEnd) -> None:
    found = measure(far.path, None, rates=(187_500,))
    assert found["rates"] == [{"baud": 187_500}]
    assert far.take() == b""


def test_octets_that_come_unasked_are_a_bus(far: PtyFarEnd, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda _s: far.send(b"\xdc\x02\x02"))
    with pytest.raises(UsageError, match="3 octets came although nothing was sent: this is a bus"):
        measure(far.path, "", rates=(187_500,))
    assert far.take() == b""


def test_the_command_sends_only_with_yes(cli: Cli, far: PtyFarEnd) -> None:
    assert "say so with --yes" in cli.err("doctor", "--measure", "--port", far.path, "--loop")
    assert "--measure needs --port P" in cli.err("doctor", "--measure")
    assert "--loop needs --measure" in cli.err("doctor", "--port", far.path, "--loop", "--yes")
    assert far.take() == b""
    found = cli.json("doctor", "--measure", "--port", far.path)
    assert (found["port"], found["loop"]) == (far.path, None)
    assert far.take() == b""
