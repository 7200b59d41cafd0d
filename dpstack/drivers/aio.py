"""The asyncio driver: one machine on one port, inside the application's event loop."""

from __future__ import annotations

import asyncio
from time import monotonic_ns

from dpstack.drivers.base import OnFailure
from dpstack.drivers.lateness import patience_of
from dpstack.drivers.reopening import Attempts
from dpstack.drivers.stepping import SPIN_NS, Stepping
from dpstack.drivers.timers import make_timer
from dpstack.errors import PortError
from dpstack.units import NEVER, NS_PER_S

__all__ = ["SPIN_NS", "AsyncioRuntime", "OnFailure", "patience_of"]


class AsyncioRuntime(Stepping):
    """:class:`Stepping` in the running asyncio loop; implements :class:`dpstack.drivers.base.Runtime`."""

    _loop: asyncio.AbstractEventLoop | None = None  # of the last open
    _quiet_until = 0  # until then the port hands nothing over; the timer waits for it, or for something sooner
    _reopening: asyncio.Task[None] | None = None

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
        if task is not None:
            task.cancel()
            await asyncio.wait([task])
        self._end(was_open)

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
