"""The slots of a slave, and names for their channels, as lines of a configuration that is written for people.

The names are comments that need only their ``# `` taken away.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dpstack.dp.channels import proposed_names
from dpstack.dp.slot_map import SlotMap
from dpstack.toml.reading import comment, toml_value

#: places of a list in one line: the bits of an octet
_IN_A_LINE: Final = 8
_PROPOSED: Final = "names for the channels, proposed: take away the # of the tables and names that you want"


def slot_remarks(slots: SlotMap) -> list[str]:
    """A comment for each slot that is not empty: ``# slot 3 "2 AI": inputs 1 to 4, 2 channels``."""
    return [comment(slot.text) for slot in slots.slots if not slot.is_empty]


def name_lines(slots: SlotMap, *, taken: bool = False) -> list[str]:
    """The tables [slave.inputs] and [slave.outputs] with proposed names, as comments unless they are ``taken``. None
    without channels."""
    lines = [
        line
        for key, names in proposed_names(slots).items()
        for line in (f"[slave.{key}]", *(one for name, places in names.items() for one in _lines(name, places)))
    ]
    if taken or not lines:
        return lines
    return [comment(_PROPOSED), *(f"# {line}" for line in lines)]


def _lines(name: str, places: str | list[str]) -> Iterator[str]:
    if len(places) <= _IN_A_LINE or isinstance(places, str):
        yield f"{name} = {toml_value(places)}"
        return
    yield f"{name} = ["
    for at in range(0, len(places), _IN_A_LINE):
        yield f"  {toml_value(places[at : at + _IN_A_LINE])[1:-1]},"
    yield "]"
