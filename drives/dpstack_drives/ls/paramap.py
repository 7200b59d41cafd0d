"""Para Status (COM-31..) and Para Control (COM-51..): which address stands where.

docs/reference/drives/ls-s100.md#parameters-and-maps. Any parameter may, as four hex digits, ``0x0A`` or a keypad code;
0000 leaves a word empty.
"""

from __future__ import annotations

from typing import Final

from msgspec import structs

from dpstack.devices.maps import MapWay
from dpstack.profile import process_data_map
from dpstack_drives.ls import table as t


def word(where: int) -> process_data_map.MapField:
    """The parameter at an address; frequency and operation command are 0 while none of either is given."""
    spec = t.spec_at(where)
    return process_data_map.MapField(
        key=where,
        name=t.code_of(where),
        text=f"{where:04X}",
        spec=spec,
        neutral=where in (t.FREQUENCY, t.OPERATION),
        wants="takes the 16-bit integer on the wire",
        read_only=f"({spec.title}) is read only" if spec is not None and spec.read_only else "",
    )


def _find(text: str) -> process_data_map.MapField | None:
    where = t.mapped_address(text)
    return None if where is None else word(where)


def _any(way: MapWay) -> process_data_map.FieldTable:
    return structs.replace(way.fields, find=_find, by_code=word)


#: of inputs and outputs
WAYS: Final = t.FILE.maps or (MapWay(), MapWay())
STATUS: Final = _any(WAYS[0])
CONTROL: Final = _any(WAYS[1])
MAPS: Final = (STATUS, CONTROL)
