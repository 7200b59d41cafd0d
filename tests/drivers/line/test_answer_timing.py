"""Sleep of the drivers until an expected answer can be complete: the telegrams and their times stay the same."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from random import Random
from typing import Any, Final

import kernel_kit
import pytest
from kernel_kit import LATE_NS, Driven, Kernel

from dpstack.drivers.line import answer_timing, asyncio_runtime, line_runtime
from dpstack.drivers.line.answer_timing import AnswerTiming, is_answered
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.units import NS_PER_MS, NS_PER_US, chars_to_ns
from tests.drivers.line.asker_kit import ANSWER, BAUD, SHORT, Asker

LONG: Final = bytes.fromhex("68 13 13 68 02 03 08" + " 00" * 16 + " 0D 16")
TOKEN: Final = bytes.fromhex("DC 02 02")
BITS_11_NS: Final = 22 * NS_PER_US
#: wake-ups that are one more or one less move what follows by this much
SAME_NS: Final = 3 * LATE_NS


class Scene:
    """A lone master that asks one slave of octets, which answers in pieces of ``piece`` octets.

    ``plan``: what the slave says to its requests by number (from 1 on), instead of :data:`ANSWER`. ``often``: requests
    in a token hold. ``jitter_ns``: the slave answers up to so much later.
    """

    def __init__(
        self,
        kind: str,
        patch: pytest.MonkeyPatch,
        *,
        paced: bool = True,
        piece: int = 4,
        often: int = 1,
        jitter_ns: int = 0,
    ) -> None:
        self.kernel = Kernel()
        self.user = Asker(often)
        self._jitter_ns = jitter_ns
        self._random = Random(1)
        params = BusParams.preset(BAUD, address=2, gap=0)
        station = ActiveStation(params, [self.user], patience=HOST, now=self.kernel.now)
        self.plan: dict[int, bytes] = {}
        self.piece = piece
        self.asked: list[int] = []  # when requests were written
        self.over: list[int] = []  # when the last octet of their answers was there, 0 without one
        self._enough = 0
        self.kernel.far = self._far
        self.driven = Driven(kind, station, self.kernel, patch, paced=paced)
        self.driven.runtime.command(GoOnline())

    def _far(self, octets: bytes, now: int) -> None:
        if octets[0] != 0x68:
            return
        self.asked.append(now)
        if len(self.asked) > self._enough:
            self.driven.stop()
        answer = self.plan.get(len(self.asked), ANSWER)
        begin = now + chars_to_ns(len(octets), BAUD) + BITS_11_NS + self._random.randint(0, self._jitter_ns)
        for first in range(0, len(answer), self.piece):
            piece = answer[first : first + self.piece]
            self.kernel.arrive(begin + chars_to_ns(first + len(piece), BAUD), piece)
        self.over.append(begin + chars_to_ns(len(answer), BAUD) if answer else 0)

    def run(self, exchanges: int) -> None:
        """Until so many requests were written, and their answers are over."""
        self._enough = exchanges
        self.driven.run(self.kernel.now + 20_000 * NS_PER_MS)
        assert len(self.asked) > exchanges

    def wakeups(self, exchange: int) -> int:
        """From the writing of a request (by number, from 1 on) to the next telegram."""
        begin = self.asked[exchange - 1]
        end = next(at for at, _ in self.kernel.written if at > begin)
        return sum(begin < at < end for at in self.kernel.woken)

    def turn_round(self, exchange: int) -> int:
        """From the last octet of its answer to the next telegram, in ns."""
        over = self.over[exchange - 1]
        return next(at for at, _ in self.kernel.written if at > self.asked[exchange - 1]) - over

    def said(self) -> list[bytes]:
        return [octets for _, octets in self.kernel.written]


@pytest.fixture
def scenes(kind: str) -> Iterator[Scenes]:
    scenes = Scenes(kind)
    yield scenes
    scenes.close()


class Scenes:
    """The same scene twice: as it is, and with everybody listening all the time."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._open: list[tuple[Scene, pytest.MonkeyPatch]] = []

    def play(self, plan: dict[int, bytes], exchanges: int, **options: Any) -> Scene:
        patch = pytest.MonkeyPatch()
        scene = Scene(self._kind, patch, **options)
        self._open.append((scene, patch))
        scene.plan = plan
        scene.run(exchanges)
        scene.driven.close()
        patch.undo()
        return scene

    def twice(self, plan: dict[int, bytes], exchanges: int, **options: Any) -> tuple[Scene, Scene]:
        """With answers that are slept for once they are known, and without."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(answer_timing, "_EQUAL_ANSWERS", 1 << 30)
            listening = self.play(plan, exchanges, **options)
        return self.play(plan, exchanges, **options), listening

    def close(self) -> None:
        for _, patch in self._open:
            patch.undo()


ROUNDS: Final = 120


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("piece", [1, 2, 4, 5])
def test_an_answer_wakes_up_once_or_twice_and_the_next_telegram_is_no_later(
    scenes: Scenes, paced: bool, piece: int
) -> None:
    quiet, listening = scenes.twice({}, ROUNDS, paced=paced, piece=piece)
    known = range(20, ROUNDS)
    # the nap before the end of T_ID1 is another one
    assert max(quiet.wakeups(n) for n in known) <= 3
    assert sum(quiet.wakeups(n) for n in known) <= 2.1 * len(known)
    pieces = -(-len(ANSWER) // piece)
    assert min(listening.wakeups(n) for n in known) >= min(pieces, pieces // 2 + 2)
    mean = [sum(scene.turn_round(n) for n in known) / len(known) for scene in (quiet, listening)]
    assert mean[0] <= mean[1] + NS_PER_US
    late = LATE_NS + asyncio_runtime._REST_NAP_NS
    assert max(quiet.turn_round(n) for n in known) < max(listening.turn_round(n) for n in known) + late
    assert quiet.said()[: 2 * ROUNDS] == listening.said()[: 2 * ROUNDS]


#: System calls of an exchange by name, of ten with a token to itself after them: the token and its idle time are a
#: tenth of what is measured. Of the select loop's polls, all belong to the token.
CALLS: Final = {
    "plain": {"select": 1.0, "read": 1.0, "nap": 1.0, "write": 1.0},
    "asyncio": {"epoll_wait": 1.0, "timerfd": 1.0, "read": 1.0, "nap": 1.0, "write": 1.0, "epoll_ctl": 0.0},
}


@pytest.mark.parametrize("piece", [1, 4, 11])
def test_an_exchange_with_a_known_answer_has_one_sleep_one_read_and_one_write(
    kind: str, scenes: Scenes, piece: int
) -> None:
    before, after = (scenes.play({}, exchanges, often=10, piece=piece).kernel.calls for exchanges in (60, 260))
    each = {name: (after[name] - before[name]) / 200 for name in after if name != "poll"}
    of_token = 2 / 10
    assert each.keys() <= CALLS[kind].keys()
    for name, wanted in CALLS[kind].items():
        assert each.get(name, 0.0) <= wanted + of_token + 0.15, name


def test_an_answer_in_one_piece_is_not_slept_through(scenes: Scenes) -> None:
    """As behind an adapter: a look of its own would be one wake-up more."""
    quiet, listening = scenes.twice({}, 30, piece=21)
    assert quiet.kernel.written == listening.kernel.written
    assert quiet.kernel.woken == listening.kernel.woken


@pytest.mark.parametrize(("jitter_us", "most"), [(1_000, (1.01, 1.0, 0.98)), (100, (0.8, 0.65, 0.4))])
def test_answers_at_irregular_times_do_not_wait(scenes: Scenes, jitter_us: int, most: tuple[float, ...]) -> None:
    """A slave that takes up to 1 ms longer, as behind the frames of an adapter: sleeping saves little, and ends."""
    for piece, of_listening in zip((11, 7, 3), most, strict=True):
        quiet, listening = scenes.twice({}, 400, piece=piece, jitter_ns=jitter_us * NS_PER_US)
        assert len(quiet.kernel.woken) <= of_listening * len(listening.kernel.woken)
        turns = [sum(scene.turn_round(n) for n in range(20, 400)) / 380 for scene in (quiet, listening)]
        assert turns[0] <= turns[1] + 15 * NS_PER_US


@pytest.mark.parametrize(("late_us", "least", "most"), [(5, 190, 215), (35, 190, 215), (100, 0, 40)])
def test_the_driver_naps_in_the_idle_time_only_where_wake_ups_are_soon(
    scenes: Scenes, monkeypatch: pytest.MonkeyPatch, late_us: int, least: int, most: int
) -> None:
    """T_ID1 is 74 us. The driver spins it through where a nap would end later, and tries again now and then. (Of the
    naps in asyncio some are for the rest of an answer.)"""
    monkeypatch.setattr(kernel_kit, "LATE_NS", late_us * NS_PER_US)
    begin, end = (scenes.play({}, exchanges, often=10) for exchanges in (200, 400))
    assert least <= end.kernel.calls["nap"] - begin.kernel.calls["nap"] <= most
    turns = sorted(end.turn_round(n) for n in range(200, 400))
    assert turns[150] <= 74 * NS_PER_US + max(late_us, 20) * NS_PER_US  # no later than after the last octet's wake-up


#: what comes instead of an answer, from some exchange on
STRANGE: Final = {
    "shorter": SHORT,
    "an acknowledgement": b"\xe5",
    "longer": LONG,
    "LE that lies: longer": b"\x68\xf9\xf9" + ANSWER[3:],
    "LE that lies: shorter": b"\x68\x05\x05" + ANSWER[3:],
    "two LE": b"\x68\x0f\x1f" + ANSWER[3:],
    "no telegram": bytes(21),
    "its beginning only": ANSWER[:9],
    "one octet": ANSWER[:1],
    "silence": b"",
    "another one right behind": ANSWER + SHORT,
    "another station's": ANSWER[:5] + b"\x04" + ANSWER[6:-2] + b"\x0e\x16",
}


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("what", STRANGE)
def test_another_answer_than_expected_leads_to_the_same(scenes: Scenes, what: str, paced: bool) -> None:
    """The same telegrams go out, later at most by the time that the usual answer is longer, and that of its rest."""
    plan = dict.fromkeys((40, 41, 60), STRANGE[what])
    quiet, listening = scenes.twice(plan, 80, paced=paced)
    assert quiet.said() == listening.said()
    assert [type(o) for o in quiet.user.outcomes] == [type(o) for o in listening.user.outcomes]
    usual = chars_to_ns(len(ANSWER) - len(STRANGE[what]), BAUD) if len(STRANGE[what]) < len(ANSWER) else 0
    for late, prompt in zip(gaps(quiet), gaps(listening), strict=True):
        assert late - prompt <= usual + SAME_NS + (line_runtime._REST_NS if what == "its beginning only" else 0)


def gaps(scene: Scene) -> list[int]:
    """From each telegram to the next, in ns."""
    return [after - before for (before, _), (after, _) in pairwise(scene.kernel.written)]


def test_a_silent_slave_is_asked_again_after_its_slot_time(scenes: Scenes) -> None:
    """Asked again after T_SL and the slack (HOST), however soon an answer was looked for."""
    quiet, listening = scenes.twice({40: b""}, 45)
    waits = [scene.asked[40] - scene.asked[39] for scene in (quiet, listening)]
    params = BusParams.preset(BAUD)
    slot = chars_to_ns(21, BAUD) + params.ns(params.t_sl + 11) + HOST.known_ns
    assert slot <= waits[0] <= slot + 2 * LATE_NS
    assert abs(waits[0] - waits[1]) <= 2 * LATE_NS


def test_after_another_answer_every_piece_wakes_the_driver_until_answers_are_alike_again(scenes: Scenes) -> None:
    scene = scenes.play({40: SHORT, 41: SHORT}, 80)
    assert scene.wakeups(38) <= 3
    assert scene.wakeups(42) >= 5
    assert scene.wakeups(80) <= 3
    # the first one is met at the end of the usual one, the other kind (FCB) too; then at once
    assert max(scene.turn_round(n) for n in range(42, 80)) < 200 * NS_PER_US


REQUEST: Final = bytes.fromhex("68 0F 0F 68 03 02 7D")


def learned(answers: AnswerTiming, request: bytes, pieces: int = 6, times: int = 6) -> int:
    """Until when nobody listens after ``request`` at 10 ms, whose answers came in so many pieces within 1 ms."""
    for _ in range(times):
        answers.sent(request, 0, 0)
        for piece in range(pieces):
            answers.received(bytes(4), 500_000 + 100_000 * piece)
    answers.sent(request, 10 * NS_PER_MS, 10 * NS_PER_MS)
    return answers.sleep_until


def test_the_driver_sleeps_until_the_soonest_end_of_a_known_answer() -> None:
    assert 10_800_000 < learned(AnswerTiming(), REQUEST) < 11_000_000


def test_the_driver_does_not_sleep_for_a_short_time() -> None:
    """Half a millisecond from the writing of the request."""
    slept = []
    for last_at in (400_000, 700_000):
        answers = AnswerTiming()
        for _ in range(8):
            answers.sent(REQUEST, 0, 100_000)
            for octets in (8,) if answers.sleep_until else (4, 4):
                answers.received(bytes(octets), last_at)
        answers.sent(REQUEST, 0, 100_000)
        slept.append(bool(answers.sleep_until))
    assert slept == [False, True]


def test_four_answers_alike_make_one_known() -> None:
    assert learned(AnswerTiming(), REQUEST, times=5) > 0
    assert learned(AnswerTiming(), REQUEST, times=4) == 0


@pytest.mark.parametrize(
    "octets",
    [
        TOKEN,  # the next master sends whatever it likes
        bytes.fromhex("DC 05 02"),
        bytes.fromhex("68 05 05 68 7F 02 46"),  # SDN to all
        bytes.fromhex("68 0F 0F 68 02 03 08"),  # a reply: the next request may be to anybody
        bytes.fromhex("10 02 03 00 05 16"),
        bytes.fromhex("10 7F 02 C0 41 16"),  # a clock value
        b"\xe5",
    ],
)
def test_after_telegrams_without_answer_the_driver_does_not_sleep(octets: bytes) -> None:
    """A ring of masters lives on tokens heard at once, a slave on requests heard at once."""
    assert not is_answered(octets[:7])
    assert learned(AnswerTiming(), octets, times=50) == 0


@pytest.mark.parametrize("octets", ["10 03 02 49 4E 16", "10 03 02 6C 71 16", "68 0F 0F 68 03 02 5D"])
def test_requests_to_one_station_are_answered(octets: str) -> None:
    assert is_answered(bytes.fromhex(octets))


def test_known_answers_are_learned_anew_now_and_then() -> None:
    """The soonest of many is taken for the usual one, and who is not listened for cannot be seen to be sooner."""
    answers = AnswerTiming()
    looked = 0
    for _ in range(1_000):
        answers.sent(REQUEST, 0, 0)
        looked += not answers.sleep_until
        for octets in (24,) if answers.sleep_until else (4, 4, 4, 4, 4, 4):
            answers.received(bytes(octets), 1_000_000)
    assert 4 < looked < 40


def test_answers_at_times_within_5_ms_are_not_read_later_than_by_listening() -> None:
    """A sleep until the soonest end of four such answers reads the next one 0.7 ms late on average."""
    answers, random, late = AnswerTiming(), Random(1), 0
    for _ in range(4_000):
        answers.sent(REQUEST, 0, 0)
        end = 2 * NS_PER_MS + random.randrange(5 * NS_PER_MS)
        read_at = max(end, answers.sleep_until) + LATE_NS
        late += read_at - end
        if end > answers.sleep_until:
            answers.received(bytes(12), end - NS_PER_US)
        answers.received(bytes(12 if end > answers.sleep_until else 24), read_at)
    assert late / 4_000 < 2 * LATE_NS


def test_a_loop_that_is_awake_for_another_reason_learns_no_lateness_from_it() -> None:
    """It reads octets before the sleep is over; later sleeps end as early as before."""
    answers = AnswerTiming()
    before = learned(answers, REQUEST)
    for _ in range(40):
        answers.received(bytes(4), before - 300_000)
        answers.received(bytes(20), 11 * NS_PER_MS)
        answers.sent(REQUEST, 10 * NS_PER_MS, 10 * NS_PER_MS)
    assert answers.sleep_until == before


def test_octets_that_arrive_during_the_sleep_are_not_counted_as_late() -> None:
    answers = AnswerTiming()
    assert answers.received(bytes(4), 100) == 4
    assert answers.received(bytes(4), 200) == 8
    learned(answers, REQUEST)
    assert answers.sleep_until
    assert answers.received(bytes(20), 10_900_000) == 0
    assert answers.received(bytes(4), 11_000_000) == 24


def answered(answers: AnswerTiming, *reads: tuple[bytes, int]) -> list[int]:
    """Its results for these reads of octets, each at its time after the end of the sleep (ns); then the next request
    goes out."""
    said = [answers.received(octets, answers.sleep_until + late) for octets, late in reads]
    answers.sent(REQUEST, 10 * NS_PER_MS, 10 * NS_PER_MS)
    return said


def known() -> AnswerTiming:
    """One that knows the answer to :data:`REQUEST`, which was sent."""
    answers = AnswerTiming()
    for _ in range(5):
        answers.sent(REQUEST, 10 * NS_PER_MS, 10 * NS_PER_MS)
        for piece in range(0, len(ANSWER), 3):
            answers.received(ANSWER[piece : piece + 3], 10_800_000 + 10_000 * piece)
    answers.sent(REQUEST, 10 * NS_PER_MS, 10 * NS_PER_MS)
    assert answers.sleep_until
    return answers


@pytest.mark.parametrize("octets", range(1, 22))
def test_only_the_beginning_of_the_usual_answer_is_worth_waiting_for(octets: int) -> None:
    begins = 2 <= octets < len(ANSWER)
    assert answered(known(), (ANSWER[:octets], 0)) == [-1 if begins else 0]
    assert answered(known(), (LONG[:octets], 0)) == [0]
    assert answered(known(), (bytes(octets), 0)) == [0]


def test_kept_octets_count_once() -> None:
    assert answered(known(), (ANSWER[:17], 0), (ANSWER, 20_000)) == [-1, len(ANSWER)]
    assert answered(known(), (ANSWER[:5], 0), (ANSWER[:17], 20_000), (ANSWER[17:], 40_000)) == [-1, 17, len(ANSWER)]


def test_sleeps_end_later_after_one_that_was_too_short_and_sooner_after_another() -> None:
    answers = known()
    ends = [answers.sleep_until]
    for complete in (True, False, True, True):
        answered(answers, (ANSWER, 5_000)) if complete else answered(answers, (ANSWER[:17], 0), (ANSWER, 20_000))
        ends.append(answers.sleep_until)
    steps = [after - before for before, after in pairwise(ends)]
    assert steps == [-NS_PER_US, 19 * NS_PER_US, -NS_PER_US, -NS_PER_US]


def test_sleeps_end_never_much_later_than_the_soonest_answer() -> None:
    answers = known()
    first = answers.sleep_until
    for _ in range(40):
        answered(answers, (ANSWER[:17], 0), (ANSWER, 20_000))
        assert first <= answers.sleep_until <= first + 100 * NS_PER_US


def test_answers_whose_rest_is_long_in_coming_are_not_slept_through() -> None:
    answers, slept = known(), 0
    for _ in range(40):
        slept += bool(answers.sleep_until)
        answered(answers, (ANSWER[:17], 0), (ANSWER, 300_000))
    assert slept < 6
