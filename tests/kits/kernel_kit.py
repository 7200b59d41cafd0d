"""The real-time drivers on a simulated kernel: every call costs a fixed time, sleeping jumps to the next event.

Octets arrive when the test says; whoever sleeps is woken up ``LATE_NS`` after what it slept for. So wake-ups can be
counted and times compared, whatever the computer that runs the test has to do. ``held_up`` keeps the processor from the
driver, at any place a test likes: the line goes on meanwhile. The time of the line is true; the driver's clock may
stand still, and is behind it from then on.
"""

from __future__ import annotations

import select
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any, Final

import pytest

from dpstack.drivers.line import asyncio_runtime, line_runtime, select_loop, select_runtime
from dpstack.drivers.line.asyncio_runtime import AsyncioRuntime
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.port_latency import Tune
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.select_runtime import SelectRuntime
from dpstack.machine import Machine
from dpstack.ports.fdport import FdPort
from dpstack.units import NEVER, NS_PER_MS

#: a wake-up comes so much after what was slept for
LATE_NS: Final = 35_000
#: looking at the clock, and every call of the system
TICK_NS: Final = 200
#: looking at a clock that stands still: fewer looks while a driver waits for it
STOPPED_TICK_NS: Final = 50_000
#: a number that no open file has
_LINE: Final = 1000


class Kernel:
    """Clock and line. ``far`` is told every write: octets and time. All times but the driver's clock are true ones."""

    def __init__(self) -> None:
        self.now = 1_000 * NS_PER_MS
        #: the driver's clock is behind the true time by so much
        self.behind = 0
        #: sleep of the computer, which its sleep clock counts
        self.asleep = 0
        #: begin and end of the time in which the driver's clock stands still next, while the driver runs
        self.clock_stops: tuple[int, int] = (NEVER, NEVER)
        self.coming: list[tuple[int, bytes]] = []
        self.written: list[tuple[int, bytes]] = []
        self.woken: list[int] = []  # when somebody who slept was woken up
        #: system calls by name; those of asyncio's loop ("epoll_wait", "epoll_ctl") and of its timer ("timerfd") too
        self.calls: Counter[str] = Counter()
        self.far: Callable[[bytes, int], None] = lambda _octets, _now: None
        #: told what was done ("clock", "octets" or "nothing" read, "write", "woken"): how long the driver stands still
        self.held_up: Callable[[str], int] = lambda _what: 0

    def clock(self) -> int:
        self.now += TICK_NS
        at = self.now - self.behind if self.now < self.clock_stops[0] else self._stopped_clock()
        self.now += self.held_up("clock")
        return at

    def _stopped_clock(self) -> int:
        begin, end = self.clock_stops
        if self.now < end:
            self.now += STOPPED_TICK_NS
            return begin - self.behind
        self.behind += end - begin
        self.clock_stops = (NEVER, NEVER)
        return self.now - self.behind

    def sleep_clock(self) -> int:
        """CLOCK_BOOTTIME: the driver's clock and the sleep of the computer."""
        return self.clock() + self.asleep

    def true_time(self, at: int) -> int:
        """The time at which the driver's clock will show ``at``."""
        if at == NEVER:
            return NEVER
        at += self.behind
        begin, end = self.clock_stops
        return at + end - begin if at > begin else at

    def true_end(self, timeout_ns: int) -> int:
        """The time at which ``timeout_ns`` from now is over by the driver's clock."""
        begin, end = self.clock_stops
        now = self.now if self.now < begin else max(begin, self.now - (end - begin))
        return self.true_time(now - self.behind + timeout_ns)

    def arrive(self, at: int, octets: bytes) -> None:
        self.coming.append((at, octets))
        self.coming.sort(key=lambda piece: piece[0])

    @property
    def readable(self) -> bool:
        return bool(self.coming) and self.coming[0][0] <= self.now

    def call(self, name: str, ticks: int = 1) -> None:
        """A system call, which takes its time."""
        self.calls[name] += 1
        self.now += ticks * TICK_NS

    def read(self, size: int) -> bytes:
        self.call("read")
        octets = b""
        while self.readable and len(octets) + len(self.coming[0][1]) <= size:
            octets += self.coming.pop(0)[1]
        self.now += self.held_up("octets" if octets else "nothing")
        if not octets:
            raise BlockingIOError
        return octets

    def write(self, octets: bytes) -> int:
        self.call("write", 10)
        self.written.append((self.now, octets))
        self.far(octets, self.now)
        self.now += self.held_up("write")
        return len(octets)

    def sleep(self, until: int, listening: bool) -> None:
        """Up to ``until`` or, for one who listens, up to when something is there."""
        if listening and self.coming:
            until = min(until, self.coming[0][0])
        if until > self.now:
            self.now = until + LATE_NS + self.held_up("woken")
            self.woken.append(self.now)

    def nap(self, until: int) -> None:
        """Up to ``until`` by the driver's clock, whatever arrives."""
        self.call("nap")
        self.sleep(self.true_time(until), listening=False)


class Line(FdPort):
    """The line as a port."""

    def __init__(self, kernel: Kernel, *, paced: bool, baud: int = 500_000) -> None:
        super().__init__("line", baud, paced=paced)
        self._kernel = kernel

    def open_now(self) -> None:
        self._fd = _LINE
        self._read, self._send = self._kernel.read, self._kernel.write

    def _close_fd(self, fd: int) -> None:
        """The number belongs to no open file."""


