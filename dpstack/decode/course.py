"""The course of a bus: which request a telegram answers or repeats, who holds the token, what is out of order.

Facts: docs/protocol.md#frame-count-bit, docs/protocol.md#the-token-ring. It sees one telegram after another, of any
number of masters, and takes nothing for granted but what it has seen: the first request of a pair of stations can be
neither a retry nor wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from dpstack.fdl.telegram import FC_FCB, FC_FCV, Kind, Req, Telegram
from dpstack.params import BROADCAST

#: functions that nobody answers
_UNANSWERED: Final = frozenset((Req.SDN_LOW, Req.SDN_HIGH, Req.TIME_EVENT))
#: functions with a frame count
_COUNTED: Final = frozenset((Req.SDA_LOW, Req.SDA_HIGH, Req.SRD_LOW, Req.SRD_HIGH, Req.MSRD))


class Place(NamedTuple):
    """A telegram's number in the log, and the time of its last bit in ns, None where it is not known."""

    number: int
    end_ns: int | None


@dataclass(slots=True)
class _Request:
    telegram: Telegram
    place: Place
    answered: bool = False


class Step(NamedTuple):
    """The place of a telegram in the course of the bus; numbers are those of other telegrams.

    ``request``: the request that it answers, for its service; ``response_us``: from the end of that request, where the
    times are known. ``remarks``: what is out of order, for people.
    """

    retry_of: int | None = None
    answer_to: int | None = None
    response_us: float | None = None
    unanswered: int | None = None
    late: bool = False
    request: Telegram | None = None
    remarks: tuple[str, ...] = ()


class Course:
    """Follows the telegrams of one bus in the order of their times."""

    def __init__(self) -> None:
        self._asked: _Request | None = None  # the request whose answer is due
        self._missed: _Request | None = None  # the one before it, that nobody answered in time
        self._last: dict[tuple[int, int], _Request] = {}  # by master and station
        self._holder: int | None = None  # of the token

    def damaged(self) -> None:
        """Octets that are no telegram: what was due may have been among them."""
        self._missed = None

    def follow(self, telegram: Telegram, place: Place, start_ns: int | None) -> Step:
        """What ``telegram`` is, whose first bit was on the line at ``start_ns``."""
        if telegram.kind is Kind.SD4:
            return self._token(telegram)
        if telegram.is_request:
            return self._request(telegram, place)
        return self._answer(telegram, start_ns)

    def _token(self, telegram: Telegram) -> Step:
        remarks = self._without_token(telegram.sa)
        self._holder = telegram.da
        return Step(unanswered=self._give_up(), remarks=remarks)

    def _without_token(self, sa: int) -> tuple[str, ...]:
        holder, self._holder = self._holder, sa
        if holder in (None, sa):
            return ()
        return (f"station {sa} sends without the token, which station {holder} holds",)

    def _give_up(self) -> int | None:
        """Whoever sends a request or the token waits for no answer any more; returns the request left unanswered."""
        asked, self._asked = self._asked, None
        if asked is None:
            return None
        self._missed = asked
        return asked.place.number

    def _request(self, telegram: Telegram, place: Place) -> Step:
        remarks = self._without_token(telegram.sa)
        unanswered = self._give_up()
        request = _Request(telegram, place)
        if telegram.da == BROADCAST or telegram.function in _UNANSWERED:
            return Step(unanswered=unanswered, remarks=remarks)
        self._asked = request
        if telegram.function not in _COUNTED:
            return Step(unanswered=unanswered, remarks=remarks)
        pair = telegram.sa, telegram.da
        before = self._last.get(pair)
        self._last[pair] = request
        if before is None:
            return Step(unanswered=unanswered, remarks=remarks)
        counted = bool(telegram.fc & FC_FCV)
        same_bit = not (telegram.fc ^ before.telegram.fc) & (FC_FCB | FC_FCV)
        if telegram == before.telegram and same_bit and not before.answered:
            return Step(retry_of=before.place.number, unanswered=unanswered, remarks=remarks)
        if counted and before.answered and telegram.fc & FC_FCB == before.telegram.fc & FC_FCB:
            remarks += (f"the frame count bit was not turned: station {telegram.da} takes this for a repetition",)
        elif counted and not before.answered and not same_bit:
            remarks += ("another request with a turned frame count bit, though the one before was not answered",)
        return Step(unanswered=unanswered, remarks=remarks)

    def _answer(self, telegram: Telegram, start_ns: int | None) -> Step:
        asked, missed = self._asked, self._missed
        if asked is not None and _fits(telegram, asked.telegram):
            self._asked = self._missed = None
            asked.answered = True
            return Step(answer_to=asked.place.number, response_us=_between_us(asked, start_ns), request=asked.telegram)
        if missed is not None and _fits(telegram, missed.telegram):
            self._missed = None
            late = f"an answer to telegram {missed.place.number}, when nobody waited for it any more"
            return Step(
                answer_to=missed.place.number,
                response_us=_between_us(missed, start_ns),
                late=True,
                request=missed.telegram,
                remarks=(late,),
            )
        return Step(remarks=("an answer that no request before it asked for",))


def _fits(answer: Telegram, request: Telegram) -> bool:
    """SC names nobody: it belongs to the request before it."""
    return answer.kind is Kind.SC or (answer.sa, answer.da) == (request.da, request.sa)


def _between_us(request: _Request, start_ns: int | None) -> float | None:
    end_ns = request.place.end_ns
    return None if start_ns is None or end_ns is None else (start_ns - end_ns) / 1000
