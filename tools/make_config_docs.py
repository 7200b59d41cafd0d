"""Writes tables of docs/reference from the keys of the readers and from the device files; a test holds the pages to it.

- ``configuration.md``: the keys of the configuration file
- ``device-files.md``: the keys of a device file
- ``devices.md``: the drives and devices that come with dpstack, by base and source
"""

from __future__ import annotations

import inspect
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints, is_typeddict

from msgspec import Struct

from dpstack.api.config.bus import BusConfig
from dpstack.api.config.connectors import CONNECTORS
from dpstack.api.config.cpu import CpuConfig, CpuKeys, CpuValueKeys
from dpstack.api.config.dpv1 import Dpv1Keys
from dpstack.api.config.drives_source import DriveConfig, DriveKeys
from dpstack.api.config.field_names import FieldKeys
from dpstack.api.config.simulate import SimulateConfig, SimulateKeys
from dpstack.api.config.slave import Changes, IdentKeys, SlaveConfig, SlaveKeys
from dpstack.devices import finding
from dpstack.devices import keys as device_keys
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.process_data import Field
from dpstack.dp.slave_params import SlaveParams
from dpstack.profile.drive_profile import DeviceProfile, DriveProfile
from dpstack.toml.table import Key, Octets, keys_of

REFERENCE: Final = Path(__file__).resolve().parent.parent / "docs" / "reference"
TARGET: Final = REFERENCE / "configuration.md"
#: the class of each table, and the one whose fields have the plain defaults
TABLES: Final[Mapping[str, tuple[type, type]]] = {
    "bus": (BusConfig, BusConfig),
    "slave": (SlaveKeys, SlaveConfig),
    "drives": (DriveKeys, DriveConfig),
    "parameters": (Changes, SlaveParams),
    "ident": (IdentKeys, SlaveParams),
    "dpv1": (Dpv1Keys, Dpv1),
    "field": (FieldKeys, Field),
    "simulate": (SimulateKeys, SimulateConfig),
    "ppi": (CpuKeys, CpuConfig),
    "ppi_value": (CpuValueKeys, Field),
    **{name: (table, table) for name, table in CONNECTORS.items()},
}
#: what a value is, where its type says it wholly
_PLAIN: Final = {str: "a text", bool: "true, false", bytes: "octets", Mapping: "a table", object: "as described"}
#: a limit from here on is none for people
_ANY: Final = 1e9
#: an entry of a docstring: the key, and its sentence in lines that are set in
_ENTRY: Final = re.compile(r"^(\w+): (.*(?:\n +.*)*)", re.MULTILINE)
#: a link in a docstring names a page of docs/ without its folder
_LINK: Final = re.compile(r"(?<=\]\()[\w-]+\.md")


def sentences(table: type) -> dict[str, str]:
    """The text for each key from the docstring of ``table``."""
    entries = _ENTRY.findall(inspect.getdoc(table) or "")
    return {key: _LINK.sub(_relative, " ".join(text.split())) for key, text in entries}


def _relative(link: re.Match[str]) -> str:
    """The path of the linked page, as seen from TARGET; of several that of the reference."""
    own = TARGET.parent / link[0]
    (page,) = (own,) if own.exists() else TARGET.parent.parent.glob(f"*/{link[0]}")
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
    limits = f"{_number(key.low)}..{_number(key.high)}"
    if math.isinf(key.low) or key.high >= _ANY:
        limits = ""
    elif key.low == key.high:
        limits = _number(key.low)
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


def _defaults(made: Any) -> dict[str, object]:
    """The defaults of the attributes of ``made``. (The signature of a msgspec class needs its annotations' names.)"""
    if issubclass(made, Struct):
        defaults = made.__struct_defaults__
        return dict(zip(made.__struct_fields__[-len(defaults) :], defaults, strict=True))
    return {name: one.default for name, one in inspect.signature(made).parameters.items()}


def rows(table: type, made: type) -> list[str]:
    """The rows of the keys of ``table``, from which a ``made`` is made."""
    hints, said = get_type_hints(table), sentences(table)
    defaults = {} if made is dict else _defaults(made)
    found = ["| key | value | meaning | default |", "|---|---|---|---|"]
    for field, key in keys_of(table).items():
        name = field.rstrip("_")
        if name not in said and made is dict:  # a table inside, with a table of its own
            continue
        meaning, _, left_out = said[name].partition(" Left out: ")
        left_out = left_out or _default_text(defaults.get(name))
        gsd = "" if key.gsd is None else f" (GSD: {key.gsd.keyword})"
        value = value_text(hints[field], key)
        found.append(f"| `{name}` | {value} | {meaning.removesuffix('.')}{gsd} | {left_out} |")
    return found


def render(page: str) -> str:
    """``page`` of configurations with its tables as they are now."""
    for name, (table, made) in TABLES.items():
        page = _between(page, f"keys: {name}", rows(table, made))
    return page


def _between(page: str, mark: str, lines: Sequence[str]) -> str:
    """``page`` with ``lines`` between the comment ``mark`` and the next end."""
    begin, end = f"<!-- {mark} -->\n", "<!-- end -->"
    before, found, rest = page.partition(begin)
    assert found, f"{mark} is not in the page"
    _, _, after = rest.partition(end)
    return before + begin + "\n".join(lines) + "\n" + end + after


# --- device files -----------------------------------------------------------------------------------------------------
def device_key_lines() -> list[str]:
    """A section for each table of a device file, in the order of the module."""
    tables = [one for one in vars(device_keys).values() if is_typeddict(one) and one.__module__ == device_keys.__name__]
    found: list[str] = []
    for table in tables:
        head = " ".join((inspect.getdoc(table) or "").partition("\n\n")[0].split())
        title, colon, text = head.partition(": ")
        found += [f"## {title.rstrip('.')}", ""] if colon else [f"## {head.rstrip('.')}", ""]
        found += [f"{text[0].upper()}{text[1:]}", ""] if text else []
        found += [*rows(table, dict), ""]
    return found[:-1]


def device_lines() -> list[str]:
    """The drives and devices that come with dpstack."""
    origins = finding.origins()
    found = ["| name | drive or device | base | telegrams | source | tried |", "|---|---|---|---|---|---|"]
    known: dict[str, DriveProfile | DeviceProfile] = {**finding.known(), **finding.known_devices()}
    ours = [(name, one) for name, one in known.items() if origins.get(name, "").startswith("dpstack ")]
    listed = []
    for name, profile in ours:
        file = finding.file_at(Path(profile.file)) if profile.file else None
        base, source, tried = ("Python", "", "") if file is None else (file.base, file.source, file.tried)
        listed.append((base, name, profile.title, " ".join(profile.telegrams), source, tried))
    for base, name, title, telegrams, source, tried in sorted(listed):
        found.append(f"| `{name}` | {title} | {base} | {telegrams} | {source} | {tried} |")
    return found


def pages() -> dict[Path, str]:
    """The pages as they should be."""
    keys, devices = REFERENCE / "device-files.md", REFERENCE / "devices.md"
    return {
        TARGET: render(TARGET.read_text(encoding="utf-8")),
        keys: _between(keys.read_text(encoding="utf-8"), "keys of device files", device_key_lines()),
        devices: _between(devices.read_text(encoding="utf-8"), "devices", device_lines()),
    }


def main() -> None:
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
