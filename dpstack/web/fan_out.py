"""One stream of items for any number of pages: what each still has to get is merged if it does not read.

The items of the source change one :class:`~dpstack.plant.state.LiveState`. Five times a second the fan-out hands the
new ones to its readers. A page that is up to date gets the same encoded texts as all others. For one that is still
reading, snapshots are merged and events are kept, up to a number; those beyond it are counted as lost. So a page costs
one plant, one whole snapshot and :data:`MOST_EVENTS` events at most between two answers to it, of which
:data:`MOST_ANSWERS` wait at most.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, Final

from dpstack.plant.items import CheckedItem, changes_of
from dpstack.plant.judge import JUDGED, judged
from dpstack.plant.pending import Pending, portions
from dpstack.plant.state import LiveState
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
    """Items and answers that wait for one page, in the order in which they came."""

    def __init__(self, first: Portion) -> None:
        self._waiting: deque[Portion | Pending | str] = deque((first,))  # texts are answers
        self._answers = 0  # among them
        self._wake = asyncio.Event()
        self._wake.set()

    def put(self, portion: Portion) -> None:
        """Hand it ``portion``, which is merged with the items behind the last answer that the page has not got yet."""
        last = self._waiting[-1] if self._waiting else None
        if isinstance(last, Pending):
            _put_all(last, portion)
        elif isinstance(last, Portion):
            merged = self._waiting[-1] = Pending(MOST_EVENTS)
            _put_all(merged, last)
            _put_all(merged, portion)
        else:
            self._waiting.append(portion)
        self._wake.set()

    def say(self, text: str) -> bool:
        """Send ``text`` behind all that waits: a new welcome must not come behind the plant that it announces. False
        if the page has too many answers to read."""
        if self._answers >= MOST_ANSWERS:
            return False
        self._waiting.append(text)
        self._answers += 1
        self._wake.set()
        return True

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits for the page."""
        return not self._waiting

    def wake(self) -> None:
        """End the wait of :meth:`take`, also if there is nothing to send."""
        self._wake.set()

    async def take(self) -> list[str]:
        """Wait for the next messages to the page."""
        await self._wake.wait()
        self._wake.clear()
        waiting, self._waiting, self._answers = self._waiting, deque(), 0
        texts: list[str] = []
        for one in waiting:
            if isinstance(one, str):
                texts.append(one)
            else:
                texts += (Portion(_all_of(one)) if isinstance(one, Pending) else one).texts
        return texts


class FanOut:
    """The state of the plant, and the readers."""

    def __init__(self) -> None:
        self.state = LiveState()
        self._new = Pending()
        self._readers: set[Reader] = set()
        #: slaves whose program, an older version, makes no verdicts
        self._judged_here: set[str] = set()

    def put(self, checked: CheckedItem) -> None:
        """The next item of the source, or of the server itself."""
        self.state.apply_checked(checked)
        if checked.plant is not None and checked.plant.whole:
            self._judged_here.clear()
        self._new.put(checked.item if checked.snapshot is None else self._judged(checked.item))

    def _judged(self, item: Item) -> dict[str, Any]:
        """The snapshot ``item``, which was applied, with the verdicts on slaves whose program makes none."""
        snapshot = item["snapshot"]
        slaves = dict(snapshot["slaves"])
        for address, values in slaves.items():
            known = self.state.slaves[address]
            if known.level is None:
                self._judged_here.add(address)
            if address in self._judged_here and not JUDGED.isdisjoint(values):
                now = self.state.slaves[address] = judged(known)
                slaves[address] = {**values, **changes_of(known, now)}
        return {"snapshot": {**snapshot, "slaves": slaves}}

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
