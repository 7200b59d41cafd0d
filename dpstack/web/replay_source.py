"""A recording as a source, in place of a bus."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import asdict
from pathlib import Path

from dpstack.record.reader import Recording
from dpstack.record.replay import replay_items
from dpstack.web.fan_out import Item
from dpstack.web.source import Source


class ReplaySource(Source):
    """The recording ``path``, at the speed at which it was made. Raises UsageError where it is none."""

    kind = "replay"

    def __init__(self, path: Path) -> None:
        self._path = path
        self._recording = Recording(path)

    async def items(self) -> AsyncGenerator[Item]:
        async for item in replay_items(self._path):
            yield item

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
