"""Codes of the HD2 that plugin and simulated drive share; all else is in imo-hd2.toml.

Passages: docs/reference/drives/imo-hd2.md; numbers in the comments are the manual's tables.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import IntEnum
from typing import Final

from dpstack.profile import ControlTable, Goal, State

#: table 2-4: a rate that PROFIBUS does not have
_NINE_MBIT: Final = 9


def check_rate(index: float) -> None:
    """Raises ValueError if PROFIBUS has no such rate."""
    if index == _NINE_MBIT:
        raise ValueError(
            "baud_index 9 is 9 Mbit/s in the card's table, a rate that PROFIBUS does not have; take 8 or 10"
        )
    if index != int(index):
        raise ValueError(f"baud_index must be a whole number (6 is 1.5 Mbit/s), not {index:g}")


class Command(IntEnum):
    """Bits 0-7 of CW (table 2-5); 0 is in no row: no command (a reading)."""

    NONE = 0
    FORWARD = 1
    REVERSE = 2
    INCH_FORWARD = 3
    INCH_REVERSE = 4
    STOP = 5
    COAST = 6
    RESET = 7
    INCH_STOP = 8
    PRE_EXCITE = 9


class Running(IntEnum):
    """Bits 0-7 of SW (table 2-7)."""

    FORWARD = 1
    REVERSE = 2
    STOPPED = 3
    FAULT = 4
    POFF = 5
    PRE_EXCITED = 6


class Source(IntEnum):
    """Bits 13-14 of SW: who commands; only COMMUNICATION obeys the bus."""

    KEYPAD = 0
    TERMINALS = 1
    COMMUNICATION = 2
    RESERVED = 3


CODE: Final = 0x00FF
SOURCE_SHIFT: Final = 13
#: bits of CW that a program may set beside the commands
SETTABLE: Final = ("torque_control", "clear_energy", "pre_excitation", "dc_brake")
#: fields of the maps
SET_FREQUENCY, FAULT_CODE, STATE_WORD = 1, 11, 25


class CodeTable(ControlTable, frozen=True, kw_only=True):
    """A control word whose command is a number: what moves after a command that does not run it is coming to rest."""

    runs: frozenset[int] = frozenset({Command.FORWARD})

    def state(self, status: int, own: int) -> State:
        """As the base, by the command's number instead of bits."""
        state = self.states.decode(status)
        return State.STOPPING if state is State.RUNNING and own & CODE not in self.runs else state


def control_table(words: ControlTable, idle: Command = Command.STOP) -> CodeTable:
    """``idle``: what is commanded while no order runs the drive; the factory's is to stop, 0 would let it go on."""
    return CodeTable(
        control=words.control,
        status=words.status,
        states=words.states,
        run=dict.fromkeys(State, int(Command.FORWARD)),
        steady={**words.steady, Goal.IDLE: idle},
        released_mask=0,
        releasing=frozenset(),
        runs=frozenset({Command.FORWARD, Command.INCH_FORWARD, Command.INCH_REVERSE}),
    )


_NAME: Final = re.compile(r"[Pp](\d{1,2})\.(\d{1,3})")


def address(name: str) -> int | None:
    """PKW2 of a function code such as ``P15.02``: group x 256 + number (a reading); None for anything else.

    The printed range 0..247 cannot reach group 15; address 10, the frequency set by keypad, is number 10 of group 0.
    """
    match = _NAME.fullmatch(name.strip())
    if match is None or int(match[2]) > 0xFF:
        return None
    return int(match[1]) << 8 | int(match[2])


def parameter(text: str, option: str) -> int | None:
    """The address of the function code in an option, None without one. Raises ValueError."""
    if not text.strip():
        return None
    found = address(text)
    if found is None:
        raise ValueError(f"{option}: {text!r} is no function code; write for instance P00.03")
    return found


def source(text: str) -> tuple[int, int] | None:
    """``P00.06=9`` as address and value, None for an empty text. Raises ValueError."""
    name, _, value = text.partition("=")
    found = parameter(name, "frequency_source")
    if found is None and not value:
        return None
    if found is None or not value.strip().isdecimal():
        raise ValueError(f"frequency_source: {text!r}: write a function code and its value, {FREQUENCY_SOURCE!r}")
    return found, int(value)


def name_of(number: int) -> str:
    """The function code at an address."""
    return f"P{number >> 8:02}.{number & 0xFF:02}"


#: made up: parameters of the inverter in the simulated drive
SOURCE, MAXIMUM_HZ, ACCELERATION, DECELERATION = "P00.01", "P00.03", "P00.11", "P00.12"
#: Of the inverter, which has a manual of its own: a reading, from the numbering of the inverters of this family
#: (address 10, the keypad's frequency, is P00.10 there, too). The plugin takes other ones by its options
FREQUENCY_CHANNEL, FROM_PROFIBUS = "P00.06", 9
FREQUENCY_SOURCE: Final = f"{FREQUENCY_CHANNEL}={FROM_PROFIBUS}"
KEYPAD_FREQUENCY: Final = "P00.10"
PER_HZ: Final = 100
#: made up: refused while running
STANDSTILL_ONLY: Final = frozenset({"P15.01", MAXIMUM_HZ})
#: made up: fault codes of the simulated drive
FAULTS_MADE_UP: Final = "4=OC1 7=OV1 10=UV 11=OL1 15=OH1 17=EF 29=E-DP"
LOST_MASTER: Final = 29


def faults(text: str) -> Mapping[int, str]:
    """Fault codes given as ``4=OC1 11=OL1``. Raises ValueError."""
    found: dict[int, str] = {}
    for word in text.replace(",", " ").split():
        code, equals, name = word.partition("=")
        if not (code.isdecimal() and equals and name) or int(code) in found:
            raise ValueError(f"fault_names: {word!r}: write each code once with its name, e.g. {FAULTS_MADE_UP!r}")
        found[int(code)] = name
    return found
