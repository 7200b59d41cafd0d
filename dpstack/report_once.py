"""Report each distinct remark once, at most `limit` of them, so that a misbehaving peer cannot fill log or memory."""

from __future__ import annotations

from collections.abc import Hashable
from enum import Enum


class News(Enum):
    """Whether a remark has to be reported."""

    NEW = "new"
    LAST = "last"  # new, and the last one that is reported
    KNOWN = "known"


class Once:
    """Keeps up to ``limit`` different remarks."""

    __slots__ = ("_known", "_limit")

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._known: set[Hashable] = set()

    def news(self, what: Hashable) -> News:
        """Whether ``what`` is new; from now on it is known."""
        if what in self._known or len(self._known) >= self._limit:
            return News.KNOWN
        self._known.add(what)
        return News.NEW if len(self._known) < self._limit else News.LAST
