"""I&M0 of the DP-V1 slaves of a bus that runs, read once from each beside data exchange, for the report of a run."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from msgspec import structs

from dpstack.api.bus.bus import Bus
from dpstack.errors import BusError, DpError
from dpstack.text import shortened

if TYPE_CHECKING:
    from dpstack.api.slave.slave import Slave

#: in s: for one slave, and for all that are not read yet at the end of the run
_TIMEOUT_S: Final = 2.0
_LAST_S: Final = 2.0
#: characters of a reason
_LONGEST: Final = 400


class Inventory:
    """Reads I&M0 of slot 0, one slave after the other, each as soon as it is in data exchange.

    The requests go where all acyclic services go: one for each token, and with a fixed cycle into its gaps. A slave is
    asked once. Nothing is read on a read-only bus.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._is_asked = not bus.config.bus.read_only
        self._found: dict[int, dict[str, object]] = {}
        self._why: dict[int, str] = {}
        self._pending = [slave for slave in bus.slaves if self._is_asked and slave.setup.dpv1 is not None]
        self._idle = asyncio.Event()  # all slaves in data exchange were asked
        self._task: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Read beside the bus from now on."""
        self._task = asyncio.ensure_future(self._read_all())

    async def rest(self) -> None:
        """Wait until the slaves in data exchange were asked, a bounded time."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._idle.wait(), _LAST_S)

    def end(self) -> None:
        """Ask nobody any more."""
        if self._task is not None:
            self._task.cancel()

    def im0(self, slave: Slave) -> dict[str, object] | None:
        """I&M0 of ``slave`` by the names of its fields; None without."""
        return self._found.get(slave.address)

    def why_not(self, slave: Slave) -> str:
        """Why ``slave`` has no I&M0 here; empty if it has."""
        if slave.address in self._found:
            return ""
        if not self._is_asked:
            return "the bus is read-only: nobody was asked"
        if slave.setup.dpv1 is None:
            return "configured without DP-V1"
        return self._why.get(slave.address, "it was not asked: it was not in data exchange, or the run ended before")

    async def _read_all(self) -> None:
        """Until all slaves were asked. The end of the bus ends it."""
        try:
            while self._pending:
                ready = [slave for slave in self._pending if slave.ready_now]
                if not ready:
                    self._idle.set()
                    await self._bus.until(lambda: any(slave.ready_now for slave in self._pending))
                    self._idle.clear()
                    continue
                await self._read(ready[0])
                self._pending.remove(ready[0])
        except DpError:  # the reason of the end
            return
        finally:
            self._idle.set()

    async def _read(self, slave: Slave) -> None:
        self._why[slave.address] = "it did not answer before the end of the run"
        try:
            self._found[slave.address] = structs.asdict(await slave.im(timeout=_TIMEOUT_S))
        except BusError:
            raise
        except DpError as error:
            self._why[slave.address] = shortened(str(error), _LONGEST)
