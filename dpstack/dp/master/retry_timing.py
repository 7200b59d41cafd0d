"""When a slave is asked next: the back-off of retries; when an absent one is looked for with patience."""

from __future__ import annotations

from typing import Final

from dpstack.units import NS_PER_MS, NS_PER_S

# design, "Bring-up and end": absent 0.1 to 1 s, refused 1 to 10 s
_ABSENT: Final = (100 * NS_PER_MS, NS_PER_S)
_REFUSED: Final = (NS_PER_S, 10 * NS_PER_S)
_POLL_PAUSE: Final = 10 * NS_PER_MS
_STATIC_PAUSE: Final = 100 * NS_PER_MS
#: shorter stays in data exchange do not reset the back-off: a slave that flaps is not re-initialised for ever
_STABLE: Final = NS_PER_S
#: So many polls in vain come before one that is waited for as if the slave were there: before the first, then between
#: two. A slave simulated on a busy computer, or behind a slow adapter, answers no request with another one behind it
_IN_VAIN: Final = (2, 7)


class Backoff:
    """A delay in ns that doubles from ``first`` to ``last`` with every use until it is reset."""

    def __init__(self, first: int, last: int) -> None:
        self._first, self._last, self._next = first, last, first

    def take(self) -> int:
        """The delay to wait now."""
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
        self._polls = _IN_VAIN[0]  # so many more before a long one
        #: it was polled with patience since it was there
        self.searched = False

    @property
    def long_due(self) -> bool:
        """It was polled in vain often enough: the next poll is one with patience."""
        return self._polls <= 0

    def absent(self, now: int, *, long: bool = False) -> None:
        """It did not answer; ``long``: although it was waited for with patience."""
        self.due = now + self._absent.take()
        self._polls = _IN_VAIN[1] if long else self._polls - 1
        self.searched |= long

    def refused(self, now: int) -> None:
        """It answered, and cannot be had."""
        self._flapping = False
        self.due = now + self._refused.take()

    def anew(self, now: int) -> None:
        """What stands there now may be another device: asked at once, as if nothing had been tried before."""
        self._flapping = False
        self._refused.reset()
        self._absent.reset()
        self.due = now

    def busy(self, now: int) -> None:
        """It refused a service this once."""
        self.due = now + _POLL_PAUSE

    def not_ready(self, now: int, waited: int) -> None:
        """It has not been ready for ``waited`` ns: asked often first, then every 10 ms."""
        self.due = now + min(_POLL_PAUSE, waited >> 2)

    def exchanging(self, now: int, *, static: bool) -> None:
        """Its diagnosis was read in data exchange; a ``static`` one is read again until it is gone."""
        self.due = now + _STATIC_PAUSE if static else now

    def left(self, now: int, stay: int, *, silent: bool) -> None:
        """It left data exchange after ``stay`` ns: its diagnosis is read at once.

        ``silent``: it did not answer. It was there a moment ago and that may be noise: not held against it as a
        refusal would be, and it is looked for again as soon as an absent slave is.
        """
        self.due = now
        stable = stay >= _STABLE
        self._flapping = not (stable or silent)
        if stable or silent:
            self._absent.reset()
            self._polls = _IN_VAIN[0]
            self.searched = False
        if stable:
            self._refused.reset()

    def pauses(self, now: int) -> bool:
        """True when the next bring-up waits, because the last one did not last; then the diagnosis is read afresh."""
        pauses = self._flapping
        if pauses:
            self.refused(now)
        return pauses
