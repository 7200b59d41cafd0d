"""``send_items``: the live stream to a reader in another program, in portions and only as fast as that one reads."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Protocol

from dpstack.plant.items import Item
from dpstack.plant.pending import SLAVES_A_PORTION, portions


class Items(Protocol):
    """The live stream of a bus (``bus.live()``), which merges what is not read."""

    def take(self) -> Item | None:
        """The next item; None if nothing waits at this moment."""

    async def wait(self) -> None:
        """Wait until :meth:`take` has an item."""

    def close(self) -> None:
        """Stop receiving items."""


async def send_items(
    stream: Items, send: Callable[[Item], object], room: Callable[[], Awaitable[object]], most: int = SLAVES_A_PORTION
) -> None:
    """Give each portion of the items of ``stream`` to ``send``, up to the item ``end``. ``room``: waits until the
    reader has room for one; until then the stream merges its items. ``most``: slaves in a portion. Behind each one the
    event loop goes on: it may drive a bus. Raises what ``send`` and ``room`` raise.
    """
    while True:
        await room()
        item = stream.take()
        if item is None:
            await stream.wait()
            continue
        for portion in portions(item, most):
            await room()  # in a long item, too
            send(portion)
            await asyncio.sleep(0)
        if "end" in item:
            return
