"""The plant as the items so far describe it, for a connector that shows it.

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

from dpstack.plant.items import check_item

#: an item of the stream: a dict with one key
Item = dict[str, Any]
#: events that a :class:`LiveState` keeps
DEPTH: Final = 1000


def end_of(text: str, *, failed: bool) -> Item:
    """The item ``end``. ``failed``: a fault has ended the bus, and not an order."""
    return {"end": {"text": text, "failed": True} if failed else {"text": text}}


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of ``new`` whose values are not those of ``old``."""
    return {key: value for key, value in new.items() if key not in old or old[key] != value}


def merge(into: dict[str, Any], snapshot: Mapping[str, Any]) -> None:
    """Merge the later ``snapshot`` into ``into``: for each key of ``bus`` and of each slave the later value counts.
    ``whole`` stays true once it is."""
    whole = snapshot["whole"]
    into["t"], into["whole"] = snapshot["t"], whole or into["whole"]
    if whole:
        into["bus"], into["slaves"] = {}, {}
    into["bus"].update(snapshot["bus"])
    for address, values in snapshot["slaves"].items():
        into["slaves"].setdefault(address, {}).update(values)


def begins_plant(item: Mapping[str, Any]) -> bool:
    """Whether ``item`` is a plant, and not a later part of one, with ``whole`` false."""
    return "plant" in item and item["plant"].get("whole") is not False


def merged_plant(known: Mapping[str, Any] | None, later: Mapping[str, Any]) -> dict[str, Any]:
    """The plant after ``later``, which has further slaves of ``known`` or is a new plant. It has ``more`` while further
    slaves follow."""
    if known is None or later.get("whole") is not False:
        return dict(later)
    merged = {**known, "slaves": {**known["slaves"], **later["slaves"]}, "more": later.get("more") is True}
    if not merged["more"]:
        del merged["more"]
    return merged


class LiveState:
    """``plant``: None before the first one. ``bus`` and ``slaves`` (by address as text): the merged snapshots, ``t``
    their time in s since the start, -1 before the first. ``events``: the last ones, oldest first. ``lost``: events that
    did not arrive. ``end``: its text; None while the bus runs. ``failed``: a fault has ended it.
    """

    def __init__(self) -> None:
        self.plant: dict[str, Any] | None = None
        self.t = -1.0
        self.bus: dict[str, Any] = {}
        self.slaves: dict[str, dict[str, Any]] = {}
        self.events: deque[dict[str, Any]] = deque(maxlen=DEPTH)
        self.lost = 0
        self.end: str | None = None
        self.failed = False

    def apply(self, item: Mapping[str, Any]) -> None:
        """Take the next item. Raises ValueError for something else than an item; unknown keys are left out."""
        check_item(item)
        self.apply_checked(item)

    def apply_checked(self, item: Mapping[str, Any]) -> None:
        """Take the next item, which :func:`~dpstack.plant.items.check_item` has judged."""
        if "plant" in item:
            self.plant = merged_plant(self.plant, item["plant"])
            if begins_plant(item):
                self.end, self.failed = None, False
                self.t, self.bus, self.slaves = -1.0, {}, {}
        elif "snapshot" in item:
            snapshot = item["snapshot"]
            now: dict[str, Any] = {"t": self.t, "whole": False, "bus": self.bus, "slaves": self.slaves}
            merge(now, snapshot)
            self.t, self.bus, self.slaves = float(now["t"]), now["bus"], now["slaves"]
        elif "event" in item:
            self.events.append(dict(item["event"]))
        elif "lost" in item:
            self.lost += int(item["lost"])
        elif "end" in item:
            self.end, self.failed = str(item["end"]["text"]), item["end"].get("failed") is True

    def whole(self) -> list[Item]:
        """The items that bring a new reader here: plant, whole snapshot, events, ``end``."""
        if self.plant is None:
            return []
        items: list[Item] = [{"plant": self.plant}]
        if self.t >= 0:
            slaves = {address: dict(values) for address, values in self.slaves.items()}
            items.append({"snapshot": {"t": self.t, "whole": True, "bus": dict(self.bus), "slaves": slaves}})
        items += ({"event": event} for event in self.events)
        if self.end is not None:
            items.append(end_of(self.end, failed=self.failed))
        return items
