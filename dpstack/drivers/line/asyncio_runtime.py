"""The asyncio driver: runs one protocol machine on one serial port inside the application's event loop."""

from __future__ import annotations

import asyncio
from time import monotonic_ns
from typing import Final

from dpstack.dp.master.commands import Shutdown
from dpstack.drivers.futures import ActsAtOnce, wait_through_cancellation
from dpstack.drivers.line.echo import Echo
from dpstack.drivers.line.last_clear import why_not_alone
from dpstack.drivers.line.line_runtime import LineRuntime
from dpstack.drivers.line.rate import ReopenAttempts
from dpstack.drivers.line.select_loop import SelectLoop
from dpstack.drivers.line.select_runtime import SelectRuntime
from dpstack.drivers.line.shutdown import Ending, EndOrder
from dpstack.drivers.line.timers import make_timer
from dpstack.drivers.runtime import IN_PARENT, stopped_by
from dpstack.errors import PortError
from dpstack.fdl.active.station import ActiveStation
from dpstack.ports import Port
from dpstack.units import NEVER, NS_PER_S, NS_PER_US

#: Naps for the rest of an answer that was not complete after a sleep. Each lasts some 20 us longer: wake-ups are late.
_REST_NAP_NS: Final = 30 * NS_PER_US
_REST_NAPS: Final = 2


class AsyncioRuntime(LineRuntime, ActsAtOnce):
    """:class:`LineRuntime` in the running asyncio loop; implements :class:`dpstack.drivers.runtime.Runtime`."""

    blocked_by = "the program did not let its event loop run, or was stopped,"
    _loop: asyncio.AbstractEventLoop | None = None  # set by open()
    _paused = False  # the port delivers nothing
    _sleep_until = 0  # until this time, which the timer ends; 0 while the loop is awake
    _reopening: asyncio.Task[None] | None = None
    _left: str | None = None  # why it no longer runs although it was not closed
    #: a real bus cannot fall behind real time
    behind_ns = 0

    @property
    def not_running(self) -> str | None:
        if self._left is not None:
            return self._left
        return None if self.failed is None else f"the bus was stopped by {stopped_by(self.failed)}"

    async def open(self) -> None:
        """Open the port and begin. Raises PortError; ConfigError when the port knows none of the machine's rates."""
        self._check_openable()
        await self._port.open()
        self._loop = loop = asyncio.get_running_loop()
        self._begin(loop, make_timer(loop, self._timer_due))

    async def close(self) -> None:
        """Stop, release the port and dispatch the machine's last events. May be called again."""
        was_open = self._at is not None
        self._halt()
        task, self._reopening = self._reopening, None
        try:
            if task is not None:
                task.cancel()
                await wait_through_cancellation(task)
        finally:
            self._end(was_open)

    #: close() cancels an opening that is under way
    close_limit_ns = 0

    def end_without_loop(self) -> str:
        """For a loop that was closed or never runs again: this thread ends the bus, see :func:`end_on_port`."""
        port, station = self._port, self._machine
        lost = self._at is None or self._attempts is not None or self.failed is not None
        self._reopening = None
        self._halt()
        why = "its port is lost"
        try:
            if isinstance(station, ActiveStation) and not lost:
                why = end_on_port(port, station, self.echo)
        except Exception as exc:  # at the end of an interpreter anything may be missing
            why = f"{type(exc).__name__}: {exc}"
        finally:
            port.close()
        self._left = why or None
        return why

    def release_after_fork(self) -> None:
        self._left = IN_PARENT
        super().release_after_fork()

    def _expect(self, at: int, sleep_until: int) -> None:
        if sleep_until:
            if not self._paused and not self._port.pause_reading(True):
                return
            sleep_until += self._early_ns  # by which the timer is set early: nothing is left to spin here
            self._paused = True
            if sleep_until < self._armed:
                self._arm(sleep_until)
        elif self._paused:
            self._resume_reading()
        self._sleep_until = sleep_until

    def _resume_reading(self) -> None:
        self._paused = False
        self._port.pause_reading(False)

    def _timer_due(self) -> None:
        sleep_until = self._sleep_until
        if not sleep_until:
            super()._timer_due()
            return
        try:
            deadline = self._deadline
            until = sleep_until if sleep_until < deadline else deadline
            if until - monotonic_ns() > self._early_ns:
                self._arm(until)
            elif until != deadline:
                self._read_after_sleep()
            else:
                super()._timer_due()
                if self._sleep_until and self._sleep_until < self._armed:
                    self._arm(self._sleep_until)
        except Exception as exc:  # above all MemoryError: the timer is not armed again
            self._fail(exc)

    def _read_after_sleep(self) -> None:
        """The answer should be there. A complete one leads to the next request, and often to the next sleep: only
        if it does not, nor within some naps, the loop is set to wake up for octets again, which costs a system call
        both ways and 80 us."""
        self._armed = NEVER  # before the step, which may arm it again
        self._sleep_until = 0
        try:
            self._step(self._drain())
            if self._kept:
                self._nap_for_rest()
        finally:
            if self._paused and not self._sleep_until:
                self._resume_reading()

    def _nap_for_rest(self) -> None:
        for _ in range(_REST_NAPS):
            if self._timer is None:
                return
            self._timer.nap(monotonic_ns() + _REST_NAP_NS)
            if chunk := self._drain():
                self._step(chunk)
                if not self._kept:
                    return
        kept, self._kept = self._kept, b""
        self._step(kept)

    def _keep(self, chunk: bytes) -> None:
        if self._paused:  # the sleep ends in naps for the rest: no timer
            self._kept = chunk
        else:
            super()._keep(chunk)

    def _count_spinning(self, spun_ns: int, now: int) -> None:
        """Spinning is limited only in a process with real-time priority."""

    def _begin_reopening(self, attempts: ReopenAttempts) -> None:
        if self._loop is not None:
            self._reopening = self._loop.create_task(self._reopen(attempts))

    async def _reopen(self, attempts: ReopenAttempts) -> None:
        while True:
            await asyncio.sleep(attempts.pause_ns() / NS_PER_S)
            try:
                await self._port.open()
                break
            except PortError as exc:
                self._reopening_refused(attempts, exc)
            except Exception as exc:
                self._fail(exc)
                return
        self._reopening = None
        self._reopened(attempts)

    def _report(self, message: str, error: Exception) -> None:
        if self._loop is not None:
            self._loop.call_exception_handler({"message": message, "exception": error})


def end_on_port(port: Port, station: ActiveStation, echo: Echo) -> str:
    """The hurried end of ``station`` on the open ``port`` in this thread, when its event loop can no longer run.

    Returns why safe values and Clear could not be sent; empty after success. ``port`` is detached. The station sends
    only when it is alone in the ring: on a bus with another master, or with octets of another station within T_TO, it
    sends nothing.
    """
    why_not = why_not_alone(port, station)
    if why_not:
        return why_not
    loop = SelectLoop()
    runtime = SelectRuntime(port, station, lambda events: ending.on_events(events), echo=echo)

    def give(order: EndOrder) -> None:
        if isinstance(order, Shutdown):  # before the first step, which might find that the token was lost long ago
            runtime.take_over(loop, order)
        else:
            runtime.command(order)

    ending = Ending(loop, give, station, lambda: NS_PER_S, lambda _why: loop.stop())
    ending.steps.hurry(monotonic_ns())
    try:
        ending.begin("")
        loop.run()
    finally:
        runtime.close()
        loop.close()
    return "" if ending.steps.cleared else "the bus did not take them in time"
