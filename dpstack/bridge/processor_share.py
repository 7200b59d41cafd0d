"""``ProcessorShare``: a bound for the processor time that the requests of clients take from the loop of a connector."""

from __future__ import annotations

import asyncio
import time
from typing import Final

#: s of processor that requests may take in a row; beyond that they get half of the time
_IN_A_ROW: Final = 0.02
#: s that one request counts at most: others run while it waits
_LONGEST: Final = 0.1


class ProcessorShare:
    """Requests get the processor for a short burst, beyond that half of the time: others have their turn."""

    def __init__(self) -> None:
        self._debt = 0.0
        self._seen = 0.0

    def spent(self, seconds: float) -> None:
        # twice, as these seconds have passed themselves
        self._debt = self._now() + 2 * min(seconds, _LONGEST)

    @property
    def debt(self) -> float:
        """s until requests have had their half of the time."""
        return self._now()

    def _now(self) -> float:
        now = time.monotonic()
        self._debt = max(0.0, self._debt - (now - self._seen))
        self._seen = now
        return self._debt

    async def turn(self) -> None:
        await asyncio.sleep(0)
        while (debt := self._now()) > _IN_A_ROW:  # noqa: ASYNC110  time heals it
            await asyncio.sleep(max(debt - _IN_A_ROW, 0.001))

    async def pause(self, begun: float) -> float:
        """Wait between two parts of a long work. ``begun``: when the last part began, by :func:`time.thread_time`;
        returns when the next one does."""
        self.spent(time.thread_time() - begun)
        await self.turn()
        return time.thread_time()
