"""The octets on the line of a running program, for the clients of its control socket.

The machine of the program only fills a bounded ring (:mod:`dpstack.drivers.tap`). The feed empties it beside the bus,
in small portions, and hands each portion to all its clients. A client that does not read in time loses portions; the
feed counts their entries. Nothing waits for a client.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from time import time_ns
from typing import Final

from dpstack.api.control.server import LongCommand, Send
from dpstack.drivers.tap import TAP_PAUSE_NS, TAP_PORTION, Tap
from dpstack.units import ns_to_s

#: portions that wait for one client
_WAITING: Final = 256
#: a client gets an empty portion after this time on a silent line: a sign of life
_SIGN_OF_LIFE_S: Final = 1.0


class _Reader:
    """One client: its queue, and the entries that found the queue full."""

    def __init__(self) -> None:
        self.queue: asyncio.Queue[list[list[object]]] = asyncio.Queue(_WAITING)
        self.lost = 0

    def put(self, portion: list[list[object]]) -> None:
        try:
            self.queue.put_nowait(portion)
        except asyncio.QueueFull:
            self.lost += len(portion)


class TapFeed:
    """``attach`` connects a tap to the program's line, or ends it with None; ``now`` is the time of its entries in ns;
    ``about`` describes the line: ``baud``, ``paced``."""

    def __init__(
        self,
        attach: Callable[[Tap | None], None],
        now: Callable[[], int],
        about: Callable[[], dict[str, object]],
    ) -> None:
        self._attach = attach
        self._now = now
        self._about = about
        self._tap: Tap | None = None
        self._readers: set[_Reader] = set()
        self._timer: asyncio.TimerHandle | None = None

    def handler(self, _args: list[str]) -> LongCommand:
        """The command ``tap``: items until the client closes the connection.

        The first one describes the line; ``epoch_ns`` plus the time of an entry is the time since 1970. The others have
        ``octets``, a list of [time, rate, octets in hex, sent by the program itself], and ``lost``, the number of
        entries lost since the item before.
        """
        return self._feed

    async def _feed(self, send: Send) -> Awaitable[object]:
        reader = _Reader()
        self._join(reader)
        try:
            await send({"epoch_ns": time_ns() - self._now(), **self._about()})
            while True:
                try:
                    async with asyncio.timeout(_SIGN_OF_LIFE_S):
                        portion = await reader.queue.get()
                except TimeoutError:
                    portion = []
                tap = self._tap
                lost, reader.lost = reader.lost, 0
                if tap is not None:
                    tap_lost, tap.lost = tap.lost, 0
                    lost += tap_lost
                    for other in self._readers - {reader}:
                        other.lost += tap_lost
                await send({"octets": portion, "lost": lost})
        finally:
            self._leave(reader)

    def _join(self, reader: _Reader) -> None:
        if not self._readers:
            self._tap = tap = Tap()
            self._attach(tap)
            self._timer = asyncio.get_running_loop().call_later(ns_to_s(TAP_PAUSE_NS), self._hand_out)
        self._readers.add(reader)

    def _leave(self, reader: _Reader) -> None:
        self._readers.discard(reader)
        if not self._readers and self._tap is not None:
            self._tap = None
            if self._timer is not None:
                self._timer.cancel()
            self._attach(None)

    def _hand_out(self) -> None:
        """Hand a portion to each client; come back soon where there is more."""
        tap = self._tap
        if tap is None:
            return
        portion = [[end_ns, baud, octets.hex(), sent] for end_ns, baud, octets, sent in tap.take(TAP_PORTION)]
        if portion:
            for reader in self._readers:
                reader.put(portion)
        pause = TAP_PAUSE_NS // 20 if tap.ring else TAP_PAUSE_NS
        self._timer = asyncio.get_running_loop().call_later(ns_to_s(pause), self._hand_out)
