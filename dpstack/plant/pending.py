"""The items that wait for one reader: events up to a limit, snapshots merged into one."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, Final

from dpstack.plant.items import Item
from dpstack.plant.state import DEPTH, begins_plant

#: slaves in one item of :func:`portions`: with 244 octets of inputs and outputs each a snapshot has some 40 KB
SLAVES_A_PORTION: Final = 24
#: named values in it: one has some 110 octets in a plant, and 15 in a snapshot. A slave may have more, and stays whole
_VALUES_A_PORTION: Final = {"plant": 500, "snapshot": 3_000}
#: keys of a slave with its named values
_VALUES: Final = {"plant": ("inputs", "outputs"), "snapshot": ("fields", "held_fields")}


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
            _merge(self._snapshot, later)
        elif "event" in item:
            self._lost += len(self._events) == self._events.maxlen
            self._events.append(item)
        elif "plant" in item:
            if begins_plant(item):
                self._snapshot, self._end = None, None  # a bus that runs again has not ended
            waiting = None if self._plant is None else self._plant["plant"]
            self._plant = {"plant": _merged_plant(waiting, item["plant"])}
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
        """The next item; None if nothing waits. ``snapshots``: False leaves a snapshot, unless the end waits."""
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


def _merge(into: dict[str, Any], snapshot: Mapping[str, Any]) -> None:
    """Merge the later ``snapshot`` into ``into``: for each key of ``bus`` and of each slave the later value counts.
    ``whole`` stays true once it is."""
    whole = snapshot["whole"]
    into["t"], into["whole"] = snapshot["t"], whole or into["whole"]
    if whole:
        into["bus"], into["slaves"] = {}, {}
    into["bus"].update(snapshot["bus"])
    for address, values in snapshot["slaves"].items():
        into["slaves"].setdefault(address, {}).update(values)


def _merged_plant(known: Mapping[str, Any] | None, later: Mapping[str, Any]) -> dict[str, Any]:
    """The plant after ``later``, which has further slaves of ``known`` or is a new plant. It has ``more`` while further
    slaves follow."""
    if known is None or later.get("whole") is not False:
        return dict(later)
    merged = {**known, "slaves": {**known["slaves"], **later["slaves"]}, "more": later.get("more") is True}
    if not merged["more"]:
        del merged["more"]
    return merged


def portions(item: Item, most: int = SLAVES_A_PORTION) -> Iterator[Item]:
    """``item``, a plant or snapshot of many slaves or named values, as several with at most ``most`` slaves each.

    The first one is whole if it was, and has all that belongs to the bus.
    """
    kind = next((one for one in _VALUES if one in item), None)
    steps = [] if kind is None else list(_steps(kind, item[kind]["slaves"], most))
    if kind is None or len(steps) < 2:
        yield item
        return
    body: Mapping[str, Any] = item[kind]
    later = {key: body[key] for key in ("t", "more") if key in body} | {"whole": False}
    if kind == "snapshot":
        later["bus"] = {}
    for number, step in enumerate(steps, 1):
        part = {**(body if number == 1 else later), "slaves": step}
        if kind == "plant" and number < len(steps):
            part["more"] = True
        yield {kind: part}


def _steps(kind: str, slaves: Mapping[str, Mapping[str, Any]], most: int) -> Iterator[dict[str, Any]]:
    """``slaves`` of a plant or snapshot, in steps that are small enough."""
    step: dict[str, Any] = {}
    values = 0
    for address, slave in slaves.items():
        own = sum(len(slave.get(key) or ()) for key in _VALUES[kind])
        if step and (len(step) == most or values + own > _VALUES_A_PORTION[kind]):
            yield step
            step, values = {}, 0
        step[address] = slave
        values += own
    if step:
        yield step
