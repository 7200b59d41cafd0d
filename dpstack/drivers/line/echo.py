"""Adapters that echo what they send: recognised at start, removed by comparing octets.

Nothing on a bus answers with the octets of the request, so a station that hears its own telegram back, octet by octet,
sits on an adapter with echo (or on a segment that has one).
"""

from __future__ import annotations

from enum import Enum
from typing import Final

#: So many transmissions followed by something else than themselves: there is no echo.
_MISSES: Final = 3
#: A short acknowledgement proves nothing, another one may follow it; a token is the shortest telegram that does.
_PROOF: Final = 3
#: more than this is not waited for: some of it was lost
_LONGEST_ECHO: Final = 1000


class Echo(Enum):
    """Whether the line echoes."""

    AUTO = "auto"  # not known yet
    ON = "on"
    OFF = "off"


class EchoFilter:
    """Takes a station's own octets out of what its port delivers. ``state`` leaves AUTO by what is heard."""

    __slots__ = ("_expected", "_held", "_last", "_misses", "_whole", "lost", "state")

    def __init__(self, state: Echo) -> None:
        self.state = state
        self._last = b""  # what was sent last
        self._expected = b""  # the part of what was sent that has not come back yet
        self._whole = 0  # size of the first telegram that is expected, with what is held of it
        self._held = b""  # while AUTO: came back as sent so far, may still be the start of something else
        self._misses = 0
        #: telegrams that did not come back as they were sent: collisions, or a damaged echo
        self.lost = 0

    def sent(self, octets: bytes) -> None:
        """``octets`` go out now."""
        if self._expected and len(self._expected) < _LONGEST_ECHO:
            self._expected += octets  # an echo may be later than the next telegram
        else:
            self._expected = octets
            self._whole = len(octets)
        self._last = octets

    def strip(self, chunk: bytes) -> bytes:
        """What remains of ``chunk``; in state AUTO with what was held before in front of it."""
        if not self._expected or not chunk or self.state is Echo.OFF:
            return chunk
        return self._learn(chunk) if self.state is Echo.AUTO else self._remove(chunk)

    def release(self) -> bytes:
        """What is held back: a deadline is due, so the rest of it does not come."""
        held, self._held = self._held, b""
        if held:
            self._expected = b""
        return held

    def _learn(self, chunk: bytes) -> bytes:
        count = _common(chunk, self._expected)
        held = self._held + chunk[:count]
        complete = len(held) >= self._whole
        if count == len(chunk) and not complete:
            self._held = held
            self._expected = self._expected[count:]
            return b""
        self._held = b""
        if complete and len(held) >= _PROOF:
            self.state = Echo.ON
            self._expected = self._expected[count:]
            return self.strip(chunk[count:])
        self._expected = b""
        if not complete:
            self._misses += 1
            if self._misses == _MISSES:
                self.state = Echo.OFF
        return held + chunk[count:]

    def _remove(self, chunk: bytes) -> bytes:
        count = _common(chunk, self._expected)
        if not count and _common(chunk, self._last):
            self.lost += 1  # an earlier one never came back
            self._expected = self._last
            count = _common(chunk, self._expected)
        self._expected = self._expected[count:]
        if self._expected and count < len(chunk):
            self.lost += 1
            self._expected = b""
        return chunk[count:]


def _common(one: bytes, other: bytes) -> int:
    """How many octets at the start are the same."""
    limit = min(len(one), len(other))
    if one[:limit] == other[:limit]:
        return limit
    return next(i for i in range(limit) if one[i] != other[i])
