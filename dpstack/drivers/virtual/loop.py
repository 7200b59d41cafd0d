"""Asyncio event loop in virtual time: exact, deterministic, and as fast as the computer allows.

Unmodified programs run in it: sleeps, timeouts, queues and tasks use the loop's time. A wait takes no real time, it
advances the simulated worlds attached to the loop to their next event. The program's own computing takes no virtual
time. With ``paced`` virtual time does not go faster than real time; the events are the same.
"""

from __future__ import annotations

import asyncio
import selectors
import sys
import time
from collections.abc import Awaitable, Callable, Coroutine
from concurrent.futures import Executor
from contextvars import Context
from typing import Any, Final, Protocol, TypeVar, TypeVarTuple, Unpack

from dpstack.errors import DpError, UsageError
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, ns_to_s, s_to_ns

_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")

#: Turns without a wait after which time goes on by _NUDGE_NS: a program that polls with ``sleep(0)`` must not stop it.
_TURNS: Final = 1_000
_NUDGE_NS: Final = 100_000
#: World events between two polls of real file descriptors (signals, sockets).
_EVENTS_PER_POLL: Final = 500
#: Such a poll is left out so often while worlds go on as fast as they can.
_SKIPS: Final = 16
_STOPS: Final = [True] + [False] * (_EVENTS_PER_POLL - 1)
#: At real time a simulated bus catches up at most this much; beyond it virtual time falls behind. It never skips.
DEBT_NS: Final = 50 * NS_PER_MS

_Ready = list[tuple[selectors.SelectorKey, int]]


class StandstillError(DpError, RuntimeError):
    """All tasks of a virtual loop wait, and no timer, simulated world, socket, signal or thread can wake them."""


class Timeline(Protocol):
    """A simulated world: events in its own virtual time. Times in ns."""

    @property
    def now(self) -> int:
        """Time of the last event, or the end of the last :meth:`run`."""

    def next_at(self) -> int:
        """Earliest time of the next event; NEVER without one."""

    def run(self, until_ns: int, stop: Callable[[], bool]) -> bool:
        """Run all events up to and including ``until_ns``, which becomes ``now`` (unless it is NEVER).

        Returns True, with ``now`` at the last event run, when ``stop()`` was true after it.
        """


_call_soon: Final = asyncio.SelectorEventLoop.call_soon


class _Attached:
    """An attached timeline. ``offset``: the loop's time less the timeline's, ns."""

    __slots__ = ("offset", "timeline")

    def __init__(self, timeline: Timeline, now: int) -> None:
        self.timeline = timeline
        self.offset = now - timeline.now

    def next_at(self) -> int:
        at = self.timeline.next_at()
        return at if at == NEVER else at + self.offset


class _Selector(selectors.DefaultSelector):
    """A selector whose wait is :meth:`VirtualLoop._wait`."""

    wait: Callable[[float | None], _Ready] | None = None

    def select(self, timeout: float | None = None) -> _Ready:
        return self.poll(timeout) if self.wait is None else self.wait(timeout)

    def poll(self, timeout: float | None) -> _Ready:
        return super().select(timeout)


