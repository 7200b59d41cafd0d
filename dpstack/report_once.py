"""Report each distinct remark once, at most `limit` of them, so that a misbehaving peer cannot fill log or memory."""

from __future__ import annotations

from collections.abc import Hashable
from enum import Enum


class Novelty(Enum):
    """Result of :meth:`ReportOnce.novelty`: whether to report a remark."""

    NEW = "new"
    LAST = "last"  # new, and the last one that is reported
    KNOWN = "known"


class ReportOnce:
    """Keeps up to ``limit`` different remarks."""

    __slots__ = ("_known", "_limit")

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._known: set[Hashable] = set()

    def novelty(self, remark: Hashable) -> Novelty:
        """Whether ``remark`` is new; from now on it is known."""
        if remark in self._known or len(self._known) >= self._limit:
            return Novelty.KNOWN
        self._known.add(remark)
        return Novelty.NEW if len(self._known) < self._limit else Novelty.LAST
