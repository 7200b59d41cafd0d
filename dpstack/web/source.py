"""A source of items and answers for the server: a run, a recording, or given items."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Literal, NamedTuple

from dpstack.errors import UsageError
from dpstack.plant.items import CheckedItem, Item, check_item
from dpstack.record.reader import Recording
from dpstack.record.replay import replay_items

#: kinds of sources, as the page shows them; none: no run is there
Kind = Literal["run", "read-only", "demo", "replay", "none"]


class Note(NamedTuple):
    """A remark of a source for pages and log."""

    text: str
    severity: str = "info"


class KindChanged(NamedTuple):
    """The source has another kind now."""


#: what a source gives: items of the stream, checked once, and its own
SourceItem = CheckedItem | Note | KindChanged


class Source:
    """The base of all sources.

    ``kind`` may change: a :class:`KindChanged` comes then.
    """

    kind: Kind = "none"

    def items(self) -> AsyncGenerator[SourceItem]:
        """The items, until the source has no more."""
        raise NotImplementedError

    async def call(self, command: str, *args: str) -> object:
        """The answer of the run to a command of its control socket. Raises DpError."""
        raise UsageError(f"{command}: there is no run here")

    async def order(self, who: str, command: str, *args: str) -> object:
        """As :meth:`call`, for an order of a page: the run reports one that it refuses, with its origin ``who``."""
        return await self.call(command, *args)

    async def refused(self, who: str, order: str, reason: str) -> None:
        """Have the run report an ``order`` that the server has refused itself; there may be no run."""

    async def start(self) -> object:
        """Start the run, in Clear. Raises DpError."""
        raise UsageError("start: there is nothing to start here")

    async def recording(self) -> object:
        """A description of the recording that it replays. Raises UsageError."""
        raise UsageError("recording: a running bus is shown here, and no recording")

    async def close(self) -> None:
        """End all that it has started, in order."""


class GivenItems(Source):
    """Items from a list, ``interval`` seconds apart (0: all at once), then those that :meth:`put` gives."""

    def __init__(self, items: Iterable[Item] = (), *, kind: Kind = "run", interval: float = 0.0) -> None:
        self.kind = kind
        self._first = items
        self._interval = interval
        self._more: asyncio.Queue[Item] = asyncio.Queue()

    def put(self, item: Item) -> None:
        """Another item. Call it in the event loop of the server."""
        self._more.put_nowait(item)

    async def items(self) -> AsyncGenerator[SourceItem]:
        for item in self._first:
            yield check_item(item)
            if self._interval:
                await asyncio.sleep(self._interval)
        while True:
            yield check_item(await self._more.get())


class ReplaySource(Source):
    """The recording ``path``, at the speed at which it was made. Raises UsageError if it is no recording."""

    kind = "replay"

    def __init__(self, path: Path) -> None:
        self._path = path
        self._recording = Recording(path)

    async def items(self) -> AsyncGenerator[SourceItem]:
        reported = ""
        async for item in replay_items(self._path):
            try:
                checked = check_item(item)
            except ValueError as error:  # a header that somebody else has written
                if str(error) != reported:
                    reported = str(error)
                    yield Note(reported, "error")
            else:
                yield checked

    async def recording(self) -> object:
        """``{"file": NAME, "seconds": its length, "started": s since 1970, "columns": [...]}``."""
        return await asyncio.to_thread(self._describe)

    def _describe(self) -> dict[str, object]:
        first = last = None
        for row in Recording(self._path).rows():
            first, last = first or row, row
        columns = [{"name": column.name, **asdict(column)} for column in self._recording.columns.values()]
        return {
            "file": self._path.name,
            "seconds": 0.0 if last is None else round(last.at, 3),
            "started": None if first is None else round(first.time, 3),
            "columns": columns,
        }
