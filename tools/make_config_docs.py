"""Writes the tables of docs/reference/configuration.md from the keys of the readers; a test holds the page to them."""

from __future__ import annotations

import inspect
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from dpstack.api.config.bus import BusConfig
from dpstack.api.config.connectors import CONNECTORS
from dpstack.api.config.dpv1 import Dpv1Keys
from dpstack.api.config.simulate import SimulateConfig, SimulateKeys
from dpstack.api.config.slave import Changes, FieldKeys, IdentKeys, SlaveConfig, SlaveKeys
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.process_data import Field
from dpstack.dp.slave_params import SlaveParams
from dpstack.toml.table import Key, Octets, keys_of

TARGET: Final = Path(__file__).resolve().parent.parent / "docs" / "reference" / "configuration.md"
#: the class of each table, and the one whose fields have the plain defaults
TABLES: Final[Mapping[str, tuple[type, type]]] = {
    "bus": (BusConfig, BusConfig),
    "slave": (SlaveKeys, SlaveConfig),
    "parameters": (Changes, SlaveParams),
    "ident": (IdentKeys, SlaveParams),
    "dpv1": (Dpv1Keys, Dpv1),
    "field": (FieldKeys, Field),
    "simulate": (SimulateKeys, SimulateConfig),
    **{name: (table, table) for name, table in CONNECTORS.items()},
}
#: what a value is, where its type says it wholly
_PLAIN: Final = {str: "a text", bool: "true, false", bytes: "octets", Mapping: "a table"}
#: an entry of a docstring: the key, and its sentence in lines that are set in
_ENTRY: Final = re.compile(r"^(\w+): (.*(?:\n +.*)*)", re.MULTILINE)
#: a link in a docstring names a page of docs/ without its folder
_LINK: Final = re.compile(r"(?<=\]\()[\w-]+\.md")


def sentences(table: type) -> dict[str, str]:
    """The text for each key from the docstring of ``table``."""
    entries = _ENTRY.findall(inspect.getdoc(table) or "")
    return {key: _LINK.sub(_relative, " ".join(text.split())) for key, text in entries}


def _relative(link: re.Match[str]) -> str:
    """The path of the linked page, as seen from TARGET."""
    (page,) = TARGET.parent.parent.glob(f"*/{link[0]}")
    return os.path.relpath(page, TARGET.parent)


def _number(value: float) -> str:
    return f"{value:g}" if isinstance(value, float) and not value.is_integer() else str(int(value))


def value_text(hint: Any, key: Key) -> str:
    """The values of a key, from its annotation and its limits."""
    if hint == Octets:
        return "octets"
    if isinstance(hint, UnionType) or get_origin(hint) is Union:
        kinds = [kind for kind in get_args(hint) if kind is not type(None)]
        if set(get_args(Octets)) <= set(kinds):
            return "octets"
        return ", or ".join(dict.fromkeys(value_text(kind, key) for kind in kinds))
    kind = get_origin(hint) or hint
    if kind is Literal:
        return ", ".join(f'`"{word}"`' for word in get_args(hint))
    limits = "" if math.isinf(key.low) else f"{_number(key.low)}..{_number(key.high)}"
    if kind in (tuple, Sequence):
        (member, *_) = get_args(hint)
        return f"a list of {limits}" if member is int and limits else "a list"
    if kind in (int, float):
        return f"{limits or 'a number'} {key.unit}".strip()
    return _PLAIN[kind]


def _default_text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'`"{value}"`'
    return str(value) if isinstance(value, int) else "none"


def rows(table: type, made: type) -> list[str]:
    """The rows of the keys of ``table``, from which a ``made`` is made."""
    hints, said = get_type_hints(table), sentences(table)
    defaults = {name: one.default for name, one in inspect.signature(made).parameters.items()}
    found = ["| key | value | meaning | default |", "|---|---|---|---|"]
    for name, key in keys_of(table).items():
        meaning, _, left_out = said[name].partition(" Left out: ")
        left_out = left_out or _default_text(defaults.get(name))
        gsd = "" if key.gsd is None else f" (GSD: {key.gsd.keyword})"
        value = value_text(hints[name], key)
        found.append(f"| `{name}` | {value} | {meaning.removesuffix('.')}{gsd} | {left_out} |")
    return found


def render(page: str) -> str:
    """``page`` with its tables as they are now."""
    for name, (table, made) in TABLES.items():
        begin, end = f"<!-- keys: {name} -->\n", "<!-- end -->"
        before, _, rest = page.partition(begin)
        _, _, after = rest.partition(end)
        page = before + begin + "\n".join(rows(table, made)) + "\n" + end + after
    return page


def main() -> None:
    TARGET.write_text(render(TARGET.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
