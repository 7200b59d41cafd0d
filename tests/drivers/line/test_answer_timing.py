"""Sleep of the drivers until an expected answer can be complete: the telegrams and their times stay the same."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Final

import pytest
from asker_kit import ANSWER, BAUD, SHORT, Asker
from kernel_kit import LATE_NS, Driven, Kernel

from dpstack.drivers.line import answer_timing
from dpstack.drivers.line.answer_timing import AnswerTiming, is_answered
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.units import NS_PER_MS, NS_PER_US, chars_to_ns

LONG: Final = bytes.fromhex("68 13 13 68 02 03 08" + " 00" * 16 + " 0D 16")
TOKEN: Final = bytes.fromhex("DC 02 02")
BITS_11_NS: Final = 22 * NS_PER_US
#: wake-ups that are one more or one less move what follows by this much
SAME_NS: Final = 3 * LATE_NS


class Scene:
    """A lone master that asks one slave of octets, which answers in pieces of ``piece`` octets.

    ``plan``: what the slave says to its requests by number (from 1 on), instead of :data:`ANSWER`.
    """

    def __init__(self, kind: str, patch: pytest.MonkeyPatch, *, paced: bool = True, piece: int = 4) -> None:
        self.kernel = Kernel()
        self.user = Asker()
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
        begin = now + chars_to_ns(len(octets), BAUD) + BITS_11_NS
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
    # the end of T_ID1 is another one
    assert max(quiet.wakeups(n) for n in known) <= 3
    assert sum(quiet.wakeups(n) for n in known) < 2.5 * len(known)
    pieces = -(-len(ANSWER) // piece)
    assert min(listening.wakeups(n) for n in known) >= min(pieces, pieces // 2 + 2)
    mean = [sum(scene.turn_round(n) for n in known) / len(known) for scene in (quiet, listening)]
    assert mean[0] <= mean[1] + NS_PER_US
    assert max(quiet.turn_round(n) for n in known) < max(listening.turn_round(n) for n in known) + LATE_NS
    assert quiet.said()[: 2 * ROUNDS] == listening.said()[: 2 * ROUNDS]


@pytest.mark.parametrize("piece", [7, 11, 21])
def test_an_answer_in_few_pieces_wakes_the_driver_for_each_piece(scenes: Scenes, piece: int) -> None:
    """As behind an adapter: a look of its own would be one wake-up more."""
    quiet, listening = scenes.twice({}, 30, piece=piece)
    assert quiet.kernel.written == listening.kernel.written
    assert quiet.kernel.woken == listening.kernel.woken


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
    """The same telegrams go out, later at most by the time that the usual answer is longer."""
    plan = dict.fromkeys((40, 41, 60), STRANGE[what])
    quiet, listening = scenes.twice(plan, 80, paced=paced)
    assert quiet.said() == listening.said()
    assert [type(o) for o in quiet.user.outcomes] == [type(o) for o in listening.user.outcomes]
    usual = chars_to_ns(len(ANSWER) - len(STRANGE[what]), BAUD) if len(STRANGE[what]) < len(ANSWER) else 0
    for late, prompt in zip(gaps(quiet), gaps(listening), strict=True):
        assert late - prompt <= usual + SAME_NS


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
        answers.sent(request, 0)
        for piece in range(pieces):
            answers.received(4, 500_000 + 100_000 * piece)
    answers.sent(request, 10 * NS_PER_MS)
    return answers.sleep_until


def test_the_driver_sleeps_until_the_soonest_end_of_a_known_answer() -> None:
    assert 10_800_000 < learned(AnswerTiming(), REQUEST) < 11_000_000


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
        answers.sent(REQUEST, 0)
        looked += not answers.sleep_until
        for piece in range(6):
            at = 500_000 + 100_000 * piece
            if at > answers.sleep_until:
                answers.received(24 - 4 * (5 - piece) if answers.sleep_until and piece == 5 else 4, at)
    assert 4 < looked < 40


def test_octets_that_arrive_during_the_sleep_are_not_counted_as_late() -> None:
    answers = AnswerTiming()
    assert answers.received(4, 100) == 4
    assert answers.received(4, 200) == 8
    learned(answers, REQUEST)
    assert answers.sleep_until
    assert answers.received(20, 10_900_000) == 0
    assert answers.received(4, 11_000_000) == 24
