"""One stream of items for any number of pages: what each still has to get is merged where it does not read.

The items of the source change one :class:`~dpstack.live.state.LiveState`. Five times a second the fan-out hands the new
ones to its readers. A page that is up to date gets the same encoded texts as all others. For one that is still reading,
snapshots are merged and events are kept, up to a number; those beyond it are counted as lost. So a page costs one
plant, one whole snapshot and :data:`MOST_EVENTS` events at most, however long it does not read.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, Final

from dpstack.live.pending import Pending, portions
from dpstack.live.state import LiveState
from dpstack.web.messages import encode

Item = Mapping[str, Any]
#: seconds between two portions for the pages
TICK_S: Final = 0.2
#: events that wait for a page
MOST_EVENTS: Final = 500
#: answers that wait for a page; one with more is disconnected
MOST_ANSWERS: Final = 64


class Portion:
    """Items for any number of readers, encoded once."""

    def __init__(self, items: Iterable[Item]) -> None:
        self.items = tuple(items)
        self._texts: list[str] | None = None

    @property
    def texts(self) -> list[str]:
        if self._texts is None:
            self._texts = [encode(part) for item in self.items for part in portions(dict(item))]
        return self._texts


class Reader:
    """What one page still has to get."""

    def __init__(self, first: Portion) -> None:
        self._portion: Portion | None = first
        self._merged: Pending | None = None  # instead of the portion, once another one has come
        self._answers: deque[str] = deque()
        self._wake = asyncio.Event()
        self._wake.set()

    def put(self, portion: Portion) -> None:
        """Hand it ``portion``, which is merged with the items that the page has not got yet."""
        if self._merged is not None:
            _put_all(self._merged, portion)
        elif self._portion is not None:
            self._merged = Pending(MOST_EVENTS)
            _put_all(self._merged, self._portion)
            _put_all(self._merged, portion)
            self._portion = None
        else:
            self._portion = portion
        self._wake.set()

    def say(self, text: str) -> bool:
        """Send ``text`` behind the items that wait. False where the page has too many answers to read."""
        if len(self._answers) >= MOST_ANSWERS:
            return False
        self._answers.append(text)
        self._wake.set()
        return True

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits for the page."""
        return not self._answers and self._portion is None and self._merged is None

    def wake(self) -> None:
        """End the wait of :meth:`take`, also where there is nothing to send."""
        self._wake.set()

    async def take(self) -> list[str]:
        """Wait for the next messages to the page."""
        await self._wake.wait()
        self._wake.clear()
        texts: list[str] = []
        merged, self._merged = self._merged, None
        portion, self._portion = self._portion, None
        if merged is not None:
            portion = Portion(_all_of(merged))
        if portion is not None:
            texts += portion.texts
        texts += self._answers
        self._answers.clear()
        return texts


class FanOut:
    """The state of the plant, and the readers."""

    def __init__(self) -> None:
        self.state = LiveState()
        self._new = Pending()
        self._readers: set[Reader] = set()

    def put(self, item: Item) -> None:
        """The next item of the source, or an event of the server. Raises ValueError where it is none."""
        self.state.apply(item)
        self._new.put(dict(item))

    def forget(self) -> None:
        """There is no plant any more: a page that comes gets the events only."""
        events = self.state.events
        self.state = LiveState()
        self.state.events = events

    def join(self) -> Reader:
        """A reader for a page that comes: it gets plant, whole snapshot and the last events first."""
        self.hand_out()  # else it would get these items twice
        known = self.state.whole() or [{"event": event} for event in self.state.events]
        others = [item for item in known if "event" not in item]
        events = [item for item in known if "event" in item][-MOST_EVENTS:]
        end = [others.pop()] if others and "end" in others[-1] else []
        reader = Reader(Portion([*others, *events, *end]))
        self._readers.add(reader)
        return reader

    def leave(self, reader: Reader) -> None:
        self._readers.discard(reader)

    def hand_out(self) -> None:
        """Hand the new items to all readers."""
        if self._new.waiting:
            portion = Portion(_all_of(self._new))
            for reader in self._readers:
                reader.put(portion)

    async def run(self) -> None:
        """Hand out portions until this task is cancelled; the last one then."""
        with contextlib.suppress(asyncio.CancelledError):
            while True:
                await asyncio.sleep(TICK_S)
                self.hand_out()
        self.hand_out()


def _put_all(pending: Pending, portion: Portion) -> None:
    for item in portion.items:
        pending.put(dict(item))


def _all_of(pending: Pending) -> list[Item]:
    items: list[Item] = []
    while (item := pending.take()) is not None:
        items.append(item)
    return items
