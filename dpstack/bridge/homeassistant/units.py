"""Units of Home Assistant with the device class and state class that a sensor gets by them.

A device class permits certain spellings of units only, and some of them certain state classes only. A unit that could
be several things (``%``; ``m³`` in a tank, or through a meter) has no device class. A test with Home Assistant itself
holds this table.
"""

from __future__ import annotations

from typing import Final, NamedTuple

MEASUREMENT: Final = "measurement"
#: of a meter, which only rises until it begins again: the only one for energy
_RISING: Final = "total_increasing"


class Unit(NamedTuple):
    """``device_class`` empty: none."""

    unit: str
    device_class: str = ""
    state_class: str = MEASUREMENT


_CLASSES: Final[dict[str, str]] = {
    "temperature": "°C °F K",
    "pressure": "Pa hPa kPa mbar bar psi mmHg",
    "voltage": "μV mV V kV",
    "current": "μA mA A",
    "power": "mW W kW MW",
    "energy": "Wh kWh MWh kJ MJ GJ",
    "apparent_power": "VA kVA",
    "reactive_power": "var kvar",
    "frequency": "mHz Hz kHz MHz",
    "duration": "μs ms s min h d",
    "distance": "mm cm m km",
    "speed": "mm/s m/s m/min km/h",
    "weight": "mg g kg",
    "volume_flow_rate": "L/s L/min L/h m³/s m³/min m³/h",
    "conductivity": "μS/cm mS/cm",
    "illuminance": "lx",
    "irradiance": "W/m²",
    "data_rate": "bit/s kbit/s Mbit/s",
}
#: other spellings, in the writing of GSD files and manuals
_SPELLINGS: Final[dict[str, str]] = {
    **dict.fromkeys(("degC", "deg C", "°c", "℃", "grad C"), "°C"),
    **dict.fromkeys(("degF", "deg F", "℉"), "°F"),
    **{f"l/{time}": f"L/{time}" for time in ("s", "min", "h")},
    **{f"m3/{time}": f"m³/{time}" for time in ("s", "min", "h")},
    # u, and the sign of the Latin alphabet, for the Greek letter
    **{f"{letter}{unit}": f"μ{unit}" for letter in "uµ" for unit in ("V", "A", "s", "S/cm")},
    "W/m2": "W/m²",
    "m3": "m³",
    "l": "L",
    "kVAr": "kvar",
    "VAr": "var",
    "sec": "s",
    "1/min": "rpm",
    "U/min": "rpm",
}
_UNITS: Final[dict[str, Unit]] = {
    unit: Unit(unit, name, _RISING if name == "energy" else MEASUREMENT)
    for name, units in _CLASSES.items()
    for unit in units.split()
}


def unit_of(given: str) -> Unit:
    """The unit of a node as Home Assistant has it; one that it does not know stays as it is."""
    unit = _SPELLINGS.get(given.strip(), given.strip())
    return _UNITS.get(unit, Unit(unit))


def known_units() -> tuple[Unit, ...]:
    """All units that have a device class."""
    return tuple(_UNITS.values())