class VirtualLoop(asyncio.SelectorEventLoop):
    """An asyncio loop on virtual time, from 0. ``paced``: never ahead of real time.

    Real file descriptors, signals and threads work in both modes. While a thread of an executor works, virtual time
    goes no faster than real time, because the duration of the thread's work is unknown.
    """

    def __init__(self, *, paced: bool = False) -> None:
        self.paced = paced
        self._at_ns = 0
        self._attached: list[_Attached] = []
        self._running: _Attached | None = None
        self._has_new_calls = False  # a callback or a timer was added while worlds ran
        #: the answers to the worlds, which ask after each event whether to stop; the next one is the last in the list
        self._stops: list[bool] = []
        self._turns = 0
        self._unpolled = 0  # polls that were left out
        self._threads = 0
        self._signals: set[int] = set()
        self._origin_ns: int | None = None  # real minus virtual time
        self._waiting = _Selector()
        super().__init__(self._waiting)
        self._own_fds = len(self._waiting.get_map())
        self._waiting.wait = self._wait

    # --- time ---
    def time(self) -> float:
        return self.time_ns() / NS_PER_S

    def time_ns(self) -> int:
        """Virtual time in ns."""
        running = self._running
        # inside a world: its time is ahead of the loop's
        return self._at_ns if running is None else running.timeline.now + running.offset

    def attach(self, timeline: Timeline) -> None:
        """Advance ``timeline`` with the loop's time."""
        self._attached.append(_Attached(timeline, self._at_ns))

    def detach(self, timeline: Timeline) -> None:
        """Undo :meth:`attach`: ``timeline`` stands still."""
        self._attached = [attached for attached in self._attached if attached.timeline is not timeline]

    # --- asyncio's methods, which note callbacks, threads and signals ---
    def call_soon(
        self, callback: Callable[[Unpack[_Ts]], object], *args: *_Ts, context: Context | None = None
    ) -> asyncio.Handle:
        self._has_new_calls = True
        self._stops.append(True)
        return _call_soon(self, callback, *args, context=context)  # in each cycle: super() would take longer

    def call_at(
        self,
        when: float,
        callback: Callable[[Unpack[_Ts]], object],
        *args: *_Ts,
        context: Context | None = None,
    ) -> asyncio.TimerHandle:
        self._has_new_calls = True
        self._stops.append(True)
        return super().call_at(when, callback, *args, context=context)

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[Unpack[_Ts]], _T], *args: *_Ts
    ) -> asyncio.Future[_T]:
        """As in asyncio; until the thread is done virtual time goes no faster than real time."""
        future = super().run_in_executor(executor, func, *args)
        self._threads += 1
        future.add_done_callback(self._thread_done)
        return future

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        """As in asyncio; the time-out is in real time."""
        self._threads += 1
        try:
            if sys.version_info >= (3, 12):
                await super().shutdown_default_executor(timeout)
            else:
                await super().shutdown_default_executor()
        finally:
            self._threads -= 1

    def add_signal_handler(self, sig: int, callback: Callable[[Unpack[_Ts]], object], *args: *_Ts) -> None:
        """As in asyncio; a loop that waits only for a signal waits in real time."""
        super().add_signal_handler(sig, callback, *args)
        self._signals.add(sig)

    def remove_signal_handler(self, sig: int) -> bool:
        self._signals.discard(sig)
        return super().remove_signal_handler(sig)

    def _thread_done(self, future: asyncio.Future[Any]) -> None:
        self._threads -= 1

    # --- the waiting step ---
    def _wait(self, timeout: float | None) -> _Ready:
        """Return when a descriptor is ready or ``timeout`` seconds of virtual time are over."""
        stops = self._stops
        while stops and stops[-1]:
            stops.pop()  # of the calls that were made, which the loop has run
        ready = self._poll_now()
        if timeout is not None and timeout <= 0:
            # callbacks are ready: time stands still
            self._turns += 1
            if ready or self._turns < _TURNS:
                return ready
            timeout = ns_to_s(_NUDGE_NS)
        self._turns = 0
        limit = NEVER if timeout is None else self._at_ns + s_to_ns(timeout)
        held = self.paced or self._threads > 0
        if held:
            self._set_origin()
        self._has_new_calls = False
        while not ready and not self._has_new_calls:
            horizon = min(limit, self._allowed()) if held else limit
            if self._advance(horizon):
                if not self._has_new_calls:
                    ready = self._poll_now()
            elif horizon == limit < NEVER:
                break
            else:
                ready = self._wait_really(limit)
        return ready

    def _poll_now(self) -> _Ready:
        """The descriptors that are ready, if it is time to ask."""
        self._unpolled += 1
        if self._attached and self._unpolled < _SKIPS and not (self.paced or self._threads):
            return []
        self._unpolled = 0
        return self._waiting.poll(0)

    def _advance(self, horizon: int) -> bool:
        """Run the worlds up to ``horizon``; True when stopped earlier."""
        attached = self._attached
        if len(attached) > 1:
            return self._advance_many(horizon)
        if attached:
            if not self._stops:
                self._stops.extend(_STOPS)
            if self._run(attached[0], horizon):
                return True
        if self._at_ns < horizon < NEVER:
            self._at_ns = horizon
        return False

    def _advance_many(self, horizon: int) -> bool:
        """Several worlds: always run the one with the next event, up to the next event of another one."""
        stopped = False
        while not stopped:
            if not self._stops:
                self._stops.extend(_STOPS)
            first, second = sorted(self._attached, key=_Attached.next_at)[:2]
            if first.next_at() > horizon or first.next_at() == NEVER:
                break
            stopped = self._run(first, min(horizon, second.next_at()))
        if not stopped and self._at_ns < horizon < NEVER:
            self._at_ns = horizon
        for attached in self._attached:
            attached.timeline.run(self._at_ns - attached.offset, _never)
        return stopped

    def _run(self, attached: _Attached, until: int) -> bool:
        timeline = attached.timeline
        self._running = attached
        try:
            return timeline.run(until if until == NEVER else until - attached.offset, self._stops.pop)
        finally:
            self._running = None
            self._at_ns = max(self._at_ns, timeline.now + attached.offset)

    # --- real time ---
    def _set_origin(self) -> None:
        real = time.monotonic_ns()
        if self._origin_ns is None or not self.paced:
            self._origin_ns = real - self._at_ns
        elif real - self._origin_ns - self._at_ns > DEBT_NS:
            self._origin_ns = real - self._at_ns - DEBT_NS

    def _allowed(self) -> int:
        """Virtual time up to which a held loop may run now."""
        assert self._origin_ns is not None
        return max(self._at_ns, time.monotonic_ns() - self._origin_ns)

    def _wait_really(self, limit: int) -> _Ready:
        """Wait in real time for a descriptor, or until the next virtual event is due."""
        at = min([limit, *(attached.next_at() for attached in self._attached)])
        if at < NEVER:
            ready = self._waiting.poll(max(0.0, ns_to_s(at - self._allowed())))
        elif self._threads or self._signals or len(self._waiting.get_map()) > self._own_fds:
            ready = self._waiting.poll(None)
        else:
            raise StandstillError(
                "the program waits for ever: no timer is set, nothing will happen on the simulated bus, and no "
                "socket, signal or thread is waited for"
            )
        if ready and self._origin_ns is not None and (self.paced or self._threads):
            self._advance(min(limit, self._allowed()))
        return ready


