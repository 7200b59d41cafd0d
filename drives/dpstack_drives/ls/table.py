"""Facts of the S100 that plugin and simulated drive share: passages in docs/reference/drives/ls-s100.md.

Source: LS ELECTRIC, LSLV-S100 Profibus-DP Module, user's manual V1.40; numbers in the comments are its sections. What
belongs to the inverter's own manual (dr-06, dr-07, Ad-08, PRT-12 to PRT-14, the bits of 0006h and 000Eh) is a reading.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from typing import Final

from msgspec import structs

from dpstack.profile import (
    PARAMETER_ERRORS,
    ControlTable,
    Goal,
    ParamSpec,
    ParamTable,
    PkwDialect,
    State,
    StateRow,
    StateTable,
    Use,
    Word,
    profidrive_states,
)
from dpstack_drives import ppo
from dpstack_drives.codes import placed

IDENT: Final = 0x0A6C
#: 2.1 gives ten rates, no response times
BAUD_RATES: Final = ppo.TEN_RATES
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
#: the internal scan time is in no manual: a reading
SCAN_MS: Final = 4

#: of the diagnosis: the six fixed octets and an alarm; a reading
MAX_DIAG: Final = 16
#: COM-11 and what PNU 930 shows for it (docs/reference/drives/ls-s100.md#profiles)
IO, PROFIDRIVE, LS_DRIVE = 0, 1, 2
PNU_930: Final = {IO: 0x8000, PROFIDRIVE: 1, LS_DRIVE: 0x8002}

# -- docs/reference/drives/ls-s100.md#profidrive-profile ---------------------------------------------------------------

#: 5.1.1: jog is not supported, bits 11-15 are reserved
CONTROL: Final = Word("STW1", profidrive_states.CONTROL_BITS)
#: 5.1.2. Bits 1, 2, 4, 5, 9 are printed as copies of STW1 bits 0, 3, 1, 2, 10; bit 10 is not supported
STATUS: Final = Word("ZSW1", {**profidrive_states.STATUS_BITS, "warning": 7, "reached": 8, "control_requested": 9})
#: status bit: the bit of STW1 that it repeats
COPIES: Final = {1: 0, 2: 3, 4: 1, 5: 2, 9: 10}
#: bit 16 of the plugin's own status word: ACT is not zero. During the ramp of OFF1 the copies look like S2
TURNING: Final = 0x1_0000
_BASE: Final = profidrive_states.table(CONTROL, STATUS)
PROFIDRIVE_TABLE: Final = structs.replace(
    _BASE,
    states=StateTable(
        (
            StateRow(State.FAULT, 0x0008, 0x0008),
            StateRow(State.SWITCH_ON_INHIBITED, 0x0049, 0x0040),
            StateRow(State.READY_TO_SWITCH_ON, 0x1004B, 0x00001),
            StateRow(State.STOPPING, 0x1004B, 0x10001),
            StateRow(State.READY, 0x004F, 0x0003),
            StateRow(State.RUNNING, 0x004F, 0x0007),
        )
    ),
    run={**_BASE.run, State.STOPPING: _BASE.run[State.RUNNING]},
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


# -- docs/reference/drives/ls-s100.md#parameter-channel ----------------------------------------------------------------

PKW: Final = PkwDialect(
    answers={1: (1,), 2: (1,), 6: (4,), 7: (4,)},
    errors={number: PARAMETER_ERRORS[number] for number in (*range(8), 0x09, 0x0B, 0x0F, 0x11, *range(0x14, 0x19))},
    zero_between=False,  # 6.2.1: an order acts once, when it changes
)

#: of a write only
WRITE_ERRORS: Final = frozenset({0x01, 0x02, 0x06, 0x07, 0x11, 0x14})

#: 7.1
PNU_ADDRESS, PNU_TELEGRAM, PNU_PROFILE, PNU_COUNTER, PNU_FAULTS, PNU_WARNING = 918, 922, 930, 944, 947, 953
PNU_BAUD, PNU_DEVICE, PNU_VERSION, PNU_STW1, PNU_ZSW1, PNU_RESET = 963, 964, 965, 967, 968, 972
#: elements of the arrays
ARRAYS: Final = {PNU_FAULTS: 64, PNU_DEVICE: 7}
#: manufacturer, type, version, year, date (month in the high octet: 0C19h is 25 December), axes, ident number; (m)
DEVICE_ID: Final = (0x0351, 1, 0x0300, 0x07E6, 0x0601, 1, IDENT)
SITUATIONS: Final = 8
MESSAGES: Final = 8

#: 7.2
TRIPS: Final[Mapping[int, str]] = {
    1: "overload",
    2: "underload",
    3: "inverter overload",
    4: "E-thermal",
    5: "ground fault",
    6: "out phase open",
    7: "in phase open",
    10: "NTC",
    11: "overcurrent",
    12: "overvoltage",
    13: "external trip",
    14: "arm short",
    15: "overheat",
    16: "fuse open",
    19: "PTC thermal sensor",
    20: "fan",
    22: "error in parameter write",
    23: "pre PID fail",
    24: "bad contact at the I/O board",
    25: "external brake",
    26: "no motor",
    27: "bad option card",
    29: "safety A",
    30: "safety B",
    33: "BX",
    34: "LV",
    35: "lost command",
    36: "keypad lost command",
    49: "ADC error",
    50: "EEPROM error",
    51: "watchdog 1 error",
    52: "watchdog 2 error",
    54: "queue full",
    64: "cannot connect",
}
LOST_COMMAND: Final = 35


def trip_text(number: int) -> str:
    """``35 lost command``; the numbers between are reserved."""
    return f"{number} {TRIPS.get(number, 'reserved')}"


# -- parameters ----------------------------------------------------------------------------------------------------


#: command and frequency source: the field bus has them (inverter's manual)
FIELD_BUS: Final = {"dr-06": 4, "dr-07": 8}
#: COM-31 and COM-51, COM-30 and COM-50
PARA_STATUS, PARA_CONTROL, STATUS_COUNT, CONTROL_COUNT, UPDATE = 0x171F, 0x1733, 0x171E, 0x1732, 0x175E
#: PZD of Para-1 (0 is the first) in PPOs, behind the profile's two words
PARA_AT: Final = 2


def _place(code: str) -> tuple[int, int] | None:
    where = mapped_address(code)
    return None if where is None else divmod(where, 0x100)


_row = partial(ParamSpec, 0)
_pnu = partial(ParamSpec, read_only=True)
#: 4.2.8: with 1 the communication parameters act
_UPDATE: Final = "COM-94"


PARAMETERS: Final = ParamTable(
    placed(
        _place,
        _row("0005", "Frequency command", 0, 400, 0, decimals=2, unit="Hz", volatile=True),
        _row("0006", "Operation command", 0, 0xFFFF, 0, volatile=True),
        _row("000A", "Output frequency", 0, 400, 0, decimals=2, unit="Hz", read_only=True),
        _row("000B", "Output voltage", 0, 0xFFFF, 0, read_only=True, made_up=True),
        _row("000E", "Operating status", 0, 0xFFFF, 0, read_only=True),
        _row("000F", "Trip information", 0, 0xFFFF, 0, read_only=True),
        _row("0316", "Output power", 0, 0xFFFF, 0, read_only=True, made_up=True),
        _row("0334", "Warning information", 0, 0xFFFF, 0, read_only=True),
        _row("dr-01", "Command frequency", 0, 40_000, 0, made_up=True),
        _row("dr-03", "Acceleration time", 0, 600, 1, decimals=1, unit="s", made_up=True),
        _row("dr-04", "Deceleration time", 0, 600, 1, decimals=1, unit="s", made_up=True),
        _row("dr-06", "Command source, 4: field bus", 0, 5, 1, use=Use.SOURCE, made_up=True),
        _row("dr-07", "Frequency source, 8: field bus", 0, 12, 0, use=Use.SOURCE, made_up=True),
        _row("dr-20", "Maximum frequency", 40, 400, 60, decimals=2, unit="Hz", use=Use.SCALE),
        _row("dr-11", "Jog frequency", 0, 400, 10, decimals=2, unit="Hz", made_up=True),
        _row("Ad-08", "Stop mode: 0 ramp, 1 DC brake, 2 coast", 0, 4, 0, made_up=True),
        _row("Ad-15", "DC brake time", 0, 60, 1, decimals=2, unit="s", made_up=True),
        _row("Ad-17", "DC brake frequency", 0, 60, 5, decimals=2, unit="Hz", made_up=True),
        _row("Ad-44", "Brake opens from this frequency", 0, 400, 1, decimals=2, unit="Hz", made_up=True),
        _row("OU-31", "Relay 1, 35: brake control", 0, 43, 29, made_up=True),
        _row("In-90", "DI status", 0, 0xFFFF, 0, read_only=True),
        _row("COM-06", "FBus software version", 0, 0xFFFF, 0x0300, read_only=True),
        _row("COM-07", "FBus ID", 1, 125, 1),
        _row("COM-09", "FBus LED", 0, 0xFFFF, 0, read_only=True),
        _row("COM-10", "Telegram type", 1, 106, 1, read_only=True),
        _row("COM-11", "Profile", 0, 2, 1, use=Use.SCALE, acts=_UPDATE),
        _row("COM-12", "Baud rate", 0, INVALID_BAUD, INVALID_BAUD, read_only=True),
        _row("COM-13", "Module reset", 0, 1, 0),
        _row("COM-14", "PROFIdrive value: 0 standard, 1 rpm", 0, 1, 0, use=Use.SCALE, acts=_UPDATE),
        _row("COM-30", "Para Status number", 1, 8, 3, use=Use.MAP, acts=_UPDATE),
        *(
            _row(f"COM-{31 + n}", f"Para Status-{1 + n}", 0, 0xFFFF, factory, use=Use.MAP, acts=_UPDATE)
            for n, factory in enumerate((0x000A, 0x000E, 0x000F, 0, 0, 0, 0, 0))
        ),
        _row("COM-50", "Para Control number", 1, 8, 2, use=Use.MAP, acts=_UPDATE),
        *(
            _row(f"COM-{51 + n}", f"Para Control-{1 + n}", 0, 0xFFFF, factory, use=Use.MAP, acts=_UPDATE)
            for n, factory in enumerate((0x0005, 0x0006, 0, 0, 0, 0, 0, 0))
        ),
        _row("COM-68", "FBus swap", 0, 1, 0, use=Use.SCALE, acts=_UPDATE),
        _row(_UPDATE, "Comm update", 0, 1, 0),
        _row(
            "PRT-12",
            "Lost command: 0 none, 1 coast, 2 ramp, 3 hold input, 4 hold output, 5 preset",
            0,
            5,
            0,
            made_up=True,
        ),
        _row("PRT-13", "Lost command time", 0.1, 120, 1, decimals=1, unit="s", made_up=True),
        _row("PRT-14", "Lost command frequency", 0, 400, 0, decimals=2, unit="Hz", made_up=True),
        _pnu(PNU_ADDRESS, "node_address", "Node address"),
        _pnu(PNU_TELEGRAM, "telegram", "Telegram selection"),
        _pnu(PNU_PROFILE, "profile", "Profile in use", use=Use.SCALE),
        _pnu(PNU_COUNTER, "fault_counter", "Fault message counter"),
        _pnu(PNU_FAULTS, "fault_numbers", "Fault numbers"),
        _pnu(PNU_WARNING, "warning_word", "Warning word"),
        _pnu(PNU_BAUD, "baud_rate", "Detected baud rate"),
        _pnu(PNU_DEVICE, "device_identification", "Device identification"),
        _pnu(PNU_VERSION, "profile_version", "PROFIdrive profile"),
        _pnu(PNU_STW1, "last_stw1", "Last STW1"),
        _pnu(PNU_ZSW1, "last_zsw1", "Latest ZSW1"),
        ParamSpec(PNU_RESET, "module_reset", "Reset of 944, 947 and 953", 0, 1),
    )
)


def spec_at(where: int) -> ParamSpec | None:
    """The parameter at an address, as far as it is known here."""
    return PARAMETERS.get(where >> 8, where & 0xFF)
