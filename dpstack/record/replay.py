"""A recording as the items of a live stream: plant, snapshots, events, end; at real speed, or any other."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from msgspec import convert, structs, to_builtins

from dpstack.errors import UsageError
from dpstack.plant.items import DriveValues, QualityValues, SlaveValues
from dpstack.plant.judge import exchanging, judged
from dpstack.plant.quality import Quality, base_type
from dpstack.record.columns import QUALITY, Cell, Column, Kind
from dpstack.record.reader import Recording, Row
from dpstack.record.rows import END
from dpstack.text import iso_time

Item = dict[str, dict[str, Any]]
#: seconds between two snapshots
INTERVAL_S: Final = 0.1
#: this much earlier a row is due, too
_JITTER_S: Final = 0.005
#: longer times without a row are not waited for
_LONGEST_PAUSE_S: Final = 10.0
#: rows read between two looks at other tasks
_ROWS_AT_ONCE: Final = 500
#: keys of a live snapshot that no recording has; null in the first one
_NOT_RECORDED_OF_BUS: Final = (
    *("mode", "in_ring", "masters", "clear", "rotations", "rotation_us", "token_us", "histogram", "histograms"),
)
_NOT_RECORDED_OF_SLAVE: Final = (
    *(
        "inputs",
        "outputs",
        "held",
        "inputs_age_ms",
        "inputs_limit_ms",
        "held_fields",
        "withheld",
        "quality",
        "doubts",
        "fault",
        "diagnosis",
        "conspicuous",
        "alarms",
        "drives",
    ),
    *(
        "exchanges",
        "retries",
        "timeouts",
        "telegrams",
        "late",
        "wrong",
        "bad",
        "watchdog_ms",
        "master",
        "links",
        "clock",
        "injected",
    ),
)
#: keys of a slave that a recording has, or that follow from it
_RECORDED: Final = ("state", "inputs_valid", "qualities", "drive", "alive", "level", "state_text", "remark")
#: severity of an event about a state
_WARNING_STATES: Final = ("fault", "offline", "diagnosis")


class Replay:
    """The items of a recording, without time: each with its place ``at`` in s since the first row.

    Slaves of a recording that does not say their addresses get the addresses 1, 2 ... in their order.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._columns: dict[str, list[Column]] = {}  # by slave
        for column in recording.columns.values():
            self._columns.setdefault(column.slave, []).append(column)
        self._addresses = _addresses(self._columns)
        self._began = 0.0  # s since 1970 at the first row
        self._known: dict[str, Cell] = {}  # states, by column

    def items(self, start: float = 0.0) -> Iterator[tuple[float, Item]]:
        """From ``start`` s on. Raises UsageError for a recording without rows, or one that is shorter."""
        shown: float | None = None  # place of the last snapshot
        due: Row | None = None  # a row behind it
        last: Row | None = None
        for row in self._recording.rows():
            if last is None:
                self._began = row.time
            before, last = last, row
            if row.at < start:
                due = row  # the values that hold at the start
                self._note_states(row)
                continue
            if shown is None:
                yield row.at, {"plant": self._plant()}
                yield row.at, self._event(row, "replay", "info", f"replay of {self._recording.path.name}")
                yield row.at, self._snapshot(due or row, row.at, whole=True)
                shown = row.at
            elif row.gap and before is not None:
                yield before.at, self._nothing(before)
            yield from ((row.at, event) for event in self._events(row))
            due = row
            if row.at - shown >= INTERVAL_S - _JITTER_S or row.gap:
                yield row.at, self._snapshot(row, row.at)
                shown, due = row.at, None
        if last is None:
            raise UsageError(f"{self._recording.path}: has no rows; nothing was recorded, or every line is damaged")
        if shown is None:
            raise UsageError(f"{self._recording.path}: is {last.at:.1f} s long; start before that")
        if due is not None:
            yield last.at, self._snapshot(last, last.at)
        for remark in self._recording.remarks:
            yield last.at, self._event(last, "note", "warning", remark)
        yield last.at, {"end": {"text": f"end of the recording {self._recording.path.name}"}}

    def _plant(self) -> dict[str, Any]:
        slaves = {}
        for name, columns in self._columns.items():
            drive = any(column.kind is Kind.DRIVE for column in columns)
            slaves[str(self._addresses[name])] = {
                "name": name,
                "address": self._addresses[name],
                **dict.fromkeys(("ident", "gsd", "watchdog_ms"), None),
                **dict.fromkeys(("vendor", "model", "safe"), ""),
                "every": 1,
                "modules": [],
                "groups": [],
                "dpv1": False,
                "input_len": None,
                "output_len": None,
                "inputs": [_field(one) for one in columns if one.kind in (Kind.INPUT, None)],
                "outputs": [_field(one) for one in columns if one.kind is Kind.OUTPUT],
                "drive": dict.fromkeys(("profile", "telegram", "reference_hz", "reference_rpm")) if drive else None,
                "drives": None,
            }
        given = self._recording.about.get("bus")
        bus = given if isinstance(given, dict) else {}
        return {
            "version": 1,
            "source": "replay",
            "started": round(self._began, 3),
            **{key: bus.get(key) for key in ("port", "baud", "driver", "address")},
            "read_only": True,
            "virtual": False,
            "paced": True,
            "config": self._recording.config,
            "config_digest": None,
            "parameters": {},
            "plan": {"rotation_us": None, "cycle_us": None},
            "slaves": slaves,
        }

    def _snapshot(self, row: Row, at: float, *, whole: bool = False) -> Item:
        no_more: dict[str, Any] = dict.fromkeys(_NOT_RECORDED_OF_SLAVE) if whole else {}
        slaves = {}
        for name, columns in self._columns.items():
            slaves[str(self._addresses[name])] = no_more | self._slave(columns, row)
        bus: dict[str, Any] = dict.fromkeys(_NOT_RECORDED_OF_BUS) if whole else {}
        return {"snapshot": {"t": round(at, 3), "whole": whole, "source": "replay", "bus": bus, "slaves": slaves}}

    def _nothing(self, row: Row) -> Item:
        """The snapshot of a time of which nothing is known."""
        empty = Row(row.time, row.t, row.at, dict.fromkeys(self._recording.columns))
        return self._snapshot(empty, row.at)

    def _slave(self, columns: list[Column], row: Row) -> dict[str, Any]:
        values = {column: row.values.get(column.name) for column in columns}
        fields = {c.field: value for c, value in values.items() if c.kind in (Kind.INPUT, Kind.OUTPUT, None)}
        inputs = [value for column, value in values.items() if column.kind in (Kind.INPUT, None)]
        given = next((value for column, value in values.items() if column.kind is Kind.STATE), None)
        drive = {c.field: value for c, value in values.items() if c.kind is Kind.DRIVE}
        found = SlaveValues(state=None if given is None else _shown(given), drive=_drive(drive) if drive else None)
        valid = any(value is not None for value in inputs) if given is None else exchanging(found)
        words = {
            column.field.removesuffix(QUALITY): value for column, value in values.items() if column.kind is Kind.QUALITY
        }
        found = judged(structs.replace(found, inputs_valid=valid, qualities=_qualities(words) or None))
        return {"fields": fields} | {key: to_builtins(getattr(found, key)) for key in _RECORDED}

    def _note_states(self, row: Row) -> Iterator[tuple[Column, Cell]]:
        """The states that ``row`` changes."""
        changed = []
        for column in self._recording.columns.values():
            if column.kind is Kind.STATE or (column.kind is Kind.DRIVE and column.type == "text"):
                now = row.values.get(column.name)
                if column.name not in self._known or self._known[column.name] != now:
                    changed.append((column, now))
                self._known[column.name] = now
        return iter(changed)

    def _events(self, row: Row) -> Iterator[Item]:
        if row.note:
            yield self._event(row, "note", "info" if row.note.startswith(END) else "warning", row.note)
        first = not self._known
        for column, now in self._note_states(row):
            if first or now is None:
                continue
            severity = "warning" if now in _WARNING_STATES or column.field == "fault" else "info"
            kind = "slave" if column.kind is Kind.STATE else "drive"
            more = {"address": self._addresses[column.slave], "name": column.slave}
            yield self._event(row, kind, severity, f"{column.slave}: {column.field} {_shown(now)}", **more)

    def _event(self, row: Row, kind: str, severity: str, text: str, **more: object) -> Item:
        event = {"event": kind, "t": round(row.at, 6), "time": iso_time(row.time), "severity": severity, "text": text}
        return {"event": {**event, "source": "replay", **more}}


