"""The asyncio driver: one machine on one port, inside the application's event loop."""

from __future__ import annotations

import asyncio
from functools import partial
from time import monotonic_ns

from dpstack.drivers.futures import carried_out, outlast
from dpstack.drivers.line.line_runtime import SPIN_NS, Stepping
from dpstack.drivers.line.port_latency import patience_of
from dpstack.drivers.line.rate import Attempts
from dpstack.drivers.line.timers import make_timer
from dpstack.drivers.runtime import IN_PARENT, OnFailure
from dpstack.drivers.shutdown import end_on_port
from dpstack.errors import PortError
from dpstack.fdl.active.station import ActiveStation
from dpstack.units import NEVER, NS_PER_S

__all__ = ["SPIN_NS", "AsyncioRuntime", "OnFailure", "patience_of"]


class AsyncioRuntime(Stepping):
    """:class:`Stepping` in the running asyncio loop; implements :class:`dpstack.drivers.runtime.Runtime`."""

    blocked_by = "the program did not let its event loop run, or was stopped,"
    _loop: asyncio.AbstractEventLoop | None = None  # of the last open
    _quiet_until = 0  # until then the port hands nothing over; the timer waits for it, or for something sooner
    _reopening: asyncio.Task[None] | None = None
    _left: str | None = None  # why nobody runs it any more, though it was not closed

    @property
    def not_running(self) -> str | None:
        """The defect that stopped it, or why it was left; None when there was none."""
        if self._left is not None:
            return self._left
        return None if self.failed is None else f"the bus was stopped by a defect in dpstack: {self.failed}"

    @property
    def behind_ns(self) -> int:
        """A real bus is where it is."""
        return 0

    async def hand_over_outputs(self) -> None:
        """The machine has them as soon as they are set."""

    def order(self, command: object) -> asyncio.Future[object]:
        """:meth:`command`, which carries it out at once."""
        return carried_out(partial(self.command, command))

    async def open(self) -> None:
        """Open the port and begin. Raises PortError; ConfigError when the port knows none of the machine's rates."""
        self._may_open()
        await self._port.open()
        self._loop = loop = asyncio.get_running_loop()
        self._begin(loop, make_timer(loop, self._timer_due))

    async def close(self) -> None:
        """Stop and release the port; what the machine still had to tell is told. May be called again."""
        was_open = self._at is not None
        self._halt()
        task, self._reopening = self._reopening, None
        try:
            if task is not None:
                task.cancel()
                await outlast(task)
        finally:
            self._end(was_open)

    #: a port that is being opened when it is closed gives that up at once
    close_limit_ns = 0

    def end_without_loop(self) -> str:
        """The loop was closed or never runs again: the end of its bus by this thread alone, see :func:`end_on_port`."""
        self._left = self._ended_here()
        return self._left or ""

    def _ended_here(self) -> str | None:
        """The end by this thread alone; why safe values and Clear could not be sent, None where they were."""
        port, station = self._port, self._machine
        lost = self._at is None or self._attempts is not None or self.failed is not None
        self._reopening = None
        self._halt()
        try:
            if lost or not isinstance(station, ActiveStation):
                return "its port is lost"
            return end_on_port(port, station, self.echo) or None
        except Exception as exc:  # at the end of an interpreter anything may be missing
            return f"{type(exc).__name__}: {exc}"
        finally:
            port.close()

    def forsake(self) -> None:
        """In the child of a fork: no more steps; line, timer and loop stay the parent's."""
        self._left = IN_PARENT
        super().forsake()

    def _expect(self, at: int, quiet_until: int) -> None:
        if quiet_until:
            if not self._quiet_until and not self._port.hush(True):
                return
            if quiet_until < self._armed:
                self._arm(quiet_until)
        elif self._quiet_until:
            self._port.hush(False)
        self._quiet_until = quiet_until

    def _timer_due(self) -> None:
        quiet_until = self._quiet_until
        if not quiet_until:
            super()._timer_due()
        elif min(quiet_until, self._deadline) - monotonic_ns() > self._early_ns:
            self._arm(min(quiet_until, self._deadline))
        elif quiet_until < self._deadline:
            self._armed = NEVER  # before the step: whatever it leads to may arm afresh
            self._quiet_until = 0
            self._port.hush(False)
            self._step(self._drain())
        else:
            super()._timer_due()
            if self._quiet_until and self._quiet_until < self._armed:
                self._arm(self._quiet_until)

    def _waited(self, spun_ns: int, now: int) -> None:
        """Nothing: an ordinary process may spin as it likes."""

    def _begin_reopening(self, attempts: Attempts) -> None:
        if self._loop is not None:
            self._reopening = self._loop.create_task(self._reopen(attempts))

    async def _reopen(self, attempts: Attempts) -> None:
        while True:
            await asyncio.sleep(attempts.pause_ns() / NS_PER_S)
            try:
                await self._port.open()
                break
            except PortError as exc:
                self._refused(attempts, exc)
            except Exception as exc:
                self._fail(exc)
                return
        self._reopening = None
        self._back(attempts)

    def _report(self, message: str, error: Exception) -> None:
        if self._loop is not None:
            self._loop.call_exception_handler({"message": message, "exception": error})
