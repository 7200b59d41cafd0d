"""``FdlLink``: the FDL services of one bus from the inside: attached at the first use, orders, events, the end."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Protocol

from dpstack.api.config.config import Config
from dpstack.api.fdl.sap import SapQueue
from dpstack.api.slave.services import Services
from dpstack.errors import DpError
from dpstack.fdl.services.identity import Ident
from dpstack.fdl.services.orders import CancelFdl, CloseSap, FdlConfirmed, FdlIndicated, FdlRequest, OpenSap
from dpstack.fdl.services.requester import AttachFdl
from dpstack.trace import Event, Severity


class FdlBus(Protocol):
    """The bus as the FDL services use it, see :class:`dpstack.api.bus.parts.BusBase`."""

    config: Config
    services: Services

    @property
    def driver(self) -> str: ...
    def command(self, command: object) -> None: ...
    async def order(self, command: object) -> None: ...
    def check_open(self) -> None: ...
    def notice(self, source: str, message: str, severity: Severity = Severity.INFO) -> None: ...


class FdlLink:
    """The FDL services of ``bus``. ``per_hold``, ``ident``: see
    :class:`~dpstack.fdl.services.requester.AttachFdl`."""

    def __init__(self, bus: FdlBus, *, per_hold: int, ident: Ident) -> None:
        self.bus = bus
        #: the open SAPs by number
        self.saps: dict[int | None, SapQueue] = {}
        self._per_hold = per_hold
        self._ident = ident
        self._attaching: asyncio.Future[None] | None = None

    @property
    def is_virtual(self) -> bool:
        """Whether the bus has virtual time, which stands still while the program works."""
        return self.bus.driver == "virtual"

    def command(self, order: object) -> None:
        """Give an order that nobody awaits. A bus that has ended meanwhile needs none."""
        with contextlib.suppress(DpError):
            self.bus.command(order)

    async def order(self, order: object) -> None:
        """Give an order and wait until the station has carried it out. Raises its exception."""
        self.bus.check_open()
        await self._attach()
        await self.bus.order(order)

    async def open_sap(self, order: OpenSap, queue: SapQueue) -> None:
        """Activate a SAP whose indications go to ``queue``. Raises UsageError."""
        self.saps[order.number] = queue  # an indication may come before the order's answer
        try:
            await self.order(order)
        except BaseException:
            del self.saps[order.number]
            raise

    async def close_sap(self, queue: SapQueue) -> None:
        """Deactivate the SAP of ``queue``. A bus that has ended meanwhile has none."""
        if self.saps.get(queue.number) is queue:
            del self.saps[queue.number]
        with contextlib.suppress(DpError):
            await self.bus.order(CloseSap(queue.number))

    async def confirmation(self, order: FdlRequest) -> FdlConfirmed:
        """Give a request and wait for its confirmation."""
        self.bus.check_open()
        await self._attach()
        try:
            return await self.bus.services.answer_to(order, FdlConfirmed)
        except asyncio.CancelledError:
            self.command(CancelFdl(order.token))
            raise

    def take(self, event: Event) -> bool:
        """Take an event of the machine; False if it is not for the FDL services."""
        match event:
            case FdlConfirmed():
                self.bus.services.resolve(event.token, event)
            case FdlIndicated(sap=number):
                queue = self.saps.get(number)
                if queue is not None:
                    queue.take(event)
            case _:
                return False
        return True

    def end(self, error: DpError) -> None:
        """The bus is over: later calls raise ``error``."""
        for queue in tuple(self.saps.values()):
            queue.end(error)
        self.saps.clear()

    def report(self, text: str, error: Exception) -> None:
        """Report an exception in a function of the program."""
        self.bus.notice("fdl", text, Severity.ERROR)
        asyncio.get_running_loop().call_exception_handler({"message": text, "exception": error})

    async def _attach(self) -> None:
        """Attach the services to the station, at the first use."""
        while self._attaching is None or not self._attaching.done():
            if self._attaching is not None:
                await asyncio.wait([self._attaching])
                continue
            self._attaching = attaching = asyncio.get_running_loop().create_future()
            try:
                if self.bus.driver == "process":
                    from dpstack.drivers.process.messages import LoadFdl  # here, as the other drivers need none of it

                    await self.bus.order(LoadFdl())
                await self.bus.order(AttachFdl(self.bus.services.token(), per_hold=self._per_hold, ident=self._ident))
            except BaseException:
                self._attaching = None
                attaching.cancel()
                raise
            attaching.set_result(None)
