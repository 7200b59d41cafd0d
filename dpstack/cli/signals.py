"""SIGINT, SIGTERM and SIGHUP, and output that nobody takes: the first ends in order, a second signal at once."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Coroutine
from types import FrameType

from dpstack.cli import streams

_AT_ONCE = 130


class StopSignal:
    """What the signals set, and the loss of standard output. Works in every kind of loop; a context manager."""

    def __init__(self) -> None:
        self._event = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._old: dict[signal.Signals, object] = {}
        self.received = False

    def __enter__(self) -> StopSignal:
        for number in (signal.SIGINT, signal.SIGTERM, *_hangup()):
            self._old[number] = signal.signal(number, self._caught)
        streams.lost.told = self._stop
        return self

    def __exit__(self, *_: object) -> None:
        streams.lost.told = None
        for number, old in self._old.items():
            if callable(old) or isinstance(old, signal.Handlers):
                signal.signal(number, old)

    def _caught(self, number: int, frame: FrameType | None) -> None:
        if self.received:
            os._exit(_AT_ONCE)  # what is in the way of an orderly end is in the way of every other
        self._stop()

    def _stop(self) -> None:
        self.received = True
        self._loop.call_soon_threadsafe(self._event.set)

    async def wait(self) -> None:
        """Until the first signal."""
        await self._event.wait()

    async def or_done(self, work: Coroutine[object, object, object]) -> bool:
        """Until ``work`` is done (True; what it raises is raised) or the first signal (False; it is cancelled)."""
        task: asyncio.Task[object] = asyncio.ensure_future(work)
        waiting = asyncio.ensure_future(self._event.wait())
        try:
            await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                task.result()
                return True
            return False
        finally:
            for each in (task, waiting):
                each.cancel()
            await asyncio.gather(task, waiting, return_exceptions=True)


def _hangup() -> list[signal.Signals]:
    """SIGHUP, the terminal's end; not where it is ignored (nohup), nor on systems without it."""
    number = getattr(signal, "SIGHUP", None)
    return [] if number is None or signal.getsignal(number) is signal.SIG_IGN else [number]