def _never() -> bool:
    return False


def refuse_running_loop(called: str, program: Awaitable[object] | None = None) -> None:
    """Raises UsageError if an event loop runs in this thread already: ``called`` needs its own. Closes ``program``,
    which nobody will await; None: ``called`` takes none."""
    try:
        running = asyncio.get_running_loop()
    except RuntimeError:
        return
    if isinstance(program, Coroutine):
        program.close()
    if isinstance(running, VirtualLoop):
        todo = "this coroutine runs in virtual time already: await instead, `await asyncio.sleep(1)` for wait(1)"
    else:
        plain = "call it from a plain function (def test_...() or a plain fixture, not async def)"
        todo = f"{plain}, and run coroutines by run()" if program is None else f"{plain}, or await the coroutine here"
    raise UsageError(f"{called} needs an event loop of its own, and one runs here already: {todo}")


def run(main: Coroutine[Any, Any, _T], *, paced: bool = False, debug: bool | None = None) -> _T:
    """``asyncio.run`` in virtual time: runs ``main`` in a :class:`VirtualLoop` of its own.

    Raises UsageError inside a running event loop.
    """
    refuse_running_loop("run_virtual()", main)
    with asyncio.Runner(debug=debug, loop_factory=lambda: VirtualLoop(paced=paced)) as runner:
        return runner.run(main)
