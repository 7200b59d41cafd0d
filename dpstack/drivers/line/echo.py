"""Echo filter for adapters that return the transmitted octets: detects the echo at start and removes it.

No station answers with the octets of the request. A station that receives its own telegram, octet by octet, therefore
uses an adapter with echo (or sits on a segment that has one).

An echo may be late, behind the next telegram, and come in one piece with answers. Its first octets, or all of it, may
be missing. An answer may begin as the request does. So an echo is removed only when it is there whole; octets that may
be its begin are held back until the next ones have come.
"""

from __future__ import annotations

from collections import deque
from enum import Enum
from typing import Final

#: After this many transmissions that were followed by other octets than their own there is no echo.
_MISSES: Final = 3
#: Octets that prove an echo. A short acknowledgement (1 octet) may follow another one; a token (3) proves it.
_PROOF: Final = 3
#: An answer may begin with this many octets of its request: SD2, twice its length, SD2. More of them are an echo.
_ALIKE: Final = 4
#: octets of a token
_TOKEN: Final = 3
#: Largest number of telegrams whose echo is outstanding. With this many in a row that never came back the echo is gone.
_MOST: Final = 16


class Echo(Enum):
    AUTO = "auto"  # not known yet
    ON = "on"
    OFF = "off"


class EchoFilter:
    """Removes a station's own octets from the received ones. ``state`` changes by them: from AUTO to ON or OFF, and
    from ON to AUTO when the echo has ended."""

    __slots__ = ("_held", "_misses", "_outstanding", "_unheard", "lost", "state")

    def __init__(self, state: Echo) -> None:
        self.state = state
        self._outstanding: deque[bytes] = deque()  # telegrams whose echo has not come, oldest first
        self._held = b""  # received octets that may be the begin of an echo
        self._misses = 0
        self._unheard = 0  # telegrams without echo since the last echo
        #: telegrams that did not come back as they were sent: collisions, or a damaged echo
        self.lost = 0

    def sent(self, octets: bytes) -> None:
        outstanding = self._outstanding
        if len(outstanding) >= _MOST:
            self._lose(1)
        outstanding.append(octets)

    def strip(self, chunk: bytes) -> bytes:
        """``chunk`` without echo, preceded by octets that were held back before."""
        outstanding = self._outstanding
        if not chunk or not (outstanding or self._held) or self.state is Echo.OFF:
            return chunk
        octets = self._held + chunk
        self._held = b""
        if not outstanding:
            return octets
        if self._unheard >= _MOST and self.state is Echo.ON:
            self.state = Echo.AUTO
            self._unheard = 0
            self._lose(len(outstanding) - 1)
        if self.state is Echo.AUTO and not self._is_proven(octets):
            return self._learn(octets)
        if octets == outstanding[0]:  # the usual case
            outstanding.popleft()
            self._unheard = 0
            return b""
        return self._remove(octets)

    def release(self) -> bytes:
        """Octets held back although no echo is proven: a deadline is due, so their rest will not arrive."""
        if self.state is not Echo.AUTO:
            return b""
        held, self._held = self._held, b""
        if held:
            self._outstanding.clear()
        return held

    def _is_proven(self, octets: bytes) -> bool:
        first = self._outstanding[0]
        if not octets.startswith(first) or len(first) < _PROOF:
            return False
        self.state = Echo.ON
        self._misses = 0
        return True

    def _learn(self, octets: bytes) -> bytes:
        """``octets`` while no echo is proven, or nothing: they may be the begin of an echo."""
        first = self._outstanding[0]
        if len(octets) < len(first) and first.startswith(octets):
            self._held = octets
            return b""
        self._outstanding.clear()
        if not octets.startswith(first):
            self._misses += 1
            if self._misses == _MISSES:
                self.state = Echo.OFF
        return octets

    def _remove(self, octets: bytes) -> bytes:
        """``octets`` without the echoes in them, as far as no echo may begin in them."""
        outstanding = self._outstanding
        rest = b""
        while outstanding and octets:
            at, number = self._find(octets)
            if at < 0:
                number = next((n for n, sent in enumerate(outstanding) if _is_damaged_token(octets, sent)), -1)
                if number < 0:
                    break
                self._lose(number + 1)
                octets = octets[_TOKEN:]
                continue
            self._lose(number)  # earlier ones never came back
            rest += octets[:at]
            octets = octets[at + len(outstanding.popleft()) :]
            self._unheard = 0
        if not outstanding or not octets:
            return rest + octets
        alike = _common(octets, outstanding[0])
        if _ALIKE < alike < len(octets):  # its end is missing, or damaged
            self._lose(1)
            octets = octets[alike:]
        held = max((_begun(octets, telegram) for telegram in outstanding), default=0)
        split = len(octets) - held
        self._held = octets[split:]
        return rest + octets[:split]

    def _find(self, octets: bytes) -> tuple[int, int]:
        """The place of the first echo in ``octets``, or -1, and the number of outstanding ones before it."""
        for number, telegram in enumerate(self._outstanding):
            at = octets.find(telegram)
            if at == 0 or (at > 0 and len(telegram) >= _PROOF):
                return at, number
        return -1, 0

    def _lose(self, number: int) -> None:
        """The echoes of the oldest telegrams never came whole."""
        for _ in range(number):
            self._outstanding.popleft()
        self.lost += number
        self._unheard += number


def _common(one: bytes, other: bytes) -> int:
    """Length of the common prefix."""
    limit = min(len(one), len(other))
    if one[:limit] == other[:limit]:
        return limit
    return next(i for i in range(limit) if one[i] != other[i])


def _is_damaged_token(octets: bytes, telegram: bytes) -> bool:
    """Whether ``octets`` begin with ``telegram``, a token, with one wrong address.

    A token has no check sequence: the machine would take this one for a token of another master. All other damaged
    telegrams are garbage to it.
    """
    return (
        len(telegram) == _TOKEN <= len(octets)
        and octets[0] == telegram[0]
        and (octets[1] == telegram[1]) != (octets[2] == telegram[2])
    )


def _begun(octets: bytes, telegram: bytes) -> int:
    """Number of octets at the end of ``octets`` with which ``telegram`` begins; it is not there whole."""
    at = octets.find(telegram[:1], max(0, len(octets) - len(telegram) + 1))
    while at >= 0:
        # of a token with a wrong first address, too
        if telegram.startswith(octets[at:]) or (len(telegram) == _TOKEN and len(octets) - at == _TOKEN - 1):
            return len(octets) - at
        at = octets.find(telegram[:1], at + 1)
    return 0
