"""Diagnoses, faults and alarms as conditions that are active, acknowledged, retained (OPC UA Part 9, 5.5 to 5.8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

from dpstack.trace import Severity

#: conditions that are kept: of one slave, and in all. For one beyond them the oldest that is not active is forgotten
MOST_OF_A_SLAVE: Final = 64
MOST_CONDITIONS: Final = 4096


@dataclass(frozen=True, slots=True)
class Condition:
    """``id``: stable for the same condition of the same slave, the source of OPC UA's ConditionId. ``slave`` None: of
    the bus. ``time``: of its last change, ``since``: when it became active last, in s since 1970 by the clock of the
    stream. ``count`` rises by one with each of its changes, and goes on if the condition was forgotten and comes
    again: so each event has an id of its own. ``unacked_from``: the count at which it came back unacknowledged.
    """

    id: str
    slave: int | None
    title: str
    text: str
    level: Severity
    active: bool
    acked: bool
    since: float
    time: float
    count: int = 1
    unacked_from: int = 1
    #: name of the person or program that acknowledged it or gave the comment, whichever was last
    said_by: str = ""
    comment: str = ""

    @property
    def retain(self) -> bool:
        """Whether a client that comes later must still learn of it."""
        return self.active or not self.acked


class ConditionBook:
    """All conditions that are retained. ``left_out``: those for which there was no room: not made, or forgotten before
    their acknowledgement."""

    def __init__(self) -> None:
        self.left_out = 0
        self._known: dict[str, Condition] = {}
        #: ids by slave, oldest first
        self._of: dict[int | None, dict[str, None]] = {}
        #: no condition that was forgotten had a greater count
        self._most_count = 0

    def __iter__(self) -> Iterator[Condition]:
        return iter(tuple(self._known.values()))

    def __len__(self) -> int:
        return len(self._known)

    def get(self, id_: str) -> Condition | None:
        return self._known.get(id_)

    def of(self, slave: int | None) -> tuple[Condition, ...]:
        """The conditions of a slave (None: of the bus), oldest first."""
        return tuple(self._known[id_] for id_ in self._of.get(slave, ()))

    def show(
        self, id_: str, slave: int | None, title: str, text: str, level: Severity, time: float, *, active: bool = True
    ) -> Condition | None:
        """The condition ``id_`` is active, with ``text``. ``active`` False: something happened that does not last; it
        is retained until it is acknowledged. Returns the condition if it has changed."""
        known = self._known.get(id_)
        if known is None:
            if not self._make_room(slave):
                return None
            count = self._most_count + 1
            return self._keep(Condition(id_, slave, title, text, level, active, False, time, time, count, count))
        if active and known.active and (known.text, known.level) == (text, level):
            return None
        begins = not known.active or not active
        again = begins or level.rank > known.level.rank
        return self._keep(
            replace(
                known,
                text=text,
                level=level,
                active=active,
                acked=known.acked and not again,
                unacked_from=known.count + 1 if again else known.unacked_from,
                since=time if begins else known.since,
                time=time,
                count=known.count + 1,
            )
        )

    def end(self, id_: str, time: float, text: str | None = None) -> Condition | None:
        """The condition is not active any more. Returns it if it was."""
        known = self._known.get(id_)
        if known is None or not known.active:
            return None
        said = known.text if text is None else text
        return self._keep(replace(known, active=False, text=said, time=time, count=known.count + 1))

    def show_only(
        self, prefix: str, slave: int | None, found: Mapping[str, tuple[str, str, Severity]], time: float
    ) -> list[Condition]:
        """Of the conditions whose id begins with ``prefix``, exactly ``found`` are active: title, text, level by id."""
        changed = [
            self.end(id_, time)
            for id_ in sorted(self._of.get(slave, ()))
            if id_.startswith(prefix) and id_ not in found
        ]
        changed += [
            self.show(id_, slave, title, text, level, time) for id_, (title, text, level) in sorted(found.items())
        ]
        return [one for one in changed if one is not None]

    def acknowledge(self, id_: str, time: float, by: str = "", comment: str | None = None) -> Condition | None:
        """Acknowledge a condition; ``comment`` None leaves the one that it has. Returns it; None without one,
        or if it is acknowledged already."""
        known = self._known.get(id_)
        if known is None or known.acked:
            return None
        return self._say(replace(known, acked=True), time, by, comment)

    def comment(self, id_: str, time: float, by: str, comment: str) -> Condition | None:
        """Give a condition another comment. Returns it; None without one."""
        known = self._known.get(id_)
        return None if known is None else self._say(known, time, by, comment)

    def _say(self, condition: Condition, time: float, by: str, comment: str | None) -> Condition:
        said = condition.comment if comment is None else comment
        return self._keep(replace(condition, said_by=by, comment=said, time=time, count=condition.count + 1))

    def _keep(self, condition: Condition) -> Condition:
        """A condition that is not retained is forgotten."""
        if condition.retain:
            self._known[condition.id] = condition
            self._of.setdefault(condition.slave, {})[condition.id] = None
        else:
            self._forget(condition)
        return condition

    def _forget(self, condition: Condition) -> None:
        self._known.pop(condition.id, None)
        self._most_count = max(self._most_count, condition.count)
        ids = self._of.get(condition.slave, {})
        ids.pop(condition.id, None)
        if not ids:
            self._of.pop(condition.slave, None)

    def _make_room(self, slave: int | None) -> bool:
        own = self._of.get(slave, {})
        full = own if len(own) >= MOST_OF_A_SLAVE else self._known if len(self._known) >= MOST_CONDITIONS else None
        if full is None:
            return True
        self.left_out += 1
        oldest = next((known for id_ in full if not (known := self._known[id_]).active), None)
        if oldest is not None:
            self._forget(oldest)
        return oldest is not None
