"""Drivers that are held up: an answer that arrived by its deadline always counts.

The line goes on while the driver is held up, and a driver may be held up anywhere: before and after every call of the
system, in between two of them, for longer than any slot time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernel_kit import Driven, Kernel, held_up_at
from property_kit import examples

from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.units import NS_PER_MS, NS_PER_US, chars_to_ns
from tests.drivers.line.asker_kit import ANSWER, BAUD, Asker

BITS_11_NS: Final = 22 * NS_PER_US
#: so many answers in pieces make the next one known (of each FCB), and nobody listens until it should be over
LEARNED: Final = 16


@dataclass(frozen=True)
class Answer:
    """One answer: so many us late, cut before these octets, so many us between the pieces, noise around it."""

    late_us: int = 0
    cuts: frozenset[int] = frozenset(range(4, 21, 4))
    gap_us: int = 0
    before: bytes = b""
    after: bytes = b""

    def pieces(self, begin: int) -> list[tuple[int, bytes]]:
        """Times and pieces of this answer, for an answer due from ``begin`` on."""
        octets = self.before + ANSWER
        edges = [0, *sorted(len(self.before) + cut for cut in self.cuts), len(octets)]
        begin += self.late_us * NS_PER_US
        pieces = []
        for number, (first, end) in enumerate(pairwise(edges)):
            pieces.append((begin + chars_to_ns(end, BAUD) + number * self.gap_us * NS_PER_US, octets[first:end]))
        return [*pieces, (pieces[-1][0] + 1_000, self.after)] if self.after else pieces


USUAL: Final = Answer()


class Bus:
    """A lone master that asks one slave of octets: as usual until it is known, then ``answers``, then as usual."""

    def __init__(
        self,
        kind: str,
        answers: list[Answer],
        held_up: Callable[[str], int],
        *,
        paced: bool = True,
        early_ns: int = 0,
    ) -> None:
        self.kernel = Kernel()
        self.asked = 0
        self._answers = answers
        self._held_up = held_up
        self._free_at = 0  # the line is one: what comes next begins when what was before is over
        user = Asker()
        station = ActiveStation(BusParams.preset(BAUD, address=2, gap=0), [user], patience=HOST, now=self.kernel.now)
        self.kernel.far = self._far
        with pytest.MonkeyPatch.context() as patch:
            self._driven = Driven(kind, station, self.kernel, patch, paced=paced, early_ns=early_ns)
            self._driven.runtime.command(GoOnline())
            self._driven.run(self.kernel.now + 3_600_000 * NS_PER_MS)
            self._driven.close()
        self.outcomes = user.outcomes
        self.station = station.stats.station(3)

    def _far(self, octets: bytes, now: int) -> None:
        self._free_at = max(now, self._free_at) + chars_to_ns(len(octets), BAUD)
        if octets[0] != 0x68:
            return
        self.asked += 1
        number = self.asked - LEARNED
        if number == 0:
            self.kernel.held_up = self._held_up
        if number > len(self._answers) + 2:
            self._driven.stop()
        answer = self._answers[number] if 0 <= number < len(self._answers) else USUAL
        for at, piece in answer.pieces(self._free_at + BITS_11_NS):
            self.kernel.arrive(at, piece)
            self._free_at = at

    @property
    def failed(self) -> list[Failure]:
        """Requests that came to nothing."""
        return [outcome for outcome in self.outcomes if not isinstance(outcome, Telegram)]


@pytest.mark.parametrize("what", ["nothing", "octets", "write", "woken"])
@pytest.mark.parametrize("late_us", [0, 5_000, 40_000])
def test_held_up_at_the_same_place_every_time(kind: str, what: str, late_us: int) -> None:
    """For 120 ms, which is more than two slot times with their slack. A look before the answer was there, and a pause
    after it, was taken for the silence of the slave, and the request repeated."""
    bus = Bus(kind, [Answer(late_us=late_us)] * 30, held_up_at({}, every=(what, 120)))
    assert bus.failed == []
    assert (bus.station.retries, bus.station.late) == (0, 0)
    assert bus.asked > LEARNED + 30


def test_held_up_after_an_order_of_the_application(kind: str) -> None:
    """An order is another occasion at which the line is read before a deadline is judged."""
    bus = Bus(kind, [Answer(late_us=30_000)] * 10, held_up_at({}, every=("nothing", 200)))
    assert (bus.failed, bus.station.retries) == ([], 0)


#: where it is held up
KINDS: Final = st.sampled_from(["nothing", "octets", "write", "woken", "clock"])
NOISE: Final = st.sampled_from([b"", b"", b"", b"\x00", b"\xff\x00", b"\x55" * 5])
ANSWERS: Final = st.builds(
    Answer,
    late_us=st.sampled_from([0, 0, 100, 1_000]) | st.integers(0, 30_000),
    cuts=st.frozensets(st.integers(1, 20), max_size=20),
    gap_us=st.sampled_from([0, 0, 20, 500]),
    before=NOISE,
    after=NOISE,
)


@examples(60)
@given(
    driver=st.sampled_from(["asyncio", "plain"]),
    paced=st.booleans(),
    early_us=st.sampled_from([0, 0, 50, 700]),
    answers=st.lists(ANSWERS, min_size=4, max_size=12),
    pauses=st.dictionaries(st.tuples(KINDS, st.integers(1, 30)), st.integers(1, 400), max_size=20),
    every=st.tuples(KINDS, st.sampled_from([0, 0, 3, 55, 300])),
)
def test_an_answer_in_time_counts_wherever_the_driver_is_held_up(
    driver: str,
    paced: bool,
    early_us: int,
    answers: list[Answer],
    pauses: dict[tuple[str, int], int],
    every: tuple[str, int],
) -> None:
    """Every split, gaps, noise around it, timers that call too early, clocks that jump: asked once, answered."""
    bus = Bus(driver, answers, held_up_at(pauses, every), paced=paced, early_ns=early_us * NS_PER_US)
    assert bus.failed == []
    assert (bus.station.retries, bus.station.late, bus.station.timeouts) == (0, 0, 0)
