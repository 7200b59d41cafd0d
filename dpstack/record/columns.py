"""The columns of a recording: named values, states, drive quantities; and their names in files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field
from dpstack.dp.process_image import Value
from dpstack.plant.quality import Quality, is_news
from dpstack.plant.status_octet import read_octets
from dpstack.text import json_text

#: the value of a cell; None: not valid, or not known
Cell = Value | str | None

#: 1: octets without a letter in front, no note in JSON lines without one
VERSION: Final = 2
#: type of a column of octets, and what stands in front of them in hex
BYTES: Final = "bytes"
OCTETS: Final = "x"
TIME: Final = "time"
T: Final = "t"
NOTE: Final = "note"
#: the quantities of a drive, in the order of their cells: name, type, unit
DRIVE_QUANTITIES: Final = (
    ("drive_state", "text", ""),
    ("setpoint", "number", ""),
    ("speed", "number", ""),
    ("frequency_hz", "number", "Hz"),
    ("current", "number", ""),
    ("torque", "number", ""),
    ("fault", "text", ""),
    ("warning", "text", ""),
)
STATE: Final = "state"
#: decimal places of a drive's quantities: as many as explained telegrams have
_DIGITS: Final = 6
#: SLAVE.FIELD [UNIT]: the slave may have any letters, the field and the unit neither a point nor a bracket
_TITLE: Final = re.compile(r"(?:(?P<slave>.*)\.)?(?P<field>[^.\[\]]+?)(?: \[(?P<unit>[^\[\]]*)\])?", re.DOTALL)


class Kind(StrEnum):
    """The source of a column."""

    STATE = "state"
    INPUT = "input"
    OUTPUT = "output"
    DRIVE = "drive"
    #: the quality of a named value, in its word
    QUALITY = "quality"


#: behind the name of a value in that of its quality
QUALITY: Final = " quality"
_GOOD, _STALE, _BAD = Quality.GOOD.value, Quality.STALE.value, Quality.BAD.value
#: what a name that is taken gets in front
_PREFIXES: Final = {Kind.STATE: "slave", Kind.DRIVE: "drive", Kind.QUALITY: "its"}


class Judged(NamedTuple):
    """Octets with the words of quality of their named values by the slave's diagnosis, in the order of the fields."""

    octets: bytes
    words: tuple[str, ...]
    #: an S7-200 gives no value for these, not even a bad one; empty: each field has one
    missing: tuple[bool, ...] = ()


@dataclass(frozen=True, slots=True)
class Column:
    """One quantity. ``type``: bool, number, text or bytes; ``at``: type and place in the octets, empty for others."""

    slave: str
    field: str
    kind: Kind | None = None
    type: str = ""
    unit: str = ""
    address: int | None = None
    at: str = ""
    scale: float = 1
    offset: float = 0
    dead_band: float = 0

    @property
    def name(self) -> str:
        """``SLAVE.FIELD``, unique in a recording."""
        return f"{self.slave}.{self.field}" if self.slave else self.field

    @property
    def title(self) -> str:
        """The name with its unit, as a CSV file has it."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @classmethod
    def of_title(cls, title: str) -> Column:
        """The column of a file that says no more about it than its title."""
        found = _TITLE.fullmatch(title)
        if found is None:
            return cls("", title)
        return cls(found["slave"] or "", found["field"], unit=found["unit"] or "")

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data without slave and address, and without what has its default; a number without ``type``."""
        given = {key: getattr(self, key) for key in _KINDS_OF_KEYS}
        return {key: value for key, value in given.items() if value != _DEFAULTS[key]}

    @classmethod
    def of_dict(cls, slave: str, address: int | None, given: Mapping[str, object]) -> Column:
        """The reverse of :meth:`as_dict`. Raises ValueError for anything else."""
        known = {key: given.get(key, default) for key, default in _DEFAULTS.items()}
        for key, value in known.items():
            if value is None and key == "kind":
                continue
            if not isinstance(value, _KINDS_OF_KEYS[key]) or isinstance(value, bool):
                raise ValueError(f"{key} = {value!r}")
        kind = known.pop("kind")
        kind = None if kind is None else Kind(str(kind))
        return cls(slave, kind=kind, address=address, **known)  # type: ignore[arg-type]


_KINDS_OF_KEYS: Final[Mapping[str, type | tuple[type, ...]]] = {
    "field": str,
    "kind": str,
    "type": str,
    "unit": str,
    "at": str,
    "scale": (int, float),
    "offset": (int, float),
    "dead_band": (int, float),
}
_DEFAULTS: Final[Mapping[str, object]] = {
    "field": None,
    "kind": None,
    "type": "number",
    "unit": "",
    "at": "",
    "scale": 1,
    "offset": 0,
    "dead_band": 0,
}


