"""Functions of PZD2 to PZD12 (docs/reference/drives/imo-hd2.md#process-data): names, units, and ranges that are checked
before anything is sent.

Source: tables 2-6 and 2-8 of the card's manual. Functions 14 and 15 of table 2-6 are cut off in our text: position
reference, high word signed, low word unsigned. Readings: torque, power and analog inputs are signed; the ramp frequency
is in 0.01 Hz; the rated torque stands as it is.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from typing import ClassVar, Final

from msgspec import Struct, structs

from dpstack_drives.imo import table as t

_ANY: Final = 0xFFFF


class Function(Struct, frozen=True):
    """A meaning of a PZD. ``low`` and ``high`` are in ``unit``; on the wire stands value x ``per_unit``.

    ``fmax``: the upper limit is the inverter's maximum frequency.
    """

    octets: ClassVar[int] = 2

    number: int
    name: str
    unit: str
    per_unit: float
    low: float
    high: float
    fmax: bool = False
    #: 0 of a limit holds the drive still: somebody has to choose it
    neutral: bool = True

    @property
    def key(self) -> int:
        return self.number

    def encode(self, value: float) -> int:
        """The 16-bit word. Raises ValueError with the range."""
        unit = f" {self.unit}" if self.unit else ""
        if not (math.isfinite(value) and self.low <= value <= self.high):
            limit = " (the maximum frequency, option max_hz)" if self.fmax else ""
            raise ValueError(f"{self.name} {value:g}{unit} is outside {self.low:g}..{self.high:g}{unit}{limit}")
        raw = value * self.per_unit
        if self.per_unit == 1 and raw != int(raw):
            raise ValueError(f"{self.name} takes whole numbers, not {value:g}")
        return round(raw) & 0xFFFF

    def decode(self, raw: int) -> int | float:
        """The value of a 16-bit word."""
        raw = (raw ^ 0x8000) - 0x8000 if self.low < 0 else raw
        return raw if self.per_unit == 1 else raw / self.per_unit


def _hertz(number: int, name: str, *, neutral: bool = True) -> Function:
    return Function(number, name, "Hz", 100, 0, 655.35, fmax=True, neutral=neutral)


def _word(number: int, name: str, high: int = _ANY, unit: str = "") -> Function:
    return Function(number, name, unit, 1, 0, high)


def _signed(number: int, name: str, unit: str = "", per_unit: float = 1) -> Function:
    return Function(number, name, unit, per_unit, -0x8000 / per_unit, 0x7FFF / per_unit)


_RECEIVED: Final = (
    _hertz(1, "set_frequency"),
    Function(2, "pid_reference", "%", 10, 0, 100),
    Function(3, "pid_feedback", "%", 10, 0, 100),
    Function(4, "torque", "%", 10, -300, 300),
    _hertz(5, "forward_limit", neutral=False),
    _hertz(6, "reverse_limit", neutral=False),
    Function(7, "motoring_torque_limit", "%", 10, 0, 300, neutral=False),
    Function(8, "braking_torque_limit", "%", 10, 0, 300, neutral=False),
    _word(9, "input_terminals", 0x3FF),
    _word(10, "output_terminals", 0x0F),
    Function(11, "voltage", "%", 10, 0, 100),
    Function(12, "ao1", "%", 10, -100, 100),
    Function(13, "ao2", "%", 10, -100, 100),
    _signed(14, "position_reference_high"),
    _word(15, "position_reference_low"),
    _signed(16, "position_feedback_high"),
    _word(17, "position_feedback_low"),
    _word(18, "position_feedback_flag", 1),
)
_TRANSMITTED: Final = (
    Function(1, "frequency", "Hz", 100, 0, 655.35),
    Function(2, "set_frequency", "Hz", 100, 0, 655.35),
    Function(3, "bus_voltage", "V", 10, 0, 6553.5),
    _word(4, "output_voltage", unit="V"),
    Function(5, "current", "A", 10, 0, 6553.5),
    _signed(6, "torque", "%", 10),
    _signed(7, "power", "%", 10),
    _word(8, "rpm", unit="rpm"),
    _word(9, "linear_speed", unit="m/s"),
    Function(10, "ramp_frequency", "Hz", 100, 0, 655.35),
    _word(11, "fault_code"),
    _signed(12, "ai1", "V", 100),
    _signed(13, "ai2", "V", 100),
    _signed(14, "ai3", "V", 100),
    Function(15, "hdia_frequency", "kHz", 100, 0, 655.35),
    _word(16, "input_terminals"),
    _word(17, "output_terminals"),
    Function(18, "pid_reference", "%", 100, 0, 655.35),
    Function(19, "pid_feedback", "%", 100, 0, 655.35),
    _word(20, "rated_torque"),
    _signed(21, "position_reference_high"),
    _word(22, "position_reference_low"),
    _signed(23, "position_feedback_high"),
    _word(24, "position_feedback_low"),
    _word(25, "state_word"),
    Function(26, "hdib_frequency", "kHz", 100, 0, 655.35),
)
#: by number
TO_DRIVE: Final[Mapping[int, Function]] = {one.number: one for one in _RECEIVED}
FROM_DRIVE: Final[Mapping[int, Function]] = {one.number: one for one in _TRANSMITTED}
SET_FREQUENCY, FAULT_CODE, STATE_WORD = 1, 11, 25
_EMPTY: Final = "-"


def to_drive(max_hz: float) -> Mapping[int, Function]:
    """:data:`TO_DRIVE` of an inverter with this maximum frequency."""
    return {n: structs.replace(one, high=max_hz) if one.fmax else one for n, one in TO_DRIVE.items()}


class PzdMap(Struct, frozen=True):
    """The functions of PZD2 to PZD12 one way, 0 for an empty one. As text: their names in order, ``-`` for empty."""

    numbers: tuple[int, ...]
    functions: Mapping[int, Function]

    @classmethod
    def parse(cls, text: str, functions: Mapping[int, Function], *, outputs: bool) -> PzdMap:
        """From names or numbers in order; what is not given is empty. Raises ValueError."""
        words = text.replace(",", " ").split()
        if len(words) > t.PZDS:
            raise ValueError(f"{len(words)} process data, there are {t.PZDS} (PZD2 to PZD12)")
        numbers = [_number(word, functions) for word in words]
        for at, number in enumerate(numbers):
            if number and outputs and number in numbers[:at]:
                raise ValueError(f"{functions[number].name} twice: which one the drive takes is not in the manual")
        return cls(tuple(numbers) + (0,) * (t.PZDS - len(numbers)), functions)

    def __str__(self) -> str:
        words = (self.functions[n].name if n in self.functions else str(n) if n else _EMPTY for n in self.numbers)
        return " ".join(words).rstrip(f" {_EMPTY}")

    def place(self, number: int) -> int | None:
        """The word behind CW or SW (0 is PZD2) that has the function; None if none has it."""
        return self.numbers.index(number) if number in self.numbers else None

    @property
    def fields(self) -> tuple[Function | None, ...]:
        """PZD2 to PZD12."""
        return tuple(self.functions.get(number) for number in self.numbers)


def _number(word: str, functions: Mapping[int, Function]) -> int:
    if word == _EMPTY:
        return 0
    if word.isdecimal() and (int(word) == 0 or int(word) in functions):
        return int(word)
    names = {one.name: one.number for one in functions.values()}
    if word.lower() in names:
        return names[word.lower()]
    near = difflib.get_close_matches(word.lower(), names, n=1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}"
    raise ValueError(f"{word!r} is no process data of the drive; {hint}")
