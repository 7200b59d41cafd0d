"""`[map]` of a device file: the fields that the process data can carry, and the parameters that say which."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from msgspec import Struct

from dpstack.devices import keys as k
from dpstack.profile.channel.base import MapCodes, ParamKey
from dpstack.profile.model.description import DescribedRange
from dpstack.profile.model.params import ParamTable
from dpstack.profile.model.process_data_map import FieldTable, MapField
from dpstack.text import brief
from dpstack.toml.table import Table, keys_of

#: lowest and highest integer of a field by its type
_LIMITS: Final = {"u16": (0, 0xFFFF), "i16": (-0x8000, 0x7FFF), "i32": (-(1 << 31), (1 << 31) - 1)} | {
    "u32": (0, (1 << 32) - 1)
}


class MapWay(Struct, frozen=True, kw_only=True):
    """The map of the inputs or of the outputs."""

    fields: FieldTable = FieldTable()
    #: the parameters that hold it; none: the drive holds it in another way
    codes: MapCodes = MapCodes(())
    #: the numbers of the fields at delivery
    default: tuple[int, ...] = ()
    #: the name of a word, with its number; "": it has none
    place: str = ""
    #: number of the first word
    first: int = 1
    #: section of the manual
    source: str = ""

    def places(self, fields: Sequence[MapField | None]) -> Iterator[tuple[str, int]]:
        """The words of a map for people, with their octets."""
        at = self.first
        for field in fields:
            octets = 2 if field is None else field.octets
            what = "not used" if field is None else field.name
            if field is not None and field.spec is not None:
                what += f", {field.spec.title}"
            yield f"{self.place.replace('{}', str(at))} ({what})" if self.place else what, octets
            at += octets // 2

    def ranges(self, fields: Sequence[MapField | None]) -> Iterator[DescribedRange]:
        """Ranges and scales of the fields that the manual lists."""
        for one in fields:
            if one is None or one.key not in self.fields.fields:
                continue
            unit = f" {one.unit}" if one.unit else ""
            yield DescribedRange(
                name=f"{one.name} ({'out' if self.fields.outputs else 'in'})",
                range=f"{one.low:g}..{one.high:g}{unit}",
                wire=f"{1 / one.per_unit:g}{unit} a count{', signed' if one.signed else ''}",
                source=self.source,
            )


def read_maps(table: Table, parameters: ParamTable) -> tuple[MapWay, MapWay] | None:
    """The maps of inputs and outputs; None: the device has none. Raises ConfigError."""
    if table.raw("map") is None:
        return None
    inside = table.table("map")
    given = inside.read(keys_of(k.MapKeys))
    common: dict[str, Any] = {
        key: given[key] for key in ("most", "places", "empty", "noun", "nouns", "hint") if key in given
    }
    written = common | {"outputs": True, "twice": given.get("twice", "")}
    return _way(inside, "inputs", common, parameters), _way(inside, "outputs", written, parameters)


def _way(table: Table, name: str, common: Mapping[str, Any], parameters: ParamTable) -> MapWay:
    if table.raw(name) is None:
        return MapWay(fields=FieldTable(**common))
    inside = table.table(name)
    given = inside.read(keys_of(k.MapWayKeys))
    for parameter in (*given.get("codes", ()), *([given["count"]] if "count" in given else [])):
        if parameters.named(parameter) is None:
            inside.fail("codes", f"{brief(parameter)} is no parameter of this file", "declare it in [parameters]")
    codes = MapCodes(())
    if "codes" in given:
        places = tuple(map(ParamKey, given["codes"]))
        codes = MapCodes(places, ParamKey(given["count"]) if "count" in given else None)
        common = {"most": len(places), "padded": codes.count is None} | dict(common)
    fields: dict[int, MapField] = {}
    if "fields" in given:
        listed = inside.table("fields")
        for one in listed:
            field = _field(listed.table(one, "a table, for instance { code = 1 }"), one)
            if field.key in fields:
                listed.fail(one, f"{one} and {fields[field.key].name} have one code", "give each field its own")
            fields[field.key] = field
    rest = {key: given[key] for key in ("default", "place", "first", "source") if key in given}
    return MapWay(fields=FieldTable(fields=fields, **common), codes=codes, **rest)


def _field(table: Table, name: str) -> MapField:
    given = table.read(keys_of(k.FieldKeys))
    if "code" not in given:
        table.fail(None, f"the field {name} has no code", "add code = ...")
    kind, per_unit = given.get("type", "u16"), given.get("per_unit", 1)
    if not per_unit:
        table.fail("per_unit", "per_unit = 0: a scale of zero", "give the counts that make 1")
    low, high = (limit / per_unit for limit in _LIMITS[kind])
    return MapField(
        key=given["code"],
        name=name,
        octets=int(kind[1:]) // 8,
        neutral=given.get("neutral", True),
        per_unit=per_unit,
        low=given.get("low", low),
        high=given.get("high", high),
        unit=given.get("unit", ""),
        signed=kind[0] == "i",
        limit=given.get("limit", ""),
    )
