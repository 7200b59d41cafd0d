"""Which other masters the application was told of.

The LAS follows every token at once, as the standard wants. A token has no check sequence, though: at a wrong rate, or
on a disturbed line, three octets in a row are one now and then. So it takes two tokens, with nothing unreadable
between, until a master is told as joined or left; what has a check sequence (a GAP poll's answer) counts at once.
"""

from __future__ import annotations

from dpstack.fdl.decoder import DecoderStats

#: a master that came (True) or went, by address
News = list[tuple[int, bool]]


class Announced:
    """The masters that were told. ``received`` counts what the receiver could not read."""

    __slots__ = ("_heard", "_missing", "_skipped", "masters", "received")

    def __init__(self) -> None:
        self.received = DecoderStats()
        self._skipped = 0  # up to the last token
        self.masters: frozenset[int] = frozenset()
        self._heard: set[int] = set()  # senders of one token
        self._missing: dict[int, int] = {}  # no longer in the LAS, and after whose token

    def forget(self) -> None:
        """Nobody is told any more."""
        self.masters = frozenset()
        self._heard.clear()
        self._missing.clear()

    def certain(self, address: int, present: bool) -> News:
        """The master ``address`` is there, or is not, beyond doubt: whether that is news."""
        if present is (address in self.masters):
            return []
        self.masters = self.masters ^ {address}
        return [(address, present)]

    def token(self, sa: int, members: frozenset[int]) -> News:
        """``members`` are the other masters as they stand after a token from ``sa``: what is news, and certain."""
        if self.received.skipped != self._skipped:
            self._skipped = self.received.skipped
            self._heard.clear()
            self._missing.clear()
        again = sa in self._heard
        self._heard.add(sa)
        if members == self.masters:
            self._missing.clear()
            return []
        gone = self.masters - members
        left = {a for a in gone if self._missing.get(a) == sa}
        self._missing = {a: self._missing.get(a, sa) for a in gone - left}
        joined = {sa} if again and sa in members - self.masters else set()
        self.masters = self.masters - left | joined
        return sorted([(a, True) for a in joined] + [(a, False) for a in left])
