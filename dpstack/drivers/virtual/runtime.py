"""The virtual driver: one station of a simulated bus, driven by the application's event loop.

In a :class:`~dpstack.drivers.virtual.loop.VirtualLoop` the world's time is the loop's, exactly. In an ordinary loop the
world is held back to real time: a timer runs it up to the real time elapsed, in bounded portions. Where the
machine cannot keep up virtual time falls behind; it never skips.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from time import monotonic_ns
from typing import Final, Protocol

from dpstack.drivers.futures import carried_out
from dpstack.drivers.line.port_latency import Lateness
from dpstack.drivers.runtime import IN_PARENT, BehindRealTime, OnEvents
from dpstack.drivers.virtual.loop import Timeline, VirtualLoop
from dpstack.errors import BusError, UsageError
from dpstack.fdl.interface import BusStation
from dpstack.trace import Event
from dpstack.units import NEVER, NS_PER_MS, NS_PER_S, ns_to_s

#: Told when a machine raised: a defect of ours, the world stands still.
OnFailure = Callable[[Exception], None]

#: In an ordinary loop: the shortest and the longest pause between two portions, and how long a portion computes.
_TICK_NS: Final = NS_PER_MS
_LONG_TICK_NS: Final = 10 * NS_PER_MS
_PORTION_NS: Final = 4 * NS_PER_MS
#: Later than this is not caught up any more.
_DEBT_NS: Final = 50 * NS_PER_MS
_EVENTS_PER_LOOK: Final = 16
#: A bus whose time goes slower than this part of real time falls behind; above the other one it keeps up again.
_SLOW: Final = 0.9
_KEEPS_UP: Final = 0.97
#: Told again when the speed has changed by this factor.
_MUCH: Final = 2


class SimulatedBus(Timeline, Protocol):
    """What the driver needs of a world (:class:`dpstack.sim.world.World` is one)."""

    def add(
        self, station: BusStation, *, name: str | None = None, on_events: Callable[[list[Event]], None] | None = None
    ) -> None:
        """Plug ``station`` in."""

    def remove(self, station: BusStation) -> None:
        """Unplug ``station``."""

    def command(self, station: BusStation, command: object) -> None:
        """Hand ``command`` to the station and let it act."""


class VirtualRuntime:
    """Keeps ``station`` running on ``world``; implements :class:`dpstack.drivers.runtime.Runtime`.

    Several runtimes may share one world. When a machine of the world raises, which it never should, the world stands
    still and ``on_failure`` is told (without one: the loop's exception handler; a VirtualLoop raises it).
    """

    #: octets take their time on the virtual wire
    paced = True

    def __init__(
        self,
        world: SimulatedBus,
        station: BusStation,
        on_events: OnEvents,
        *,
        on_failure: OnFailure | None = None,
        port_name: str = "virtual",
    ) -> None:
        self.port_name = port_name
        #: nothing is late in virtual time
        self.lateness = Lateness()
        self.on_failure = on_failure
        self._world = world
        self._station = station
        self._on_events = on_events
        self._clockwork: _Clockwork | None = None
        self._forsaken = False
        self._behind_at_open_ns = 0
        self._behind_ns = 0  # of a bus that was closed

    @property
    def not_running(self) -> str | None:
        """That a defect stopped the simulated bus, or that it was forked away from; None when it runs."""
        if self._forsaken:
            return IN_PARENT
        failed = self._clockwork is not None and self._clockwork.failed
        return "the simulated bus was stopped by a defect in dpstack" if failed else None

    @property
    def behind_ns(self) -> int:
        """How far the bus's time has fallen behind real time since the opening (ns); 0 where it is not held to it."""
        clockwork = self._clockwork
        return self._behind_ns if clockwork is None else clockwork.behind_ns - self._behind_at_open_ns

    async def hand_over_outputs(self) -> None:
        """The machine has them as soon as they are set."""

    def order(self, command: object) -> asyncio.Future[object]:
        """:meth:`command`, which carries it out at once."""
        return carried_out(partial(self.command, command))

    def damage(self) -> dict[str, int]:
        """A medium in virtual time tells every octet as it is; the decoder's counters are all there is."""
        return {}

    async def open(self) -> None:
        """Plug the station in; from now on the world's time goes. Raises UsageError when it is open."""
        if self._clockwork is not None:
            raise UsageError(f"{self.port_name} is open already")
        clockwork = _clockwork(self._world, asyncio.get_running_loop())
        self._world.add(self._station, on_events=self._tell)
        self._clockwork = _clockworks[self._world] = clockwork
        clockwork.join(self)
        self._behind_at_open_ns = clockwork.behind_ns

    async def close(self) -> None:
        """Unplug the station; with the last one the world stands still."""
        clockwork = self._clockwork
        if clockwork is not None:
            self._behind_ns = self.behind_ns
            self._clockwork = None
            self._world.remove(self._station)
            clockwork.leave(self)

    #: nothing is waited for
    close_limit_ns = 0

    def end_without_loop(self) -> str:
        """The world stands still with its loop: nobody real has outputs."""
        return ""

    def forsake(self) -> None:
        """Both processes have a world of their own now; the child's stands still."""
        self._clockwork = None
        self._forsaken = True

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

    def tell(self, event: Event) -> None:
        """Hand an event of the clockwork to the application."""
        self._tell([event])

    def _tell(self, events: list[Event]) -> None:
        try:
            self._on_events(events)
        except Exception as exc:
            text = f"{self.port_name}: the application's event handler raised"
            asyncio.get_running_loop().call_exception_handler({"message": text, "exception": exc})


class Pace:
    """Compares bus time with real time, both in ns; begins at ``real`` and ``bus``."""

    def __init__(self, real: int, bus: int) -> None:
        self._start = self._window = (real, bus)
        self._told: float | None = None  # bus time by real time, as told last; None: it keeps up

    def behind_ns(self, real: int, bus: int) -> int:
        """In all."""
        return max(0, (real - self._start[0]) - (bus - self._start[1]))

    def look(self, real: int, bus: int) -> BehindRealTime | None:
        """What is to be told, judged once a second: that it falls behind, anew at another speed, that it keeps up."""
        real_ns, bus_ns = real - self._window[0], bus - self._window[1]
        if real_ns < NS_PER_S:
            return None
        self._window = (real, bus)
        speed, told = bus_ns / real_ns, self._told
        if speed < _SLOW:
            if told is not None and told / _MUCH < speed < told * _MUCH:
                return None
            self._told = speed
        elif told is None or speed < _KEEPS_UP:
            return None
        else:
            self._told = None
        behind_ns = self.behind_ns(real, bus)
        return BehindRealTime(
            t_ns=bus, bus_ns=bus_ns, real_ns=real_ns, behind_ns=behind_ns, keeps_up=self._told is None
        )


class _Clockwork:
    """Makes the time of one world go, for all runtimes on it. A Timeline itself."""

    def __init__(self, world: SimulatedBus, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self._world = world
        self._users: list[VirtualRuntime] = []
        self._pace: Pace | None = None  # where bus time is held to real time
        self.failed = False
        self._timer: asyncio.TimerHandle | None = None
        self._resting = False  # the timer is a long one
        self._origin_ns = 0  # real minus virtual time
        self._events = 0
        self._until_ns = 0

    # --- who uses it ---
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
        """There may be something to do earlier than it seemed."""
        if self._resting and self._timer is not None:
            self._timer.cancel()
            self._set_timer(_TICK_NS)

    @property
    def behind_ns(self) -> int:
        """How far bus time is behind real time since the first runtime joined."""
        return 0 if self._pace is None else self._pace.behind_ns(monotonic_ns(), self.now)

    def _look(self) -> None:
        event = None if self._pace is None else self._pace.look(monotonic_ns(), self.now)
        if event is not None:
            for user in tuple(self._users):
                user.tell(event)

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
            told = [user.on_failure for user in self._users if user.on_failure is not None]
            if not told and isinstance(self.loop, VirtualLoop):
                raise
            for on_failure in told:
                on_failure(exc)
            if not told:
                self.loop.call_exception_handler({"message": "the simulated bus stands still", "exception": exc})
            return True
        self._look()
        return stopped

    # --- in an ordinary loop ---
    def _tick(self) -> None:
        real = monotonic_ns()
        if real - self._origin_ns - self.now > _DEBT_NS:
            self._origin_ns = real - self.now - _DEBT_NS
        self._until_ns = real + _PORTION_NS
        self._events = 0
        stopped = self.run(max(self.now, real - self._origin_ns), self._enough)
        if self.failed or not self._users:
            return
        pause = 0 if stopped else min(max(self.next_at() - self.now, _TICK_NS), _LONG_TICK_NS)
        self._set_timer(pause)

    def _set_timer(self, pause_ns: int) -> None:
        self._resting = pause_ns > _TICK_NS
        self._timer = self.loop.call_later(ns_to_s(pause_ns), self._tick)

    def _enough(self) -> bool:
        self._events += 1
        return self._events % _EVENTS_PER_LOOK == 0 and monotonic_ns() > self._until_ns


#: worlds that are going
_clockworks: dict[SimulatedBus, _Clockwork] = {}


def _clockwork(world: SimulatedBus, loop: asyncio.AbstractEventLoop) -> _Clockwork:
    clockwork = _clockworks.get(world)
    if clockwork is None or clockwork.loop.is_closed():
        return _Clockwork(world, loop)
    if clockwork.loop is not loop:
        raise UsageError("this simulated bus is driven by another event loop already: close its runtimes there first")
    return clockwork
