"""The items that wait for one reader: events up to a limit, snapshots merged into one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, Final

from dpstack.live.state import DEPTH, Item, merge

#: slaves in one snapshot of :func:`portions`: with 244 octets of inputs and outputs each a line has some 40 KB
SLAVES_A_PORTION: Final = 24


class Pending:
    """``put`` never waits and needs bounded memory. A reader that comes late gets the newest plant, one snapshot with
    all changes since its last one, the last ``depth`` events, and the number of those before."""

    def __init__(self, depth: int = DEPTH) -> None:
        self._plant: Item | None = None
        self._snapshot: dict[str, Any] | None = None
        self._events: deque[Item] = deque(maxlen=depth)
        self._lost = 0
        self._end: Item | None = None

    def put(self, item: Item) -> None:
        """Add an item; it is not changed. One that only a newer version knows is left out."""
        if "snapshot" in item:
            later = item["snapshot"]
            if self._snapshot is None:
                self._snapshot = {"t": later["t"], "whole": later["whole"], "bus": {}, "slaves": {}}
            merge(self._snapshot, later)
        elif "event" in item:
            self._lost += len(self._events) == self._events.maxlen
            self._events.append(item)
        elif "plant" in item:
            self._plant, self._snapshot, self._end = item, None, None  # a bus that runs again has not ended
        elif "lost" in item:
            self._lost += item["lost"]
        elif "end" in item:
            self._end = item

    @property
    def urgent(self) -> bool:
        """Whether something else than a snapshot waits."""
        return self._plant is not None or bool(self._events) or bool(self._lost) or self._end is not None

    @property
    def waiting(self) -> bool:
        return self.urgent or self._snapshot is not None

    def take(self, *, snapshots: bool = True) -> Item | None:
        """The next item; None where nothing waits. ``snapshots``: False leaves a snapshot, unless the end waits."""
        if self._plant is not None:
            item, self._plant = self._plant, None
            return item
        if self._lost:
            lost, self._lost = self._lost, 0
            return {"lost": lost}
        if self._events:
            return self._events.popleft()
        if self._snapshot is not None and (snapshots or self._end is not None):
            snapshot, self._snapshot = self._snapshot, None
            return {"snapshot": snapshot}
        end, self._end = self._end, None
        return end


def portions(item: Item, most: int = SLAVES_A_PORTION) -> Iterator[Item]:
    """``item``, a snapshot of more than ``most`` slaves as several: the first one is whole if it was."""
    snapshot: Mapping[str, Any] | None = item.get("snapshot")
    if snapshot is None or len(snapshot["slaves"]) <= most:
        yield item
        return
    slaves = list(snapshot["slaves"].items())
    for first in range(0, len(slaves), most):
        yield {
            "snapshot": {
                "t": snapshot["t"],
                "whole": snapshot["whole"] and not first,
                "bus": {} if first else snapshot["bus"],
                "slaves": dict(slaves[first : first + most]),
            }
        }
