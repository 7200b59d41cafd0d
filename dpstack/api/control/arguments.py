"""Parsers of command arguments: times, numbers, switches, octets. All raise UsageError with an example."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Mapping
from typing import Final, TypeVar

from dpstack.errors import UsageError
from dpstack.text import decimal, shortened
from dpstack.toml.table import parse_hex
from dpstack.units import NS_PER_S

#: as a port: a pty that the program makes itself
PTY: Final = "pty"
_N = TypeVar("_N", bound=float)
_TIME: Final = re.compile(r"([0-9]{1,12}(?:\.[0-9]{0,12})?|\.[0-9]{1,12})(ms|s|min|)")
_UNIT_NS: Final = {"ms": NS_PER_S // 1000, "s": NS_PER_S, "min": 60 * NS_PER_S, "": NS_PER_S}
_LONGEST_NS: Final = 365 * 86_400 * NS_PER_S


def time_ns(text: str) -> int:
    """``2s``, ``500ms``, ``1min``, ``2`` (seconds) in ns."""
    match = _TIME.fullmatch(text.strip().lower())
    ns = round(float(match[1]) * _UNIT_NS[match[2]]) if match else 0
    if not 0 < ns < _LONGEST_NS:
        raise UsageError(f"{shortened(text)!r} is no time; write it as 2s or 500ms")
    return ns


def within(text: str, read: Callable[[str], _N | None], low: float, high: float, what: str) -> _N:
    """``text`` parsed by ``read`` (None or ValueError: no number), from ``low`` to ``high``. ``what``: the kind of
    number for the message of the UsageError.
    """
    with contextlib.suppress(ValueError):
        value = read(text)
        if value is not None and low <= value <= high:
            return value
    raise UsageError(f"{shortened(text)!r} is no {what}")


def number(text: str, low: float, high: float, example: str) -> float:
    """A number from ``low`` to ``high``."""
    return within(text, float, low, high, f"number from {low:g} to {high:g}; write for instance {example}")


def mask(text: str) -> int:
    """A word of 16 bits in hex."""
    return within(text, lambda digits: int(digits, 16), 0, 0xFFFF, "word of four hex digits; write for instance 0080")


def switch(text: str) -> bool:
    """``on`` or ``off``."""
    if text.lower() not in ("on", "off"):
        raise UsageError(f"{text!r} is neither on nor off")
    return text.lower() == "on"


def direction(text: str) -> int:
    """``forward``, ``reverse`` or ``off``: 1, -1, 0."""
    try:
        return {"forward": 1, "reverse": -1, "off": 0}[text.lower()]
    except KeyError:
        raise UsageError(f"{text!r} is neither forward nor reverse nor off") from None


def field_value(text: str) -> tuple[str, str, str]:
    """``SLAVE.FIELD=VALUE``: the three parts."""
    where, equals, value = text.partition("=")
    slave, dot, name = where.rpartition(".")
    if not (equals and dot and slave.strip() and name.strip()):
        raise UsageError(f"{text!r} is not SLAVE.FIELD=VALUE; write it as 8.limit=on")
    return slave.strip(), name.strip(), value


def octets(text: str) -> tuple[str, bytes]:
    """``SLAVE=HEX``."""
    where, equals, digits = text.partition("=")
    try:
        if equals and where:
            return where, parse_hex(digits)
    except ValueError as error:
        raise UsageError(f"{text!r}: {error}; write it as 9=00FF") from None
    raise UsageError(f"{text!r} is not SLAVE=HEX; write it as 9=00FF")


def whole_number(text: str, what: str = "whole number; write for instance 1") -> int:
    """A whole number from 0 (slots, channels)."""
    return within(text, decimal, 0, math.inf, what)


def hex_octets(text: str, advice: str) -> bytes:
    """Octets in hex."""
    try:
        return parse_hex(text)
    except ValueError as error:
        raise UsageError(f"{text!r}: {error}; {advice}") from None


def octet(text: str) -> int:
    """One octet in hex."""
    found = hex_octets(text, "write for instance 03")
    if len(found) != 1:
        raise UsageError(f"{text!r} is not one octet; write for instance 03")
    return found[0]


def address_of(text: str, names: Mapping[int, str]) -> int:
    """The address of a slave by its address or name. Raises UsageError with the known ones."""
    for address, name in names.items():
        if text in (name, str(address)):
            return address
    known = ", ".join(f"{address} ({name})" for address, name in sorted(names.items())) or "none"
    raise UsageError(f"no slave {text!r} here; there are: {known}")
