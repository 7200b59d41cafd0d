"""A program listens to its own bus in short steps: every telegram in its order, and each loss told."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import pytest
from fake_adapter import FakeDriver
from far_ends import PtyFarEnd, until
from msgspec import structs

from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.listen import own_tap
from dpstack.api.listen.listening import Listening
from dpstack.api.listen.own_tap import OwnTap
from dpstack.api.listen.tap_cutter import OctetsLost, TapCutter
from dpstack.capture.transmission import Damage, Transmission
from dpstack.drivers.runtime import PortBack, PortLost
from dpstack.drivers.tap import CAPACITY, Tap
from dpstack.ports import termios2, tty
from dpstack.trace import Event
from dpstack.units import chars_to_ns

BAUD = 500_000
TOKEN = bytes.fromhex("dc 02 02")


class Line:
    """A line with a tap, in place of a runtime."""

    def __init__(self) -> None:
        self.tap: Tap | None = None
        self.heard: list[Transmission] = []
        self.events: list[Event] = []
        self.feed = TapFeed(self.attach, lambda: 0, self.about)
        self.own = OwnTap(self.feed, "port", self.heard.append, self.events.append)

    def attach(self, tap: Tap | None) -> None:
        self.tap = tap

    def about(self) -> Mapping[str, object]:
        return {"baud": BAUD, "paced": True, "exact": True}

    def send(self, *entries: Any) -> None:
        assert self.tap is not None
        for entry in entries:
            self.tap.add(entry)

    async def until(self, count: int) -> None:
        """Wait until ``count`` transmissions were heard."""
        for _ in range(20_000):
            if len(self.heard) >= count:
                return
            await asyncio.sleep(0.001)
        raise AssertionError(f"only {len(self.heard)} of {count} transmissions were heard")


def _tokens(count: int, begin: int = 0) -> list[tuple[int, int, bytes, bool]]:
    return [((begin + number + 1) * 1_000_000, BAUD, TOKEN, True) for number in range(count)]


@pytest.fixture
def line() -> Line:
    return Line()


async def test_every_telegram_once_and_in_order_and_steps_are_short(line: Line) -> None:
    line.own.begin()
    line.send(*_tokens(3000))
    await line.until(1)
    assert len(line.heard) < 3000  # not all at once
    await line.until(3000)
    line.send(*_tokens(500, 3000))
    line.own.end()
    assert line.tap is None
    line.own.rest()
    assert len(line.heard) == 3500
    ends = [(one.t_ns or 0) + chars_to_ns(3, BAUD) for one in line.heard]
    assert {after - before for before, after in pairwise(ends)} == {1_000_000}
    assert (line.own.lost, line.events) == (0, [])
    assert line.own.timing.resolution_ns == 1


async def test_a_lost_entry_is_told_in_its_place(line: Line) -> None:
    line.own.begin()
    assert line.tap is not None
    line.send(*_tokens(CAPACITY + 7))
    line.own.end()
    line.own.rest()
    # the line that describes the tap takes one place in the queue
    assert line.own.lost + len(line.heard) == CAPACITY + 7
    assert line.own.lost >= 7
    assert sum(event.count for event in line.events if isinstance(event, OctetsLost)) == line.own.lost


async def test_a_queue_that_is_full_delays_nobody(line: Line) -> None:
    line.own.begin()
    for number in range(4):  # nothing runs between these
        line.own.put(0, _tokens(CAPACITY // 2, number * CAPACITY))
    line.own.end()
    line.own.rest()
    assert len(line.heard) + line.own.lost == 2 * CAPACITY
    assert line.own.lost >= CAPACITY


async def test_a_port_that_was_lost_and_is_back(line: Line) -> None:
    line.own.begin()
    line.send(*_tokens(1), (2_000_000, 0, b"", False), (3_000_000, BAUD, b"", False), *_tokens(1, 3))
    await line.until(2)
    line.own.end()
    assert [type(event) for event in line.events] == [PortLost, PortBack]


async def test_a_step_ends_when_its_time_is_over(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a computer that needs 60 us for a telegram a cycle of the bus is delayed by 0.25 ms at most."""
    line.own.begin()
    line.own.put(0, _tokens(100))
    clock = itertools.count(0, 60_000)
    monkeypatch.setattr(own_tap, "monotonic_ns", lambda: next(clock))
    for _ in range(5):
        before = len(line.heard)
        line.own._step()
        assert 1 <= len(line.heard) - before <= 4
    line.own.end()
    line.own.rest()
    assert len(line.heard) == 100


