"""Facts of the S100 that its Python looks at by name; all others are in ls-s100.toml, whose comments have the sources.

Passages: docs/reference/drives/ls-s100.md; numbers in the comments are sections of the manual V1.40.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from msgspec import structs

from dpstack.devices.finding import drive_file_at
from dpstack.profile import ControlTable, Goal, ParamSpec, State, StateRow, StateTable, Word

FILE: Final = drive_file_at(Path(__file__).with_name("ls-s100.toml"))
PARAMETERS: Final = FILE.parameters
PKW: Final = FILE.channel.of_pkw
TRIPS: Final = FILE.fault.texts
#: PNU 963, COM-12
BAUD_INDEX: Final[Mapping[int, int]] = {
    0: 9_600,
    1: 19_200,
    2: 93_750,
    3: 187_500,
    4: 500_000,
    6: 1_500_000,
    7: 3_000_000,
    8: 6_000_000,
    9: 12_000_000,
    11: 45_450,
}
INVALID_BAUD: Final = 255
#: of the diagnosis: the six fixed octets and an alarm; a reading
MAX_DIAG: Final = 16
#: COM-11 and what PNU 930 shows for it (docs/reference/drives/ls-s100.md#profiles)
IO, PROFIDRIVE, LS_DRIVE = 0, 1, 2
PNU_930: Final = {IO: 0x8000, PROFIDRIVE: 1, LS_DRIVE: 0x8002}

# -- docs/reference/drives/ls-s100.md#profidrive-profile ---------------------------------------------------------------

#: status bit: the bit of STW1 that it repeats
COPIES: Final = {1: 0, 2: 3, 4: 1, 5: 2, 9: 10}
#: bit 16 of the plugin's own status word: ACT is not zero. During the ramp of OFF1 the copies look like S2
TURNING: Final = 0x1_0000
PROFIDRIVE_TABLE: Final = structs.replace(
    FILE.table,
    states=StateTable(
        (
            *(row for row in FILE.table.states.rows if row.state is not State.READY_TO_SWITCH_ON),
            StateRow(State.READY_TO_SWITCH_ON, 0x1004B, 0x00001),
            StateRow(State.STOPPING, 0x1004B, 0x10001),
        )
    ),
)

# -- docs/reference/drives/ls-s100.md#ls-drive-profile -----------------------------------------------------------------

LS_CONTROL: Final = Word(
    "LS control word",
    {
        "stop": 0,
        "forward": 1,
        "reverse": 2,
        "acknowledge": 3,
        "emergency": 4,
        "run_authority": 13,
        "ramp_authority": 14,
    },
)
LS_STATUS: Final = Word(
    "LS status word",
    {
        "stopped": 0,
        "forward": 1,
        "reverse": 2,
        "fault": 3,
        "accelerating": 4,
        "decelerating": 5,
        "reached": 6,
        "dc_brake": 7,
        "stopping": 8,
        "jog": 9,
        "brake_open": 10,
        "forward_command": 11,
        "reverse_command": 12,
        "run_granted": 13,
        "ramp_granted": 14,
        "keypad": 15,
    },
)
AUTHORITY: Final = LS_CONTROL.mask("run_authority", "ramp_authority")
#: bit 16 of the plugin's own control word, never sent: a run command, whose direction is bit 1 or 2
RUN: Final = 0x1_0000
_LS_STATES: Final = StateTable(
    (
        StateRow(State.FAULT, 0x0008, 0x0008),
        StateRow(State.READY, 0x0009, 0x0001),
        StateRow(State.STOPPING, 0x0109, 0x0100),
        StateRow(State.RUNNING, 0x010F, 0x0002),
        StateRow(State.RUNNING, 0x010F, 0x0004),
    )
)


def ls_table(authority: int) -> ControlTable:
    """The words of the LS Drive profile; ``authority`` 0 for 0006h and 000Eh in the vendor telegram."""
    stop = authority | LS_CONTROL.mask("stop")
    coast = authority | LS_CONTROL.mask("emergency")
    return ControlTable(
        control=LS_CONTROL,
        status=LS_STATUS,
        states=_LS_STATES,
        run={state: authority | RUN for state in State if state not in (State.FAULT, State.OFFLINE)},
        steady={
            Goal.IDLE: stop,
            Goal.STOP: stop,
            Goal.QUICK_STOP: stop,
            Goal.COAST: coast,
            Goal.ACK_HIGH: authority | LS_CONTROL.mask("acknowledge"),
            Goal.ACK_LOW: stop,
        },
        released_mask=RUN,
        releasing=frozenset({State.RUNNING}),
    )


# -- docs/reference/drives/ls-s100.md#parameters-and-maps --------------------------------------------------------------

#: 6.2.1 prints 000B and 0316 (and 1101, dr-01); what they show is the inverter manual's:
#: integers without a scale, made up in the simulated drive
OUTPUT_VOLTAGE, OUTPUT_POWER = 0x000B, 0x0316
#: COM-09 (4.2.3). Conflict: the prose has the order "from right to left", its example CPU at the right: the example
LEDS: Final = 0x1709
#: COM-10
TELEGRAM: Final = 0x170A
#: COM-11 (4.2.11): a display of the profile in force; what is written to it counts from COM-94 = 1
PROFILE: Final = 0x170B
LED_CPU, LED_ERROR, LED_ONLINE = 0x0001, 0x0002, 0x0004
FREQUENCY, OPERATION, OUTPUT_FREQUENCY, RUN_STATUS, TRIP, WARNING = 0x0005, 0x0006, 0x000A, 0x000E, 0x000F, 0x0334
#: 5.1: not to be used beside a drive profile
ADVISED_AGAINST: Final = frozenset({0x0005, 0x000A, 0x0381, 0x0015})

#: 4.2.5, and the longer names that the manual uses beside them
GROUPS: Final = {"dr": 1, "bA": 2, "Ad": 3, "Cn": 4, "In": 5, "OU": 6, "COM": 7, "AP": 8, "PRT": 11, "M2": 12}
_OTHER_NAMES: Final = {"drv": 1, "bas": 2, "adv": 3, "con": 4, "out": 6, "cm": 7, "app": 8}
_BY_GROUP: Final = {**{name.lower(): number for name, number in GROUPS.items()}, **_OTHER_NAMES}
_CODE: Final = re.compile(r"(m2|[a-z]+)-?(\d{1,2})")
_HEX: Final = re.compile(r"0[xh]([0-9a-f]{1,4})")
_BARE: Final = re.compile(r"[0-9A-Fa-f]{4}")


def address(text: str) -> int | None:
    """The address of ``dr-03``, ``COM-31``, ``0x000A`` or ``0h000A``; None for anything else. Any case."""
    wanted = text.strip().lower()
    if (match := _HEX.fullmatch(wanted)) is not None:
        return int(match[1], 16)
    match = _CODE.fullmatch(wanted)
    group = None if match is None else _BY_GROUP.get(match[1])
    return None if match is None or group is None else 0x1000 + group * 0x100 + int(match[2])


def mapped_address(text: str) -> int | None:
    """As :func:`address`, also of four hex digits."""
    return int(text, 16) if _BARE.fullmatch(text) else address(text)


def code_of(number: int) -> str:
    """``dr-03`` for 1103h, ``000A`` if it is no parameter of the keypad."""
    for name, group in GROUPS.items():
        if 0x1000 + group * 0x100 <= number <= 0x1000 + group * 0x100 + 99:
            return f"{name}-{number & 0xFF:02}"
    return f"{number:04X}"


#: 7.1
PNU_ADDRESS, PNU_TELEGRAM, PNU_PROFILE, PNU_COUNTER, PNU_FAULTS, PNU_WARNING = 918, 922, 930, 944, 947, 953
PNU_BAUD, PNU_DEVICE, PNU_VERSION, PNU_STW1, PNU_ZSW1, PNU_RESET = 963, 964, 965, 967, 968, 972
#: elements of the arrays
ARRAYS: Final = {PNU_FAULTS: 64, PNU_DEVICE: 7}
#: manufacturer, type, version, year, date (month in the high octet: 0C19h is 25 December), axes, ident number; (m)
DEVICE_ID: Final = (0x0351, 1, 0x0300, 0x07E6, 0x0601, 1, FILE.bus.ident or 0)
SITUATIONS: Final = 8
MESSAGES: Final = 8

LOST_COMMAND: Final = 35


def trip_text(number: int) -> str:
    """``35 lost command``; the numbers between are reserved."""
    return f"{number} {TRIPS.get(number, 'reserved')}"


#: command and frequency source: the field bus has them (inverter's manual)
FIELD_BUS: Final = {"dr-06": 4, "dr-07": 8}
#: COM-30, COM-50 and COM-94
STATUS_COUNT, CONTROL_COUNT, UPDATE = 0x171E, 0x1732, 0x175E
#: PZD of Para-1 (0 is the first) in PPOs, behind the profile's two words
PARA_AT: Final = 2


def spec_at(where: int) -> ParamSpec | None:
    """The parameter at an address, as far as it is known here."""
    return PARAMETERS.get(where >> 8, where & 0xFF)
