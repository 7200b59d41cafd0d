"""Facts of the HD2 that plugin and simulated drive share. Passages: docs/reference/drives/imo-hd2.md.

Source: IMO, HD2 PROFIBUS Communication Card, instruction manual; numbers in the comments are its tables. It has no GSD
file: ident number and identifier octets are made up until the user's GSD overrides them. The inverter's own parameters,
its fault codes and what it does without a master are in the inverter's manual, which we do not have.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import IntEnum
from functools import partial
from typing import Final

from dpstack.profile import (
    ControlTable,
    Goal,
    MapCodes,
    ParamKey,
    ParamSpec,
    ParamTable,
    RateSetting,
    State,
    StateRow,
    StateTable,
    TelegramSpec,
    Use,
    Word,
)
from dpstack_drives import ppo

IDENT: Final = 0xDD02

#: 2.6, figure 2-4: PKW1 to PKW4, CW or SW, PZD2 to PZD12. "16-bit packets" is read as 16 words each way.
TELEGRAM: Final = TelegramSpec(
    name="PKW+12", config=bytes.fromhex("F3 7B"), outputs=24, inputs=24, channel=True, made_up=True
)
#: PZD2 to PZD12
PZDS: Final = 11
FIRST_PZD: Final = 2

#: table 2-4, parameter 2: the rate by its number; 9 is no rate
_RATES: Final = dict(zip((*range(9), 10), ppo.TEN_RATES, strict=True))
RATE_SETTING: Final = RateSetting("baud_index", _RATES)
RATE_FACTORY: Final = 6
_NINE_MBIT: Final = 9


def check_rate(index: float) -> None:
    """Raises ValueError if PROFIBUS has no such rate."""
    if index == _NINE_MBIT:
        raise ValueError(
            "baud_index 9 is 9 Mbit/s in the card's table, a rate that PROFIBUS does not have; take 8 or 10"
        )
    if index not in _RATES:
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
#: table 2-5. Bits 9-10 are a number (motor 1 or 2)
CONTROL: Final = Word(
    "CW",
    {
        "enable_writing": 8,
        "motor_2": 9,
        "torque_control": 11,
        "clear_energy": 12,
        "pre_excitation": 13,
        "dc_brake": 14,
        "heartbeat": 15,
    },
)
#: bits that a program may set beside the commands
SETTABLE: Final = ("torque_control", "clear_energy", "pre_excitation", "dc_brake")
#: table 2-7. Bits 13-14 are a number, :class:`Source`; bit 14 is set if the bus commands
STATUS: Final = Word(
    "SW",
    {"bus_voltage": 8, "motor_2": 9, "synchronous": 11, "overload": 12, "terminals": 13, "remote": 14, "heartbeat": 15},
)
_BUS_VOLTAGE: Final = STATUS.mask("bus_voltage")
ENABLE_WRITING: Final = CONTROL.mask("enable_writing")


class CodeTable(ControlTable, frozen=True, kw_only=True):
    """A control word whose command is a number: what moves after a command that does not run it is coming to rest."""

    runs: frozenset[int] = frozenset({Command.FORWARD})

    def state(self, status: int, own: int) -> State:
        """As the base, by the command's number instead of bits."""
        state = self.states.decode(status)
        return State.STOPPING if state is State.RUNNING and own & CODE not in self.runs else state


def control_table(idle: Command = Command.STOP) -> CodeTable:
    """``idle``: what is commanded while no order runs the drive; the factory's is to stop, 0 would let it go on.

    Readings: stopped without bus voltage (bit 8) and POFF are not ready; pre-excited is ready.
    """
    runs = {Command.FORWARD, Command.INCH_FORWARD, Command.INCH_REVERSE}
    return CodeTable(
        control=CONTROL,
        status=STATUS,
        states=StateTable(
            (
                StateRow(State.RUNNING, CODE, Running.FORWARD),
                StateRow(State.RUNNING, CODE, Running.REVERSE),
                StateRow(State.READY, CODE | _BUS_VOLTAGE, Running.STOPPED | _BUS_VOLTAGE),
                StateRow(State.NOT_READY, CODE | _BUS_VOLTAGE, Running.STOPPED),
                StateRow(State.FAULT, CODE, Running.FAULT),
                StateRow(State.NOT_READY, CODE, Running.POFF),
                StateRow(State.READY, CODE, Running.PRE_EXCITED),
            )
        ),
        run=dict.fromkeys(State, int(Command.FORWARD)),
        steady={
            Goal.IDLE: idle,
            Goal.STOP: Command.STOP,
            Goal.QUICK_STOP: Command.COAST,
            Goal.COAST: Command.COAST,
            Goal.ACK_HIGH: Command.RESET,
            Goal.ACK_LOW: Command.STOP,
        },
        released_mask=0,
        releasing=frozenset(),
        runs=frozenset(runs),
    )


