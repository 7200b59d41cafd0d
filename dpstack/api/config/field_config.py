"""The keys ``inputs`` and ``outputs`` of a [[slave]] table: names for its process data."""

from __future__ import annotations

from dpstack.api.config.table import Table
from dpstack.dp.process_data import Field, FieldMap, field_of, overlap
from dpstack.errors import ConfigError


def read_fields(table: Table, input_len: int, output_len: int) -> tuple[FieldMap, FieldMap]:
    """The fields of a slave with so many octets of inputs and outputs. Raises ConfigError.

    Inputs may be read in several ways, so their fields may overlap; outputs may not: who writes one field must not
    change another. A name stands for one field of a slave.
    """
    inputs = _fields(table, "inputs", input_len)
    outputs = _fields(table, "outputs", output_len)
    both = next((name for name in outputs if name in inputs), None)
    if both is not None:
        table.fail("outputs", f"{both!r} is an input and an output", "give one of them another name")
    shared = overlap(outputs)
    if shared is not None:
        later, first = shared
        table.fail(
            "outputs",
            f"{later.name} ({later.spec}) and {first.name} ({first.spec}) share bits",
            "move one of them, or name the bits that are left",
        )
    return FieldMap(inputs, input_len), FieldMap(outputs, output_len)


def _fields(table: Table, key: str, length: int) -> dict[str, Field]:
    inside = table.table(key)
    return {} if inside is None else {name: _field(inside, name, length, key) for name in inside}


def _field(inside: Table, name: str, length: int, key: str) -> Field:
    text = inside.text(name) or ""
    try:
        return field_of(name, text, length, key)
    except ConfigError as error:
        what, _, todo = str(error).rpartition("; ")
        raise inside.error(name, what, todo) from None
