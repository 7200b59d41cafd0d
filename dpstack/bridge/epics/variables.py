"""A process variable as Channel Access has it: type, value, unit, limits, alarm; and the value of a put.

Channel Access has no 64-bit integer and no unsigned one of 32 bits: they are doubles, exact up to 2^53. A text has 39
octets, a unit 7, an enum 16 states. ``NAME.VAL$`` has a whole text as characters.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any, Final

from caproto import (
    AlarmStatus,
    ChannelByte,
    ChannelData,
    ChannelDouble,
    ChannelEnum,
    ChannelFloat,
    ChannelInteger,
    ChannelString,
    ChannelType,
    native_type,
    native_types,
)

from dpstack.bridge.epics.alarms import Alarm, of_reading
from dpstack.bridge.epics.names import Pv
from dpstack.plant.nodes import Kind, Node, digits_of
from dpstack.plant.quality import BOOL, BYTES, MOST_OCTETS, MOST_TEXT, TEXT, Reading, Value

#: octets of a text and of a unit, each without the zero behind it
MOST_STRING: Final = 39
MOST_UNIT: Final = 7
#: states of an enum, and octets of the name of one
MOST_STATES: Final = 16
_MOST_STATE: Final = 25
#: s since 1970 at the first second of EPICS times, 1990
FIRST_TIME: Final = 631_152_000.0
_LAST_TIME: Final = FIRST_TIME + 0xFFFF_FFFF
#: types that fit the LONG of Channel Access
_LONGS: Final = frozenset({"u8", "i8", "u16", "i16", "i32"})
#: states of a value that is true or false, and of an order without a value
_BOOL: Final = ("false", "true")
#: digits behind the point of a number whose unit or scale says nothing
_DIGITS: Final = 3
#: fields of a variable besides its value; a ``$`` behind a text: all of its characters
FIELDS: Final = ("", "VAL", "VAL$", "DESC", "EGU", "AMSG", "AMSG$")


def cut(text: str, most: int) -> str:
    """``text`` within ``most`` octets of UTF-8."""
    octets = text.encode()
    return text if len(octets) <= most else octets[:most].decode(errors="ignore")


def states_of(pv: Pv) -> tuple[str, ...]:
    """The names of the states of an enum; empty for another type."""
    if pv.is_button and pv.order is not None:
        return "idle", str(pv.order.operation)
    node = pv.node
    if node.type == BOOL:
        return _BOOL
    states = node.states if "unknown" in node.states else (*node.states, "unknown")
    fits = len(states) <= MOST_STATES and all(len(one) <= _MOST_STATE for one in states)
    return states if node.states and fits else ()


class Variable:
    """The value or another field of ``pv``, as clients read and monitor it. ``watchers``: called at each change, with
    whether the alarm has changed."""

    def __init__(self, pv: Pv, field: str) -> None:
        self.pv = pv
        self.field = field
        self.watchers: dict[object, Callable[[bool], None]] = {}
        self._states = states_of(pv) if field in ("", "VAL") else ()
        self._data = self._make()
        #: the value of an array of octets; :attr:`_data` has the rest of it
        self._octets = b""
        self._shown: tuple[object, ...] = ()
        self._encoded: dict[ChannelType, tuple[Any, Any]] = {}

    @property
    def type(self) -> ChannelType:
        return self._data.data_type

    @property
    def count(self) -> int:
        """Elements at most."""
        return int(self._data.max_length)

    @property
    def is_value(self) -> bool:
        """Whether it is the value of its process variable, which a put may set."""
        return self.field in ("", "VAL")

    async def show(self, reading: Reading, wall: Callable[[float], float]) -> None:
        """Show ``reading``; calls the watchers if something has changed. ``wall``: a time of the tree as one of this
        computer."""
        alarm = of_reading(self.pv.node, reading) if self.is_value or self.field == "VAL$" else Alarm(*_NONE)
        value = self._value(reading)
        time = min(max(wall(reading.time), FIRST_TIME), _LAST_TIME) if reading.time else FIRST_TIME
        # a NaN is not equal to itself
        shown = (repr(value) if isinstance(value, float) else value, alarm, time)
        if shown == self._shown:
            return
        alarm_has_changed = not self._shown or self._shown[1] != alarm
        self._shown = shown
        self._encoded.clear()
        if isinstance(self._data, ChannelByte):
            self._octets, value = value, b""
        await self._data.write(
            value, verify_value=False, update_fields=False, timestamp=time, status=alarm.status, severity=alarm.severity
        )
        for watcher in tuple(self.watchers.values()):
            watcher(alarm_has_changed)

    async def encoded(self, type_: ChannelType) -> tuple[Any, Any]:
        """Metadata and values as ``type_``. Raises CaprotoError if they cannot be converted."""
        found = self._encoded.get(type_)
        if found is None:
            metadata, values = await self._data.read(type_)
            if isinstance(self._data, ChannelByte):
                values = await self._elements(native_type(type_))
            found = self._encoded[type_] = metadata, values
        return found

    async def _elements(self, type_: ChannelType) -> Any:
        """The octets as values of a native type. caproto itself fails at octets above 127."""
        if type_ == ChannelType.CHAR:  # signed ones for its array, and the same octets on the wire
            return [(one + 128) % 256 - 128 for one in self._octets]
        numbers = ChannelInteger(value=list(self._octets), max_length=max(len(self._octets), 1))
        return (await numbers.read(type_))[1]

    def length(self, values: Any) -> int:
        return int(self._data.calculate_length(values))

    def given(self, data: Any, type_: ChannelType) -> Value:
        """The value that a put of ``data`` means, of the type of its order. Raises ValueError."""
        order = self.pv.order
        assert order is not None, "it can only be read"
        if type_ not in native_types:  # an alarm handler acknowledges in this way
            raise ValueError("it takes a plain value; alarms cannot be acknowledged here")
        values = _plain(data, type_)
        if order.type == BYTES:
            return bytes(_octet(self._number(one) if isinstance(one, str) else one) for one in values)
        if len(values) != 1:
            raise ValueError(f"it takes one value, not {len(values)}")
        [one] = values
        number = self._number(one) if isinstance(one, str) else one
        if order.type in (BOOL, None):
            if number not in (0, 1):
                raise ValueError(f"it takes {' or '.join(self._states)} (0 or 1), not {one!r}")
            return bool(number)
        if not math.isfinite(number):
            raise ValueError(f"{one!r} is not a finite number")
        return number

    def _number(self, text: str) -> int | float:
        if text in self._states:
            return self._states.index(text)
        try:
            return int(text)
        except ValueError:
            pass
        try:
            return float(text)
        except ValueError:
            raise ValueError(f"{text!r} is not a number") from None

    def _make(self) -> ChannelData:
        node, order = self.pv.node, self.pv.order
        about: dict[str, Any] = {"string_encoding": "utf-8", "reported_record_type": "dpstack"}
        if self.field in ("VAL$", "AMSG$"):
            return ChannelByte(value=b"", max_length=4 * MOST_TEXT, reported_record_type="dpstack")
        if self.field == "DESC":
            what = node.text if node.text and node.kind is not Kind.VALUE else f"{node.path[-1]} of slave {node.slave}"
            return ChannelString(value=cut(what, MOST_STRING), **about)
        if self.field in ("EGU", "AMSG"):
            return ChannelString(value=cut(node.unit, MOST_STRING) if self.field == "EGU" else "", **about)
        if self._states:
            return ChannelEnum(value=0, enum_strings=self._states, **about)
        if node.type == TEXT:
            return ChannelString(value="", **about)
        if node.type == BYTES:
            return ChannelByte(value=b"", max_length=_octets_of(node), strip_null_terminator=False,
                               reported_record_type="dpstack")  # fmt: skip
        about |= {"units": cut(node.unit, MOST_UNIT)} | _limits(node, writable=order is not None)
        if node.type in _LONGS:
            return ChannelInteger(value=0, **about)
        digits = 0 if node.type in ("u32", "u64", "i64") else digits_of(node, _DIGITS)
        made = ChannelFloat if node.type == "f32" and order is None else ChannelDouble
        return made(value=math.nan, precision=digits, **about)

    def _value(self, reading: Reading) -> Any:
        pv, value = self.pv, reading.value
        if self.field == "VAL$":
            return str(value or "").encode()
        if self.field in ("AMSG", "AMSG$"):
            return reading.text.encode() if self.field == "AMSG$" else cut(reading.text, MOST_STRING)
        if self.field in ("DESC", "EGU"):
            return self._data.value
        if self._states:
            if pv.is_button:
                return 0
            if isinstance(value, bool):
                return int(value)
            return self._states.index(value) if value in self._states else self._unknown
        if pv.node.type == TEXT:
            return cut(str(value or ""), MOST_STRING)
        if pv.node.type == BYTES:
            return bytes(value)[: self.count] if isinstance(value, bytes) else b""
        if value is None:
            return 0 if pv.node.type in _LONGS else math.nan
        return value

    @property
    def _unknown(self) -> int:
        return self._states.index("unknown") if "unknown" in self._states else 0


_NONE: Final = (AlarmStatus.NO_ALARM, 0)


def _limits(node: Node, *, writable: bool) -> dict[str, Any]:
    """The range of a number; that of a put, too, if it is ``writable``. Two equal limits stand for none."""
    if node.low is None or node.high is None:
        return {}
    kinds, digits = ("disp", "ctrl") if writable else ("disp",), digits_of(node, _DIGITS)
    ends = (("lower", node.low), ("upper", node.high))  # 32767 times 0.1 is 3276.7000000000003
    return {f"{side}_{kind}_limit": round(end, digits) for kind in kinds for side, end in ends}


def _octets_of(node: Node) -> int:
    """Octets of a field such as ``bytes@4:3``, which are its elements."""
    found = re.fullmatch(r"bytes@\d+:(\d+)", node.text)
    return min(max(int(found[1]), 1), MOST_OCTETS) if found else MOST_OCTETS


def _octet(number: float) -> int:
    """An octet, as a signed one too. Raises ValueError."""
    if not -128 <= number <= 255 or number != int(number):
        raise ValueError(f"an octet is a whole number from 0 to 255, not {number!r}")
    return int(number) & 0xFF


def _plain(data: Any, type_: ChannelType) -> list[str | int | float]:
    """The values of a put: texts, or numbers."""
    if type_ == ChannelType.STRING:
        return [
            (text.decode(errors="replace") if isinstance(text, bytes) else str(text)).rstrip("\0").strip()
            for text in data
        ]
    return list(data.tolist())
