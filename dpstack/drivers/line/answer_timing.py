"""When an answer is to be expected: requests that begin alike were answered after so long.

Between a request and its answer there is time for what can wait, but not for more than that. And what comes of an
answer before its end need not wake anybody up: a line hands an answer over in pieces, and a wake-up for each of them is
paid six times for 21 octets at 500 kbit/s. So where the answers to a kind of request are known (of one length and in
several pieces), nobody listens until the next one should be over. That says when to look and nothing else: the system
keeps what arrives, deadlines are met as ever, and what is not the answer that was expected is met with the same look.
"""

from __future__ import annotations

from typing import Final

from dpstack.fdl.telegram import FC_FUNCTION, FC_REQUEST, Kind, Req
from dpstack.units import NEVER, NS_PER_US

#: What tells requests apart: the header of a telegram with addresses and function code.
_ALIKE: Final = 7
#: So many kinds of requests are remembered: each slave's with both values of the FCB, and more.
_KINDS: Final = 1024
#: a new delay counts for this part (as a shift)
_SHIFT: Final = 3

#: An answer that comes in fewer pieces is listened for: the look before its end costs a wake-up of its own.
_PIECES: Final = 4
#: So many answers alike say what the next one will be like; the soonest of them says when.
_ALIKE_ANSWERS: Final = 4
#: After so many it is learned anew: what comes sooner than before a look cannot see, nor what is in fewer pieces.
_AFRESH: Final = 250
#: A shorter time is not worth it.
_LEAST_NS: Final = 100 * NS_PER_US
#: The wake-up is asked for so much before the end: at first, at least, at most. It is what half of all wake-ups are
#: late: as often as not the answer is whole then, and sooner seen than by somebody who was woken up by its last octet.
_EARLY_NS: Final = 40 * NS_PER_US
_LEAST_EARLY_NS: Final = 15 * NS_PER_US
_MOST_EARLY_NS: Final = 150 * NS_PER_US
_LESSON_NS: Final = NS_PER_US

_SD1: Final = int(Kind.SD1)
_SD2: Final = int(Kind.SD2)
#: nobody answers these
_UNANSWERED: Final = frozenset((Req.TIME_EVENT, Req.SDN_LOW, Req.SDN_HIGH))


def is_answered(header: bytes) -> bool:
    """Whether a telegram that begins so (7 octets, or all of it) is a request that one station answers.

    Until that answer is over, or T_SL without one, nobody else may send: in what follows a token, a reply or an SDN
    there may be anybody.
    """
    if header[0] == _SD2:
        fc = header[6]
    elif header[0] == _SD1:
        fc = header[3]
    else:
        return False
    return bool(fc & FC_REQUEST) and not fc & Req.CLOCK_VALUE and fc & FC_FUNCTION not in _UNANSWERED


class _Usual:
    """What followed requests of one kind. Times in ns from the end of the request."""

    __slots__ = ("alike", "answered", "delay", "octets", "soonest")

    def __init__(self, delay: int, octets: int, answered: bool) -> None:
        self.delay = self.soonest = delay  # to its last octet
        self.octets = octets
        self.alike = 0  # answers that were like the one before, one after the other
        self.answered = answered


class Answers:
    """Learns from transmissions and what follows them. Times in ns."""

    __slots__ = ("_early", "_end", "_first_at", "_header", "_heard_at", "_kinds", "_octets", "_pieces", "quiet_until")

    def __init__(self) -> None:
        self._kinds: dict[bytes, _Usual] = {}
        self._header = b""
        self._end = 0
        self._early = _EARLY_NS
        #: up to when nothing of the answer need be looked at, 0: listen at once
        self.quiet_until = 0
        # since the last transmission
        self._first_at = self._heard_at = 0  # when octets were delivered, 0: none
        self._octets = self._pieces = 0

    def heard(self, octets: int, now: int) -> int:
        """So many octets were delivered at ``now``. How many there are since the transmission, where this is the time
        of the last one's arrival; 0 where nobody listened to that."""
        self._octets += octets
        self._pieces += 1
        self._heard_at = now
        if self._pieces == 1:
            self._first_at = now
            if self.quiet_until:
                return 0
        return self._octets

    def sent(self, octets: bytes, end: int) -> int:
        """``octets`` leave the line at ``end``: when the last octet of an answer should arrive, or NEVER."""
        kinds, header = self._kinds, self._header
        usual = kinds.get(header)
        if self._pieces:
            if usual is not None:
                self._learn(usual)
            else:
                kinds[header] = _Usual(self._heard_at - self._end, self._octets, bool(header) and is_answered(header))
            self._octets = self._pieces = 0
        elif usual is not None:
            del kinds[header]  # it answers no more
        if len(kinds) > _KINDS:
            kinds.clear()
        self._end = end
        self._header = header = octets[:_ALIKE]
        self.quiet_until = 0
        usual = kinds.get(header)
        if usual is None:
            return NEVER
        if usual.alike >= _ALIKE_ANSWERS:
            quiet = usual.soonest - self._early
            if quiet > _LEAST_NS:
                self.quiet_until = end + quiet
        return end + usual.delay

    def _learn(self, usual: _Usual) -> None:
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
