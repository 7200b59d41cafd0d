"""When a slave is asked next: the back-off of retries."""

from __future__ import annotations

from typing import Final

from dpstack.units import NS_PER_MS, NS_PER_S

# design, "Bring-up and end": absent 0.1 to 1 s, refused 1 to 10 s
_ABSENT: Final = (100 * NS_PER_MS, NS_PER_S)
_REFUSED: Final = (NS_PER_S, 10 * NS_PER_S)
#: shorter stays in data exchange do not reset the back-off: a slave that flaps is not re-initialised for ever
_STABLE: Final = NS_PER_S


class Backoff:
    """A delay in ns that doubles from ``first`` to ``last`` with every use until it is reset."""

    __slots__ = ("_first", "_last", "_next")

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

    __slots__ = ("_absent", "_flapping", "_refused", "due")

    def __init__(self) -> None:
        self.due = 0
        self._absent = Backoff(*_ABSENT)
        self._refused = Backoff(*_REFUSED)
        self._flapping = False

    def absent(self, now: int) -> None:
        """It did not answer."""
        self.due = now + self._absent.take()

    def refused(self, now: int) -> None:
        """It answered, and cannot be had."""
        self._flapping = False
        self.due = now + self._refused.take()

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
        if stable:
            self._refused.reset()

    def pauses(self, now: int) -> bool:
        """True when the next bring-up waits, because the last one did not last; then the diagnosis is read afresh."""
        pauses = self._flapping
        if pauses:
            self.refused(now)
        return pauses
