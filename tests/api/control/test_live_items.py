"""The command ``live`` of the control socket: a client that reads slowly gets each line of a large plant."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from dpstack.api.bus.live import LiveItems, LiveStream
from dpstack.api.control import live_items
from dpstack.api.control.control_server import Sender
from dpstack.plant.items import check_item
from dpstack.plant.state import LiveState

#: 123 slaves with 224 named values each: 1.3 million octets, which is more than a sender takes at once
FIELDS = [{"name": f"value {number}", "at": f"u8@{number}"} for number in range(224)]
PLANT: dict[str, Any] = {"plant": {"slaves": {str(address): {"inputs": FIELDS} for address in range(3, 126)}}}


class SlowClient:
    """A transport whose client reads 30 000 octets between two looks. ``most``: octets that waited at most."""

    def __init__(self) -> None:
        self.lines: list[bytes] = []
        self.waiting = self.most = 0

    @property
    def transport(self) -> SlowClient:
        return self

    def is_closing(self) -> bool:
        return False

    def get_write_buffer_size(self) -> int:
        self.waiting = max(0, self.waiting - 30_000)
        return self.waiting

    def write(self, line: bytes) -> None:
        self.lines.append(line)
        self.waiting += len(line)
        self.most = max(self.most, self.waiting)


async def test_a_client_that_reads_slowly_gets_the_whole_plant_in_lines_of_bounded_length(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_items, "_PAUSE_S", 0.0)
    items, client, others = LiveItems(0.1), SlowClient(), 0
    for item in (PLANT, {"end": {"text": "over"}}):
        items.put(item)

    async def count_turns() -> None:
        nonlocal others
        while True:
            others += 1
            await asyncio.sleep(0)

    bus = asyncio.create_task(count_turns())
    bus_with_items: Any = type("Bus", (), {"live": lambda _, interval: LiveStream(items, None)})()
    await live_items.live_items(bus_with_items, [])(Sender(None, client))  # type: ignore[arg-type]
    bus.cancel()
    assert max(map(len, client.lines)) < 66_000
    assert client.most < 200_000
    assert others >= len(client.lines) > 20  # the bus had its turn behind each line
    state = LiveState()
    for line in client.lines:
        state.apply(json.loads(line)["item"])
    assert (state.plant, state.end) == (check_item(PLANT).plant, "over")
