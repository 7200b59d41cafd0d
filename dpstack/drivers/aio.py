"""The asyncio driver: one machine on one port, inside the application's event loop."""

from __future__ import annotations

import asyncio

from dpstack.drivers.base import OnFailure
from dpstack.drivers.lateness import patience_of
from dpstack.drivers.reopening import Attempts
from dpstack.drivers.stepping import SPIN_NS, Stepping
from dpstack.drivers.timers import make_timer
from dpstack.errors import PortError
from dpstack.units import NS_PER_S

__all__ = ["SPIN_NS", "AsyncioRuntime", "OnFailure", "patience_of"]


class AsyncioRuntime(Stepping):
    """:class:`Stepping` in the running asyncio loop; implements :class:`dpstack.drivers.base.Runtime`."""

    _loop: asyncio.AbstractEventLoop | None = None  # of the last open
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

    def _written(self, octets: bytes, end: int) -> None:
        """Nothing: the loop has other work than waiting for the answer."""

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
