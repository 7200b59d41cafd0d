"""The reader of recordings (CSV, JSON lines): damaged lines are left out, a wrong file is a UsageError."""

from __future__ import annotations

import itertools
import json
import math
import os
import tempfile
from pathlib import Path
from typing import Final

from dpstack.errors import UsageError
from dpstack.record.columns import Column
from dpstack.record.reader import Recording
from dpstack.record.replay import Replay
from dpstack.text import json_text
from tests.fuzz.frame import Target, assert_plain

#: in memory where the system has such a place
_FOLDER: Final = Path("/dev/shm") if os.access("/dev/shm", os.W_OK) else Path(tempfile.gettempdir())
_MOST_ITEMS: Final = 30


def run(octets: bytes) -> None:
    """The octets are a CSV file, or JSON lines where they begin with a brace."""
    path = _FOLDER / f"dpstack-fuzz-{os.getpid()}{'.jsonl' if octets[:1] == b'{' else '.csv'}"
    path.write_bytes(octets)
    try:
        _read(path)
    except UsageError as error:
        assert_plain(str(error))
    finally:
        path.unlink()


def _read(path: Path) -> None:
    recording = Recording(path)
    for name, column in recording.columns.items():
        assert isinstance(name, str)
        assert isinstance(column, Column)
    at = 0.0
    for row in recording.rows():
        assert math.isfinite(row.time)
        assert math.isfinite(row.t)
        assert row.at >= at
        at = row.at
        assert set(row.values) <= {column.name for column in recording.columns.values()}
    for remark in recording.remarks:
        assert_plain(remark)
    for _, item in itertools.islice(Replay(recording).items(0.0), _MOST_ITEMS):
        json.dumps(item, allow_nan=False)
        assert_plain(json_text(item))


_JSON: Final = (
    b'{"recording":{"version":1,"on_change":true,"config":"a","slaves":[{"name":"a","address":3,"columns":'
    b'[{"field":"level","kind":"input","type":"number","unit":"bar","at":"i16@0","scale":0.1}]}]}}\n'
)

TARGET = Target(
    run,
    covers=("dpstack.record.reader", "dpstack.record.columns", "dpstack.record.replay"),
    max_len=300,
    words=(
        b"time,t,a.state,a.level [bar],note\n",
        b'2026-01-31T12:00:00.005Z,0.005000,data_exchange,12.3,"x, y"\n',
        _JSON,
        b'{"time":"2026-01-31T12:00:00Z","t":0.5,"a.level":1.5,"note":"n"}\n',
        b'"{""recording"":{""slaves"":[]},""note"":""n""}"\n',
        b"1e400",
        b"1" * 320,
        b"nan",
        b"NaN",
        b"Infinity",
        b"\xef\xbb\xbf",
        b"\r\n",
        b"0001-01-01T00:00:00+23:59",
    ),
)
