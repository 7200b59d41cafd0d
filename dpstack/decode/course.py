"""The course of a bus: which request a telegram answers or repeats, who holds the token, what is out of order.

Facts: docs/reference/protocol.md#frame-count-bit, docs/reference/protocol.md#the-token-ring. It sees one telegram after
another, of any number of masters, and takes nothing for granted but what it has seen: the first request of a pair of
stations can be neither a retry nor wrong, and nothing is called wrong that damaged octets may explain.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from msgspec import Struct

from dpstack.fdl.telegram import COUNTED, FC_FCB, FC_FCV, FC_FUNCTION, FC_REQUEST, UNANSWERED, Kind, Req, Telegram
from dpstack.params import BROADCAST

_SD1: Final = int(Kind.SD1)
_SD2: Final = int(Kind.SD2)
_KIND_SD4: Final = Kind.SD4
_KIND_SC: Final = Kind.SC
#: by function code, because a look-up of an enum's member takes ten times as long
_NOT_ASKED: Final = tuple(number in UNANSWERED for number in range(16))
_IS_COUNTED: Final = tuple(number in COUNTED for number in range(16))


class _Request(Struct, eq=False):
    """A request that was heard. ``end_ns``: of its last bit, None if it is not known. ``damages``: how many damaged
    transmissions came before it; ``damaged``: one came while its answer was due."""

    telegram: Telegram
    number: int
    end_ns: int | None
    damages: int
    answered: bool = False
    damaged: bool = False


class Step(NamedTuple):
    """The place of a telegram in the course of the bus; numbers are those of other telegrams.

    ``retry_of``: the request that it repeats with the frame count bit unturned; ``repeated_poll_of``: the same for a
    request without a frame count. ``fcb_turned``: None if nobody can know. ``request``: the request that it answers,
    for its service; ``response_us``: from the end of that request, if the times are known. ``probably_answers``: the
    request whose answer was due when damaged octets came. ``remarks``: what is out of order, for people.
    """

    retry_of: int | None = None
    answer_to: int | None = None
    response_us: float | None = None
    unanswered: int | None = None
    late: bool = False
    request: Telegram | None = None
    remarks: tuple[str, ...] = ()
    repeated_poll_of: int | None = None
    fcb_turned: bool | None = None
    probably_answers: int | None = None


_NEW = tuple.__new__  # the constructor of a NamedTuple takes twice as long
#: nothing to say
NOTHING: Final = Step()


class Course:
    """Follows the telegrams of one bus in the order of their times."""

    def __init__(self) -> None:
        self._asked: _Request | None = None  # the request whose answer is due
        self._missed: _Request | None = None  # the one before it, that nobody answered in time
        self._last: dict[tuple[int, int], _Request] = {}  # by master and station
        self._holder: int | None = None  # of the token
        self._passer: int | None = None  # who passed the token, as long as its holder has not sent anything
        self._damages = 0  # damaged transmissions so far

    def damaged(self, octets: bytes) -> Step:
        """Octets that are no telegram: what was due may have been among them, a token too."""
        self._damages += 1
        self._missed = None
        self._holder = self._passer = None
        asked = self._asked
        head = _head(octets)
        if head is not None and head[2] & FC_REQUEST:
            return Step(remarks=(f"probably a request {head[1]} -> {head[0]}",))
        if asked is None:
            return NOTHING
        asked.damaged = True
        readable = head is not None and head[:2] == (asked.telegram.sa, asked.telegram.da)
        surely = ", as its addresses say" if readable else ""
        return Step(probably_answers=asked.number, remarks=(f"probably the answer to telegram {asked.number}{surely}",))

    def follow(self, telegram: Telegram, number: int, start_ns: int | None, end_ns: int | None) -> Step:
        """The place of ``telegram``, whose first bit was on the line at ``start_ns`` and its last at ``end_ns``."""
        kind = telegram.kind
        if kind is _KIND_SD4:
            return self._token(telegram)
        if kind is not _KIND_SC and telegram.fc & FC_REQUEST:
            return self._request(telegram, number, end_ns)
        return self._answer(telegram, start_ns)

    def _token(self, telegram: Telegram) -> Step:
        sa, da, holder = telegram.sa, telegram.da, self._holder
        remarks: tuple[str, ...] = ()
        if holder is None or holder == sa:
            pass
        elif self._passer == sa:
            again = "the token again" if da == holder else "the token to another station"
            remarks = (f"{again}: station {holder} did not take it",)
        elif sa == da:
            remarks = (f"station {sa} claims the token, which station {holder} held",)
        else:
            remarks = self._without_token(sa)
        self._holder, self._passer = da, sa if sa != da else None
        unanswered = self._give_up()
        return NOTHING if unanswered is None and not remarks else Step(unanswered=unanswered, remarks=remarks)

    def _without_token(self, sa: int) -> tuple[str, ...]:
        holder, self._holder, self._passer = self._holder, sa, None
        if holder is None or holder == sa:
            return ()
        return (f"station {sa} sends without the token, which station {holder} holds",)

    def _give_up(self) -> int | None:
        """Whoever sends a request or the token waits for no answer any more; returns the request left unanswered."""
        asked, self._asked = self._asked, None
        if asked is None:
            return None
        self._missed = asked
        return None if asked.damaged else asked.number

    def _request(self, telegram: Telegram, number: int, end_ns: int | None) -> Step:
        sa = telegram.sa
        remarks = self._without_token(sa) if self._passer is not None or self._holder != sa else ()
        unanswered = None if self._asked is None else self._give_up()
        fc = telegram.fc
        function = fc & FC_FUNCTION
        if telegram.da == BROADCAST or _NOT_ASKED[function]:
            return NOTHING if unanswered is None and not remarks else Step(unanswered=unanswered, remarks=remarks)
        self._asked = request = _Request(telegram, number, end_ns, self._damages)
        if not _IS_COUNTED[function]:
            return Step(unanswered=unanswered, remarks=remarks)
        pair = sa, telegram.da
        before = self._last.get(pair)
        self._last[pair] = request
        if before is None:
            return Step(unanswered=unanswered, remarks=remarks)
        retry = repeated = turned = None
        open_ = not before.answered
        if fc & FC_FCV:
            turned = bool((fc ^ before.telegram.fc) & FC_FCB)
            known = before.damages == self._damages  # else a request or an answer between them may be missing
            if open_ and not turned and telegram == before.telegram:
                retry = before.number
            elif known:
                remarks += _out_of_step(telegram.da, answered=before.answered, turned=turned)
            else:
                turned = None
        elif open_ and telegram == before.telegram:
            repeated = before.number
        return _NEW(Step, (retry, None, None, unanswered, False, None, remarks, repeated, turned, None))

    def _answer(self, telegram: Telegram, start_ns: int | None) -> Step:
        asked, missed = self._asked, self._missed
        if asked is not None and _fits(telegram, asked.telegram):
            self._asked = self._missed = None
            asked.answered = True
            us = _between_us(asked, start_ns)
            return _NEW(Step, (None, asked.number, us, None, False, asked.telegram, (), None, None, None))
        if missed is not None and _fits(telegram, missed.telegram):
            self._missed = None
            late = f"an answer to telegram {missed.number}, when nobody waited for it any more"
            return Step(
                answer_to=missed.number,
                response_us=_between_us(missed, start_ns),
                late=True,
                request=missed.telegram,
                remarks=(late,),
            )
        if self._holder is None and not self._damages:
            return NOTHING  # listening began between a request and its answer
        return Step(remarks=("an answer that no request before it asked for",))


def _out_of_step(station: int, *, answered: bool, turned: bool) -> tuple[str, ...]:
    """The remark about the frame count bit of a request that is no repetition."""
    if answered and not turned:
        return (f"the frame count bit was not turned: station {station} takes this for a repetition",)
    if not answered and turned:
        return ("another request with a turned frame count bit, though the one before was not answered",)
    if not answered:
        return ("another request with the same frame count bit, though the one before was not answered",)
    return ()


def _fits(answer: Telegram, request: Telegram) -> bool:
    """SC names nobody: it belongs to the request before it. The answer to MSRD goes to all."""
    if answer.kind is _KIND_SC:
        return True
    to_all = answer.da == BROADCAST and request.function == Req.MSRD
    return answer.sa == request.da and (to_all or answer.da == request.sa)


def _between_us(request: _Request, start_ns: int | None) -> float | None:
    end_ns = request.end_ns
    return None if start_ns is None or end_ns is None else (start_ns - end_ns) / 1000


def _head(octets: bytes) -> tuple[int, int, int] | None:
    """DA, SA and FC of damaged octets, as far as they begin like a telegram."""
    at = {_SD1: 1, _SD2: 4}.get(octets[0]) if octets else None
    if at is None or len(octets) < at + 3:
        return None
    return octets[at] & 0x7F, octets[at + 1] & 0x7F, octets[at + 2]