def _addresses(columns: Mapping[str, list[Column]]) -> dict[str, int]:
    given = {name: _address(found) for name, found in columns.items()}
    taken = set(given.values())
    free = (address for address in itertools.count(1) if address not in taken)
    return {name: next(free) if address is None else address for name, address in given.items()}


def _qualities(words: Mapping[str, Cell]) -> dict[str, QualityValues]:
    """The qualities that a recording has columns for, but those that are good; it keeps no reasons."""
    return {
        name: QualityValues(word, "", word)
        for name, word in words.items()
        if word in (Quality.UNCERTAIN, Quality.BAD) and isinstance(word, str)
    }


def _address(columns: Sequence[Column]) -> int | None:
    return next((column.address for column in columns if column.address is not None), None)


def _shown(cell: Cell) -> str:
    return cell.hex() if isinstance(cell, bytes) else str(cell)


def _field(column: Column) -> dict[str, Any]:
    return {
        "name": column.field,
        "type": base_type(column.at) or column.type,
        "at": column.at,
        **dict.fromkeys(("slot", "channel")),
        "scale": column.scale,
        "offset": column.offset,
        "unit": column.unit,
        "dead_band": column.dead_band,
    }


def _drive(values: Mapping[str, Cell]) -> DriveValues:
    """The status of a drive as ``run --json`` has it, as far as it was recorded."""
    state, fault, warning = values.get("drive_state"), values.get("fault"), values.get("warning")
    quantities = {key: values.get(key) for key in ("setpoint", "speed", "frequency_hz", "current", "torque")}
    return convert(
        {
            **quantities,
            "state": None if state is None else _shown(state),
            "running": state == "running",
            "faults": [_shown(fault)] if fault else [],
            "warnings": [_shown(warning)] if warning else [],
            "words": [],
            "bits": [],
            "settings_texts": [],
        },
        DriveValues,
    )


