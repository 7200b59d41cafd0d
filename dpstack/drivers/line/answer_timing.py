"""Expected time of an answer, learned from earlier answers to requests with the same header.

The driver uses the expected time for two purposes. It collects garbage between a request and its answer. And it saves
wake-ups: a port delivers an answer in pieces, six of them for 21 octets at 500 kbit/s, and each piece wakes the driver.
If earlier answers to requests with the same header had the same length and came in several pieces at nearly the same
time, the driver sleeps until the next answer should be complete, and reads it with one call. The operating system keeps
the octets meanwhile. The deadlines of the protocol machine do not change, so the driver never notices a missing answer
later than without this sleep.
"""

from __future__ import annotations

from typing import Final

from dpstack.drivers.line.timers import Lead
from dpstack.fdl.telegram import FC_FUNCTION, FC_REQUEST, Kind, Req
from dpstack.units import NEVER, NS_PER_US

#: Requests are distinguished by the header of the telegram: addresses and function code.
_HEADER_OCTETS: Final = 7
#: The largest number of different headers: enough for each slave with both values of the FCB.
_MOST_HEADERS: Final = 1024
#: weight of a new delay in the mean, as a shift: one eighth
_MEAN_SHIFT: Final = 3

#: The driver sleeps only through answers of at least this many pieces: one piece wakes it once anyhow.
_LEAST_PIECES: Final = 2
#: After this many answers of equal length the driver expects the end of the next one at the earliest time among them.
_EQUAL_ANSWERS: Final = 4
#: These answers end this much sooner or later than the soonest of them at most. If they came at any time within 5 ms,
#: the next one was read 0.2 to 0.5 ms late on average.
_REGULAR_NS: Final = 250 * NS_PER_US
#: After this many expected answers the driver learns the time anew: while it sleeps it cannot notice that answers have
#: become faster.
_RELEARN_AFTER: Final = 250
#: At most this many wake-ups that were saved may be lost again by answers that come at irregular times. Then the driver
#: does not sleep through this many answers to requests with this header.
_MOST_SAVED: Final = 4
_LISTEN_FOR: Final = 40
#: The driver does not sleep through a shorter time: it would read the answer some 15 us later than with a wake-up for
#: each piece, as the processor does not rest between these (measured at 1.5 Mbit/s, 21 octets: 2 % of a rotation).
_SHORTEST_SLEEP_NS: Final = 500 * NS_PER_US
#: The driver sets the wake-up this much before the end of the answer: first value, maximum, the step up. Nine of ten
#: wake-ups are later than that, so that they find the answer complete: a second one costs more than the time lost.
_LEAD_NS: Final = 20 * NS_PER_US
_MOST_LEAD_NS: Final = 150 * NS_PER_US
_LEAD_STEP_NS: Final = NS_PER_US // 2
#: If the rest of an answer ends sooner than this after a wake-up that found it incomplete, the earliest time is
#: raised, by one eighth of the wait for the rest.
_NEARLY_NS: Final = 25 * NS_PER_US
_RAISE_SHIFT: Final = 3

_SD1: Final = int(Kind.SD1)
_SD2: Final = int(Kind.SD2)
#: requests without an answer
_UNANSWERED: Final = frozenset((Req.TIME_EVENT, Req.SDN_LOW, Req.SDN_HIGH))


def is_answered(header: bytes) -> bool:
    """Whether the telegram with this header (7 octets, or all of it) is a request that one station answers.

    No other station may send before that answer has ended, or T_SL has expired. After a token, a reply or an SDN the
    next octets may come from any station.
    """
    if header[0] == _SD2:
        fc = header[6]
    elif header[0] == _SD1:
        fc = header[3]
    else:
        return False
    return bool(fc & FC_REQUEST) and not fc & Req.CLOCK_VALUE and fc & FC_FUNCTION not in _UNANSWERED


class _UsualAnswer:
    """The usual answer to requests with one header. Times in ns from the end of the request."""

    __slots__ = ("answered", "delay", "equal_answers", "octets", "pieces", "saved", "soonest")

    def __init__(self, delay: int, octets: int, answered: bool) -> None:
        self.delay = delay  # to the reading of its last octet, the mean
        self.soonest = delay  # to its end at the earliest
        self.octets = octets
        self.equal_answers = 0  # successive answers of equal length in several pieces
        self.answered = answered
        self.pieces = 0  # of the last answer that the driver did not sleep through
        self.saved = 0  # wake-ups


