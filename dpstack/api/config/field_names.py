"""The keys ``inputs`` and ``outputs`` of a [[slave]] table: names for its process data."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Final, Literal, TypedDict

from dpstack.dp.field_map import FieldMap
from dpstack.dp.process_data import Field, field_of, overlap, with_scale, with_status, with_words
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.slot_map import SlotMap
from dpstack.text import brief
from dpstack.toml.table import Key, Table, keys_of

#: the largest scale and offset
_MOST: Final = 1e9
#: characters of a unit
_UNIT_LENGTH: Final = 20
#: a number in the key ``words``, and characters of its text
_WHOLE: Final = re.compile(r"-?[0-9]{1,10}")
_WORD_LENGTH: Final = 60


def read_fields(table: Table, params: SlaveParams) -> tuple[FieldMap, FieldMap]:
    """The fields of a slave with ``params``. Raises ConfigError.

    Fields of inputs may overlap: a program may read the same octets in several ways. Fields of outputs may only if one
    is a word and the other one some of its bits: a program that writes one field must not change another by chance. A
    name stands for one field of a slave.
    """
    inputs = _fields(table, "inputs", params)
    outputs = _fields(table, "outputs", params)
    both = next((name for name in outputs if name in inputs), None)
    if both is not None:
        table.fail("outputs", f"{both!r} is an input and an output", "give one of them another name")
    shared = overlap(outputs)
    if shared is not None:
        later, first = shared
        table.fail(
            "outputs",
            f"{later.name} ({later.spec}) and {first.name} ({first.spec}) share bits",
            "move one of them; only a word and some of its bits may share them",
        )
    return FieldMap(inputs, params.input_len), FieldMap(outputs, params.output_len)


class FieldKeys(TypedDict, total=False):
    """The keys of one named value, as docs/reference/configuration.md has them.

    at: type and place, for instance `"i16@2"`. Left out: required
    scale: the value of one step; not 0. A field that is no number (bool, bytes) has none of these keys. Left out: 1
    offset: the value for the number 0 in the octets. Left out: 0
    unit: the unit of the value, for people, up to 20 characters. Left out: none
    dead_band: a [recording on change](record.md#on-change) leaves out changes up to this. Left out: 0, every change
        counts
    status: the status octet of the value, for instance `"u8@4"`; only beside `quality`. Left out: none
    quality: the coding of that octet: `"pa-classic"` or `"pa-condensed"`, see [quality.md](quality.md). Left out: none
    words: the meaning of its numbers, `{ 0 = "stopped", 1 = "running" }`: shown beside the number on screen and page,
        as the reason of its quality elsewhere, and taken in place of the number; only for a whole number without a
        scale. Left out: none
    """

    at: str
    scale: Annotated[float, Key(-_MOST, _MOST)]
    offset: Annotated[float, Key(-_MOST, _MOST)]
    unit: str
    dead_band: Annotated[float, Key(0, _MOST)]
    status: str
    quality: Literal["pa-classic", "pa-condensed"]
    words: Mapping[str, object]


def _fields(table: Table, key: str, params: SlaveParams) -> dict[str, Field]:
    if table.raw(key) is None:
        return {}
    return {name: read_field(inside, name, key, params) for inside, name in _names(table.table(key))}


def _names(table: Table) -> Iterator[tuple[Table, str]]:
    """Each name with the table that has it: a list of places gives names with a number behind them, from 0."""
    for name in table:
        if not isinstance(table.raw(name), list):
            yield table, name
            continue
        members = table.numbered(name)
        for member in members:
            if member in table:
                table.fail(member, f"{member!r} is also a place of the list {name}", "give it another name")
            yield members, member


def read_field(table: Table, name: str, key: str, params: SlaveParams) -> Field:
    """The field ``name`` of ``table``, among the ``inputs`` or ``outputs`` (``key``) of a slave. Raises ConfigError."""
    length = params.input_len if key == "inputs" else params.output_len
    if isinstance(table.raw(name), Mapping):
        return _scaled_field(table, name, length, key, params.slots)
    text = table.text(name)
    with table.blaming(name):
        return field_of(name, text, length, key, params.slots)


def _scaled_field(table: Table, name: str, length: int, what: str, slots: SlotMap) -> Field:
    keys, given = _keys_of_field(table, name, FieldKeys, 'add type and place, for instance at = "i16@2"')
    with keys.blaming("at"):
        found = field_of(name, given.pop("at"), length, what, slots)
    found = _with_status(keys, found, given, length, what, slots)
    return _described(keys, found, given)


def described_field(table: Table, name: str, keys: type, todo: str, make: Callable[[str], Field]) -> Field:
    """The field ``name`` of ``table``: a text, or a table with the keys of ``keys``, ``at`` among them, which has it.
    ``make``: makes the field of that text. ``todo``: the remedy without ``at``. Raises ConfigError."""
    if not isinstance(table.raw(name), Mapping):
        text = table.text(name)
        with table.blaming(name):
            return make(text)
    inside, given = _keys_of_field(table, name, keys, todo)
    with inside.blaming("at"):
        found = make(given.pop("at"))
    return _described(inside, found, given)


def _keys_of_field(table: Table, name: str, keys: type, todo: str) -> tuple[Table, dict[str, Any]]:
    """The table of one field, and its checked keys. Raises ConfigError; ``todo``: the remedy without ``at``."""
    inside = table.table(name)
    given = inside.read(keys_of(keys))
    if "at" not in given:
        inside.fail(None, "no at", todo)
    if len(given.get("unit", "")) > _UNIT_LENGTH:
        inside.fail("unit", f"unit has {len(given['unit'])} characters", f"at most {_UNIT_LENGTH} fit into a table")
    if any(letter in given.get("unit", "") for letter in "[]"):
        inside.fail(
            "unit", f"unit = {given['unit']!r} has a bracket", "leave it out: it stands in brackets in recordings"
        )
    inside.title = table.title  # messages about a field begin with its name
    return inside, given


def _described(keys: Table, found: Field, given: dict[str, Any]) -> Field:
    """``found`` with scale, offset, unit, dead band and words as ``given``. Raises ConfigError."""
    words = _words(keys) if given.pop("words", None) is not None else {}
    with keys.blaming(next(iter(given), None)):
        found = with_scale(found, given)
    with keys.blaming("words"):
        return with_words(found, words) if words else found


def _words(keys: Table) -> dict[int, str]:
    """The key ``words``: texts by numbers."""
    inside, found = keys.table("words"), {}
    for number in inside:
        text = inside.text(number).strip()
        if not _WHOLE.fullmatch(number) or not text or len(text) > _WORD_LENGTH or not text.isprintable():
            todo = f'write a number and up to {_WORD_LENGTH} characters: 1 = "on"'
            inside.fail(number, f"{brief(number)} = {brief(text)}", todo)
        found[int(number)] = text
    return found


def _with_status(keys: Table, found: Field, given: dict[str, Any], length: int, what: str, slots: SlotMap) -> Field:
    """``found`` with the keys ``status`` and ``quality``, which are taken out of ``given``."""
    place, coding = given.pop("status", None), given.pop("quality", None)
    if place is None and coding is None:
        return found
    if place is None or coding is None:
        missing = (
            'status, for instance status = "u8@4"' if place is None else 'quality = "pa-classic" or "pa-condensed"'
        )
        keys.fail("status" if coding is None else "quality", "status and quality go together", f"add {missing}")
    if what == "outputs":
        keys.fail("status", "an output has no status of the slave", "leave status and quality out")
    with keys.blaming("status"):
        return with_status(found, field_of(found.name, place, length, what, slots), coding)
