"""A crafted recording, replayed into the live state and drawn by the screen.

The input bends the description of the columns, rows and cells of a recording as JSON lines. Judged: the replay
yields items or refuses the file by UsageError; the screen takes or refuses each item, and can be drawn after
each, printable; a slave is alive only while its row says data exchange; the end is shown as the end.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import shutil
import tempfile
from pathlib import Path
from typing import Any

from dpstack.errors import UsageError
from dpstack.record.reader import Recording
from dpstack.record.replay import Replay
from dpstack.screen.view import View
from tests.fuzz.bent_json import bent, text_of
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.targets.live_items import draw

_COLUMNS: list[dict[str, Any]] = [
    {"field": "state", "kind": "state", "type": "text"},
    {"field": "level", "kind": "input", "type": "number", "unit": "bar", "at": "i16@0", "scale": 0.1},
    {"field": "open", "kind": "output", "type": "bool", "at": "bit@0.0"},
    {"field": "speed", "kind": "drive", "type": "number"},
    {"field": "drive_state", "kind": "drive", "type": "text"},
    {"field": "fault", "kind": "drive", "type": "text"},
]
_ABOUT: dict[str, Any] = {
    "recording": {
        "version": 1, "config": "plant.toml", "on_change": False, "bus": {"port": "/dev/ttyUSB0", "baud": 500000},
        "slaves": [{"name": "valves", "address": 3, "columns": _COLUMNS}],
    }
}  # fmt: skip
_NAMES = [f"valves.{column['field']}" for column in _COLUMNS]


def row(t: float, *cells: object, note: str = "") -> dict[str, Any]:
    return {"time": f"2026-01-31T12:00:{t:06.3f}Z", "t": t, **dict(zip(_NAMES, cells, strict=True)), "note": note}


_ROWS: list[dict[str, Any]] = [
    row(1.0, "data_exchange", 3.4, True, 0.5, "running", None),
    row(1.2, "data_exchange", 3.5, False, 0.5, "running", None, note="a note"),
    row(1.4, "fault", None, None, None, "fault", "F1"),
    row(9.0, "data_exchange", 1, True, 0.0, "ready", None),
]


@functools.cache
def folder() -> Path:
    """A folder of this process, removed at its end."""
    found = Path(tempfile.mkdtemp(prefix="dpstack-fuzz-"))
    atexit.register(shutil.rmtree, found, True)
    return found


def run(octets: bytes) -> None:
    script = Cutter(octets)
    head = script.octet()
    lines = [text_of(bent(_ABOUT, script))]
    while script.at < len(octets) and len(lines) < 12:
        how = script.octet()
        right = _ROWS[how % len(_ROWS)]
        lines.append(text_of(bent(right, script)) if how & 0x80 else script.take(how & 31).decode("latin-1"))
        if how & 0x40:
            lines.append(text_of(right))
    path = folder() / "plant.jsonl"
    path.write_text("\n".join(lines) + "\n" * (head & 1), encoding="utf-8", errors="surrogatepass")
    view, now = View(), 1.0
    with contextlib.suppress(UsageError):
        for number, (at, item) in enumerate(Replay(Recording(path)).items(0.3 if head & 2 else 0.0)):
            assert at >= 0
            now += 0.1
            try:
                view.apply(item, now)
            except ValueError as error:
                assert_plain(str(error))
            if number < 20:
                draw(view, 20 + (head >> 2))
            if "end" in item:
                assert not view.fresh


TARGET = Target(run=run, covers=("dpstack.record", "dpstack.plant", "dpstack.screen"), executions=100_000, max_len=200)
