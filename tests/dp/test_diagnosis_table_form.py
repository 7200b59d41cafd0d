"""The form of the table of real diagnoses (diagnoses/*.toml): whole rows, octets that parse, sources, enough kinds."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parent / "diagnoses"
Row = dict[str, Any]
ROWS: list[Row] = [
    {**row, "file": path.name}
    for path in sorted(FOLDER.glob("*.toml"))
    for row in tomllib.loads(path.read_text())["row"]
]
NEEDED = {"id", "kind", "maker", "device", "source", "octets_from", "config", "diagnoses", "values", "expect", "why"}
NEEDED |= {"first_slot", "dpv1", "exchange", "file"}
OPTIONAL = {"also", "gsd", "inputs", "status"}
LEAST = {
    "channel": 12,
    "identifier": 6,
    "device": 6,
    "module status": 6,
    "alarm": 5,
    "overflow or static": 3,
    "status classic": 3,
    "status condensed": 3,
    "strange": 3,
    "limit": 3,
    "bring-up": 1,
}
FIELD = r"(bool|[iu](8|16|32|64)|f(32|64))"
PLACE = re.compile(rf"(out )?(slot \d+ channel \d+ {FIELD}|bool@\d+\.[0-7]|{FIELD}@\d+)")


def octets(text: str) -> bytes:
    assert re.fullmatch(r"[0-9a-f]{2}( [0-9a-f]{2})*", text), text
    return bytes.fromhex(text)


def slots_of(config: bytes) -> int:
    """Identifiers of a Chk_Cfg: compact ones of one octet, special ones with their lengths and maker's octets."""
    count = at = 0
    while at < len(config):
        special = config[at] & 0x30 == 0
        lengths = (0, 1, 1, 2)[config[at] >> 6] if special else 0
        at += 1 + lengths + (config[at] & 0x0F if special else 0)
        count += 1
    assert at == len(config), "the last identifier is cut"
    return count


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row["id"]))
def test_a_row_is_whole(row: Row) -> None:
    assert NEEDED <= set(row) <= NEEDED | OPTIONAL
    assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", row["id"])
    assert row["octets_from"] in ("printed", "bit table")
    assert len(row["source"]) > 20
    assert len(row["why"]) > 20
    assert "://" not in row["source"]
    assert {row["kind"], *row.get("also", [])} <= set(LEAST)
    assert row["first_slot"] in (0, 1)
    assert isinstance(row["dpv1"], bool)
    assert isinstance(row["exchange"], bool)
    assert row["diagnoses"]
    for answer in row["diagnoses"]:
        status = octets(answer)
        assert 6 <= len(status) <= 244
        assert status[1] & 0x04, "status 2 bit 2 is always 1"
    slots = slots_of(octets(row["config"]))
    assert set(row["values"]) == set(row["expect"])
    for place in row["values"].values():
        assert PLACE.fullmatch(place), place
        if named := re.search(r"slot (\d+)", place):
            assert row["first_slot"] <= int(named[1]) < row["first_slot"] + slots
    for quality, fragment in row["expect"].values():
        assert quality in ("good", "uncertain", "bad")
        assert fragment == fragment.lower()
    assert set(row.get("status", {})) <= set(row["values"])
    for status_octet in row.get("status", {}).values():
        assert set(status_octet) == {"at", "quality"}
        assert re.fullmatch(r"u8@\d+", status_octet["at"])
        assert status_octet["quality"] in ("pa-classic", "pa-condensed")
        assert len(octets(row["inputs"])) > int(status_octet["at"][3:])


def test_each_id_occurs_once() -> None:
    assert [name for name, times in Counter(row["id"] for row in ROWS).items() if times > 1] == []


def test_the_table_has_enough_rows_of_each_kind() -> None:
    kinds = Counter(kind for row in ROWS for kind in {row["kind"], *row.get("also", [])})
    assert {kind: kinds[kind] for kind, least in LEAST.items() if kinds[kind] < least} == {}
    assert len(ROWS) >= 45
