"""A lost port is opened again: the pauses between the attempts, and which refusal is worth telling."""

from __future__ import annotations

from typing import Final

from dpstack.units import NS_PER_MS

#: Pauses between the attempts to open a lost port in ns: the first, and the longest after doubling.
BACKOFF_NS: Final = (100 * NS_PER_MS, 2_000 * NS_PER_MS)


class Attempts:
    """The attempts that follow one loss."""

    __slots__ = ("_longest", "_pause", "_told")

    def __init__(self, backoff_ns: tuple[int, int] = BACKOFF_NS) -> None:
        self._pause, self._longest = backoff_ns
        self._told = ""

    def pause_ns(self) -> int:
        """How long to wait before the next attempt."""
        pause = self._pause
        self._pause = min(2 * pause, self._longest)
        return pause

    def is_news(self, refusal: str) -> bool:
        """Whether the attempt before failed for another reason."""
        news, self._told = refusal != self._told, refusal
        return news