class _Select:
    """The part of the module ``select`` that the plain loop uses."""

    POLLIN, POLLOUT, POLLNVAL = select.POLLIN, select.POLLOUT, select.POLLNVAL

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel

    def select(
        self, readers: list[int], _writers: object, _errors: object, timeout: float | None
    ) -> tuple[list[int], list[int], list[int]]:
        kernel = self._kernel
        kernel.call("select")
        until = NEVER if timeout is None else kernel.true_end(round(timeout * 1e6) * 1000)
        kernel.sleep(until, _LINE in readers)
        return ([_LINE] if _LINE in readers and kernel.readable else []), [], []

    def poll(self) -> _Poll:
        return _Poll(self._kernel)


class _Poll:
    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._fds: set[int] = set()

    def register(self, fd: int, _events: int) -> None:
        self._fds.add(fd)

    def unregister(self, fd: int) -> None:
        self._fds.discard(fd)

    def poll(self, _timeout: int) -> Iterable[tuple[int, int]]:
        self._kernel.call("poll")
        return [(_LINE, select.POLLIN)] if _LINE in self._fds and self._kernel.readable else []


class _Soon:
    def __init__(self, callback: Callable[[], object]) -> None:
        self.callback: Callable[[], object] | None = callback

    def cancel(self) -> None:
        self.callback = None


class _Asyncio:
    """The part of an asyncio loop that ports and drivers use, and its timer."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._reader: Callable[[], object] | None = None
        self._soon: list[_Soon] = []
        self._at = NEVER
        self._due: Callable[[], None] = lambda: None
        self.stopping = False
        #: the timer calls so much too early
        self.early_ns = 0

    def add_reader(self, _fd: int, callback: Callable[[], object], /) -> None:
        self._kernel.call("epoll_ctl")
        self._reader = callback

    def remove_reader(self, _fd: int, /) -> None:
        self._kernel.call("epoll_ctl")
        self._reader = None

    def call_soon(self, callback: Callable[[], object], /) -> _Soon:
        self._soon.append(_Soon(callback))
        return self._soon[-1]

    call_soon_threadsafe = call_soon

    def is_closed(self) -> bool:
        return False

    def timer(self, due: Callable[[], None]) -> _Asyncio:
        self._due = due
        return self

    def stop(self) -> None:
        self.stopping = True

    def set(self, at: int) -> None:
        self._kernel.call("timerfd")
        self._at = at

    def nap(self, until: int) -> None:
        self._kernel.nap(until)

    def close(self) -> None:
        self._at = NEVER

    def run(self, until: int) -> None:
        kernel = self._kernel
        self.stopping = False
        while kernel.now < until and not self.stopping:
            soon, self._soon = self._soon, []
            for call in soon:
                if call.callback is not None:
                    call.callback()
            at = kernel.true_time(self._at - self.early_ns if self._at != NEVER else NEVER)
            kernel.calls["epoll_wait"] += 1
            kernel.sleep(kernel.now if self._soon else min(at, until), self._reader is not None)
            if self._reader is not None and kernel.readable:
                self._reader()
            if self._at != NEVER and kernel.true_time(self._at - self.early_ns) <= kernel.now:
                self._at = NEVER
                self._due()


def held_up_at(pauses: Mapping[tuple[str, int], int], every: tuple[str, int] = ("", 0)) -> Callable[[str], int]:
    """For ``Kernel.held_up``: the driver stands still for so many ms at these calls (kind, number from 1 on), and at
    ``every`` call of one kind."""
    calls: Counter[str] = Counter()

    def held_up(done: str) -> int:
        calls[done] += 1
        usual = every[1] if done == every[0] else 0
        return pauses.get((done, calls[done]), usual) * NS_PER_MS

    return held_up


class Driven:
    """``machine`` on the line of ``kernel`` with one of the drivers, ``asyncio`` or ``plain``."""

    def __init__(
        self,
        kind: str,
        machine: Machine,
        kernel: Kernel,
        patch: pytest.MonkeyPatch,
        *,
        paced: bool = False,
        early_ns: int = 0,
        echo: Echo = Echo.OFF,
        tune: Tune | None = None,
    ) -> None:
        self.kernel = kernel
        self.events: list[Any] = []
        self._loop: SelectLoop | None = None
        port = Line(kernel, paced=paced, baud=machine.baud)
        for module in (line_runtime, asyncio_runtime, select_runtime, select_loop):
            patch.setattr(module, "monotonic_ns", kernel.clock)
        for clock, shown in (("boottime_ns", kernel.sleep_clock), ("suspended_ns", lambda: kernel.asleep)):
            patch.setattr(line_runtime, clock, shown)
        port.open_now()
        options: dict[str, Any] = {"echo": echo, "tune": tune}
        if kind == "asyncio":
            asyncio_loop = _Asyncio(kernel)
            asyncio_loop.early_ns = early_ns
            runtime: Any = AsyncioRuntime(port, machine, self.events.extend, **options)
            runtime._begin(asyncio_loop, asyncio_loop.timer(runtime._timer_due))
            self._run = asyncio_loop.run
            self.stop = asyncio_loop.stop
        else:
            patch.setattr(select_loop, "select", _Select(kernel))
            patch.setattr(select_loop.Alarm, "nap", lambda _alarm, until: kernel.nap(until))
            self._loop = loop = SelectLoop()
            runtime = SelectRuntime(port, machine, self.events.extend, **options)
            runtime.open(loop)
            self._run = partial(_run_plain, loop, kernel)
            self.stop = loop.stop
        self.runtime = runtime
        self.port = port

    def run(self, until: int) -> None:
        """Up to the true time ``until``, or :meth:`stop`; not so far where the driver's clock stood still meanwhile."""
        self._run(until)

    def close(self) -> None:
        self.runtime._halt()
        self.runtime._end(False)
        if self._loop is not None:
            self._loop.close()


def _run_plain(loop: SelectLoop, kernel: Kernel, until: int) -> None:
    alarm = loop.call_at(until - kernel.behind, loop.stop)
    loop.run()
    alarm.close()
