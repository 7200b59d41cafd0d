"""Echo filter for adapters that return the transmitted octets: detects the echo at start and removes it.

No station answers with the octets of the request. A station that receives its own telegram, octet by octet, therefore
uses an adapter with echo (or sits on a segment that has one).
"""

from __future__ import annotations

from enum import Enum
from typing import Final

#: After this many transmissions that were followed by other octets than their own there is no echo.
_MISSES: Final = 3
#: Octets that prove an echo. A short acknowledgement (1 octet) may follow another one; a token (3) proves it.
_PROOF: Final = 3
#: octets of an outstanding echo; with more of them some were lost
_LONGEST_ECHO: Final = 1000


class Echo(Enum):
    AUTO = "auto"  # not known yet
    ON = "on"
    OFF = "off"


class EchoFilter:
    """Removes a station's own octets from the received ones. ``state`` changes from AUTO to ON or OFF by them."""

    __slots__ = ("_expected", "_held", "_last", "_misses", "_whole", "lost", "state")

    def __init__(self, state: Echo) -> None:
        self.state = state
        self._last = b""  # last transmission
        self._expected = b""  # transmitted octets whose echo is outstanding
        self._whole = 0  # size of the first telegram whose echo is outstanding, including the held octets
        self._held = b""  # while AUTO: received octets that equal the transmitted ones so far
        self._misses = 0
        #: telegrams that did not come back as they were sent: collisions, or a damaged echo
        self.lost = 0

    def sent(self, octets: bytes) -> None:
        if self._expected and len(self._expected) < _LONGEST_ECHO:
            self._expected += octets  # an echo may be later than the next telegram
        else:
            self._expected = octets
            self._whole = len(octets)
        self._last = octets

    def strip(self, chunk: bytes) -> bytes:
        """``chunk`` without echo; in state AUTO preceded by octets that were held back before."""
        if not self._expected or not chunk or self.state is Echo.OFF:
            return chunk
        return self._learn(chunk) if self.state is Echo.AUTO else self._remove(chunk)

    def release(self) -> bytes:
        """Octets held back so far: a deadline is due, so their rest will not arrive."""
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
    """Length of the common prefix."""
    limit = min(len(one), len(other))
    if one[:limit] == other[:limit]:
        return limit
    return next(i for i in range(limit) if one[i] != other[i])
