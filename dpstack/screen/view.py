"""The plant as the screen shows it: freshness, slaves that are alive, values that have just changed, the filter."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from datetime import datetime
from typing import Any, Final

from dpstack.plant.items import check_item
from dpstack.plant.state import Item, LiveState

#: without a snapshot for so long (s) nothing counts as fresh: one comes every 0.1 s
SILENT_S: Final = 2.0
#: a value is marked as changed for so long (s)
CHANGED_S: Final = 1.0
#: marks of changed values that are kept, also where they are older
_MOST_CHANGED: Final = 10_000
#: styles of severities and of levels
_STYLES: Final = {"error": "bad", "warning": "warn", "good": "good"}
#: kinds of items that bring values
_VALUES: Final = ("plant", "snapshot")


class View:
    """``state``: the merged items. Times are those of one monotonic clock in s."""

    def __init__(self) -> None:
        self.state = LiveState()
        self.now = 0.0
        #: the bus process was reported silent, and not back yet
        self.process_silent = False
        self._received_at = 0.0
        self._changed: dict[tuple[str, str], float] = {}

    def apply(self, item: Item, now: float) -> None:
        """Take an item of the stream. Raises ValueError for something else."""
        kind = check_item(item)
        self.now = now
        if kind in _VALUES:  # events alone do not make old values fresh
            self._received_at = now
        snapshot = item.get("snapshot")
        if isinstance(snapshot, dict):
            self._mark_changes(snapshot, now)
        self.state.apply_checked(item)
        event = item.get("event")
        if isinstance(event, dict) and event.get("event") == "bus_process":
            self.process_silent = bool(event.get("silent"))

    def _mark_changes(self, snapshot: Mapping[str, Any], now: float) -> None:
        if len(self._changed) > _MOST_CHANGED:
            self._changed = {key: at for key, at in self._changed.items() if now - at < CHANGED_S}
        for address, values in snapshot.get("slaves", {}).items():
            before = self.state.slaves.get(address, {}).get("fields")
            if before:
                for name, value in (values.get("fields") or {}).items():
                    if before.get(name) != value:
                        self._changed[address, name] = now

    def frozen(self) -> View:
        """A copy that stands still."""
        return copy.deepcopy(self)

    # --- freshness ------------------------------------------------------------------------------------------------

    @property
    def silent_s(self) -> float:
        """Seconds since the last snapshot or plant."""
        return max(0.0, self.now - self._received_at)

    @property
    def fresh(self) -> bool:
        """Whether the last snapshot is of this moment: the bus runs, its process counts, and ``run`` tells it."""
        stale = self.process_silent or self.state.bus.get("stale", False)
        return not stale and self.state.end is None and self.silent_s < SILENT_S

    def alive(self, address: str) -> bool:
        """Whether the values of this slave are those of now."""
        return self.fresh and self._values(address).get("alive") is True

    def age_s(self, address: str) -> float | None:
        """Age of the inputs; None where there were none."""
        age = self._values(address).get("inputs_age_ms")
        return None if age is None else age / 1000 + self.silent_s

    def just_changed(self, address: str, name: str) -> bool:
        return self.now - self._changed.get((address, name), -CHANGED_S) < CHANGED_S

    # --- slaves ---------------------------------------------------------------------------------------------------

    def slave_plant(self, address: str) -> dict[str, Any]:
        """The slave as configured; empty where it is not."""
        slaves: dict[str, dict[str, Any]] = (self.state.plant or {}).get("slaves", {})
        return slaves.get(address, {})

    def name(self, address: str) -> str:
        return str(self.slave_plant(address).get("name", ""))

    def _values(self, address: str) -> dict[str, Any]:
        return self.state.slaves.get(address, {})

    def remark(self, address: str) -> tuple[str, str]:
        """The most important thing to say about a slave, and its style; empty where all is well."""
        remark = self._values(address).get("remark")
        return (remark["text"], _STYLES.get(remark["severity"], "warn")) if remark else ("", "")

    def mark(self, address: str) -> tuple[str, str]:
        """One sign for the state of a slave, and its style: ``*`` alive, ``!`` something is wrong, ``-`` not alive."""
        level = self._values(address).get("level")
        if self.alive(address):
            return ("*", "good") if level == "good" else ("!", _STYLES.get(str(level), "warn"))
        return ("!", "bad") if level == "error" else ("-", "bad")

    def addresses(self, words: str = "", *, conspicuous: bool = False) -> list[str]:
        """Addresses of the slaves, in order, that have each of ``words`` in address, name, state or remark;
        ``conspicuous``: only those that are not alive, or with a remark."""
        wanted = words.casefold().split()
        known = set(self.state.slaves) | set((self.state.plant or {}).get("slaves", {}))
        found = []
        for address in sorted(known, key=lambda text: (len(text), text)):
            if conspicuous and self.mark(address)[0] == "*":
                continue
            if wanted:
                texts = (address, self.name(address), self.state_text(address), self.remark(address)[0])
                text = " ".join(texts).casefold()
                if not all(word in text for word in wanted):
                    continue
            found.append(address)
        return found

    def state_text(self, address: str) -> str:
        """The slave's state for people; ``not valid`` also where no snapshots come any more."""
        values = self._values(address)
        text = str(values.get("state_text", "unknown"))
        return "not valid" if values.get("alive") and not self.fresh else text

    def events_of(self, address: str | None = None) -> list[dict[str, Any]]:
        """Events, oldest first, without repetitions of the same text about the same slave; of one slave."""
        last: dict[object, object] = {}
        found = []
        for event in self.state.events:
            of, text = event.get("address"), event.get("text")
            if address is not None and str(of) != address:
                continue
            if of is None or last.get(of) != text:
                found.append(event)
            last[of] = text
        return found


def clock_text(event: Mapping[str, Any]) -> str:
    """The wall clock of an event in local time; empty where it has none."""
    try:
        return datetime.fromisoformat(str(event["time"])).astimezone().strftime("%H:%M:%S")
    except (KeyError, ValueError):
        return ""
