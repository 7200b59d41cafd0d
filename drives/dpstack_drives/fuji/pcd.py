"""PCD1 to PCD4 of PPO2 and PPO4: function codes as cyclic words (docs/reference/drives/fuji.md#pcd-words).

o40 to o43 (PNU 915) say what is written, o48 to o51 (PNU 916) what is read: group and number in four hex digits, F26 is
041A. They act after power-on. Of doubled assignments of writes the lowest counts; S01 and S05 cannot be written.
"""

from __future__ import annotations

import re
from typing import Final

from msgspec import structs

from dpstack.devices.maps import MapWay
from dpstack.profile import MapCodes, ParamKey, process_data_map
from dpstack_drives.fuji import table as t

_BARE: Final = re.compile(r"[0-9A-Fa-f]{4}")
#: the assignments of inputs and outputs
CODES: Final = (
    MapCodes(tuple(ParamKey(t.PNU_PCD_READ, index=index) for index in t.ARRAYS[t.PNU_PCD_READ])),
    MapCodes(tuple(ParamKey(t.PNU_PCD_WRITE, index=index) for index in t.ARRAYS[t.PNU_PCD_WRITE])),
)


class Commands(process_data_map.MapField, frozen=True, kw_only=True):
    """S06, whose bits 0 and 1 do nothing here."""

    def encode(self, value: float) -> int:
        if int(value) & t.S06_IGNORED:
            raise ValueError("S06: bits 0 and 1 (run forward, reverse) are ignored here: start() and speed do that")
        return process_data_map.MapField.encode(self, value)


def word(code: int) -> process_data_map.MapField:
    """The function code with this assignment (041A). Group S is commands and set points, all others are kept."""
    return (Commands if code == t.S06 else process_data_map.MapField)(
        key=code,
        name=t.code_of(code),
        spec=t.spec_at(code),
        neutral=code >> 8 == t.GROUPS["S"],
        low=-0x8000,
        wants="takes the 16-bit integer on the wire (its format is in no manual of ours)",
    )


def _find(text: str) -> process_data_map.MapField | None:
    found = t.address(text)
    if found is not None:
        return word(found[0] - t.GROUP_OFFSET << 8 | found[1])
    return word(int(text, 16)) if _BARE.fullmatch(text) else None


def _written(text: str) -> process_data_map.MapField | None:
    found = _find(text)
    if found is None or found.key not in t.READ_ONLY_HERE:
        return found
    return structs.replace(found, read_only="can only be read: its assignment would be ignored")


_WAYS: Final = t.FILE.maps or (MapWay(), MapWay())
#: of inputs and outputs
MAPS: Final = (
    structs.replace(_WAYS[0].fields, padded=True, find=_find, by_code=word),
    structs.replace(_WAYS[1].fields, padded=True, find=_written, by_code=word),
)
