"""OUT-PZD3 to OUT-PZD6 of PPO2 and PPO4 as sources 750 to 761 (docs/reference/drives/demag.md#out-pzd).

PZD3 is also the additional reference (docs/reference/drives/demag.md#additional-reference). The manual's list and
example have PZD5 as long at 759: by its table it is 760, which is taken.
"""

from __future__ import annotations

from typing import Final

from msgspec import structs

from dpstack.profile import Scale, process_data_map

#: PZD3 is the first one
FIRST: Final = 3
COUNT: Final = 4
#: meaning: first source number (of PZD3)
SOURCES: Final = {"bool": 750, "percent": 754, "current": 754, "torque": 754, "frequency": 758}
#: 11.2.4: PZD3 is added to the ramp output
ADDITIONAL: Final = "reference"
EMPTY: Final = "-"
_KINDS: Final = (*SOURCES, ADDITIONAL, EMPTY)
_PERCENT: Final = Scale("percent", full=100, span=1.0, unit="%")
_PERCENT_LIMIT: Final = 300
_CURRENTS: Final = ("current", "torque")
#: of the scaling current
_AMPERE: Final = 0x2000


def word(number: int, kind: str, reference_hz: float, scaling_current: float) -> process_data_map.MapField:
    """PZD ``number`` as ``kind``. ``reference_hz`` and ``scaling_current`` (A, 0: not known) scale it."""
    name = f"pzd{number}"
    field = process_data_map.MapField(key=number, name=name, text=kind, label=f"{name} ({kind})", signed=True)
    if kind == "bool":
        return structs.replace(field, per_unit=-1, low=0, high=1, wants="is 0 or 1")
    if kind == "percent":
        return structs.replace(field, per_unit=_PERCENT.full, low=-_PERCENT_LIMIT, high=_PERCENT_LIMIT, unit="%")
    if kind not in _CURRENTS:
        per_unit, unit = Scale("frequency").full / reference_hz, "Hz"
    elif scaling_current:
        per_unit, unit = _AMPERE / scaling_current, "A"
    else:
        return structs.replace(field, read_only="needs the option scaling_current: the drive's scaling current in A")
    return structs.replace(field, per_unit=per_unit, low=-0x8000 / per_unit, high=0x7FFF / per_unit, unit=unit)


def parse(text: str, reference_hz: float, scaling_current: float) -> process_data_map.FieldMap:
    """``reference percent - frequency``; what is not given is not used. Raises ValueError."""
    kinds = process_data_map.split(text)[0].lower().split()
    if len(kinds) > COUNT:
        raise ValueError(f"{len(kinds)} words, there are {COUNT} (PZD3 to PZD6)")
    fields: list[process_data_map.MapField | None] = []
    for number, kind in enumerate(kinds, FIRST):
        if kind not in _KINDS:
            raise ValueError(f"{kind!r} is no meaning of PZD{number}; write {', '.join(_KINDS)}")
        if kind == ADDITIONAL and number != FIRST:
            raise ValueError(f"only PZD{FIRST} is the additional reference, not PZD{number}")
        fields.append(None if kind == EMPTY else word(number, kind, reference_hz, scaling_current))
    return process_data_map.FieldMap((*fields, *(None,) * (COUNT - len(fields))))


def source(number: int, words: tuple[int, ...], reference_hz: float) -> bool | float:
    """A source as the drive's functions take it: Boolean, per cent (words), Hz (longs). Raises ValueError.

    Readings: anything but 0 is TRUE; per cent beyond 300 are 300.
    """
    kind, at = divmod(number - SOURCES["bool"], COUNT)
    if not 0 <= kind <= 2:
        raise ValueError(f"source {number} is none of 750 to 761")
    word = words[FIRST - 1 + at]
    if kind == 0:
        return bool(word)
    if kind == 1:
        return min(max(_PERCENT.decode(word), -_PERCENT_LIMIT), _PERCENT_LIMIT)
    return Scale("frequency", span=reference_hz).decode(word)
