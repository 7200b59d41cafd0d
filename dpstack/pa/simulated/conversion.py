"""Factors between the units of one quantity, for parameters that follow a change of unit.

Codes: docs/reference/decisions/pa.md#unit-codes. Factors are definitions of the units.
"""

from __future__ import annotations

from typing import Final

from dpstack.errors import UsageError

#: quantity: unit code -> (factor, offset): value in the base unit = factor * value + offset
_TABLES: Final[dict[str, dict[int, tuple[float, float]]]] = {
    "pressure": {
        1130: (1e-5, 0),
        1132: (10, 0),
        1133: (0.01, 0),
        1137: (1, 0),
        1138: (1e-3, 0),
        1141: (0.0689475729, 0),
    },
    "temperature": {1000: (1, -273.15), 1001: (1, 0), 1002: (5 / 9, -160 / 9)},
    "length": {1010: (1, 0), 1012: (0.01, 0), 1013: (1e-3, 0), 1018: (0.3048, 0)},
    "volume": {1034: (1, 0), 1038: (1e-3, 0), 1041: (0.1, 0)},
    "mass": {1088: (1, 0), 1089: (1e-3, 0), 1092: (1000, 0)},
    "volume flow": {
        1347: (3600, 0),
        1348: (60, 0),
        1349: (1, 0),
        1351: (3.6, 0),
        1352: (0.06, 0),
        1353: (1e-3, 0),
    },
    "mass flow": {1322: (3600, 0), 1323: (60, 0), 1324: (1, 0), 1328: (1000, 0)},
    "density": {1097: (1, 0), 1103: (1000, 0), 1104: (1000, 0)},
    "percent": {1342: (1, 0)},
    "frequency": {1077: (1, 0)},
    "velocity": {1061: (1, 0)},
}
#: a totaliser's quantity and that of its flow: the integral of the base unit over an hour is the base unit
TOTALS: Final = {"volume": "volume flow", "mass": "mass flow"}


def quantity_of(unit: int) -> str | None:
    """The quantity of a unit code; None for a code that the simulation does not convert."""
    return next((name for name, table in _TABLES.items() if unit in table), None)


def convert(value: float, unit: int, to: int) -> float:
    """``value`` in another unit of its quantity. Raises UsageError if the units do not belong together."""
    if unit == to:
        return value
    table = _TABLES.get(quantity_of(unit) or "", {})
    if to not in table:
        raise UsageError(f"unit {unit} is not convertible to unit {to}")
    (factor, offset), (factor_to, offset_to) = table[unit], table[to]
    return (factor * value + offset - offset_to) / factor_to


def per_hour(flow: float, unit: int, total: int) -> float:
    """What ``flow`` in ``unit`` gives in an hour, in the unit ``total``. Raises UsageError if they do not fit."""
    quantity = quantity_of(total) or ""
    if TOTALS.get(quantity) != quantity_of(unit):
        raise UsageError(f"unit {unit} is no flow of unit {total}")
    factor, _ = _TABLES[TOTALS[quantity]][unit]
    return flow * factor / _TABLES[quantity][total][0]
