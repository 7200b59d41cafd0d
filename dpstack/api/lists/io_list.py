"""The I/O list of a configuration: a row for each named value and for each channel without a name, as CSV.

A named value of an S7-200 has the address in its CPU as type, and no octet: it lies in no telegram of the bus cycle.

The file is what spreadsheets open and write. :mod:`dpstack.api.lists.io_list_reader` takes one back.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator
from typing import Final

from msgspec import Struct

from dpstack.api.config.config import Config
from dpstack.api.config.cpu import CpuConfig
from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.channels import Channel, channels
from dpstack.dp.process_data import Field
from dpstack.dp.slot_map import Direction, Slot
from dpstack.text import printable

#: the columns in their order
COLUMNS: Final = (
    "slave",
    "address",
    "slot",
    "module",
    "channel",
    "direction",
    "name",
    "type",
    "octet",
    "bit",
    "unit",
    "scale",
    "offset",
    "dead_band",
    "status",
    "quality",
)
#: spreadsheets take such a text for a formula; an apostrophe in front makes it a text
_FORMULA: Final = re.compile(r"'*[=+\-@\t\r]")


class Row(Struct, frozen=True):
    """A row. ``slave``: its slave or CPU.

    ``field``: the value, or the place and type proposed for a channel without a name (``is_named`` False).
    ``channel``: its number in the slot; None if it is not the whole channel or part of one.
    """

    slave: SlaveConfig | CpuConfig
    direction: Direction
    slot: Slot | None
    channel: int | None
    field: Field
    is_named: bool

    @property
    def cells(self) -> dict[str, str | int | float | None]:
        """The cells by column; None is an empty one."""
        field = self.field
        of_cpu = isinstance(self.slave, CpuConfig)
        named: dict[str, str | int | float | None] = {
            "unit": field.unit or None,
            "scale": None if field.scale == 1 else field.scale,
            "offset": field.offset or None,
            "dead_band": field.dead_band or None,
            "status": field.status,
            "quality": field.coding or None,
        }
        return {
            "slave": self.slave.name,
            "address": self.slave.address,
            "slot": None if self.slot is None else self.slot.number,
            "module": None if self.slot is None or not self.slot.name else printable(self.slot.name),
            "channel": self.channel,
            "direction": self.direction.value,
            "name": field.name if self.is_named else None,
            "type": field.written if of_cpu else type_cell(field),
            "octet": None if of_cpu else field.octet,
            "bit": None if of_cpu else field.bit,
            **named,
        }


def type_cell(field: Field) -> str:
    """``i16``, ``bool``; ``bytes:3`` with the number of octets."""
    return f"{field.type_text}:{field.length}" if field.type == "bytes" else field.type_text


def first_bit(field: Field) -> int:
    """The first bit of its octets, or its own bit; counted from the lowest bit of octet 0."""
    return 8 * field.octet + (field.bit or 0)


def io_rows(config: Config) -> Iterator[Row]:
    """The rows by slave, slot, direction and place, then those of the CPUs. The words of a drive, which its plugin
    reads, have rows only if they have names. A value of a CPU that ``allow_commands`` lists is an output."""
    for slave in config.slaves:
        found = [row for direction in Direction for row in _of_direction(slave, direction)]
        yield from sorted(
            found,
            key=lambda row: (
                row.slot is None,
                0 if row.slot is None else row.slot.number,
                row.direction,
                first_bit(row.field),
                -row.field.width,
            ),
        )
    for cpu in config.ppi:
        for direction in Direction:
            for field in fields_of(cpu, direction):
                yield Row(cpu, direction, None, None, field, is_named=True)


def _of_direction(slave: SlaveConfig, direction: Direction) -> Iterator[Row]:
    slots = slave.params.slots
    fields = fields_of(slave, direction)
    for field in fields:
        slot = slots.at(direction, field.octet)
        yield Row(slave, direction, slot, channel_of(field, slot, direction), field, is_named=True)
    if slave.has_plugin:
        return
    used = 0
    for field in fields:
        used |= field.mask
    for channel in channels(slots):
        if channel.direction is direction:
            for free in _without(channel, used):
                yield Row(slave, direction, free.slot, free.number, free.field, is_named=False)


def fields_of(slave: SlaveConfig | CpuConfig, direction: Direction) -> Iterable[Field]:
    """The named values of a direction."""
    return (slave.input_fields if direction is Direction.INPUT else slave.output_fields).fields.values()


def channel_of(field: Field, slot: Slot | None, direction: Direction) -> int | None:
    """The channel of a value, as its declaration or the width of the slot's channels has it."""
    if field.channel is not None or slot is None:
        return field.channel
    area = slot.area(direction)
    return (first_bit(field) - 8 * area.at) // area.width if area.width else None


def _without(channel: Channel, used: int) -> Iterator[Channel]:
    """The channel if it has no bit of ``used``; of octets of unknown width the runs that have none."""
    if channel.number is not None:
        if not channel.field.mask & used:
            yield channel
        return
    first, length = channel.field.octet, channel.field.length
    at = first
    while at < first + length:
        end = at
        while end < first + length and not used >> 8 * end & 0xFF:
            end += 1
        if end > at:
            yield channel.part(at, end - at)
        at = end + 1


# --- CSV --------------------------------------------------------------------------------------------------------------


def csv_text(rows: Iterable[Row], *, semicolons: bool = False) -> str:
    """The rows as CSV, its lines end with CR LF. ``semicolons``: between the cells, and numbers with a decimal comma,
    as spreadsheets of some languages want it."""
    written = io.StringIO()
    writer = csv.writer(written, delimiter=";" if semicolons else ",", lineterminator="\r\n")
    writer.writerow(COLUMNS)
    for row in rows:
        cells = row.cells
        writer.writerow(_cell(cells[column], comma=semicolons) for column in COLUMNS)
    return written.getvalue()


def _cell(value: str | float | None, *, comma: bool) -> str:
    match value:
        case None:
            return ""
        case str():
            return f"'{value}" if _FORMULA.match(value) else value
    return repr(value).replace(".", ",") if comma else repr(value)


def text_of_cell(cell: str) -> str:
    """A text as it was before :func:`csv_text` marked it as no formula."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
