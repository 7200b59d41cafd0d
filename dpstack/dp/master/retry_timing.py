"""Due times of service requests to a slave: back-off of retries, long polls of absent slaves.

A long poll waits for the answer of an absent slave as long as for that of a present one
(:data:`dpstack.fdl.interface.LONG_NS`); other polls of absent slaves wait for the slot time only.
"""

from __future__ import annotations

from typing import Final

from dpstack.units import NS_PER_MS, NS_PER_S

# design, "Bring-up and end": absent 0.1 to 1 s, refused 1 to 10 s
_ABSENT: Final = (100 * NS_PER_MS, NS_PER_S)
_REFUSED: Final = (NS_PER_S, 10 * NS_PER_S)
_POLL_PAUSE: Final = 10 * NS_PER_MS
_STATIC_PAUSE: Final = 100 * NS_PER_MS
#: a shorter data exchange does not reset the back-off, so that a flapping slave is not brought up without end
_STABLE: Final = NS_PER_S
#: Unanswered polls before the first long poll, and between two long polls. Long polls are needed because a slave behind
#: a slow adapter, or simulated on a busy computer, does not answer a request if the next one follows too early.
_POLLS_BEFORE_LONG: Final = (2, 7)


class Backoff:
    """A delay in ns that doubles from ``first`` to ``last`` with every use until it is reset."""

    def __init__(self, first: int, last: int) -> None:
        self._first, self._last, self._next = first, last, first

    def next_delay(self) -> int:
        """The delay to wait now; the next one is twice as long."""
        delay = self._next
        self._next = min(2 * delay, self._last)
        return delay

    def reset(self) -> None:
        """Begin with the first delay again."""
        self._next = self._first


class Pacing:
    """``due``: no service request to the slave before this time, in ns."""

    def __init__(self) -> None:
        self.due = 0
        self._absent = Backoff(*_ABSENT)
        self._refused = Backoff(*_REFUSED)
        self._flapping = False
        self._excused = False
        self._polls = _POLLS_BEFORE_LONG[0]  # unanswered polls left before the next long poll
        #: the slave had a long poll since it became absent
        self.had_long_poll = False

    @property
    def long_poll_due(self) -> bool:
        """The next poll is a long one, because enough polls were not answered."""
        return self._polls <= 0

    def absent(self, now: int, *, long: bool = False) -> None:
        """The slave did not answer; ``long``: it was a long poll."""
        self.due = now + self._absent.next_delay()
        self._polls = _POLLS_BEFORE_LONG[1] if long else self._polls - 1
        self.had_long_poll |= long

    def refused(self, now: int) -> None:
        """The slave answered, but cannot be brought up."""
        self._flapping = False
        self.due = now + self._refused.next_delay()

    def anew(self, now: int) -> None:
        """Ask at once and forget earlier failures, because the station at this address may be another device."""
        self._flapping = False
        self._refused.reset()
        self._absent.reset()
        self.due = now

    def busy(self, now: int) -> None:
        """The slave refused a service; ask it again soon."""
        self.due = now + _POLL_PAUSE

    def not_ready(self, now: int, waited: int) -> None:
        """The slave has not been ready for ``waited`` ns: ask often at first, then every 10 ms."""
        self.due = now + min(_POLL_PAUSE, waited >> 2)

    def exchanging(self, now: int, *, static: bool) -> None:
        """The diagnosis was read in data exchange; a ``static`` one (Stat_Diag) is read again until it is gone."""
        self.due = now + _STATIC_PAUSE if static else now

    def excuse(self, now: int, *, left: bool) -> None:
        """The slave was not asked for longer than its watchdog. It leaves data exchange because of that, or has left
        it (``left``). The next bring-up is not delayed, however short the stay was."""
        self._excused = not left
        if left:
            self._flapping = False
            self._refused.reset()
            self.due = now

    def left(self, now: int, stay: int, *, silent: bool) -> None:
        """The slave left data exchange after ``stay`` ns: its diagnosis is read at once.

        ``silent``: the slave did not answer. The reason may be noise, so unlike a refusal this does not delay the next
        bring-up, and polls begin again with the shortest pause.
        """
        self.due = now
        stable = stay >= _STABLE or self._excused
        self._excused = False
        self._flapping = not (stable or silent)
        if stable or silent:
            self.answered()
        if stable:
            self._refused.reset()

    def answered(self) -> None:
        """The absent slave has answered: the next time that it is absent begins with the shortest pause."""
        self._absent.reset()
        self._polls = _POLLS_BEFORE_LONG[0]
        self.had_long_poll = False

    def pauses(self, now: int) -> bool:
        """Whether the next bring-up must wait because the last data exchange was too short. Then the diagnosis is read
        again."""
        pauses = self._flapping
        if pauses:
            self.refused(now)
        return pauses
