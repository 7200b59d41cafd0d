"""Finding the baud rate at a port: the search listens, the port follows it from rate to rate."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from time import monotonic_ns
from typing import Final

from dpstack.drivers.aio import patience_of
from dpstack.errors import BaudError, DpError, PortError
from dpstack.fdl.autobaud import AutoBaud, BaudFound, BaudNotFound
from dpstack.ports import Delivery, Port
from dpstack.units import BAUD_RATES, NEVER, NS_PER_MS, ns_to_s

#: What arrives so soon after a change of the rate may have been received before it: an adapter holds octets back for
#: up to 16 ms and hands them over in frames of 1 ms; a hub of ptys is a process that may be held up.
_SETTLE_NS: Final = {Delivery.HOST: 5 * NS_PER_MS, Delivery.ADAPTER: 20 * NS_PER_MS}


async def search_baud(
    port: Port, *, silence_ns: int = NEVER, limit_ns: int = NEVER, rates: Sequence[int] = BAUD_RATES
) -> BaudFound | BaudNotFound:
    """Open ``port``, listen until its rate is found or given up (see :class:`AutoBaud`), and close it.

    Nothing is sent. Rates that the port cannot do are left out. Raises PortError where it cannot be opened, vanishes,
    or is of a kind whose rate cannot be changed.
    """
    await port.open()
    try:
        port.set_baud(port.baud)  # a port that cannot change its rate says so
        search = AutoBaud(
            monotonic_ns(),
            rates=rates,
            silence_ns=silence_ns,
            limit_ns=limit_ns,
            slack_ns=patience_of(port).known_ns,
            settle_ns=_SETTLE_NS[port.delivery],
        )
        return await _Listening(port, search).result
    finally:
        port.close()


class _Listening:
    """Keeps ``search`` going on an open ``port``, up to ``result``."""

    def __init__(self, port: Port, search: AutoBaud) -> None:
        self._port = port
        self._search = search
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self.result: asyncio.Future[BaudFound | BaudNotFound] = self._loop.create_future()
        port.attach(self._loop, self._heard, self._lost)
        self._go_on()

    def _heard(self, chunk: bytes) -> None:
        if not self.result.done():
            self._search.receive(chunk, monotonic_ns())
            self._go_on()

    def _due(self) -> None:
        if self.result.done():
            return
        chunk = self._port.read_now()  # before the dwell is judged
        if chunk:
            self._search.receive(chunk, monotonic_ns())
        self._search.wake(monotonic_ns())
        self._go_on()

    def _go_on(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        try:
            while self._search.result is None and self._port.baud != self._search.baud:
                try:
                    self._port.set_baud(self._search.baud)
                except BaudError:
                    self._search.refused(monotonic_ns())
        except DpError as error:
            self.result.set_exception(error)
            return
        if self._search.result is not None:
            self.result.set_result(self._search.result)
            return
        wait = max(0, self._search.wake_at() - monotonic_ns())
        self._timer = self._loop.call_later(ns_to_s(wait), self._due)

    def _lost(self, reason: str) -> None:
        if not self.result.done():
            self.result.set_exception(PortError(f"{self._port.name} vanished while listening: {reason}"))
