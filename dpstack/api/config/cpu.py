"""The entries of ``ppi``: S7-200 CPUs of a plant, with names for values in their memory.

The values of a CPU lie one behind the other in an image, so that they are fields as those of a slave
(:mod:`dpstack.dp.process_data`): scale, unit, quality, recordings and orders need nothing of their own.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Annotated, Final, NamedTuple, TypedDict

from msgspec import Struct

from dpstack.api.config.connectors import read_names
from dpstack.api.config.field_names import described_field
from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field, field_of
from dpstack.dp.process_image import Value
from dpstack.errors import ConfigError, UsageError
from dpstack.params import MAX_STATION
from dpstack.ppi.addresses import BIT, PpiAddress, PpiValue, parse_address
from dpstack.text import brief, did_you_mean
from dpstack.toml.reading import Path as KeyPath
from dpstack.toml.table import Key, Source, Table, keys_of
from dpstack.units import NS_PER_MS

#: address of the master in a plant with CPUs, unless it is given: that of Siemens' tools, as a CPU has 2 as delivered
OWN_ADDRESS: Final = 0
#: time from one poll to the next in ms, unless it is given
POLL_MS: Final = 500
#: values of one CPU: a plant that has more asks for octets (VB0[200])
_MOST_VALUES: Final = 400
_EXAMPLE: Final = 'ppi = [{ address = 2, values = { level = "VW100" } }]'
_NO_VALUES: Final = 'name at least one: values = { level = "VW100" }'
_NO_ADDRESS: Final = 'add the address of the value, for instance at = "VW100"'
_NUMERIC: Final = re.compile(r"[+-]?(\d+|0[xX][0-9a-fA-F]+)")
#: types of fields by the code of an address
_TYPES: Final = {"B": "u8", "b": "i8", "H": "u16", "h": "i16", "I": "u32", "i": "i32", "f": "f32"}
#: timers and counters: the value behind their status octet
_ELEMENTS: Final = {"T": "u32", "C": "u16"}


class CpuKeys(TypedDict, total=False):
    """The keys of one entry of ``ppi``, as docs/reference/configuration.md has them.

    address: the station address of the CPU; 2 as delivered. Left out: required
    name: the name in programs and messages, unique. Left out: `cpuN`
    values: names for values in its memory, see [ppi.md](ppi.md#in-the-plant-file): an address, or a table with one.
        Left out: required
    allow_commands: the values that may be written from outside: by the page with `--control`, by `dpstack ctl`, and by
        connectors whose `allow_commands` list them, too. Left out: none
    poll_ms: the time from one poll of all values to the next
    """

    address: Annotated[int, Key(0, MAX_STATION)]
    name: str
    values: Mapping[str, object]
    allow_commands: Annotated[tuple[str, ...], Key(read=read_names)]
    poll_ms: Annotated[int, Key(20, 3_600_000)]


class CpuValueKeys(TypedDict, total=False):
    """The keys of one named value of a CPU, as docs/reference/configuration.md has them.

    at: its address as STEP 7-Micro/WIN writes it, with a type if it is not the usual one: `"VW100:int"`. Left out:
        required
    scale: the value of one step; not 0. A value that is no number has none of these keys. Left out: 1
    offset: the value for the number 0. Left out: 0
    unit: the unit of the value, for people, up to 20 characters. Left out: none
    dead_band: a [recording on change](record.md#on-change) leaves out changes up to this. Left out: 0, every change
        counts
    words: the meaning of its numbers, `{ 0 = "stopped", 1 = "running" }`; only for a whole number without a scale. Left
        out: none
    """

    at: str
    scale: Annotated[float, Key(-1e9, 1e9)]
    offset: Annotated[float, Key(-1e9, 1e9)]
    unit: str
    dead_band: Annotated[float, Key(0, 1e9)]
    words: Mapping[str, object]


class CpuValue(NamedTuple):
    """A named value: its address in the memory of the CPU, and its field in the image."""

    address: PpiAddress
    field: Field

    def image_part(self, value: PpiValue) -> bytes:
        """The octets of ``value``, which was read, in the image."""
        if self.address.area.name in _ELEMENTS:
            return int(value).to_bytes(self.field.length, "big")
        if isinstance(value, bytes):
            return value
        return self.address.packed(value)

    def read(self, octets: bytes) -> Value:
        """The scaled value of the octets of an answer. Raises PduError for another number of octets."""
        return self.field.get(bytes(self.field.octet) + self.image_part(self.address.value(octets)))

    def plain(self, value: object) -> PpiValue:
        """``value``, which is scaled, as the CPU has it. Raises ValueError that names the possible values."""
        octets = self.field.put(bytes(self.field.octet + self.field.length), value)[self.field.octet :]
        return int.from_bytes(octets, "big") if self.address.area.name in _ELEMENTS else self.address.value(octets)


class CpuConfig(Struct, frozen=True):
    """One S7-200 of the plant. ``path``: its place in the configuration, for messages."""

    address: int
    name: str
    values: Mapping[str, CpuValue] = {}
    #: the values that may only be read from outside, and those that may be written, in one image
    input_fields: FieldMap = FieldMap()
    output_fields: FieldMap = FieldMap()
    poll_ms: int = POLL_MS
    path: KeyPath = ()

    @property
    def poll_ns(self) -> int:
        return self.poll_ms * NS_PER_MS

    @property
    def fields(self) -> tuple[FieldMap, FieldMap]:
        """Those that may only be read from outside, and those that may be written."""
        return self.input_fields, self.output_fields

    @property
    def who(self) -> str:
        """For messages."""
        return f"CPU {self.address} ({self.name})"

    def value(self, name: str) -> CpuValue:
        """The value called ``name``. Raises UsageError with the nearest one."""
        found = self.values.get(name)
        if found is None:
            known = f"there are: {', '.join(self.values) or 'none'}"
            raise UsageError(f"{self.who}: no value is called {name!r}; {did_you_mean(name, self.values, known)}")
        return found


def read_cpus(source: Source, places: Sequence[tuple[KeyPath, object]], title: str = "[[ppi]]") -> Iterator[CpuConfig]:
    """The CPUs of the lists at ``places``, each with its path in ``source``. Raises ConfigError, one line."""
    for path, entries in places:
        if not isinstance(entries, (list, tuple)) or not all(isinstance(one, (Mapping, CpuConfig)) for one in entries):
            raise source.error(path, f"ppi = {brief(entries)} is no list of tables", f"write {_EXAMPLE}")
        for number, entry in enumerate(entries):
            if isinstance(entry, CpuConfig):
                yield entry
            else:
                yield _read_cpu(source, (*path, number), entry, f"{title} {number + 1}")


def _read_cpu(source: Source, path: KeyPath, entry: object, title: str) -> CpuConfig:
    table = Table(source, path, entry, title)
    named = table.raw("name")
    if isinstance(named, str) and named.strip() and named.isprintable():
        table.title = f"{title.rstrip('0123456789 ')} {named}"
    given = table.read(keys_of(CpuKeys))
    if "address" not in given:
        table.fail(None, "no address", "add the station address of the CPU, 2 as delivered")
    address: int = given["address"]
    name = given.get("name") or f"cpu{address}"
    if _NUMERIC.fullmatch(name.strip()):
        table.fail("name", f"name = {name!r} looks like an address", f'write a word: name = "cpu{address}"')
    values = _read_values(table)
    allowed = _allowed(table, given.get("allow_commands", ()), values)
    length = sum(one.field.length for one in values.values())
    inputs, outputs = (
        FieldMap({key: one.field for key, one in values.items() if (key in allowed) is writable}, length)
        for writable in (False, True)
    )
    return CpuConfig(address, name, values, inputs, outputs, given.get("poll_ms", POLL_MS), path)


def _read_values(table: Table) -> dict[str, CpuValue]:
    """The named values of a CPU, their fields one behind the other."""
    if table.raw("values") is None:
        table.fail(None, "no values", _NO_VALUES)
    inside, found, at = table.table("values"), dict[str, CpuValue](), 0
    for name in inside:
        field = described_field(inside, name, CpuValueKeys, _NO_ADDRESS, partial(_placed, name, at))
        found[name] = CpuValue(parse_address(field.written), field)
        at += field.length
    if not 1 <= len(found) <= _MOST_VALUES:
        todo = "read octets as one: VB0[200]" if found else _NO_VALUES
        table.fail("values", f"{len(found)} values; 1 to {_MOST_VALUES} are possible", todo)
    return found


def _placed(name: str, at: int, text: str) -> Field:
    """The field of the address that ``text`` names, at the octet ``at`` of the image. Raises ConfigError."""
    try:
        address = parse_address(text)
    except UsageError as error:
        raise ConfigError(f"{name}: {error}") from None
    kind = _ELEMENTS.get(address.area.name) or _TYPES.get(address.code)
    if kind is not None:
        spec = f"{kind}@{at}"
    else:
        spec = f"bool@{at}.0" if address.size == BIT else f"bytes@{at}:{address.length}"
    field = field_of(name, spec, at + max(8, address.length), "values")
    return dataclasses.replace(field, written=address.text)


def _allowed(table: Table, names: Sequence[str], values: Mapping[str, CpuValue]) -> frozenset[str]:
    """The values that may be written from outside. Raises ConfigError for an unknown name, and for a value that nobody
    can write."""
    for name in names:
        if name not in values:
            known = f"there are: {', '.join(values) or 'none'}"
            what = f"allow_commands: no value is called {brief(name)}"
            table.fail("allow_commands", what, did_you_mean(name, values, known))
        area = values[name].address.area
        if not area.writable or area.name in _ELEMENTS:
            kind = "an analogue input" if area.name == "AI" else "a timer" if area.name == "T" else "a counter"
            what = f"allow_commands: {name} is {kind}, which only the CPU itself sets"
            table.fail("allow_commands", what, "take it out")
    return frozenset(names)
