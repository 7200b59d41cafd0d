"""The names of a configuration as a list for the dissector (profibus.lua): a line for each station and named value.

Columns are separated by tabs: address, "station", name; or address, "input" or "output", kind (bool, uint, int, float,
bytes), first octet, octets, first bit, bits, order of the octets (big, little, swapped), scale, offset, unit, name.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from dpstack.text import printable

if TYPE_CHECKING:
    from dpstack.api.config.config import Config

_KINDS: Final = {"b": "bytes", "u": "uint", "i": "int", "f": "float"}
#: the first line; the dissector takes no other file
_FIRST: Final = "# names for the PROFIBUS dissector of dpstack"


def names_text(config: Config) -> str:
    """The list for ``config``, with line ends."""
    return "\n".join([_FIRST, *_lines(config)]) + "\n"


def _lines(config: Config) -> Iterator[str]:
    for slave in config.slaves:
        yield f"{slave.address}\tstation\t{_cell(slave.name)}"
        for direction, fields in slave.fields:
            for field in fields.fields.values():
                kind = "bool" if field.is_bool else _KINDS[field.type[0]]
                order = "little" if field.little else "swapped" if field.swapped else "big"
                place = (field.octet, field.length, field.bit or 0, field.width, order)
                columns = (slave.address, direction, kind, *place, field.scale, field.offset, field.unit, field.name)
                yield "\t".join(_cell(str(column)) for column in columns)


def _cell(text: str) -> str:
    return printable(text.replace("\t", " "))