async def replay_items(
    path: str | Path,
    speed: float = 1.0,
    start: float = 0.0,
    *,
    sleep: Callable[[float], Any] = asyncio.sleep,
) -> AsyncIterator[Item]:
    """The recording ``path`` as the items of a live stream, ``speed`` times as fast as it was, from ``start`` s on.

    First ``plant``, then ``snapshot`` and ``event`` in their order, each when it is due, at last ``end``. Plant,
    snapshots and events have ``"source": "replay"``. Times of more than 10 s without a row are shortened to that.

    Raises UsageError for anything that is no recording, for a recording without rows, for a ``start`` behind its end,
    and for a ``speed`` of 0 or less.
    """
    if not 0 < speed < float("inf"):
        raise UsageError(f"speed = {speed}: give a number above 0, 1 for real time")
    replay = Replay(Recording(path))
    clock = asyncio.get_running_loop().time
    began: float | None = None
    before = 0.0
    for number, (at, item) in enumerate(replay.items(start)):
        if began is None:
            began, before = clock(), at
            origin = at
        if at - before > _LONGEST_PAUSE_S:
            origin += at - before - _LONGEST_PAUSE_S
        before = max(before, at)
        wait = began + (at - origin) / speed - clock()
        if wait > 0:
            await sleep(wait)
        elif number % _ROWS_AT_ONCE == 0:
            await sleep(0)
        yield item
