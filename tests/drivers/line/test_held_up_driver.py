"""Drivers that are held up: an answer that arrived by its deadline always counts; held up for longer than a slave's
watchdog, they let no old output out, wherever they stood still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernel_kit import Driven, Kernel, held_up_at
from octet_slave import SC, frame, sd1, sd2
from property_kit import examples

from dpstack.boottime import suspended_ns
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import Blocked, SlaveState, Stalled
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.units import NS_PER_MS, NS_PER_US, chars_to_ns
from tests.drivers.line.asker_kit import ANSWER, BAUD, Asker

RUN: Final = b"\x04\x7f"
WATCHDOG_NS: Final = 200 * NS_PER_MS


class Plant:
    """A master on the line of a kernel with one slave of two octets each way, in Operate with the outputs RUN."""

    def __init__(self, kind: str, *, after_stall: str = "safe", asleep_ms: int = 0) -> None:
        self.kernel = Kernel()
        self.kernel.asleep = asleep_ms * NS_PER_MS
        self.kernel.far = self._far
        self.given: list[tuple[int, bytes]] = []  # outputs, and when they arrived
        self.controls: list[tuple[int, int]] = []  # control octet of Global_Control, and when
        self.mute = False
        self._heard = 0
        self._state = "wait_prm"
        self._free_at = 0
        setup = SlaveParams(address=3, name="s3", ident=0x0696, config=b"\x31", initial=RUN)
        params = BusParams.preset(BAUD, address=2, gap=0)
        self.master = Master(params, [setup], MasterSettings(safe_after_stall=after_stall == "safe"))
        self.station = ActiveStation(params, [self.master], patience=HOST, now=self.kernel.now)
        self.patch = pytest.MonkeyPatch()
        self.driven = Driven(kind, self.station, self.kernel, self.patch)
        self.driven.runtime.command(GoOnline())
        self.driven.runtime.command(SetMode(Mode.OPERATE))
        self.run(300)
        assert self.given[-1][1] == RUN

    def run(self, ms: int) -> None:
        self.driven.run(self.kernel.now + ms * NS_PER_MS)

    def run_past_stall(self, most_ms: int) -> None:
        """Until the master has noticed a stall, after ``most_ms`` at most, and until Global_Control has come again."""
        end = self.kernel.now + most_ms * NS_PER_MS
        while not self.stalls and self.kernel.now < end:
            self.run(25)
        self.run(250)

    def close(self) -> None:
        self.driven.close()
        self.patch.undo()

    @property
    def stalls(self) -> list[Stalled]:
        return [event for event in self.driven.events if isinstance(event, Stalled)]

    def _far(self, octets: bytes, now: int) -> None:
        self._free_at = max(now, self._free_at) + chars_to_ns(len(octets), BAUD)
        if octets[0] not in (0x10, 0x68):
            return
        answer = self._answer(octets, self._free_at)
        if answer is not None and not self.mute:
            at = self._free_at + 22 * NS_PER_US
            self._free_at = at + chars_to_ns(len(answer), BAUD)
            self.kernel.arrive(self._free_at, answer)

    def _answer(self, octets: bytes, now: int) -> bytes | None:
        if octets[0] == 0x10:
            return sd1(2, 3, 0x03)
        da = octets[4] & 0x7F
        if octets[4] & 0x80 and octets[7] == 58:
            self.controls.append((octets[9], now))
            return None
        if da != 3:
            return None
        if now - self._heard > WATCHDOG_NS:
            self._state = "wait_prm"
        self._heard = now
        if not octets[4] & 0x80:
            self.given.append((now, octets[7:-2]))
            return frame(b"\x02\x03\x08\x00\x00") if self._state == "data_exchange" else sd1(2, 3, 0x03)
        match octets[7]:
            case 60:
                ready = self._state == "data_exchange"
                return sd2(2, 3, 0x08, 62, 60, bytes.fromhex("000C00020696" if ready else "020500FF0696"))
            case 61:
                self._state = "wait_cfg"
                return SC
            case 62:
                self._state = "data_exchange"
                return SC
        return sd1(2, 3, 0x03)


@pytest.mark.parametrize("what", ["nothing", "octets", "write", "woken"])
@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_stopped_anywhere_nothing_old_goes_out(kind: str, what: str, number: int) -> None:
    plant = Plant(kind)
    began = plant.kernel.now
    plant.kernel.held_up = held_up_at({(what, number): 900})
    plant.run_past_stall(1_800)  # a read that finds nothing comes every 200 ms, after a Global_Control
    plant.close()
    resumed = max((b for a, b in gaps(plant) if b - a > 800 * NS_PER_MS), default=0)
    assert resumed > began
    assert plant.master.mode is Mode.CLEAR
    assert {octets for at, octets in plant.given if at >= resumed} == {bytes(2)}
    assert {control & 0x02 for control, at in plant.controls if at >= resumed} == {0x02}
    (stall,) = plant.stalls
    assert stall.blocked is Blocked.PROGRAM
    assert stall.gap_ns is not None
    assert 890 * NS_PER_MS < stall.gap_ns < 1_000 * NS_PER_MS


@pytest.mark.parametrize("what", ["nothing", "octets", "write", "woken"])
@pytest.mark.parametrize("number", [1, 2, 3])
def test_suspended_anywhere_nothing_old_goes_out(kind: str, what: str, number: int) -> None:
    """CLOCK_MONOTONIC stands still, also between the beginning of a step and its write; CLOCK_BOOTTIME goes on."""
    plant = Plant(kind)
    kernel = plant.kernel
    pause = held_up_at({(what, number): 900})

    def asleep(done: str) -> int:
        ns = pause(done)
        kernel.behind += ns
        kernel.asleep += ns
        return ns

    kernel.held_up = asleep
    plant.run_past_stall(1_500)
    plant.close()
    resumed = max(b for a, b in gaps(plant) if b - a > 800 * NS_PER_MS)
    assert plant.master.mode is Mode.CLEAR
    assert {octets for at, octets in plant.given if at >= resumed} == {bytes(2)}
    (stall,) = plant.stalls
    assert stall.blocked is Blocked.SUSPENDED


def test_a_slave_lost_by_a_stall_is_not_held_for_one_that_flaps(kind: str) -> None:
    """It had been in data exchange for less than a second, yet it is brought up again at once."""
    plant = Plant(kind, after_stall="resume")
    plant.kernel.held_up = held_up_at({("woken", 5): 900})
    plant.run(1_000)
    plant.close()
    resumed = max(b for a, b in gaps(plant) if b - a > 800 * NS_PER_MS)
    assert plant.given[-1] == (plant.given[-1][0], RUN)
    assert plant.master.handlers[3].state is SlaveState.DATA_EXCHANGE
    assert plant.master.handlers[3].since - resumed < 50 * NS_PER_MS


@pytest.mark.parametrize(("ms", "mode"), [(40, Mode.OPERATE), (400, Mode.CLEAR), (3_000, Mode.CLEAR)])
def test_a_port_that_takes_nothing_is_a_stall(kind: str, ms: int, mode: Mode) -> None:
    """The driver runs, and the machine believes that it asks its slave; nothing is on the wire."""
    plant = Plant(kind)
    port = plant.driven.port
    write = port._send

    def refuse(_octets: bytes) -> int:
        raise BlockingIOError

    port._send = refuse
    plant.run(ms)
    port._send = write
    resumed = plant.kernel.now
    plant.run(1_500)
    plant.close()
    assert plant.master.mode is mode
    given = {octets for at, octets in plant.given if at >= resumed}
    assert given == {RUN if mode is Mode.OPERATE else bytes(2)}
    assert [stall.blocked for stall in plant.stalls] == [Blocked.PORT] * (mode is Mode.CLEAR)


def gaps(plant: Plant) -> list[tuple[int, int]]:
    """Ends of neighbouring telegrams to the slave and to all."""
    at = sorted([at for at, _ in plant.given] + [at for _, at in plant.controls])
    return list(pairwise(at))


def test_a_request_whose_answer_was_lost_meanwhile_is_not_repeated(kind: str) -> None:
    """Held up while the answer is waited for, and no answer is there afterwards: the repetition would be old."""
    plant = Plant(kind)
    plant.mute = True
    plant.kernel.held_up = held_up_at({("write", 1): 900})
    begin = len(plant.given)
    plant.run(950)
    plant.mute = False
    plant.run(1_500)
    plant.close()
    assert [octets for _, octets in plant.given[begin:]].count(RUN) <= 1  # the one before it was held up
    assert plant.master.mode is Mode.CLEAR
    assert plant.given[-1][1] == bytes(2)


@pytest.mark.parametrize("ms", [20, 100, 150])
def test_a_shorter_pause_changes_nothing(kind: str, ms: int) -> None:
    plant = Plant(kind)
    plant.kernel.held_up = held_up_at({("woken", 5): ms})
    plant.run(1_000)
    plant.close()
    assert plant.master.mode is Mode.OPERATE
    assert plant.given[-1][1] == RUN
    assert not plant.stalls


def test_resume_sends_the_old_outputs_again(kind: str) -> None:
    plant = Plant(kind, after_stall="resume")
    plant.kernel.held_up = held_up_at({("woken", 5): 900})
    plant.run(2_000)
    plant.close()
    assert plant.master.mode is Mode.OPERATE
    assert plant.given[-1][1] == RUN
    assert not plant.stalls


def test_a_suspended_computer(kind: str) -> None:
    """CLOCK_MONOTONIC stands still meanwhile, CLOCK_BOOTTIME goes on."""
    plant = Plant(kind, asleep_ms=5_000)
    plant.kernel.asleep += 3_600_000 * NS_PER_MS
    resumed = plant.kernel.now
    plant.run(1_000)
    plant.close()
    assert {octets for at, octets in plant.given if at > resumed + NS_PER_MS} == {bytes(2)}
    (stall,) = plant.stalls
    assert stall.blocked is Blocked.SUSPENDED
    assert "the computer was suspended for 3600000 ms" in stall.text
    assert stall.gap_ns is not None
    assert 3_600_000 * NS_PER_MS <= stall.gap_ns < 3_600_050 * NS_PER_MS


def test_a_short_sleep_changes_nothing(kind: str) -> None:
    plant = Plant(kind)
    for _ in range(5):
        plant.kernel.asleep += 150 * NS_PER_MS
        plant.run(100)
    plant.close()
    assert not plant.stalls
    assert plant.given[-1][1] == RUN


def test_the_time_of_system_sleep_never_runs_backwards() -> None:
    """However long the computer slept: the value never becomes smaller."""
    first = suspended_ns()
    assert first > -50 * NS_PER_MS
    assert suspended_ns() - first < 1_000 * NS_PER_MS


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
