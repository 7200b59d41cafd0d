"""The named fields of an image of process data as a whole, and their values.

:mod:`dpstack.dp.process_data` reads the single fields; a bus without names for its process data does not load it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from msgspec import Struct

from dpstack.dp.process_image import Value
from dpstack.errors import UsageError

if TYPE_CHECKING:
    from dpstack.dp.process_data import Field
    from dpstack.dp.slot_map import SlotMap


class FieldMap(Struct, frozen=True):
    """The fields of one image of ``length`` octets; empty if nothing is named. A collection of their names."""

    fields: Mapping[str, Field] = {}
    length: int = 0

    def __contains__(self, name: object) -> bool:
        return name in self.fields

    def __iter__(self) -> Iterator[str]:
        return iter(self.fields)

    def __len__(self) -> int:
        return len(self.fields)

    def fitted(self, length: int, what: str, slots: SlotMap | None = None) -> FieldMap:
        """The same fields for an image of another length, called ``what``, whose slots may have moved. Raises
        ConfigError if one lies outside."""
        if not self.fields:
            return self if length == self.length else FieldMap({}, length)
        from dpstack.dp.process_data import check_inside, moved  # here, as many slaves have no names for their data

        found = {name: moved(one, what, slots) for name, one in self.fields.items()}
        if length == self.length and found == self.fields:
            return self
        for one in found.values():
            check_inside(one, one.spec, length, what)
        return FieldMap(found, length)

    @property
    def units(self) -> dict[str, str]:
        """The units of the fields that have one, by name."""
        return {name: found.unit for name, found in self.fields.items() if found.unit}

    def values(self, octets: bytes) -> dict[str, Value]:
        """The values of all fields; empty if ``octets`` are too short for them."""
        if len(octets) < self.length:
            return {}
        return {name: found.get(octets) for name, found in self.fields.items()}


class NamedValues(dict[str, Value]):
    """Values of fields by name. An unknown name raises UsageError with the nearest one, instead of KeyError."""

    def __missing__(self, name: object) -> Value:
        import difflib  # here, as it is for mistakes

        near = difflib.get_close_matches(str(name), self, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(self) or 'none'}"
        raise UsageError(f"no input is called {name!r}; {hint}")


class ReadValues(NamedValues):
    """The same; ``read``: the names that somebody has asked for."""

    def __init__(self, values: Mapping[str, Value]) -> None:
        super().__init__(values)
        self.read: set[str] = set()

    def __getitem__(self, name: str) -> Value:
        value = super().__getitem__(name)
        self.read.add(name)
        return value

    def get(self, name: str, default: Any = None) -> Any:
        found = super().get(name, default)
        self.read.update((name,) if name in self else ())
        return found

    def items(self) -> Any:
        self.read.update(self)
        return super().items()

    def values(self) -> Any:
        self.read.update(self)
        return super().values()


def as_json(values: Mapping[str, Value]) -> dict[str, object]:
    """Plain JSON data: octets as hex, infinite and undefined numbers as null."""
    made: dict[str, object] = {}
    for name, value in values.items():
        if isinstance(value, bytes):
            made[name] = value.hex()
        elif isinstance(value, float) and not math.isfinite(value):
            made[name] = None
        else:
            made[name] = value
    return made
