"""Expected time of an answer, learned from earlier answers to requests with the same header.

The driver uses the expected time for two purposes. It collects garbage between a request and its answer. And it saves
wake-ups: a port delivers an answer in pieces, six of them for 21 octets at 500 kbit/s, and each piece wakes the driver.
If earlier answers to requests with the same header had the same length and came in several pieces at nearly the same
time, the driver sleeps until the next answer should be complete, and reads it with one call. The operating system keeps
the octets meanwhile; the driver keeps those that it has read too soon. The deadlines of the protocol machine do not
change, so the driver never notices a missing answer later than without this sleep.
"""

from __future__ import annotations

from typing import Final

from dpstack.fdl.codec import claimed
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
#: After this many answers of equal length the driver expects the next one at the earliest time among them.
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
#: An answer that ends later than this after a sleep came at an irregular time, and counts as so many that were lost.
_NEAR_NS: Final = 120 * NS_PER_US
_LOST: Final = 2
#: The driver does not sleep through a shorter time: it would read the answer some 15 us later than with a wake-up for
#: each piece, as the processor does not rest between these (measured at 1.5 Mbit/s, 21 octets: 2 % of a rotation).
_SHORTEST_SLEEP_NS: Final = 500 * NS_PER_US
#: The first sleep ends this much before the soonest reading of an answer that was not slept through: octets wake the
#: driver as late as a timer does.
_LEAD_NS: Final = 20 * NS_PER_US
#: After a sleep that ended before the answer the next one ends this much later, after another one this much sooner: 19
#: of 20 find the answer complete. A second wake-up costs the time of 50 us, and delays the next request by as much.
_LATER_NS: Final = 19 * NS_PER_US
_SOONER_NS: Final = NS_PER_US
#: In all a sleep ends at most this much later than the first one: answers at irregular times would wait for it.
_MOST_LATER_NS: Final = 100 * NS_PER_US

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

    __slots__ = ("answered", "delay", "equal_answers", "latest", "octets", "pieces", "saved", "wake")

    def __init__(self, delay: int, octets: int, answered: bool) -> None:
        self.delay = delay  # to the reading of its last octet, the mean, without those that the driver slept through
        self.wake = delay - _LEAD_NS  # to the end of the sleep
        self.latest = self.wake + _MOST_LATER_NS  # and at the latest
        self.octets = octets
        self.equal_answers = 0  # successive answers of equal length in several pieces
        self.answered = answered
        self.pieces = 0  # of the last answer that the driver did not sleep through
        self.saved = 0  # wake-ups

    def was_heard(self, pieces: int, delay: int) -> None:
        """An answer that the driver did not sleep through came in ``pieces``."""
        self.delay += (delay - self.delay) >> _MEAN_SHIFT
        self.pieces = pieces
        wake = delay - _LEAD_NS
        is_regular = self.answered and pieces >= _LEAST_PIECES and abs(wake - self.wake) < _REGULAR_NS
        self.equal_answers = self.equal_answers + 1 if is_regular or self.equal_answers < 0 else 0
        if wake < self.wake or self.equal_answers <= 0:
            self.wake = wake
            self.latest = wake + _MOST_LATER_NS

    def was_slept_through(self, pieces: int, first: int, last: int) -> None:
        """An answer came in ``pieces``, the first and the last of them read so long after the end of the sleep."""
        if pieces == 1:
            if first >= 0:  # else the loop was awake for another reason
                self.wake -= _SOONER_NS
            saved = self.saved + self.pieces - 1
        else:
            if first >= 0:
                self.wake = min(self.wake + _LATER_NS, self.latest)
            saved = self.saved + (self.pieces - pieces if last < _NEAR_NS else -_LOST)
        self.equal_answers = self.equal_answers + 1 if self.equal_answers < _RELEARN_AFTER else 0
        if saved < 0:
            saved = 0
            self.equal_answers = _EQUAL_ANSWERS - _LISTEN_FOR
        self.saved = saved if saved < _MOST_SAVED else _MOST_SAVED


class AnswerTiming:
    """Learns when answers arrive: the driver reports each transmission and each read of the port. Times in ns."""

    __slots__ = ("_asked", "_end", "_first_at", "_header", "_last_at", "_octets", "_pieces", "_usual", "sleep_until")

    def __init__(self) -> None:
        self._usual: dict[bytes, _UsualAnswer] = {}
        self._header = b""
        self._asked: _UsualAnswer | None = None  # the usual answer to it
        self._end = 0
        #: the driver need not read the answer before this time; 0: read at once
        self.sleep_until = 0
        # since the last transmission
        self._first_at = self._last_at = 0  # times of the first and last read that returned octets, 0: none
        self._octets = self._pieces = 0

    def received(self, chunk: bytes, now: int) -> int:
        """The driver has read ``chunk`` at ``now``. Returns the number of octets since the last transmission.

        Of the first read after a sleep, returns 0: the octets arrived earlier than ``now``, at an unknown time; or -1:
        they are the beginning of the expected answer, whose end is near. The driver had better keep them until then,
        as a step of the machine takes longer, and pass all as one chunk.
        """
        self._last_at = now
        self._octets = octets = self._octets + len(chunk)
        if self._pieces:
            self._pieces += 1
            return octets
        self._pieces = 1
        self._first_at = now
        if not self.sleep_until:
            return octets
        usual = self._asked
        if usual is None or octets >= usual.octets or claimed(chunk, 0, octets) != usual.octets:
            return 0
        self._octets = 0
        return -1

    def sent(self, octets: bytes, now: int, end: int) -> int:
        """``octets`` were written at ``now`` and leave until ``end``. Returns when the last octet of the answer should
        arrive, or NEVER."""
        by_header, usual, pieces = self._usual, self._asked, self._pieces
        if pieces:
            if usual is None:
                header = self._header
                by_header[header] = _UsualAnswer(
                    self._last_at - self._end, self._octets, bool(header) and is_answered(header)
                )
            elif self.sleep_until:
                usual.was_slept_through(pieces, self._first_at - self.sleep_until, self._last_at - self.sleep_until)
            else:
                usual.was_heard(pieces, self._last_at - self._end)
            if usual is not None and self._octets != usual.octets:
                usual.octets = self._octets
                usual.equal_answers = 0
            self._octets = self._pieces = 0
        elif usual is not None:
            del by_header[self._header]  # no answer this time
        self._end = end
        self._header = header = octets[:_HEADER_OCTETS]
        self._asked = usual = by_header.get(header)
        if usual is None:
            if len(by_header) > _MOST_HEADERS:
                by_header.clear()
            self.sleep_until = 0
            return NEVER
        if usual.equal_answers >= _EQUAL_ANSWERS:
            wake_at = end + usual.wake
            self.sleep_until = wake_at if wake_at - now > _SHORTEST_SLEEP_NS else 0
        else:
            self.sleep_until = 0
        return end + usual.delay
