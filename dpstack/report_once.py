"""Report each distinct remark once, at most `limit` of them, so that a misbehaving peer cannot fill log or memory."""

from __future__ import annotations

from collections.abc import Hashable
from enum import Enum


class News(Enum):
    """Whether something is to be told."""

    NEW = "new"
    LAST = "last"  # new, and nothing new is told any more
    KNOWN = "known"


class Once:
    """Up to ``limit`` different things."""

    __slots__ = ("_limit", "_told")

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._told: set[Hashable] = set()

    def news(self, what: Hashable) -> News:
        """What ``what`` is; asked again it is known."""
        if what in self._told or len(self._told) >= self._limit:
            return News.KNOWN
        self._told.add(what)
        return News.NEW if len(self._told) < self._limit else News.LAST
