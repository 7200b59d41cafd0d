"""Configuration files as a user writes them: the keys of [bus] and the [[slave]] tables of a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

Tables = Mapping[str, Mapping[str, object]]
NO_TABLES: Tables = {}


def toml(value: object) -> str:
    """``value`` as it stands in a TOML file."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str | Path):
        return '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{toml(str(key))} = {toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(toml(one) for one in value) + "]"
    return str(value)


def _table(head: str, keys: Mapping[str, object]) -> str:
    return "\n".join([head, *(f"{key} = {toml(value)}" for key, value in keys.items()), "", ""])


def plant_text(*slaves: Mapping[str, object], tables: Tables = NO_TABLES, **bus: Any) -> str:
    """A configuration with the tables of ``slaves``; [bus] is on the port "virtual" at 500 kbit/s, with ``bus``.

    ``tables``: others by their names, for instance {"mqtt": {"url": ...}}.
    """
    text = _table("[bus]", {"port": "virtual", "baud": 500_000, **bus})
    text += "".join(_table("[[slave]]", slave) for slave in slaves)
    return text + "".join(_table(f"[{name}]", keys) for name, keys in tables.items())


def plant_file(folder: Path, *slaves: Mapping[str, object], tables: Tables = NO_TABLES, **bus: Any) -> Path:
    """:func:`plant_text` as the file ``plant.toml`` in ``folder``."""
    path = folder / "plant.toml"
    path.write_text(plant_text(*slaves, tables=tables, **bus), encoding="utf-8")
    return path
