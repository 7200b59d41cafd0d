"""Expected time of an answer, learned from earlier answers to requests with the same header.

The driver uses it twice. Work that can wait (garbage collection) is done between a request and its answer. And a port
delivers an answer in pieces, six of them for 21 octets at 500 kbit/s, each with a wake-up. Where earlier answers to a
kind of request had one length and came in several pieces, the driver sleeps until the next one should be complete. The
operating system keeps the octets meanwhile. Deadlines stay as they are, so an unexpected answer is read at the same
moment.
"""

from __future__ import annotations

from typing import Final

from dpstack.fdl.telegram import FC_FUNCTION, FC_REQUEST, Kind, Req
from dpstack.units import NEVER, NS_PER_US

#: Requests are distinguished by the header of the telegram: addresses and function code.
_HEADER_OCTETS: Final = 7
#: The largest number of kinds of requests: enough for each slave with both values of the FCB.
_KINDS: Final = 1024
#: weight of a new delay in the mean, as a shift: one eighth
_SHIFT: Final = 3

#: The driver sleeps only through answers of at least this many pieces: its look before the end costs one wake-up.
_PIECES: Final = 4
#: After this many equal answers the next one is predicted, at the time of the earliest of them.
_ALIKE_ANSWERS: Final = 4
#: After this many predicted answers the prediction is learned anew: a sleeping driver cannot notice earlier answers.
_AFRESH: Final = 250
#: The driver does not sleep through a shorter time.
_LEAST_NS: Final = 100 * NS_PER_US
#: The wake-up is set this much before the end of the answer: first value, minimum, maximum. It follows the median
#: lateness of wake-ups, so that about half of the answers are complete when the driver looks.
_EARLY_NS: Final = 40 * NS_PER_US
_LEAST_EARLY_NS: Final = 15 * NS_PER_US
_MOST_EARLY_NS: Final = 150 * NS_PER_US
_LESSON_NS: Final = NS_PER_US

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
    """The usual answer to requests of one kind. Times in ns from the end of the request."""

    __slots__ = ("alike", "answered", "delay", "octets", "soonest")

    def __init__(self, delay: int, octets: int, answered: bool) -> None:
        self.delay = self.soonest = delay  # to its last octet
        self.octets = octets
        self.alike = 0  # successive equal answers
        self.answered = answered


class Answers:
    """Learns the times of answers from transmissions and the octets after them. Times in ns."""

    __slots__ = ("_early", "_end", "_first_at", "_header", "_heard_at", "_kinds", "_octets", "_pieces", "quiet_until")

    def __init__(self) -> None:
        self._kinds: dict[bytes, _UsualAnswer] = {}
        self._header = b""
        self._end = 0
        self._early = _EARLY_NS
        #: the driver need not read the answer before this time; 0: read at once
        self.quiet_until = 0
        # since the last transmission
        self._first_at = self._heard_at = 0  # when octets were delivered, 0: none
        self._octets = self._pieces = 0

    def heard(self, octets: int, now: int) -> int:
        """The port delivered ``octets`` octets at ``now``. Returns their number since the transmission; 0 where
        ``now`` is not the time of their arrival, because the driver slept."""
        self._octets += octets
        self._pieces += 1
        self._heard_at = now
        if self._pieces == 1:
            self._first_at = now
            if self.quiet_until:
                return 0
        return self._octets

    def sent(self, octets: bytes, end: int) -> int:
        """``octets`` have left at ``end``. Returns when the last octet of the answer should arrive, or NEVER."""
        kinds, header = self._kinds, self._header
        usual = kinds.get(header)
        if self._pieces:
            if usual is not None:
                self._learn(usual)
            else:
                kinds[header] = _UsualAnswer(
                    self._heard_at - self._end, self._octets, bool(header) and is_answered(header)
                )
            self._octets = self._pieces = 0
        elif usual is not None:
            del kinds[header]  # no answer this time
        if len(kinds) > _KINDS:
            kinds.clear()
        self._end = end
        self._header = header = octets[:_HEADER_OCTETS]
        self.quiet_until = 0
        usual = kinds.get(header)
        if usual is None:
            return NEVER
        if usual.alike >= _ALIKE_ANSWERS:
            quiet = usual.soonest - self._early
            if quiet > _LEAST_NS:
                self.quiet_until = end + quiet
        return end + usual.delay

    def _learn(self, usual: _UsualAnswer) -> None:
        delay = self._heard_at - self._end
        if self.quiet_until:
            if self._first_at - self.quiet_until > self._early:
                self._early = min(self._early + _LESSON_NS, _MOST_EARLY_NS)
            else:
                self._early = max(self._early - _LESSON_NS, _LEAST_EARLY_NS)
            usual.alike = usual.alike + 1 if usual.alike < _AFRESH else 0
        else:
            usual.alike = usual.alike + 1 if usual.answered and self._pieces >= _PIECES else 0
        if self._octets != usual.octets:
            usual.octets = self._octets
            usual.alike = 0
        if delay < usual.soonest or not usual.alike:
            usual.soonest = delay
        usual.delay += (delay - usual.delay) >> _SHIFT
