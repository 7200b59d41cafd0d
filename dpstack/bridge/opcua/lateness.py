"""The lateness of requests of one connection: a network that was cut for a while delivers an old start late.

A request has the time of its client, whose clock may go wrong. So a request counts from the fastest one before it over
the same connection, and no clocks are compared.
"""

from __future__ import annotations

from contextvars import ContextVar
from datetime import UTC, datetime
from typing import Final

#: clocks of two computers drift apart by less
_DRIFT: Final = 1e-3
#: s that the request which is carried out came late; the connection sets it in the task of the request
LATE_S: Final[ContextVar[float]] = ContextVar("dpstack_opcua_late_s", default=0.0)


class Lateness:
    """Of one connection. ``now``, of :meth:`of`: s by a clock that nobody sets."""

    def __init__(self) -> None:
        self._least: float | None = None
        self._at = 0.0

    def of(self, sent: datetime | None, now: float) -> float:
        """The s that a request which its client sent at ``sent`` came later than the fastest one before it."""
        seconds = seconds_of(sent)
        if seconds is None:
            return 0.0
        delay = now - seconds
        least = delay if self._least is None else min(delay, self._least + _DRIFT * (now - self._at))
        self._least, self._at = least, now
        return delay - least


def seconds_of(time: datetime | None) -> float | None:
    """A time of OPC UA in s since 1970; None if it has none (null is the begin of 1601)."""
    if time is None or time.year < 1970:
        return None
    return (time if time.tzinfo is not None else time.replace(tzinfo=UTC)).timestamp()