TABLE: Final = control_table()

#: 2-11: response 3
ERRORS: Final = {
    1: "invalid command",
    2: "invalid data address",
    3: "invalid data value",
    4: "operation failure",
    5: "password error",
    6: "data frame error",
    7: "the parameter is read only",
    8: "the parameter cannot be changed while the drive runs",
    9: "protected by password",
}

#: of a write only
WRITE_ERRORS: Final = frozenset({3, 5, 7, 8, 9})

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


KEYPAD_FREQUENCY: Final = 10
#: 0..125 (printed 0-99 in table 2-4, 0-127 in 2.3); table 2-4 numbers it and the PZDs in another way: P15 holds
ADDRESS: Final = 0x0F01
#: tables 2-6 and 2-8: what each received and each transmitted PZD stands for (P15.22 is missing in print)
RECEIVED: Final = tuple(range(0x0F02, 0x0F02 + PZDS))
TRANSMITTED: Final = tuple(range(0x0F0D, 0x0F0D + PZDS))
MOST_RECEIVED, MOST_TRANSMITTED = 18, 26
#: of inputs and outputs
MAP_CODES: Final = (MapCodes(tuple(map(ParamKey, TRANSMITTED))), MapCodes(tuple(map(ParamKey, RECEIVED))))
#: made up: parameters of the inverter in the simulated drive
SOURCE, MAXIMUM_HZ, ACCELERATION, DECELERATION = "P00.01", "P00.03", "P00.11", "P00.12"
#: Of the inverter, which has a manual of its own: a reading, from the numbering of the inverters of this family
#: (address 10, the keypad's frequency, is P00.10 there, too). The plugin takes other ones by its options
FREQUENCY_CHANNEL, FROM_PROFIBUS = "P00.06", 9
FREQUENCY_SOURCE: Final = f"{FREQUENCY_CHANNEL}={FROM_PROFIBUS}"
PER_HZ: Final = 100
#: made up: refused while running
STANDSTILL_ONLY: Final = frozenset({ADDRESS, 0x0003})


_row = partial(ParamSpec, by_name=True)
#: the simulated drive's; the plugin knows those that are not made up
PARAMETERS: Final = ParamTable(
    (
        _row(0x0001, SOURCE, "Run command channel", 0, 2, Source.KEYPAD, use=Use.SOURCE, made_up=True),
        _row(0x0003, MAXIMUM_HZ, "Maximum frequency", 0, 400, 50, decimals=2, unit="Hz", made_up=True),
        _row(0x0006, FREQUENCY_CHANNEL, "Source of the set frequency", 0, 15, made_up=True),
        _row(KEYPAD_FREQUENCY, "P00.10", "Frequency set by keypad", 0, 400, 50, decimals=2, unit="Hz"),
        _row(0x000B, ACCELERATION, "Acceleration time", 0, 3600, 1, decimals=1, unit="s", made_up=True),
        _row(0x000C, DECELERATION, "Deceleration time", 0, 3600, 1, decimals=1, unit="s", made_up=True),
        _row(0x0F00, "P15.00", "Module type", read_only=True),
        _row(ADDRESS, "P15.01", "Node address", 0, 125, 2),
        *(
            _row(number, name_of(number), f"{way} PZD{at}", 0, most, use=Use.MAP)
            for way, numbers, most in (
                ("Received", RECEIVED, MOST_RECEIVED),
                ("Transmitted", TRANSMITTED, MOST_TRANSMITTED),
            )
            for at, number in enumerate(numbers, FIRST_PZD)
        ),
    )
)


def known(number: int) -> ParamSpec | None:
    """The parameter at an address, if the manual of the card has it."""
    spec = PARAMETERS.get(number)
    return None if spec is None or spec.made_up else spec


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