@dataclass(frozen=True, slots=True)
class Block:
    """Columns of one slave that come from the same octets (or from one state, or from one drive)."""

    kind: Kind
    columns: tuple[Column, ...]
    fields: tuple[Field, ...] = ()
    length: int = 0
    #: columns of qualities stand beside: a bad value keeps its number
    has_quality: bool = False

    def cells(self, source: object) -> tuple[Cell, ...]:
        """The values of the columns; ``source``: octets (with qualities, or without: by the diagnosis all are good),
        the text of a state, the quantities of a drive, or None."""
        if self.kind is Kind.QUALITY:
            return self._qualities(source)
        if isinstance(source, (bytes, Judged)):
            octets = source if isinstance(source, bytes) else source.octets
            if len(octets) >= self.length:
                values: tuple[Cell, ...] = tuple(found.get(octets) for found in self.fields)
                if isinstance(source, Judged) and source.missing:
                    values = tuple(None if gone else value for value, gone in zip(values, source.missing, strict=True))
                if self.has_quality:
                    return values
                words = self._words(source)
                return tuple(None if word == _BAD else value for value, word in zip(values, words, strict=True))
        elif isinstance(source, str):
            return (source,)
        elif isinstance(source, tuple):
            return tuple(round(value, _DIGITS) if isinstance(value, float) else value for value in source)
        return (None,) * len(self.columns)

    def _words(self, source: bytes | Judged) -> tuple[str, ...]:
        """The quality of each field, its own octets included."""
        octets, words = (source, (_GOOD,) * len(self.fields)) if isinstance(source, bytes) else source[:2]
        return tuple(
            _worse(word, read_octets(one, octets).reason.quality.value) if one.speaks_for_itself else word
            for one, word in zip(self.fields, words, strict=True)
        )

    def _qualities(self, source: object) -> tuple[Cell, ...]:
        """``source``: as of the block whose qualities these are; None: its slave is not in data exchange."""
        if not isinstance(source, (bytes, Judged)):
            return (_STALE,) * len(self.columns)
        octets = source if isinstance(source, bytes) else source.octets
        return self._words(source) if len(octets) >= self.length else (_BAD,) * len(self.columns)


def _worse(one: str, other: str) -> str:
    return max(one, other, key=_ORDER.index)


_ORDER: Final = (_GOOD, Quality.UNCERTAIN.value, _STALE, _BAD)


@dataclass(frozen=True, slots=True)
class RecordedSlave:
    """One slave of a recording, with the names of its process data. ``quality``: with a column for that of each."""

    address: int
    name: str
    inputs: FieldMap = field(default_factory=FieldMap)
    outputs: FieldMap = field(default_factory=FieldMap)
    is_drive: bool = False
    quality: bool = False

    def blocks(self) -> Iterator[Block]:
        """Its state, its named inputs and outputs, and the quantities of a drive."""
        taken = {*self.inputs, *self.outputs}
        yield Block(Kind.STATE, (self._column(STATE, taken, Kind.STATE, "text"),))
        for kind, fields in ((Kind.INPUT, self.inputs), (Kind.OUTPUT, self.outputs)):
            if fields:
                found = tuple(fields.fields.values())
                columns = tuple(_column_of(self, one, kind) for one in found)
                yield Block(kind, columns, found, fields.length, self.quality)
                if self.quality:
                    names = (self._column(one.name + QUALITY, taken, Kind.QUALITY, "text") for one in found)
                    yield Block(Kind.QUALITY, tuple(names), found, fields.length)
        if self.is_drive:
            columns = tuple(self._column(name, taken, Kind.DRIVE, kind, unit) for name, kind, unit in DRIVE_QUANTITIES)
            yield Block(Kind.DRIVE, columns)

    def as_dict(self) -> dict[str, object]:
        """Plain JSON data: name, address and columns."""
        columns = [column.as_dict() for block in self.blocks() for column in block.columns]
        return {"name": self.name, "address": self.address, "columns": columns}

    def _column(self, name: str, taken: set[str], kind: Kind, type_: str, unit: str = "") -> Column:
        """A column that is no field; if a field has its name, a word stands in front."""
        while name in taken:
            name = f"{_PREFIXES[kind]} {name}"
        taken.add(name)
        return Column(self.name, name, kind, type_, unit, self.address)


def _column_of(slave: RecordedSlave, found: Field, kind: Kind) -> Column:
    return Column(
        slave.name,
        found.name,
        kind,
        "number" if found.is_number else found.type,
        found.unit,
        slave.address,
        found.spec,
        found.scale,
        found.offset,
        found.dead_band,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The columns of one file. ``started``: s since 1970 at ``t`` = 0; ``config``: the configuration file, or None.

    ``bus``: its port, baud, driver and address, plain JSON data.
    """

    slaves: tuple[RecordedSlave, ...]
    started: float = 0.0
    config: str | None = None
    on_change: bool = False
    bus: Mapping[str, object] = field(default_factory=dict)
    blocks: tuple[Block, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", tuple(block for slave in self.slaves for block in slave.blocks()))

    @property
    def columns(self) -> tuple[Column, ...]:
        return tuple(column for block in self.blocks for column in block.columns)

    def description(self, note: str = "") -> str:
        """The description that stands in the file, as JSON; ``note``: what else its place has to say."""
        about = {
            "version": VERSION,
            "started": self.started,
            "config": self.config,
            "on_change": self.on_change,
            "bus": dict(self.bus),
        }
        # slave by slave: JSON of a large plant is made in one step, in which no other thread can run
        slaves = ",".join(map(json_text, map(RecordedSlave.as_dict, self.slaves)))
        more = f",{json_text(NOTE)}:{json_text(note)}" if note else ""
        return f'{{"recording":{json_text(about)[:-1]},"slaves":[{slaves}]}}{more}}}'


def differs(column: Column, before: Cell, now: Cell, dead_band: float) -> bool:
    """Whether ``now`` is another value: of numbers, one outside the dead band around ``before``."""
    return is_news(before, now, max(column.dead_band, dead_band) if column.type == "number" else 0)


def unique(columns: Sequence[Column]) -> dict[str, Column]:
    """``columns`` by name, the first of each."""
    found: dict[str, Column] = {}
    for column in columns:
        found.setdefault(column.name, column)
    return found
