"""Signals that end a command: SIGINT, SIGTERM, SIGHUP and all others that would kill it; the loss of standard output.

The first signal ends the command in order. Signals within a second of it are the same one: GNU ``timeout`` and other
wrappers send SIGTERM to a program and to its process group, half a millisecond apart. A later one skips waiting,
connections and summary, but never safe values and one Clear; it ends the command within a second. A third leaves at
once.
"""

from __future__ import annotations

import asyncio
import atexit
import contextlib
import os
import signal
from collections.abc import Awaitable, Callable, Coroutine
from time import monotonic
from types import FrameType
from typing import Final, TypeVar

from dpstack.api.bus.shutdown import ENDING_SIGNALS, hurry_all
from dpstack.cli.terminal import output
from dpstack.errors import BusError

_T = TypeVar("_T")
#: exit code of a command that was hurried, or left at once
INTERRUPTED: Final = 130
#: signals within this many seconds of the first are the same one
_SAME_S: Final = 1.0
#: and within this many of the second, from programs that send every signal twice
_SAME_AGAIN_S: Final = 0.1
#: after this time (s) a hurried end is abandoned
_HURRIED_S: Final = 1.0

#: called before the program leaves without any clean-up: gives a terminal back
before_leaving: Final[list[Callable[[], None]]] = []

_LATE: Final = "the end was not over within a second after the second signal, so it was left"
_LEFT: Final = "left at once, by a third signal"
_WATCHDOGS: Final = "what was not sent to slaves is made safe by their watchdogs (off: not at all)"


class StopSignal:
    """Set by the signals, and by the loss of standard output. Works in every kind of loop; a context manager."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._event = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self._old: dict[int, object] = {}
        self._within = False
        self._at = 0.0  # of the first signal
        self._again_at = 0.0  # of the second one
        self.received = False
        #: a second signal came: the command returns :data:`INTERRUPTED`, without a summary
        self.hurried = False

    def __enter__(self) -> StopSignal:
        for number in dict.fromkeys((signal.SIGINT, signal.SIGTERM, *_hangup(), *_others())):
            self._old[number] = signal.signal(number, self._caught)
        output.lost.on_lost = self.stop
        self._within = True
        return self

    def __exit__(self, *_: object) -> None:
        self._within = False
        output.lost.on_lost = None
        if self.hurried:
            _alarm(0.0, signal.SIG_DFL)
        if not (self.received and self._clock() - self._at < _SAME_S):
            self._restore()
        else:  # its copy may still come, until the interpreter ends and removes the signal handlers
            atexit.register(self._ignore)

    def _ignore(self) -> None:
        """Ignore the signals that this object still handles, until the process has ended."""
        for number in self._old:
            if signal.getsignal(number) == self._caught:
                signal.signal(number, signal.SIG_IGN)

    def _restore(self) -> None:
        for number, old in self._old.items():
            if callable(old) or isinstance(old, signal.Handlers):
                signal.signal(number, old)

    def _caught(self, number: int, frame: FrameType | None) -> None:
        now = self._clock()
        if not self.received:
            self.stop()
        elif now - self._at < _SAME_S:
            return
        elif not self._within:
            self._restore()
            signal.raise_signal(number)
        elif not self.hurried:
            self.hurried = True
            self._again_at = now
            _alarm(_HURRIED_S, lambda *_: _leave(_LATE))
            self._loop.call_soon_threadsafe(hurry_all)
        elif now - self._again_at >= _SAME_AGAIN_S:
            _leave(_LEFT)

    def stop(self) -> None:
        """End the command as the first signal does."""
        if not self.received:
            self.received = True
            self._at = self._clock()
        self._loop.call_soon_threadsafe(self._event.set)

    async def or_done(self, work: Awaitable[object]) -> bool:
        """Wait until ``work`` is done (True; raises its exception) or the first signal (False; cancels it)."""
        task = asyncio.ensure_future(work)
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


async def first_of(*works: Coroutine[object, object, None], timeout: float | None = None) -> None:
    """Run ``works`` until the first of them ends, or for ``timeout`` in s; raises its exception. Cancels the others."""
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        done, _ = await asyncio.wait(tasks, timeout=timeout, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def run_to_result(work: Coroutine[object, object, _T], before: str) -> _T:
    """Run ``work``. Returns its result. Raises BusError ("ended before ...") if a signal ended it first."""

    async def run() -> _T:
        with StopSignal() as stop:
            task = asyncio.ensure_future(work)
            if not await stop.or_done(task):
                raise BusError(f"ended before {before}")
            return task.result()

    return asyncio.run(run())


def _leave(why: str) -> None:
    """Leave without any clean-up: it might block again."""
    for call in before_leaving:
        with contextlib.suppress(Exception):
            call()
    with contextlib.suppress(OSError):
        os.write(2, f"dpstack: {why}; {_WATCHDOGS}\n".encode())
    os._exit(INTERRUPTED)


def _alarm(seconds: float, handler: Callable[[int, FrameType | None], object] | signal.Handlers) -> None:
    """Call ``handler`` after ``seconds``, also while the event loop is blocked; 0: cancel it."""
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, handler)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _others() -> list[int]:
    """The other signals that would end the program without a handler: an operator may send any of them by mistake.

    Also those whose handler an earlier StopSignal has left, because a copy of its signal might still come.
    """
    handlers = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    return [
        number
        for number, handler in handlers.items()
        if handler is signal.SIG_DFL or getattr(handler, "__func__", None) is StopSignal._caught
    ]


def _hangup() -> list[signal.Signals]:
    """SIGHUP, the terminal's end; not if it is ignored (nohup), nor on systems without it."""
    return [] if output.hangup_is_ignored() else [signal.SIGHUP]
