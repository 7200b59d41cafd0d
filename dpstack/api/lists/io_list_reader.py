"""An I/O list that people have edited, taken back into the text of its configuration.

A row with a name declares that value. A name of the configuration that the list does not have stays, unless the list
has another row for its place. Nothing is taken if one line is refused.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from msgspec import Struct

from dpstack.api.config.config import Config, parse_config
from dpstack.api.config.field_names import read_field
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.config.toml_edit import TomlEdit
from dpstack.api.lists.io_list import COLUMNS, fields_of, first_bit, text_of_cell, type_cell
from dpstack.dp.process_data import Field, overlap
from dpstack.dp.slot_map import Direction
from dpstack.errors import ConfigError
from dpstack.text import did_you_mean, nearest, shortened
from dpstack.toml.reading import Path as KeyPath
from dpstack.toml.reading import read_toml, toml_value
from dpstack.toml.table import Source, Table

#: octets of a list: 125 slaves with 1952 channels each way have some 40 MB
MAX_LIST: Final = 50_000_000
_NEEDED: Final = ("slave", "direction", "name", "type", "octet")
#: columns that describe a value beside its place, with their defaults
_NUMBERS: Final = {"scale": 1, "offset": 0, "dead_band": 0}
_DIRECTIONS: Final = {
    "input": Direction.INPUT,
    "in": Direction.INPUT,
    "output": Direction.OUTPUT,
    "out": Direction.OUTPUT,
}
_NUMBER: Final = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
#: a word that comes nearer than this to the name of a column is one that was misspelt
_MISSPELT: Final = 0.75
#: characters of a cell that a message shows
_SHOWN: Final = 40


class Change(Struct, frozen=True):
    """A change of one name. ``kind``: added, changed, renamed, removed. ``was``: its earlier name if it is renamed;
    ``at``: type and place, None if it is removed."""

    slave: str
    direction: Direction
    name: str
    kind: str
    was: str | None = None
    at: str | None = None

    def as_dict(self) -> dict[str, str | None]:
        return {
            "slave": self.slave,
            "direction": self.direction.value,
            "name": self.name,
            "change": self.kind,
            "was": self.was,
            "at": self.at,
        }

    @property
    def text(self) -> str:
        """The change for people."""
        was = "" if self.was is None else f", it was {self.was}"
        return (
            f"{self.slave}: {self.direction} {self.name} {self.kind}{was}{'' if self.at is None else f' ({self.at})'}"
        )


class TakenList(Struct, frozen=True):
    """The contents of a list. ``text``: the configuration with its names, the present one if lines are ``refused``.

    ``kept``: names (``slave.name``) that the list does not have; ``notes``: columns and rows that are not read.
    """

    text: str
    changes: tuple[Change, ...] = ()
    refused: tuple[ConfigError, ...] = ()
    kept: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class _Record(Struct, frozen=True):
    """A line of the list. ``cells``: by column, stripped; columns that the list does not have are absent."""

    line: int
    cells: Mapping[str, str]


class _Wanted(Struct, frozen=True):
    """A row that was read. ``value``: the declaration as TOML has it; ``is_named`` False: its place has no name."""

    line: int
    slave: SlaveConfig
    direction: Direction
    field: Field
    value: str | dict[str, Any]
    is_named: bool


def take_list(octets: bytes, name: str, config: Config, text: str) -> TakenList:
    """Read the list ``octets``, called ``name`` in messages, into ``text``, from which ``config`` was read.

    Raises ConfigError if the file is no I/O list, or if the text cannot be changed.
    """
    columns, records = _records(octets, name)
    known = [column for column in columns if column in COLUMNS]
    notes = tuple(f"{name}: the column {column!r} is not read" for column in columns if column and column not in known)
    refused: list[ConfigError] = []
    wanted: list[_Wanted] = []
    reader = _RowReader(name, config)
    cpus = {cpu.name.strip(): False for cpu in config.ppi}
    for record in records:
        try:
            if isinstance(record, ConfigError):
                raise record
            if record.cells["slave"] in cpus:
                cpus[record.cells["slave"]] = True
                continue
            found = reader.read(record)
        except ConfigError as error:
            refused.append(error)
            continue
        if found is not None:
            wanted.append(found)
    listed = ", ".join(cpu for cpu, is_listed in cpus.items() if is_listed)
    if listed:
        notes += (f"{name}: the rows of {listed} are not read: values of a CPU stand in [[ppi]], change them there",)
    finals = [_Final(slave, number, wanted, name) for number, slave in enumerate(config.slaves)]
    refused += [error for final in finals for error in final.refused]
    if refused:
        return TakenList(text, refused=tuple(sorted(refused, key=lambda error: error.line or 0)), notes=notes)
    edit = TomlEdit(text)
    data, _ = read_toml(text)
    changes = tuple(change for final in finals for change in final.changes(edit, data["slave"]))
    new = edit.result()
    _verify(new, config, finals)
    return TakenList(new, changes, kept=tuple(one for final in finals for one in final.kept), notes=notes)


def _verify(text: str, config: Config, finals: Iterable[_Final]) -> None:
    """Raises ConfigError if ``text`` has not the names that it shall have."""
    again = parse_config(text, config.source.name, file=config.file)
    for final, slave in zip(finals, again.slaves, strict=True):
        for direction in Direction:
            found = {field.name: field for field in fields_of(slave, direction)}
            if found.keys() != final.fields[direction].keys() or not all(
                _is_same(field, final.fields[direction][name]) for name, field in found.items()
            ):
                raise ConfigError(
                    f"{config.source.name}: the {direction}s of {slave.name} cannot be changed in this layout; write "
                    f"them as a table [slave.{direction}s]"
                )


# --- the file ---------------------------------------------------------------------------------------------------------


def _records(octets: bytes, name: str) -> tuple[list[str], Iterator[_Record | ConfigError]]:
    """The columns of the header, and the lines below it that are not empty."""
    if len(octets) > MAX_LIST:
        raise ConfigError.at(name, None, f"has more than {MAX_LIST // 1_000_000} MB", "name an I/O list")
    try:
        text = octets.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = octets.count(b"\n", 0, error.start) + 1
        raise ConfigError.at(name, line, "is not UTF-8 text", "save it as CSV in UTF-8") from None
    lines = list(io.StringIO(text, newline=""))
    skipped = 0
    if lines and re.fullmatch(r'"?sep=(.)"?', lines[0].strip()):
        skipped = 1  # a mark for spreadsheets
    delimiter = _delimiter(lines[skipped] if len(lines) > skipped else "")
    reader = csv.reader(iter(lines[skipped:]), delimiter=delimiter, strict=True)
    header_line = skipped + 1
    try:
        columns = [column.strip().lower() for column in next(reader, [])]
    except csv.Error as error:
        raise ConfigError.at(name, header_line, f"is no CSV ({error})", _SAVE) from None
    _check_columns(columns, name, header_line)
    return columns, _lines(reader, columns, name, skipped)


_SAVE: Final = "save the list as CSV again"


def _delimiter(header: str) -> str:
    """The delimiter by which most words of the header are columns."""

    def known(delimiter: str) -> int:
        return sum(word.strip().strip('"').strip().lower() in COLUMNS for word in header.split(delimiter))

    return max((",", ";", "\t"), key=known)


def _check_columns(columns: list[str], name: str, line: int) -> None:
    for column in columns:
        if column and columns.count(column) > 1:
            raise ConfigError.at(name, line, f"the column {column!r} is there twice", "take one of them out")
        near = None if column in COLUMNS else nearest(column, COLUMNS, _MISSPELT)
        if near is not None and near not in columns:
            raise ConfigError.at(name, line, f"there is no column {column!r}", f"did you mean {near!r}?")
    missing = [column for column in _NEEDED if column not in columns]
    if missing:
        raise ConfigError.at(
            name,
            line,
            f"the header has no column {', '.join(map(repr, missing))}",
            "the first line names the columns, as `dpstack names CONFIG --csv` writes them",
        )


def _lines(reader: Any, columns: list[str], name: str, skipped: int) -> Iterator[_Record | ConfigError]:
    while True:
        line = skipped + reader.line_num + 1
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            yield ConfigError.at(name, line, f"is no line of CSV ({error})", _SAVE)
            return
        if not any(cell.strip() for cell in cells):
            continue
        if any(cell.strip() for cell in cells[len(columns) :]):
            what = f"{len(cells)} cells, the header has {len(columns)}"
            yield ConfigError.at(name, line, what, "put a text with the delimiter in it into quotes")
            continue
        found = dict(zip(columns, (*cells, *[""] * len(columns)), strict=False))
        yield _Record(line, {column: text_of_cell(cell).strip() for column, cell in found.items()})


# --- rows -------------------------------------------------------------------------------------------------------------


class _RowReader:
    """Reads the rows of the list ``name`` for ``config``."""

    def __init__(self, name: str, config: Config) -> None:
        self._name = name
        self._slaves = {slave.name.strip(): slave for slave in config.slaves}
        self._addresses = {str(slave.address): slave for slave in config.slaves}
        self._fields = {
            (slave.name, direction): {field.name: field for field in fields_of(slave, direction)}
            for slave in config.slaves
            for direction in Direction
        }
        self._places = {
            key: {(first_bit(field), field.width): field for field in fields.values()}
            for key, fields in self._fields.items()
        }

    def read(self, record: _Record) -> _Wanted | None:
        """The row; None if it declares nothing and has no place. Raises ConfigError at its line."""
        slave = self._slave(record)
        cell = record.cells["direction"].lower()
        direction = _DIRECTIONS.get(cell)
        if direction is None:
            raise self._error(record, f"direction = {shortened(cell, _SHOWN)!r}", "write input or output")
        name = record.cells["name"]
        if not name and not (record.cells["type"] and record.cells["octet"]):
            return None
        key = f"{direction}s"
        at = self._at(record, slave, direction)
        label = name or "channel"
        place = self._field(record, slave, key, label, at)
        existing = self._fields[slave.name, direction].get(name) if name else None
        if existing is None:
            existing = self._places[slave.name, direction].get((first_bit(place), place.width))
        elif _is_same_place(existing, place):
            at = existing.written or at  # a place by slot stays one
        if not name:
            return _Wanted(record.line, slave, direction, place, at, is_named=False)
        keys = self._keys(record, existing)
        value: str | dict[str, Any] = {"at": at, **keys} if keys else at
        return _Wanted(
            record.line, slave, direction, self._field(record, slave, key, name, value), value, is_named=True
        )

    def _error(self, record: _Record, what: str, todo: str) -> ConfigError:
        return ConfigError.at(self._name, record.line, what, todo)

    def _field(self, record: _Record, slave: SlaveConfig, key: str, name: str, value: object) -> Field:
        """The field as the configuration would read it, with messages about this line."""
        source = Source(self._name, {(name,): record.line})
        return read_field(Table(source, (), {name: value}, f"slave {slave.name}"), name, key, slave.params)

    def _slave(self, record: _Record) -> SlaveConfig:
        name, address = record.cells["slave"], record.cells.get("address", "")
        by_name = self._slaves.get(name)
        by_address = self._addresses.get(str(self._whole(record, "address"))) if address else None
        if by_address is not None and by_address.name.strip() == name:
            return by_address
        if name and by_name is None:
            hint = did_you_mean(name, self._slaves, f"there are: {', '.join(self._slaves) or 'none'}")
            raise self._error(record, f"no slave is called {shortened(name, _SHOWN)!r}", hint)
        if address and by_address is None:
            raise self._error(
                record, f"no slave has the address {shortened(address, _SHOWN)}", "correct it or empty it"
            )
        if by_name is not None and by_address is not None and by_name is not by_address:
            raise self._error(record, f"{name} has address {by_name.address}, the row {address}", "correct one of them")
        found = by_name or by_address
        if found is None:
            raise self._error(record, "no slave", "write its name")
        return found

    def _at(self, record: _Record, slave: SlaveConfig, direction: Direction) -> str:
        """Type and place as a declaration. Raises ConfigError if slot, channel and octet contradict one another."""
        kind, _, length = record.cells["type"].partition(":")
        kind = kind.strip().lower()
        if not kind:
            raise self._error(record, "no type", "write for instance bool, i16 or f32")
        slot, channel = self._whole(record, "slot"), self._whole(record, "channel")
        octet, bit = self._whole(record, "octet"), self._whole(record, "bit")
        if octet is None:
            if slot is None or channel is None:
                raise self._error(record, "no octet", "write octet and bit, or slot and channel")
            return f"slot {slot} channel {channel} {kind}"
        found = slave.params.slots.at(direction, octet)
        if slot is not None and found is not None and found.number != slot:
            raise self._error(
                record,
                f"octet {octet} of the {direction}s is in {found.title}, the row has slot {slot}",
                "correct one of them, or empty the slot",
            )
        at = f"{kind}@{octet}" + ("" if bit is None else f".{bit}") + (f":{length.strip()}" if length else "")
        if channel is not None and found is not None:
            area = found.area(direction)
            step = max(self._field(record, slave, f"{direction}s", "channel", at).width, area.width)
            first = 8 * (octet - area.at) + (bit or 0)
            if channel not in {first // width for width in (area.width, step) if width}:
                raise self._error(
                    record,
                    f"octet {octet} is not in channel {channel} of {found.title}",
                    "correct one of them, or empty the channel",
                )
        return at

    def _keys(self, record: _Record, existing: Field | None) -> dict[str, Any]:
        """The keys beside ``at``, without those at their defaults. A column that the list does not have changes
        nothing."""
        found: dict[str, Any] = {}
        for key, default in _NUMBERS.items():
            value: float | None = getattr(existing, key, default)
            if key in record.cells:
                value = self._number(record, key)
            if value not in (None, default):
                found[key] = value
        unit = record.cells.get("unit")
        earlier = "" if existing is None else existing.unit
        if unit is None or unit == earlier.strip():
            unit = earlier
        if unit:
            found["unit"] = unit
        status = self._whole(record, "status") if "status" in record.cells else getattr(existing, "status", None)
        coding = record.cells.get("quality", getattr(existing, "coding", ""))
        if status is not None:
            found["status"] = f"u8@{status}"
        if coding:
            found["quality"] = coding
        return found

    def _number(self, record: _Record, key: str) -> int | float | None:
        """The number in a cell, with a decimal point or comma; None if it is empty or absent."""
        cell = record.cells.get(key, "")
        if not cell:
            return None
        text = cell.replace("\u2212", "-")
        if "." not in text and text.count(",") == 1:
            text = text.replace(",", ".")
        if len(text) > _SHOWN or not _NUMBER.fullmatch(text):
            raise self._error(record, f"{key} = {shortened(cell, _SHOWN)!r} is no number", "write for instance 0.1")
        value = float(text)
        return int(value) if value.is_integer() and abs(value) < 1e15 else value

    def _whole(self, record: _Record, key: str) -> int | None:
        value = self._number(record, key)
        if isinstance(value, float) or (value is not None and value < 0):
            todo = "write the bit into a column of its own" if key == "octet" else "write for instance 3"
            raise self._error(record, f"{key} = {record.cells[key]} is no whole number from 0", todo)
        return value


def _is_same_place(one: Field, other: Field) -> bool:
    return (type_cell(one), one.octet, one.bit) == (type_cell(other), other.octet, other.bit)


def _is_same(one: Field, other: Field) -> bool:
    """Whether two declarations mean the same, however they are written."""
    return _is_same_place(one, other) and all(
        getattr(one, key) == getattr(other, key) for key in ("scale", "offset", "unit", "dead_band", "status", "coding")
    )


# --- the names of one slave -------------------------------------------------------------------------------------------


class _Final:
    """The names of ``slave``, table ``number`` of the configuration, after the list: ``fields`` by direction."""

    def __init__(self, slave: SlaveConfig, number: int, wanted: Iterable[_Wanted], name: str) -> None:
        self._slave = slave
        self._number = number
        self._list = name
        self.refused: list[ConfigError] = []
        self._rows: dict[str, _Wanted] = {}
        rows = [row for row in wanted if row.slave is slave]
        for row in rows:
            if not row.is_named:
                continue
            earlier = self._rows.setdefault(row.field.name, row)
            if earlier is not row:
                self._refuse(row, f"{row.field.name!r} stands in line {earlier.line} already", _OTHER_NAME)
        self.fields = {direction: self._of(direction, rows) for direction in Direction}
        if not self.refused:
            self._check()

    def _refuse(self, row: _Wanted, what: str, todo: str) -> None:
        self.refused.append(ConfigError.at(self._list, row.line, f"slave {self._slave.name}: {what}", todo))

    def _of(self, direction: Direction, rows: Iterable[_Wanted]) -> dict[str, Field]:
        """The present names in their order, those of the list behind them."""
        places = {_place(row.field) for row in rows if row.direction is direction}
        named = {name: row.field for name, row in self._rows.items() if row.direction is direction}
        found: dict[str, Field] = {}
        for field in fields_of(self._slave, direction):
            if field.name in named:
                found[field.name] = named[field.name]
            elif _place(field) not in places:
                found[field.name] = field
        return found | named

    def _check(self) -> None:
        inputs, outputs = self.fields[Direction.INPUT], self.fields[Direction.OUTPUT]
        for name in inputs.keys() & outputs.keys():
            self._refuse(self._rows[name], f"{name!r} is an input and an output", _OTHER_NAME)
        shared = overlap(outputs)
        if shared is not None:
            later, first = shared
            row = self._rows.get(later.name) or self._rows[first.name]
            self._refuse(row, f"{later.name} ({later.spec}) and {first.name} ({first.spec}) share bits", "move one")

    @property
    def kept(self) -> Iterator[str]:
        """The names that the list does not have, ``slave.name``."""
        for fields in self.fields.values():
            yield from (f"{self._slave.name}.{name}" for name in fields if name not in self._rows)

    def changes(self, edit: TomlEdit, slaves: list[dict[str, Any]]) -> Iterator[Change]:
        """Make the changes in ``edit``; ``slaves``: the tables as they are."""
        for direction in Direction:
            key = f"{direction}s"
            table = _NamesTable(edit, ("slave", self._number, key), slaves[self._number].get(key, {}))
            present = {field.name: field for field in fields_of(self._slave, direction)}
            yield from self._of_direction(direction, present, table)
            table.write()

    def _of_direction(self, direction: Direction, present: dict[str, Field], table: _NamesTable) -> Iterator[Change]:
        wanted = self.fields[direction]
        new = {_place(field): name for name, field in wanted.items() if name not in present}
        renamed: set[str] = set()
        for name, field in present.items():
            if name in wanted:
                if not _is_same(field, wanted[name]):
                    table.change(name, field, self._rows[name])
                    yield Change(self._slave.name, direction, name, "changed", at=wanted[name].spec)
                continue
            other = new.pop(_place(field), None)
            if other is None:
                table.remove(name)
                yield Change(self._slave.name, direction, name, "removed")
                continue
            renamed.add(other)
            table.rename(name, other)
            if not _is_same(field, wanted[other]):
                table.change(name, field, self._rows[other])
            yield Change(self._slave.name, direction, other, "renamed", was=name, at=wanted[other].spec)
        for name, field in wanted.items():
            if name not in present and name not in renamed:
                table.add(name, self._rows[name].value)
                yield Change(self._slave.name, direction, name, "added", at=field.spec)


_OTHER_NAME: Final = "give one of them another name"


def _place(field: Field) -> tuple[int, int]:
    return first_bit(field), field.width


class _NamesTable:
    """The table ``inputs`` or ``outputs`` at ``path``, ``raw`` as TOML has it; with lists of places as well."""

    def __init__(self, edit: TomlEdit, path: KeyPath, raw: Mapping[str, Any]) -> None:
        self._edit = edit
        self._path = path
        self._raw = raw
        self._members = {
            f"{key}_{number}": (key, number)
            for key, value in raw.items()
            if isinstance(value, list)
            for number in range(len(value))
        }
        #: new names of list members, None: removed; and their new values
        self._names: dict[str, str | None] = {}
        self._values: dict[str, str] = {}

    def add(self, name: str, value: str | dict[str, Any]) -> None:
        self._edit.add(self._path, name, _toml(value))

    def remove(self, name: str) -> None:
        if name in self._members:
            self._names[name] = None
        else:
            self._edit.remove((*self._path, name))

    def rename(self, name: str, new: str) -> None:
        if name in self._members:
            self._names[name] = new
        else:
            self._edit.rename((*self._path, name), new)

    def change(self, name: str, before: Field, row: _Wanted) -> None:
        """Give ``name``, which is ``before`` now, the declaration of ``row``."""
        if name in self._members:
            self._values[name] = _toml(row.value)
            return
        path, raw = (*self._path, name), self._raw[name]
        if not isinstance(raw, dict):
            self._edit.replace(path, _toml(row.value))
            return
        value = row.value if isinstance(row.value, dict) else {"at": row.value}
        now = row.field
        same = {key: getattr(before, key) == getattr(now, key) for key in ("scale", "offset", "unit", "dead_band")}
        same |= {"status": before.status == now.status, "quality": before.coding == now.coding}
        same["at"] = _is_same_place(before, now)
        for key, is_same in same.items():
            if is_same:
                continue
            if key not in value:
                self._edit.remove((*path, key))
            elif key in raw:
                self._edit.replace((*path, key), toml_value(value[key]))
            else:
                self._edit.add(path, key, toml_value(value[key]))

    def write(self) -> None:
        """Write the lists: one whose members have other names becomes a key for each of them."""
        for key, value in self._raw.items():
            if not isinstance(value, list):
                continue
            members = {f"{key}_{number}": (*self._path, key, number) for number in range(len(value))}
            if not members.keys() & self._names.keys():
                for name in members.keys() & self._values.keys():
                    self._edit.replace(members[name], self._values[name])
                continue
            texts = {
                name: self._values[name] if name in self._values else self._edit.value_text(path)
                for name, path in members.items()
            }
            keys = ((self._names.get(name, name), text) for name, text in texts.items())
            self._edit.split((*self._path, key), [(name, text) for name, text in keys if name is not None])


def _toml(value: str | dict[str, Any]) -> str:
    """A declaration as TOML."""
    if isinstance(value, str):
        return toml_value(value)
    return "{ " + ", ".join(f"{key} = {toml_value(one)}" for key, one in value.items()) + " }"
