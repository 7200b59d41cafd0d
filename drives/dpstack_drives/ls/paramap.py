"""Para Status (COM-31..) and Para Control (COM-51..): which address stands where.

docs/reference/drives/ls-s100.md#parameters-and-maps. Any parameter may, as four hex digits, ``0x0A`` or a keypad code;
0000 leaves a word empty.
"""

from __future__ import annotations

from typing import Final

from msgspec import structs

from dpstack.profile import MapCodes, ParamKey, process_data_map
from dpstack_drives.ls import table as t
from dpstack_drives.ls import telegrams


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


STATUS: Final = process_data_map.FieldTable(
    most=telegrams.MOST,
    empty="0000",
    noun="address",
    nouns="addresses",
    hint="write 000A (four hex digits), dr-03 or In-90",
    find=_find,
    by_code=word,
)
CONTROL: Final = structs.replace(STATUS, outputs=True, twice="the last word would win")
MAPS: Final = (STATUS, CONTROL)
#: as delivered
DEFAULTS: Final = ((0x000A, 0x000E, 0x000F), (0x0005, 0x0006))


def _codes(count: int, first: int) -> MapCodes:
    return MapCodes(tuple(ParamKey(first + place) for place in range(telegrams.MOST)), ParamKey(count))


#: of inputs and outputs: addresses and their number (4.2.8)
CODES: Final = (_codes(t.STATUS_COUNT, t.PARA_STATUS), _codes(t.CONTROL_COUNT, t.PARA_CONTROL))
