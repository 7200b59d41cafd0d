"""Event loop of the bus process on select(): file descriptors, deadlines in nanoseconds, signals.

A wait has two parts. The loop sleeps and wakes up before the deadline by the lateness of nine of ten wake-ups. Then it
polls until the deadline, as far as the :class:`~dpstack.drivers.realtime.cpu_budget.Budget` allows. A poll costs 0.5
us. On a virtual machine a wake-up was 20 to 80 us late with a timer slack of 1 ns, and 90 to 120 us without it.
``select`` takes its timeout in microseconds and needs no timer. It is as precise as ``ppoll``; ``epoll`` has a grain of
1 ms.

The loop never polls for answers, however soon they are expected. Measured with polling, an exchange over a pty took as
long (70 us and more with 30 us at the other end) or, at p50, twice as long, and 1.5 times the processor time: the
kernel hands octets from the UART (or the pty) to the tty in a worker of ordinary priority, which cannot run on the
processor of a process that polls.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import sys
from collections import deque
from collections.abc import Callable, Iterable
from time import monotonic_ns, sleep
from typing import Final

from dpstack.drivers.line.timers import Lead
from dpstack.drivers.realtime.cpu_budget import Budget
from dpstack.errors import UsageError
from dpstack.text import traceback_text
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US

#: The loop wakes up this much before a deadline: first value, minimum, maximum. Nine of ten wake-ups are less late.
_LEAD_NS: Final = 40 * NS_PER_US
_LEAST_LEAD_NS: Final = 15 * NS_PER_US
_MOST_LEAD_NS: Final = 90 * NS_PER_US
_LEAD_STEP_NS: Final = NS_PER_US // 2

#: select's own limit (FD_SETSIZE); beyond it the loop sleeps in poll(), whose grain is 1 ms
_MOST_FDS: Final = 1024

_IN: Final = select.POLLIN

#: Called with a sentence and the exception of a callback.
Report = Callable[[str, Exception], None]


class Alarm:
    """Calls back once when its deadline is reached, never early; a :class:`dpstack.drivers.line.timers.Timer`."""

    __slots__ = ("_alarms", "at", "callback", "lasts")

    def __init__(self, alarms: list[Alarm], callback: Callable[[], object], at: int, *, lasts: bool) -> None:
        self._alarms = alarms
        self.callback = callback
        self.at = at
        self.lasts = lasts  # may be set again after the call
        alarms.append(self)

    def set(self, at: int) -> None:
        """Replace the deadline by ``at`` (CLOCK_MONOTONIC, ns)."""
        self.at = at

    def close(self) -> None:
        self.at = NEVER
        with contextlib.suppress(ValueError):
            self._alarms.remove(self)

    cancel = close  # the name of asyncio's handles

    def nap(self, until: int) -> None:
        """Let the thread sleep until ``until`` (CLOCK_MONOTONIC, ns). The loop does nothing meanwhile."""
        sleep(max(0, until - monotonic_ns()) / NS_PER_S)


class _Soon:
    __slots__ = ("callback",)

    def __init__(self, callback: Callable[[], object]) -> None:
        self.callback: Callable[[], object] | None = callback

    def cancel(self) -> None:
        self.callback = None


class SelectLoop:
    """Runs callbacks one at a time in the thread that calls :meth:`run`. A :class:`dpstack.ports.Loop`.

    Exceptions of callbacks go to ``report`` (default: a traceback on standard error); the loop goes on.
    """

    def __init__(self, *, report: Report | None = None, budget: Budget | None = None) -> None:
        self.report = _print if report is None else report
        self.budget = Budget() if budget is None else budget
        #: expected time of the next octets (ns), NEVER if it is unknown; for ``on_idle``
        self.expected_at = NEVER
        #: The loop does not wake up for the quiet descriptor (:meth:`set_quiet`) before this time (ns), and calls its
        #: reader then, whether there are octets or not. 0: it wakes up for all octets. A loop that is awake for another
        #: reason calls the reader sooner.
        self.quiet_until = 0
        #: called before the loop sleeps: with the time, and the time of the next deadline or expected octets (ns)
        self.on_idle: Callable[[int, int], object] | None = None
        self._readers: dict[int, Callable[[], object]] = {}
        self._writers: dict[int, Callable[[], object]] = {}
        self._read_fds: list[int] = []
        self._write_fds: list[int] = []
        self._quiet: tuple[tuple[int, int], ...] = ()  # the quiet descriptor, as if it were ready
        self._loud_fds: list[int] = []  # those to read, without the quiet one
        self._has_high_fd = False
        self._poll = select.poll()
        self._soon: deque[_Soon] = deque()
        self._alarms: list[Alarm] = []
        self._signals: dict[int, Callable[[], object]] = {}
        self._waker: tuple[socket.socket, socket.socket] | None = None
        self._lead = Lead(
            _LEAD_NS, least=_LEAST_LEAD_NS, most=_MOST_LEAD_NS, raised=9 * _LEAD_STEP_NS, lowered=_LEAD_STEP_NS
        )
        self._is_running = False
        self._stopping = False
        self._closed = False

    # --- as in asyncio ---
    def add_reader(self, fd: int, callback: Callable[[], object], /) -> None:
        """Call back whenever ``fd`` is readable or hung up. A second callback replaces the first."""
        self._readers[fd] = callback
        self._register(fd)

    def remove_reader(self, fd: int, /) -> bool:
        known = self._readers.pop(fd, None) is not None
        self._register(fd)
        return known

    def add_writer(self, fd: int, callback: Callable[[], object], /) -> None:
        """Call back whenever ``fd`` is writable."""
        self._writers[fd] = callback
        self._register(fd)

    def remove_writer(self, fd: int, /) -> bool:
        known = self._writers.pop(fd, None) is not None
        self._register(fd)
        return known

    def call_soon(self, callback: Callable[[], object], /) -> _Soon:
        """Call once, in the next turn."""
        soon = _Soon(callback)
        self._soon.append(soon)
        return soon

    def call_soon_threadsafe(self, callback: Callable[[], object], /) -> _Soon:
        """:meth:`call_soon` from another thread or a signal handler. Raises RuntimeError when the loop is closed."""
        if self._closed:
            raise RuntimeError("the loop is closed")
        waker, soon = self._waker, self.call_soon(callback)
        if waker is not None:
            try:
                waker[1].send(b"\0")
            except BlockingIOError:
                pass  # a wake-up is pending already
            except OSError:  # it was closed just now
                raise RuntimeError("the loop is closed") from None
        return soon

    def add_signal_handler(self, sig: int, callback: Callable[[], object]) -> None:
        """Call back after signal ``sig``. From the main thread only."""
        signal.set_wakeup_fd(self._waker_fd(), warn_on_full_buffer=False)
        self._signals[sig] = callback
        signal.signal(sig, self._signalled)

    def is_closed(self) -> bool:
        return self._closed

    # --- beyond asyncio ---
    def alarm(self, callback: Callable[[], object]) -> Alarm:
        """A deadline that can be set repeatedly; none is set yet."""
        return Alarm(self._alarms, callback, NEVER, lasts=True)

    def set_quiet(self, fd: int | None) -> None:
        """The descriptor that ``quiet_until`` is about."""
        self._quiet = () if fd is None else ((fd, _IN),)
        self._sort_out_loud()

    def call_at(self, at: int, callback: Callable[[], object]) -> Alarm:
        """Call once at ``at`` (CLOCK_MONOTONIC, ns)."""
        return Alarm(self._alarms, callback, at, lasts=False)

    def run(self) -> None:
        """Run until :meth:`stop`. May be called again."""
        if self._is_running or self._closed:
            raise UsageError("the loop is running already" if self._is_running else "the loop is closed")
        with contextlib.suppress(OSError):  # no descriptors left: another thread's call comes with the next deadline
            self._waker_fd()
        self._is_running = True
        self.budget.begin(monotonic_ns())
        try:
            while not self._stopping:
                self._turn()
        finally:
            self._is_running = self._stopping = False

    def stop(self) -> None:
        """Let :meth:`run` return after this turn; a loop that does not run yet: after its first one."""
        self._stopping = True

    def close(self) -> None:
        """Release the loop's own descriptors. Raises UsageError while it runs. May be called again."""
        if self._is_running:
            raise UsageError("the loop is running: stop it first")
        for sig in self._signals:
            signal.signal(sig, signal.SIG_DFL)
        if self._signals:
            signal.set_wakeup_fd(-1)
        self._signals.clear()
        self._closed = True
        self._soon.clear()
        self._alarms.clear()
        for fds in (self._readers, self._writers, self._read_fds, self._loud_fds, self._write_fds):
            fds.clear()
        self._poll = select.poll()
        bell, self._waker = self._waker, None
        if bell is not None:
            bell[0].close()
            bell[1].close()

    # --- one turn ---
    def _turn(self) -> None:
        if self._soon:
            self._run_soon()
        budget = self.budget
        now = monotonic_ns()
        if now >= budget.rest_at:
            sleep(budget.forced_sleep_ns(now) / NS_PER_S)
            woke = monotonic_ns()
            budget.slept(woke - now, woke)
            now = woke
        due = NEVER
        for alarm in self._alarms:
            if alarm.at < due:
                due = alarm.at
        if due <= now or self._soon or self._stopping:
            ready: Iterable[tuple[int, int]] = self._poll.poll(0)
        elif now < self.quiet_until < due and not self._has_high_fd:
            ready = self._sleep_quietly(now, self.quiet_until)
        else:
            ready = self._wait(now, due)
        for fd, event in ready:
            # A callback may remove another descriptor: look each one up.
            if event == _IN:
                if (callback := self._readers.get(fd)) is not None:
                    try:
                        callback()
                    except Exception as exc:
                        self._raised(exc)
            elif event & select.POLLNVAL:
                self._drop_closed()
            else:
                if event & ~select.POLLOUT and (callback := self._readers.get(fd)) is not None:
                    self._call(callback)
                if event & ~select.POLLIN and (callback := self._writers.get(fd)) is not None:
                    self._call(callback)
        now = monotonic_ns()
        if due <= now:
            self._sound(now)

    def _run_soon(self) -> None:
        soon = self._soon
        for _ in range(len(soon)):
            callback = soon.popleft().callback
            if callback is not None:
                self._call(callback)

    def _sound(self, now: int) -> None:
        for alarm in [alarm for alarm in self._alarms if alarm.at <= now]:
            if alarm.at > now:  # a callback has changed it meanwhile
                continue
            alarm.at = NEVER
            if not alarm.lasts:
                alarm.close()
            self._call(alarm.callback)

    def _call(self, callback: Callable[[], object]) -> None:
        try:
            callback()
        except Exception as exc:
            self._raised(exc)

    def _raised(self, exc: Exception) -> None:
        self.report("a callback raised", exc)

    def _wait(self, now: int, due: int) -> Iterable[tuple[int, int]]:
        """Wait until a descriptor is ready or ``due`` is reached; descriptors with their events."""
        budget, poll = self.budget, self._poll.poll
        if due - now <= self._lead.ns and budget.may_spin(now):
            begin = now
            until = min(due, now + budget.left_ns())
            ready: Iterable[tuple[int, int]] = ()
            while now < until and not ready:
                ready = poll(0)
                now = monotonic_ns()
            in_vain = not ready and now < due
            budget.spun(now - begin, now, in_vain=in_vain)
            if not in_vain:
                return ready
        return self._sleep(now, due)

    def _sleep(self, now: int, due: int) -> Iterable[tuple[int, int]]:
        """Sleep in the kernel; ends early enough to poll until ``due``."""
        if self.on_idle is not None:
            expected = self.expected_at
            self.on_idle(now, expected if now < expected < due else due)
            now = monotonic_ns()
        lead = self._lead
        target = due - lead.ns if due - lead.ns > now and self.budget.may_spin(due) else due
        ready, woke = self._select(self._read_fds, now, target)
        if woke >= target:
            lead.learn(woke - target)
        return ready

    def _sleep_quietly(self, now: int, until: int) -> Iterable[tuple[int, int]]:
        """Sleep without the quiet descriptor, which is to be read at ``until``."""
        if self.on_idle is not None:
            self.on_idle(now, until)
            now = monotonic_ns()
        ready, woke = self._select(self._loud_fds, now, until)
        if woke < until:
            return ready
        return [*ready, *self._quiet] if ready else self._quiet

    def _select(self, read_fds: list[int], now: int, until: int) -> tuple[Iterable[tuple[int, int]], int]:
        """Sleep until a descriptor is ready, up to ``until``; the descriptors with their events, and the time."""
        ready: Iterable[tuple[int, int]] = ()
        if self._has_high_fd:
            ready = self._poll.poll(None if until == NEVER else max(0, until - now) // NS_PER_MS)
        else:
            try:
                readable, writable, _ = select.select(
                    read_fds, self._write_fds, (), None if until == NEVER else max(0, until - now) / NS_PER_S
                )
            except OSError:
                self._drop_closed()
                return (), now
            if writable:
                ready = self._poll.poll(0)
            elif readable:
                ready = [(fd, _IN) for fd in readable]
        woke = monotonic_ns()
        self.budget.slept(woke - now, woke)
        return ready, woke

    # --- book-keeping ---
    def _register(self, fd: int) -> None:
        self._read_fds = list(self._readers)
        self._sort_out_loud()
        self._write_fds = list(self._writers)
        self._has_high_fd = max((*self._read_fds, *self._write_fds), default=0) >= _MOST_FDS
        events = (select.POLLIN if fd in self._readers else 0) | (select.POLLOUT if fd in self._writers else 0)
        if events:
            self._poll.register(fd, events)
        else:
            with contextlib.suppress(KeyError):
                self._poll.unregister(fd)

    def _sort_out_loud(self) -> None:
        self._loud_fds = [fd for fd in self._read_fds if (fd, _IN) not in self._quiet]

    def _drop_closed(self) -> None:
        """Remove descriptors that were closed without being removed, so that the others go on."""
        for fd in {*self._readers, *self._writers}:
            try:
                os.fstat(fd)
            except OSError as exc:
                self._readers.pop(fd, None)
                self._writers.pop(fd, None)
                self._register(fd)
                self.report(f"descriptor {fd} was closed without being removed", exc)

    def _waker_fd(self) -> int:
        """The write end of the socket pair that wakes the loop from another thread or a signal."""
        if self._waker is None:
            self._waker = socket.socketpair()
            for end in self._waker:
                end.setblocking(False)
            self.add_reader(self._waker[0].fileno(), self._on_waker)
        return self._waker[1].fileno()

    def _on_waker(self) -> None:
        if self._waker is not None:
            with contextlib.suppress(BlockingIOError):
                os.read(self._waker[0].fileno(), 4096)

    def _signalled(self, sig: int, _frame: object) -> None:
        callback = self._signals.get(sig)
        if callback is not None:
            self.call_soon(callback)


def _print(message: str, error: Exception) -> None:
    print(traceback_text(error), file=sys.stderr, flush=True)