class AnswerTiming:
    """Learns when answers arrive: the driver reports each transmission and each read of the port. Times in ns."""

    __slots__ = (
        "_end",
        "_first_at",
        "_header",
        "_last_at",
        "_lead",
        "_octets",
        "_pieces",
        "_usual",
        "sleep_until",
    )

    def __init__(self) -> None:
        self._usual: dict[bytes, _UsualAnswer] = {}
        self._header = b""
        self._end = 0
        self._lead = Lead(_LEAD_NS, least=0, most=_MOST_LEAD_NS, raised=_LEAD_STEP_NS, lowered=9 * _LEAD_STEP_NS)
        #: the driver need not read the answer before this time; 0: read at once
        self.sleep_until = 0
        # since the last transmission
        self._first_at = self._last_at = 0  # times of the first and last read that returned octets, 0: none
        self._octets = self._pieces = 0

    def received(self, octets: int, now: int) -> int:
        """The driver has read ``octets`` octets at ``now``. Returns the number of octets since the last transmission.

        Returns 0 for the first read after a sleep: the octets arrived earlier than ``now``, at an unknown time.
        """
        self._octets += octets
        self._pieces += 1
        self._last_at = now
        if self._pieces == 1:
            self._first_at = now
            if self.sleep_until:
                return 0
        return self._octets

    def sent(self, octets: bytes, now: int, end: int) -> int:
        """``octets`` were written at ``now`` and leave until ``end``. Returns when the last octet of the answer should
        arrive, or NEVER."""
        by_header, header = self._usual, self._header
        usual = by_header.get(header)
        if self._pieces:
            if usual is not None:
                self._learn(usual)
            else:
                by_header[header] = _UsualAnswer(
                    self._last_at - self._end, self._octets, bool(header) and is_answered(header)
                )
            self._octets = self._pieces = 0
        elif usual is not None:
            del by_header[header]  # no answer this time
        if len(by_header) > _MOST_HEADERS:
            by_header.clear()
        self._end = end
        self._header = header = octets[:_HEADER_OCTETS]
        self.sleep_until = 0
        usual = by_header.get(header)
        if usual is None:
            return NEVER
        if usual.equal_answers >= _EQUAL_ANSWERS:
            wake_at = end + usual.soonest - self._lead.ns
            if wake_at - now > _SHORTEST_SLEEP_NS:
                self.sleep_until = wake_at
        return end + usual.delay

    def _learn(self, usual: _UsualAnswer) -> None:
        delay = self._last_at - self._end
        usual.delay += (delay - usual.delay) >> _MEAN_SHIFT
        pieces, sleep_until = self._pieces, self.sleep_until
        ended = delay  # the answer had ended by then
        if sleep_until:
            if (late := self._first_at - sleep_until) >= 0:  # else the loop was awake for another reason
                self._lead.learn(late)
            usual.equal_answers = usual.equal_answers + 1 if usual.equal_answers < _RELEARN_AFTER else 0
            usual.saved = min(usual.saved + usual.pieces - pieces, _MOST_SAVED)
            if usual.saved < 0:
                usual.saved = 0
                usual.equal_answers = _EQUAL_ANSWERS - _LISTEN_FOR
        else:
            usual.pieces = pieces
            ended -= self._lead.ns  # octets wake the driver as late as a timer does
            is_regular = usual.answered and pieces >= _LEAST_PIECES and abs(ended - usual.soonest) < _REGULAR_NS
            usual.equal_answers = usual.equal_answers + 1 if is_regular or usual.equal_answers < 0 else 0
        if self._octets != usual.octets:
            usual.octets = self._octets
            usual.equal_answers = 0
        if ended < usual.soonest or usual.equal_answers <= 0:
            usual.soonest = ended
        elif sleep_until and pieces > 1 and (rest := self._last_at - self._first_at) - self._lead.ns < _NEARLY_NS:
            usual.soonest += rest >> _RAISE_SHIFT
