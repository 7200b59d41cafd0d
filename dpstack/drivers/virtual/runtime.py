"""The virtual driver: one station of a simulated bus, driven by the application's event loop.

In a :class:`~dpstack.drivers.virtual.loop.VirtualLoop` the bus has exactly the loop's time. In an ordinary loop a timer
runs the bus up to the real time elapsed, in bounded portions. On a computer that is too slow bus time falls behind; it
never skips.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from time import monotonic_ns
from typing import Final

from dpstack.drivers.futures import ActsAtOnce
from dpstack.drivers.line.port_latency import PortLatency
from dpstack.drivers.runtime import IN_PARENT, BehindRealTime, OnEvents, OnFailure
from dpstack.drivers.tap import Tap, TapStation
from dpstack.drivers.virtual.loop import DEBT_NS, VirtualLoop
from dpstack.errors import BusError, UsageError
from dpstack.fdl.interface import BusStation
from dpstack.sim.world import World
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, ns_to_s

#: In an ordinary loop: shortest and longest pause between two portions, and the computing time of a portion.
_TICK_NS: Final = NS_PER_MS
_LONG_TICK_NS: Final = 10 * NS_PER_MS
_PORTION_NS: Final = 4 * NS_PER_MS
_EVENTS_PER_LOOK: Final = 16
#: Bus time by real time: below _SLOW the bus falls behind, above _KEEPS_UP it keeps up again.
_SLOW: Final = 0.9
_KEEPS_UP: Final = 0.97
#: The driver reports a change of the speed by this factor.
_MUCH: Final = 2


class VirtualRuntime(ActsAtOnce):
    """Keeps ``station`` running on ``world``; implements :class:`dpstack.drivers.runtime.Runtime`.

    Several runtimes may share one world. An exception of a machine is a defect: the world stands still and
    ``on_failure`` is called (without one: the loop's exception handler; a VirtualLoop raises it).
    """

    port_name = "virtual"
    #: octets take their time on the virtual wire
    paced = True

    def __init__(
        self,
        world: World,
        station: BusStation,
        on_events: OnEvents,
        *,
        on_failure: OnFailure | None = None,
    ) -> None:
        #: stays empty: no latency in virtual time
        self.lateness = PortLatency()
        self.on_failure = on_failure
        self._world = world
        self._station = station
        self._on_events = on_events
        self._clockwork: _Clockwork | None = None
        self._in_child = False
        self._tap: Tap | None = None
        self._ear: TapStation | None = None  # fills the tap
        self._behind_at_open_ns = 0
        self._behind_ns = 0  # at the closing

    @property
    def not_running(self) -> str | None:
        if self._in_child:
            return IN_PARENT
        failed = self._clockwork is not None and self._clockwork.failed
        return "the simulated bus was stopped by a defect in dpstack" if failed else None

    @property
    def pid(self) -> int | None:
        return None

    @property
    def behind_ns(self) -> int:
        """How far bus time has fallen behind real time since the opening (ns); 0 in unpaced virtual time."""
        clockwork = self._clockwork
        return self._behind_ns if clockwork is None else clockwork.behind_ns - self._behind_at_open_ns

    def damage(self) -> dict[str, int]:
        """Empty: only the decoder counts damaged octets in virtual time."""
        return {}

    async def open(self) -> None:
        """Plug the station in and start the world's time. Raises UsageError when it is open."""
        if self._clockwork is not None:
            raise UsageError(f"{self.port_name} is open already")
        clockwork = _clockwork(self._world, asyncio.get_running_loop())
        self._world.add(self._station, on_events=self.emit)
        self._clockwork = _clockworks[self._world] = clockwork
        self.tap(self._tap)
        clockwork.join(self)
        self._behind_at_open_ns = clockwork.behind_ns

    async def close(self) -> None:
        """Unplug the station; without stations the world stands still."""
        clockwork = self._clockwork
        if clockwork is not None:
            self._behind_ns = self.behind_ns
            self._clockwork = None
            self.tap(self._tap)
            self._world.remove(self._station)
            clockwork.leave(self)

    #: close() does not wait
    close_limit_ns = 0
    #: simulated slaves need no Clear
    cleared = False
    mode_before_silence = None

    def end_without_loop(self) -> str:
        """Empty: the world stands still with its loop, and no real slave has outputs."""
        return ""

    def release_after_fork(self) -> None:
        """In the child of a fork: its copy of the world stands still."""
        self._clockwork = None
        self._in_child = True

    def command(self, command: object) -> None:
        """Hand an order to the station and let it act at once. Raises UsageError when not open, BusError when a defect
        has stopped the bus."""
        if self._clockwork is None:
            raise UsageError(f"{self.port_name} is not open")
        if self._clockwork.failed:
            raise BusError("the simulated bus was stopped by a defect")
        self._world.command(self._station, command)
        self._clockwork.hurry()

    def now(self) -> int:
        """The world's time in ns."""
        return self._world.now

    def tap(self, tap: Tap | None) -> None:
        """A station that only listens copies the octets of the simulated wire while this runtime is open. Without a
        tap nothing is copied."""
        self._tap = tap
        ear, self._ear = self._ear, None
        if ear is not None:
            self._world.remove(ear)
        if tap is not None and self._clockwork is not None:
            self._ear = TapStation(self._station, tap)
            self._world.add(self._ear, name="tap")

    def emit(self, events: list[Event]) -> None:
        """Call the application's event handler; the loop reports its exceptions."""
        try:
            self._on_events(events)
        except Exception as exc:
            text = f"{self.port_name}: the application's event handler raised"
            asyncio.get_running_loop().call_exception_handler({"message": text, "exception": exc})


class Pace:
    """Compares bus time with real time, both in ns; begins at ``real`` and ``bus``."""

    def __init__(self, real: int, bus: int) -> None:
        self._start = self._window = (real, bus)
        self._reported: float | None = None  # bus time by real time as last reported; None: it keeps up

    def behind_ns(self, real: int, bus: int) -> int:
        return max(0, (real - self._start[0]) - (bus - self._start[1]))

    def event_at(self, real: int, bus: int) -> BehindRealTime | None:
        """The event to be reported, if any, at most once a second: falls behind, another speed, keeps up again."""
        real_ns, bus_ns = real - self._window[0], bus - self._window[1]
        if real_ns < NS_PER_S:
            return None
        self._window = (real, bus)
        speed, reported = bus_ns / real_ns, self._reported
        if speed < _SLOW:
            if reported is not None and reported / _MUCH < speed < reported * _MUCH:
                return None
            self._reported = speed
        elif reported is None or speed < _KEEPS_UP:
            return None
        else:
            self._reported = None
        behind_ns = self.behind_ns(real, bus)
        return BehindRealTime(
            t_ns=bus, bus_ns=bus_ns, real_ns=real_ns, behind_ns=behind_ns, keeps_up=self._reported is None
        )


class _Clockwork:
    """Advances the time of one world for all runtimes on it; itself a Timeline."""

    def __init__(self, world: World, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._world = world
        self._users: list[VirtualRuntime] = []
        self._pace: Pace | None = None  # if bus time is paced by real time
        self.failed = False
        self._timer: asyncio.TimerHandle | None = None
        self._resting = False  # the timer is a long one
        self._origin_ns = 0  # real minus virtual time
        self._events = 0
        self._until_ns = 0

    # --- its runtimes ---
    def join(self, user: VirtualRuntime) -> None:
        self._users.append(user)
        if len(self._users) > 1:
            return
        if not isinstance(self.loop, VirtualLoop) or self.loop.paced:
            self._pace = Pace(monotonic_ns(), self.now)
        if isinstance(self.loop, VirtualLoop):
            self.loop.attach(self)
        else:
            self._origin_ns = monotonic_ns() - self.now
            self._set_timer(_TICK_NS)

    def leave(self, user: VirtualRuntime) -> None:
        self._users.remove(user)
        if self._users:
            return
        del _clockworks[self._world]
        if isinstance(self.loop, VirtualLoop):
            self.loop.detach(self)
        elif self._timer is not None:
            self._timer.cancel()

    def hurry(self) -> None:
        """Shorten a long pause: a command may have made an earlier event."""
        if self._resting and self._timer is not None:
            self._timer.cancel()
            self._set_timer(_TICK_NS)

    @property
    def behind_ns(self) -> int:
        """How far bus time is behind real time since the first runtime joined."""
        return 0 if self._pace is None else self._pace.behind_ns(monotonic_ns(), self.now)

    def _report_pace(self, pace: Pace) -> None:
        event = pace.event_at(monotonic_ns(), self.now)
        if event is not None:
            for user in tuple(self._users):
                user.emit([event])

    # --- Timeline ---
    @property
    def now(self) -> int:
        return self._world.now

    def next_at(self) -> int:
        return NEVER if self.failed else self._world.next_at()

    def run(self, until_ns: int, stop: Callable[[], bool]) -> bool:
        if self.failed:
            return False
        try:
            stopped = self._world.run(until_ns, stop)
        except Exception as exc:
            self.failed = True
            handlers = [user.on_failure for user in self._users if user.on_failure is not None]
            if not handlers and isinstance(self.loop, VirtualLoop):
                raise
            for on_failure in handlers:
                on_failure(exc)
            if not handlers:
                self.loop.call_exception_handler({"message": "the simulated bus stands still", "exception": exc})
            return True
        if self._pace is not None:
            self._report_pace(self._pace)
        return stopped

    # --- in an ordinary loop ---
    def _tick(self) -> None:
        real = monotonic_ns()
        if real - self._origin_ns - self.now > DEBT_NS:
            self._origin_ns = real - self.now - DEBT_NS
        self._until_ns = real + _PORTION_NS
        self._events = 0
        stopped = self.run(max(self.now, real - self._origin_ns), self._portion_is_over)
        if self.failed or not self._users:
            return
        pause = 0 if stopped else min(max(self.next_at() - self.now, _TICK_NS), _LONG_TICK_NS)
        self._set_timer(pause)

    def _set_timer(self, pause_ns: int) -> None:
        self._resting = pause_ns > _TICK_NS
        self._timer = self.loop.call_later(ns_to_s(pause_ns), self._tick)

    def _portion_is_over(self) -> bool:
        self._events += 1
        return self._events % _EVENTS_PER_LOOK == 0 and monotonic_ns() > self._until_ns


#: worlds whose time goes
_clockworks: dict[World, _Clockwork] = {}


def _clockwork(world: World, loop: asyncio.AbstractEventLoop) -> _Clockwork:
    clockwork = _clockworks.get(world)
    if clockwork is None or clockwork.loop.is_closed():
        return _Clockwork(world, loop)
    if clockwork.loop is not loop:
        raise UsageError("this simulated bus is driven by another event loop already: close its runtimes there first")
    return clockwork
