"""The plant as the items so far describe it.

Items of the stream, each a dict with one key (docs/reference/live.md):

- ``plant``: the bus and its slaves as configured; first, and again when the configuration of the running bus changes.
  One of many slaves may come in several: all but the first have ``whole`` false, all but the last ``more``
- ``snapshot``: state and values; whole after ``plant``, later only the keys that have changed
- ``event``: an event as a line of ``dpstack run --json``, with wall clock, severity and text
- ``lost``: the number of events that this reader missed
- ``end``: the bus has ended, in order or by a fault; the last item
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import msgspec
from msgspec import structs

from dpstack.plant.items import BusValues, CheckedItem, Item, Plant, SlaveValues, Snapshot, check_item, merged

#: events that a :class:`LiveState` keeps
DEPTH: Final = 1000


def end_of(text: str, *, failed: bool) -> Item:
    """The item ``end``. ``failed``: a fault has ended the bus, and not an order."""
    return {"end": {"text": text, "failed": True} if failed else {"text": text}}


def begins_plant(item: Mapping[str, Any]) -> bool:
    """Whether ``item`` is a plant, and not a later part of one, with ``whole`` false."""
    return "plant" in item and item["plant"].get("whole") is not False


class LiveState:
    """``plant``: None before the first one. ``bus`` and ``slaves`` (by address as text): the merged snapshots, ``t``
    their time in s since the start, -1 before the first. ``events``: the last ones, oldest first. ``lost``: events that
    did not arrive. ``end``: its text; None while the bus runs. ``failed``: a fault has ended it.
    """

    def __init__(self) -> None:
        self.plant: Plant | None = None
        self.t = -1.0
        self.bus = BusValues()
        self.slaves: dict[str, SlaveValues] = {}
        self.events: deque[dict[str, Any]] = deque(maxlen=DEPTH)
        self.lost = 0
        self.end: str | None = None
        self.failed = False

    def apply(self, item: Mapping[str, Any]) -> None:
        """Take the next item. Raises ValueError for something else than an item; unknown keys are left out."""
        self.apply_checked(check_item(item))

    def apply_checked(self, checked: CheckedItem) -> None:
        """Take the next item, which was checked."""
        if checked.plant is not None:
            self._take_plant(checked.plant)
        elif checked.snapshot is not None:
            self._take_snapshot(checked.item["snapshot"], checked.snapshot)
        elif checked.event is not None:
            self.events.append(dict(checked.item["event"]))
        elif checked.lost is not None:
            self.lost += checked.lost
        elif checked.end is not None:
            self.end, self.failed = checked.end.text, checked.end.failed

    def _take_plant(self, plant: Plant) -> None:
        if plant.whole:
            self.end, self.failed = None, False
            self.t, self.bus, self.slaves = -1.0, BusValues(), {}
        elif self.plant is not None:
            slaves = {**self.plant.slaves, **plant.slaves}
            plant = structs.replace(self.plant, slaves=slaves, more=plant.more)
        self.plant = plant

    def _take_snapshot(self, given: Mapping[str, Any], snapshot: Snapshot) -> None:
        """For each key of ``bus`` and of each slave the later value counts."""
        self.t = snapshot.t
        if snapshot.whole:
            self.bus, self.slaves = BusValues(), {}
        self.bus = merged(self.bus, snapshot.bus, given["bus"])
        for address, values in snapshot.slaves.items():
            before = self.slaves.get(address)
            known = values if before is None else merged(before, values, given["slaves"][address])
            self.slaves[address] = known

    def whole(self) -> list[Item]:
        """The items that bring a new reader here: plant, whole snapshot, events, ``end``."""
        if self.plant is None:
            return []
        items: list[Item] = [{"plant": msgspec.to_builtins(self.plant)}]
        if self.t >= 0:
            slaves = {address: msgspec.to_builtins(values) for address, values in self.slaves.items()}
            bus = msgspec.to_builtins(self.bus)
            items.append({"snapshot": {"t": self.t, "whole": True, "bus": bus, "slaves": slaves}})
        items += ({"event": event} for event in self.events)
        if self.end is not None:
            items.append(end_of(self.end, failed=self.failed))
        return items
