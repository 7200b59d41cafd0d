"""Recordings of two plants over midnight, as `dpstack run --record --on-change --quality` and `--log` write them: what
docs/how-to/ask-recordings.md asks. North: CSV in two files of a rotation; the same in JSON lines and Parquet."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field
from dpstack.record.columns import Judged, Layout, RecordedSlave
from dpstack.record.rows import END, Rows, Sample
from dpstack.text import json_text
from dpstack.units import NS_PER_S

_ROOT: Final = Path(__file__).resolve().parents[2]
#: 2026-01-31T22:00:00Z, in s since 1970
STARTED: Final = 1_769_896_800
_EXCHANGE, _OFFLINE = "data_exchange", "offline"


class Moment(NamedTuple):
    """``at``: minutes after the start; ``level`` in m, None: not in data exchange; ``quality``: of the level."""

    at: int
    level: float | None
    quality: str = "good"
    pump: bool = True


#: the level of a tank: the transmitter's wire is broken from 23:30 to 00:30, the slave is off from 01:00 to 01:30
NORTH: Final = (
    Moment(0, 5.0),
    Moment(60, 6.0),
    Moment(90, 3276.75, "bad"),
    Moment(150, 6.0, "uncertain"),
    Moment(165, 4.0, pump=False),
    Moment(180, None),
    Moment(210, 2.0),
)
#: a short fault of the same kind in each day
SOUTH: Final = (
    Moment(0, 1.0),
    Moment(30, 3276.75, "bad"),
    Moment(40, 3.0),
    Moment(140, 3276.75, "bad", pump=False),
    Moment(145, 3.0),
)
_ENDED: Final = 240
#: lines of the event log: minute, texts of the diagnosis
_EVENTS: Final = {
    "north": ((90, ["slot 3 (2 AI), input channel 0 (word): line break"]), (150, []), (210, [])),
    "south": (
        (30, ["slot 3 (2 AI), input channel 0 (word): short circuit"]),
        (40, []),
        (140, ["fuse blown"]),
        (145, []),
    ),
}


def _layout() -> Layout:
    level = replace(Field.parse("level", "f32@0"), unit="m")
    fields = FieldMap({"level": level, "pump": Field.parse("pump", "bool@4.0")}, 5)
    tank = RecordedSlave(12, "tank", fields, quality=True)
    return Layout((tank,), STARTED, "plant.toml", True, {"port": "/dev/ttyUSB0", "baud": 500_000})


def _lines(form: str, moments: Sequence[Moment], *, end: bool) -> Iterator[bytes]:
    layout = _layout()
    rows = Rows(layout, form)
    level = layout.slaves[0].inputs.fields["level"]
    yield rows.head()
    for one in moments:
        source: object = None
        if one.level is not None:
            octets = level.put(bytes(4) + bytes([one.pump]), one.level)
            source = Judged(octets, (one.quality, "good"))
        t_ns = one.at * 60 * NS_PER_S
        state = _OFFLINE if one.level is None else _EXCHANGE
        line = rows.row(Sample(layout, t_ns, STARTED * NS_PER_S + t_ns, (state, source, source)))
        assert line is not None
        yield line
    if end:
        t_ns = _ENDED * 60 * NS_PER_S
        yield rows.end(t_ns, STARTED * NS_PER_S + t_ns, END)


def write_recordings(folder: Path, python: Path) -> None:
    """``plants/plant=north`` and ``plants/plant=south``: tank.csv (north: of a rotation), tank.jsonl, tank.parquet,
    events.jsonl. ``python``: an interpreter with pyarrow, which makes the Parquet files as a run does."""
    for name, moments in (("north", NORTH), ("south", SOUTH)):
        place = folder / "plants" / f"plant={name}"
        place.mkdir(parents=True)
        parts: dict[str, Sequence[Moment]] = {"tank.csv": moments}
        if name == "north":
            parts = {"tank_00001_20260131T220000Z.csv": moments[:4], "tank_00002_20260201T004500Z.csv": moments[4:]}
        for file, some in parts.items():
            (place / file).write_bytes(b"".join(_lines("csv", some, end=some[-1] is moments[-1])))
        (place / "tank.jsonl").write_bytes(b"".join(_lines("jsonl", moments, end=True)))
        journal = place / "tank.part.csv"
        journal.write_bytes(b"".join(_lines("csv", moments, end=True)))
        words = (python, "-m", "dpstack.api.recording.parquet", journal, place / "tank.parquet")
        subprocess.run(words, check=True, timeout=120, env={**os.environ, "PYTHONPATH": str(_ROOT)})
        (place / "events.jsonl").write_text("".join(_events(name)), encoding="utf-8")


def _events(plant: str) -> Iterator[str]:
    for minute, texts in _EVENTS[plant]:
        hour, rest = divmod(22 * 60 + minute, 60)
        day = "2026-02-01" if hour >= 24 else "2026-01-31"
        about = {"event": "diagnosis", "t": minute * 60.0, "address": 12, "name": "tank"}
        flags = ["ext_diag"] if texts else []
        text = f"slave 12 (tank): {', '.join(texts) or 'its diagnosis is clear'}"
        line = {**about, "flags": flags, "texts": texts, "text": text, "severity": "warning" if texts else "info"}
        yield json_text({**line, "time": f"{day}T{hour % 24:02}:{rest:02}:00.000Z"}) + "\n"
