"""Readers of a bus under soak: they follow its events and its live stream, and count."""

from __future__ import annotations

from collections import Counter

import dpstack
from dpstack.plant.state import LiveState


class StreamReaders:
    """A run of :attr:`bus`; ``events``: its events by class, ``items``: number of items of the live stream."""

    bus: dpstack.Bus
    #: s between two snapshots of the live stream
    LIVE_S = 0.5

    def __init__(self) -> None:
        self.events: Counter[str] = Counter()
        self.items = 0

    async def read_events(self) -> None:
        async for event in self.bus.events():
            self.events[type(event).__name__] += 1

    async def read_live(self) -> None:
        state = LiveState()
        async for item in self.bus.live(self.LIVE_S):
            state.apply(item)
            self.items += 1
