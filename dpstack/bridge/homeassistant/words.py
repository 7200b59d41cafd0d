"""Words of Home Assistant: templates of Jinja that read values of plain JSON and write orders; units and their classes.

A name in a template is a literal in which every character is an escape but ASCII letters and digits, space, ``_`` and
``-``: so no name can end the literal, or begin a statement.

A device class permits certain spellings of units only, and some of them certain state classes only. A unit that could
be several things (``%``; ``m³`` in a tank, or through a meter) has no device class. A test with Home Assistant itself
holds the table of units.
"""

from __future__ import annotations

import string
from typing import Final, NamedTuple

# --- templates ----------------------------------------------------------------------------------------------------

_PLAIN: Final = frozenset(string.ascii_letters + string.digits + " _-")
#: the time of the sender, without which an order is refused
_TIME: Final = '"time": {{ now().timestamp() }}'
#: an order without an argument, and one with the value that Home Assistant puts into it
PRESS: Final = "{" + _TIME + "}"
COMMAND: Final = '{"value": {{ value }}, ' + _TIME + "}"
#: of the set point of a drive, which is in percent for people
COMMAND_PERCENT: Final = '{"value": {{ value / 100 }}, ' + _TIME + "}"
#: the last order and its result; why it was refused
_RESULT: Final = "{% set v = value_json | default({}) %}"
RESULT: Final = _RESULT + "{{ (v.get('order') ~ ': ' ~ v.get('result'))[:255] }}"
RESULT_ATTRIBUTES: Final = _RESULT + "{{ {'reason': v.get('reason'), 'order_time': v.get('order_time')} | tojson }}"
#: words for true and false, in states and orders
TRUE: Final = "true"
FALSE: Final = "false"


def literal(text: str) -> str:
    """``text`` as a literal of Jinja, in ASCII."""
    return "'" + "".join(letter if letter in _PLAIN else _escape(ord(letter)) for letter in text) + "'"


def _escape(code: int) -> str:
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"


def _member(name: str) -> str:
    """The statement that makes ``v`` of the member ``name``; an empty object if it is not there."""
    return "{% set v = (value_json | default({})).get(" + literal(name) + ") | default({}, true) %}"


def quality(name: str) -> str:
    """``true`` while the value ``name`` is one of this moment."""
    return _member(name) + "{{ 'true' if v.get('quality') in ['good', 'uncertain'] else 'false' }}"


def attributes(name: str) -> str:
    """Quality and reason of the value ``name``. Not its time: each change of an attribute is a row in a database."""
    return _member(name) + "{{ {'quality': v.get('quality'), 'reason': v.get('reason')} | tojson }}"


def flag(name: str) -> str:
    return _member(name) + "{{ {true: 'true', false: 'false'}.get(v.get('value')) }}"


def number(name: str) -> str:
    return _member(name) + "{{ v.get('value') }}"


def single(name: str) -> str:
    """A number of four octets (IEEE 754): seven digits of it are those that somebody meant, 1.234 and not
    1.23399996757507."""
    few = "v.get('value') is number and v.value | abs < 1e7"
    return _member(name) + "{{ '%.7g' | format(v.value) if " + few + " else v.get('value') }}"


def percent(name: str) -> str:
    return _member(name) + "{{ none if v.get('value') is none else (v.value * 100) | round(1) }}"


def text(name: str) -> str:
    """Home Assistant takes no state of more than 255 characters, and shows an empty one as nothing at all."""
    return _member(name) + "{{ (v.get('value') | string)[:255] or 'none' }}"


# --- units --------------------------------------------------------------------------------------------------------

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
