"""The command ``live`` of a running master: its live stream for a client of the control socket."""

from __future__ import annotations

import asyncio
from typing import Final

from dpstack.api.bus.bus import Bus
from dpstack.api.control import arguments
from dpstack.api.control.control_server import LongCommand, Sender
from dpstack.plant.sender import send_items
from dpstack.text import json_text

#: octets that may wait for a client before its items are kept back, and merged
_MOST_UNREAD: Final = 1 << 17
#: pause before a client that reads slowly is tried again, and number of tries in vain before it is disconnected
_PAUSE_S: Final = 0.25
_PATIENCE: Final = 240


def live_items(bus: Bus, args: list[str]) -> LongCommand:
    """Items until the bus ends or the client closes the connection. Snapshots come even if nothing has changed."""
    interval = arguments.number(args[0], 0.02, 60, "0.5") if args else 0.1

    async def feed(sender: Sender) -> object:
        stream = bus.live(interval)
        try:
            await send_items(
                stream,
                lambda item: sender.offer(json_text({"item": item}).encode() + b"\n"),
                lambda: _wait_for_room(sender),  # beyond its limit a sender drops lines
            )
        finally:
            stream.close()
        return None

    return feed


async def _wait_for_room(sender: Sender) -> None:
    """Wait until the client has read enough. Raises if it has gone, or does not read."""
    sender.check()
    unread = deaf = 0
    while sender.unread > _MOST_UNREAD:
        deaf = deaf + 1 if sender.unread >= unread else 0
        unread = sender.unread
        if deaf >= _PATIENCE:
            sender.give_up()
        await asyncio.sleep(_PAUSE_S)
        sender.check()
