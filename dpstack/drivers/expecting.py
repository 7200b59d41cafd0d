"""When an answer is to be expected: requests that begin alike were answered after so long.

Between a request and its answer there is time for what can wait, but not for more than that.
"""

from __future__ import annotations

from typing import Final

from dpstack.units import NEVER

#: What tells requests apart: the header of a telegram with addresses and function code.
_ALIKE: Final = 7
#: So many kinds of requests are remembered: each slave's with both values of the FCB, and more.
_KINDS: Final = 1024
#: a new delay counts for this part (as a shift)
_SHIFT: Final = 3


class Answers:
    """Learns from transmissions and what follows them. Times in ns."""

    __slots__ = ("_delays", "_end", "_kind")

    def __init__(self) -> None:
        self._delays: dict[bytes, int] = {}
        self._kind = b""
        self._end = 0

    def sent(self, octets: bytes, end: int, heard_at: int) -> int:
        """``octets`` leave the line at ``end``: when the last octet of an answer should arrive, or NEVER.

        ``heard_at`` is when the last octets before were delivered, 0 for none since the transmission before.
        """
        delays, kind = self._delays, self._kind
        before = delays.get(kind)
        if heard_at:
            delay = heard_at - self._end
            delays[kind] = delay if before is None else before + ((delay - before) >> _SHIFT)
        elif before is not None:
            del delays[kind]  # it answers no more
        if len(delays) > _KINDS:
            delays.clear()
        self._end = end
        self._kind = octets[:_ALIKE]
        delay = delays.get(self._kind, NEVER)
        return NEVER if delay == NEVER else end + delay
