"""One stream of items for any number of pages: what each page still has to get, merged where it does not read.

The items of the source change one :class:`~dpstack.live.state.LiveState`. Five times a second the fan-out hands what is
new to its readers. A page that is up to date gets the same encoded text as all others. For one that is still reading,
snapshots are merged and the events are kept, up to a number; those beyond it are counted as lost. So a page costs one
plant, one whole snapshot and :data:`MOST_EVENTS` events at most, however long it does not read.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Mapping
from typing import Any, Final

from dpstack.web.messages import encode

Item = Mapping[str, Any]
#: seconds between two portions for the pages
TICK_S: Final = 0.2
#: events that wait for a page
MOST_EVENTS: Final = 200
#: answers that wait for a page; one with more is disconnected
MOST_ANSWERS: Final = 64


def merge(into: dict[str, Any], snapshot: Mapping[str, Any]) -> None:
    """Merge ``snapshot`` into the earlier one ``into``: each new value of the bus and of a slave replaces the old."""
    if snapshot.get("whole"):
        into.clear()
    into.update({key: value for key, value in snapshot.items() if key not in ("bus", "slaves", "whole")})
    into["whole"] = bool(into.get("whole") or snapshot.get("whole"))
    into.setdefault("bus", {}).update(snapshot.get("bus") or {})
    slaves = into.setdefault("slaves", {})
    for address, values in (snapshot.get("slaves") or {}).items():
        slaves[address] = {**slaves.get(address, {}), **values}


class Portion:
    """The items that are new since the last portion."""

    def __init__(self) -> None:
        self.plant: Item | None = None
        self.snapshot: dict[str, Any] = {}
        self.events: deque[Item] = deque()
        self.lost = 0
        self.end: Item | None = None
        self._texts: list[str] | None = None

    def __bool__(self) -> bool:
        return bool(self.plant is not None or self.snapshot or self.events or self.lost or self.end is not None)

    def add(self, item: Item) -> None:
        if "plant" in item:
            self.plant, self.end, self.snapshot = item, None, {}
        elif "snapshot" in item:
            merge(self.snapshot, item["snapshot"])
        elif "event" in item:
            self.events.append(item)
            if len(self.events) > MOST_EVENTS:
                self.events.popleft()
                self.lost += 1
        elif "lost" in item:
            self.lost += item["lost"]
        elif "end" in item:
            self.end = item

    def merge(self, later: Portion) -> None:
        if later.plant is not None:
            self.add(later.plant)
        if later.snapshot:
            merge(self.snapshot, later.snapshot)
        self.lost += later.lost
        for event in later.events:
            self.add(event)
        if later.end is not None:
            self.end = later.end

    def texts(self) -> list[str]:
        """The items as JSON, encoded once."""
        if self._texts is None:
            items: list[Item] = [] if self.plant is None else [self.plant]
            items += [{"snapshot": self.snapshot}] if self.snapshot else []
            items += [{"lost": self.lost}] if self.lost else []
            items += self.events
            items += [] if self.end is None else [self.end]
            self._texts = [encode(item) for item in items]
        return self._texts


class Reader:
    """What one page still has to get."""

    def __init__(self, first: Portion) -> None:
        self._portion: Portion | None = first
        self._own = True  # the portion is this reader's: it may be changed
        self._answers: deque[str] = deque()
        self._wake = asyncio.Event()
        self._wake.set()

    def put(self, portion: Portion) -> None:
        """Hand it ``portion``, which is merged with what the page has not got yet."""
        if self._portion is None:
            self._portion, self._own = portion, False
        else:
            if not self._own:
                mine = Portion()
                mine.merge(self._portion)
                self._portion, self._own = mine, True
            self._portion.merge(portion)
        self._wake.set()

    def say(self, text: str) -> bool:
        """Send ``text`` before any item. False where the page has too many answers to read."""
        if len(self._answers) >= MOST_ANSWERS:
            return False
        self._answers.append(text)
        self._wake.set()
        return True

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits for the page."""
        return not self._answers and self._portion is None

    def wake(self) -> None:
        """End the wait of :meth:`take`, also where there is nothing to send."""
        self._wake.set()

    async def take(self) -> list[str]:
        """Wait for the next messages to the page."""
        await self._wake.wait()
        self._wake.clear()
        texts = list(self._answers)
        self._answers.clear()
        portion, self._portion = self._portion, None
        if portion is not None:
            texts += portion.texts()
        return texts


class FanOut:
    """The state of the plant, and the readers."""

    def __init__(self) -> None:
        self.state = Portion()  # all of it: a page that comes gets this
        self._new = Portion()
        self._readers: set[Reader] = set()

    @property
    def plant(self) -> Mapping[str, Any] | None:
        return None if self.state.plant is None else self.state.plant["plant"]

    def put(self, item: Item) -> None:
        """The next item of the source, or an event of the server."""
        self.state.add(item)
        self.state.lost = 0
        self._new.add(item)

    def forget(self) -> None:
        """There is no plant any more: a page that comes gets the events only."""
        events = self.state.events
        self.state = Portion()
        self.state.events = events

    def join(self) -> Reader:
        """A reader for a page that comes: plant, whole snapshot, the last events."""
        self.hand_out()  # else it would get these items twice
        first = Portion()
        first.merge(self.state)
        if first.snapshot:
            first.snapshot["whole"] = True
        reader = Reader(first)
        self._readers.add(reader)
        return reader

    def leave(self, reader: Reader) -> None:
        self._readers.discard(reader)

    def say(self, text: str) -> None:
        """Send ``text`` to all pages."""
        for reader in self._readers:
            reader.say(text)

    def hand_out(self) -> None:
        """Hand the portion to all readers."""
        portion, self._new = self._new, Portion()
        if portion:
            for reader in self._readers:
                reader.put(portion)

    async def run(self) -> None:
        """Hand out portions until this task is cancelled; the last one then."""
        with contextlib.suppress(asyncio.CancelledError):
            while True:
                await asyncio.sleep(TICK_S)
                self.hand_out()
        self.hand_out()