# --- Listening on a port of its own: marked octets reach the transmissions with their place -------------------------


@pytest.fixture
def adapter(monkeypatch: pytest.MonkeyPatch) -> PtyFarEnd:
    """The other end of a pty that looks like an adapter; it writes the marks of damaged octets itself, FF 00 x."""
    really = termios2.set_raw

    def marking(fd: int, baud: int | None, *, marks: bool) -> termios2.Applied:
        return structs.replace(really(fd, baud), parity=True, marks=marks)

    far = PtyFarEnd()
    FakeDriver(monkeypatch)
    monkeypatch.setattr(termios2, "set_raw", marking)
    monkeypatch.setattr(tty, "is_pty_path", lambda _name: False)
    return far


async def test_a_damaged_octet_is_where_it_was(adapter: PtyFarEnd) -> None:
    heard: list[Transmission] = []
    async with Listening(adapter.path, 500_000, heard.append) as listening:
        adapter.send(TOKEN + bytes.fromhex("10 05 02 FF 00 48 50 16") + TOKEN)
        await until(lambda: len(heard) == 3, "three transmissions")
        assert listening.line.source == "adapter"
        assert listening.line.damaged == "octets with a parity or framing error are marked at their place"
        assert listening.damage() == {"marked": 1}
    adapter.hang_up()
    first, damaged, last = heard
    assert (first.octets, last.octets) == (TOKEN, TOKEN)
    assert damaged.octets.hex() == "100502485016"
    assert damaged.damage == Damage.FCS | Damage.PARITY_OR_FRAMING
    assert damaged.note == "damaged by mark of the port: octet 4"


# --- Entries of a tap become transmissions: times since 1970, telegrams in slow pieces, those of the program itself


POLL = bytes.fromhex("10 05 02 49 50 16")
LONG = b"\x68\xf9\xf9\x68" + bytes(249) + b"\0\x16"
EPOCH = 1_790_000_000_000_000_000


def test_a_long_telegram_at_a_slow_rate_comes_in_pieces_that_last_longer_than_a_silence() -> None:
    """An adapter on USB delivers 62 octets at a time: 71 ms at 9600 bit/s."""
    heard: list[Transmission] = []
    tap = TapCutter("a port", heard.append, lambda event: None)
    tap.begin(EPOCH, "run")
    now = 0
    for at in range(0, len(LONG), 62):
        piece = LONG[at : at + 62]
        now += chars_to_ns(len(piece), 9_600)
        tap.add(now, 9_600, piece, False)
    assert [(one.octets, one.t_ns) for one in heard] == [(LONG, EPOCH + now - chars_to_ns(len(LONG), 9_600))]


def test_octets_of_the_program_begin_a_telegram_and_another_epoch_counts_from_then_on() -> None:
    heard: list[Transmission] = []
    tap = TapCutter("a port", heard.append, lambda event: None)
    tap.begin(EPOCH, "run")
    tap.add(1_000_000, 500_000, POLL[:3], False)
    tap.add(1_200_000, 500_000, POLL, True)
    tap.begin(EPOCH + 7, "run")
    tap.add(2_000_000, 500_000, POLL, False)
    assert [(one.octets, bool(one.damage)) for one in heard] == [(POLL[:3], True), (POLL, False), (POLL, False)]
    assert heard[2].t_ns == EPOCH + 7 + 2_000_000 - chars_to_ns(len(POLL), 500_000)
