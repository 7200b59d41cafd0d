"""The plant as the screen shows it: freshness, slaves that are alive, values that have just changed, the filter."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

from msgspec import structs

from dpstack.plant.items import FieldPlant, Item, QualityValues, SlavePlant, SlaveValues, Snapshot, check_item
from dpstack.plant.judge import exchanging
from dpstack.plant.quality import Quality
from dpstack.plant.state import LiveState

#: without a snapshot for this long (s) nothing counts as fresh: one comes every 0.1 s
SILENT_S: Final = 2.0
#: a value is marked as changed for this long (s)
CHANGED_S: Final = 1.0
#: marks of changed values that are kept, also if they are older
_MOST_CHANGED: Final = 10_000
#: styles of severities and of levels
_STYLES: Final = {"error": "bad", "warning": "warn", "good": "good"}
#: qualities that the screen adds: it gets nothing new, or an older version sends no qualities
_NOT_OF_NOW: Final = QualityValues(Quality.STALE.value, "stream_silent", "nothing here is of this moment")
_NOT_ALIVE: Final = QualityValues(Quality.STALE.value, "not_valid", "the inputs of the slave are not valid")
#: severities of diagnoses by the quality that they leave
_SEVERITIES: Final = {Quality.BAD.value: "error", Quality.UNCERTAIN.value: "warning"}
#: events about places of one slave in one snapshot; the others are counted in one
_MOST_PLACES: Final = 8
#: reason of a doubt that lasts until the diagnosis is read
_ANNOUNCED: Final = "announced"
_NO_PLANT: Final = SlavePlant()
_NO_VALUES: Final = SlaveValues()


class View:
    """``state``: the merged items. Times are those of one monotonic clock in s."""

    def __init__(self) -> None:
        self.state = LiveState()
        self.now = 0.0
        #: the bus process was reported silent, and not back yet
        self.process_silent = False
        self._received_at = 0.0
        self._changed: dict[tuple[str, str], float] = {}
        #: by address: the doubts of the last snapshot in data exchange, with their severities
        self._standing: dict[str, dict[str, str]] = {}

    def apply(self, item: Item, now: float) -> None:
        """Take an item of the stream. Raises ValueError for something else."""
        checked = check_item(item)
        self.now = now
        if checked.plant is not None or checked.snapshot is not None:  # events alone do not make old values fresh
            self._received_at = now
        if checked.snapshot is not None:
            self._mark_changes(checked.snapshot, now)
        if checked.plant is not None and checked.plant.whole:
            self._standing = {}
        self.state.apply_checked(checked)
        if checked.snapshot is not None:
            for address in checked.snapshot.slaves:
                self._note_diagnoses(address)
        if checked.event is not None and checked.event.event == "bus_process":
            self.process_silent = checked.event.silent is True

    def _mark_changes(self, snapshot: Snapshot, now: float) -> None:
        if len(self._changed) > _MOST_CHANGED:
            self._changed = {key: at for key, at in self._changed.items() if now - at < CHANGED_S}
        for address, values in snapshot.slaves.items():
            before = self.values(address).fields
            if before:
                for name, value in (values.fields or {}).items():
                    if before.get(name) != value:
                        self._changed[address, name] = now

    def _note_diagnoses(self, address: str) -> None:
        """Add an event for each place of a slave that has a diagnosis now and had none before, and the other way round.
        Nothing is known of a slave outside data exchange: its diagnoses may stand."""
        values = self.values(address)
        before = self._standing.get(address, {})
        if not exchanging(values) or (not values.doubts and not before):
            return
        doubts = [one for one in values.doubts or () if one.reason != _ANNOUNCED]
        now = {one.text: _SEVERITIES.get(one.quality, "info") for one in doubts}
        since = {one.text: one.since for one in doubts}
        found = [("appears", text, severity) for text, severity in now.items() if text not in before]
        found += [("gone", text, "info") for text in before if text not in now]
        for number, (change, text, severity) in enumerate(found):
            at = since.get(text)
            event = {"event": "place", "change": change, "severity": severity, "address": int(address)}
            if number == _MOST_PLACES:
                event |= {"change": "changes", "text": f"{len(found) - number} more diagnoses, {self.who(address)}"}
            else:
                event["text"] = f"{text}, {self.who(address)}"
            self.state.events.append(event | {"time": self._iso(self.state.t if at is None else at)})
            if number == _MOST_PLACES:
                break
        self._standing[address] = now

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
        """Whether the last snapshot is of this moment: the bus runs, its process counts, and ``run`` sends it."""
        stale = self.process_silent or self.state.bus.stale
        return not stale and self.state.end is None and self.silent_s < SILENT_S

    def alive(self, address: str) -> bool:
        """Whether the values of this slave are those of now."""
        return self.fresh and self.values(address).alive is True

    def age_s(self, address: str) -> float | None:
        """Age of the inputs; None before the first ones."""
        age = self.values(address).inputs_age_ms
        return None if age is None else age / 1000 + self.silent_s

    def just_changed(self, address: str, name: str) -> bool:
        return self.now - self._changed.get((address, name), -CHANGED_S) < CHANGED_S

    def quality(self, address: str, name: str | None = None) -> QualityValues | None:
        """The quality of a named value, or of everything that the slave and its drive send; None: good."""
        values = self.values(address)
        told = (values.qualities or {}).get(name or "") or values.quality
        if told is not None and (told.quality == Quality.BAD or self.fresh):
            return told
        if not self.fresh:
            return _NOT_OF_NOW
        return None if values.alive else _NOT_ALIVE

    def quality_of(self, address: str, field: FieldPlant) -> QualityValues | None:
        """As :meth:`quality`, without the word for the number, which stands beside the number."""
        told, word = self.quality(address, field.name), field.word((self.values(address).fields or {}).get(field.name))
        if told is None or not word or not told.text.startswith(word):
            return told
        rest = told.text[len(word) :].removeprefix("; ")
        return structs.replace(told, text=rest) if rest or told.quality != Quality.GOOD else None

    def clock(self, t: float | None) -> str:
        """The wall clock of ``t`` s after the start; empty if it is not known."""
        return clock_text({"time": self._iso(t)})

    def _iso(self, t: float | None) -> str:
        started = -1.0 if self.state.plant is None else self.state.plant.started
        if t is not None and t >= 0 and started >= 0:
            with contextlib.suppress(ValueError, OverflowError, OSError):  # beyond the years of a clock
                return datetime.fromtimestamp(started + t, UTC).isoformat()
        return ""

    # --- slaves ---------------------------------------------------------------------------------------------------

    def slave_plant(self, address: str) -> SlavePlant:
        """The slave as configured; without content if it is not."""
        return _NO_PLANT if self.state.plant is None else self.state.plant.slaves.get(address, _NO_PLANT)

    def who(self, address: str) -> str:
        """Address and name, for texts."""
        name = self.name(address)
        return f"slave {address} ({name})" if name else f"slave {address}"

    def name(self, address: str) -> str:
        return self.slave_plant(address).name

    def values(self, address: str) -> SlaveValues:
        """State and values of the slave; without content before the first."""
        return self.state.slaves.get(address, _NO_VALUES)

    def remark(self, address: str) -> tuple[str, str]:
        """The most important thing to say about a slave, and its style; empty if all is well."""
        remark = self.values(address).remark
        return ("", "") if remark is None else (remark.text, _STYLES.get(remark.severity, "warn"))

    def mark(self, address: str) -> tuple[str, str]:
        """One sign for the state of a slave, and its style: ``*`` alive, ``!`` something is wrong, ``-`` not alive."""
        level = self.values(address).level
        if self.alive(address):
            return ("*", "good") if level == "good" else ("!", _STYLES.get(str(level), "warn"))
        return ("!", "bad") if level == "error" else ("-", "bad")

    def addresses(self, words: str = "", *, conspicuous: bool = False) -> list[str]:
        """Addresses of the slaves, in order, that have each of ``words`` in address, name, state or remark;
        ``conspicuous``: only those that are not alive, or with a remark."""
        wanted = words.casefold().split()
        known = set(self.state.slaves) | set(() if self.state.plant is None else self.state.plant.slaves)
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
        """The slave's state for people; ``not valid`` also if no snapshots come any more."""
        values = self.values(address)
        return "not valid" if values.alive and not self.fresh else values.state_text or "unknown"

    def events_of(self, address: str | None = None) -> list[dict[str, Any]]:
        """Events, oldest first, without repetitions of the same text about the same slave; of one slave."""
        last: dict[object, object] = {}
        found = []
        for event in self.state.events:
            of, text = event.get("address"), (event.get("text"), event.get("change"))
            if address is not None and str(of) != address:
                continue
            if of is None or last.get(of) != text:
                found.append(event)
            last[of] = text
        return found


def clock_text(event: Mapping[str, Any]) -> str:
    """The wall clock of an event in local time; empty if it has none."""
    try:
        return datetime.fromisoformat(str(event["time"])).astimezone().strftime("%H:%M:%S")
    except (KeyError, ValueError):
        return ""
