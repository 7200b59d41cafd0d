"""Facts of the FRENIC that plugin and simulated drive share. Passages: docs/reference/drives/fuji.md.

Source: Fuji, PROFIBUS DP Interface Option OPC-E1-PDP, instruction manual; numbers in the comments are its sections.
The manual has no GSD file: ident number and identifier octets are made up until the user's GSD overrides them.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Final, NamedTuple

from dpstack.profile import POWER_ON, ParamSpec, ParamTable, ParamType, PkwDialect, Use, Word, profidrive_states
from dpstack_drives import ppo
from dpstack_drives.codes import placed

IDENT: Final = 0xDD04

#: 2.4: nine rates and 45.45 k, no response times
BAUD_RATES: Final = ppo.TEN_RATES

TELEGRAMS: Final = ppo.ppos(4, made_up=True)
#: the internal scan time is in no manual: a reading
SCAN_MS: Final = 4

#: Table 5.1: the telegrams that o30 chooses, all others are PPO1
BY_O30: Final = {2: "PPO2", 3: "PPO3", 4: "PPO4", 5: "PPO2"}
O30: Final = {"PPO1": 1, "PPO2": 2, "PPO3": 3, "PPO4": 4}


#: Table 8.5
CONTROL: Final = Word("CTW", {**profidrive_states.CONTROL_BITS, "reverse": 11})
#: Table 8.6. Bit 9 is what others call remote; bit 6 is always the opposite of bit 0
STATUS: Final = Word("STW", {**profidrive_states.STATUS_BITS, "reached": 8, "remote": 9, "frequency_detected": 10})
TABLE: Final = profidrive_states.table(CONTROL, STATUS)

#: 8.3, tables 8.9 and 8.10
PKW: Final = PkwDialect(
    answers={1: (1,), 2: (1,), 6: (4,), 7: (4,), 9: (6,)},
    errors={
        0: "nonexistent parameter",
        1: "writing inhibited",
        2: "value out of range",
        3: "invalid subindex",
        4: "the parameter is no array",
        11: "write-protected while running",
        17: "cannot be read now",
        101: "link priority error",
        104: "busy writing",
    },
    zero_between=False,
    busy=frozenset({104}),
)

#: table 8.10, what the drive's own state makes of an access; 11, 101 and 104 of a write only, 17 of a read
STATE_ERRORS: Final = (11, 17, 101, 104)
READ_ERRORS: Final = frozenset({17})
WRITE_ERRORS: Final = frozenset({11, 101, 104})

#: Table 8.8
GROUPS: Final = {
    "S": 0x02,
    "M": 0x03,
    "F": 0x04,
    "E": 0x05,
    "C": 0x06,
    "P": 0x07,
    "H": 0x08,
    "o": 0x0A,
    "J": 0x0E,
    "y": 0x0F,
    "W": 0x10,
    "X": 0x11,
    "Z": 0x12,
}
GROUP_OFFSET: Final = 0x100
_CODE: Final = re.compile(r"([A-Za-z])(\d{1,3})")


def address(code: str) -> tuple[int, int] | None:
    """PNU and subindex of a function code such as ``F26``; None for anything else. Groups in either case."""
    match = _CODE.fullmatch(code.strip())
    if match is None:
        return None
    group = next((number for name, number in GROUPS.items() if name.lower() == match[1].lower()), None)
    number = int(match[2])
    return None if group is None or number > 0xFF else (group + GROUP_OFFSET, number)


def code_of(assignment: int) -> str:
    """``F26`` of 041A; the hex digits if there is no such group."""
    group = next((name for name, number in GROUPS.items() if number == assignment >> 8), None)
    return f"{assignment:04X}" if group is None else f"{group}{assignment & 0xFF:02}"


class Alarm(NamedTuple):
    """One alarm (table 10.1): malfunction code of PNU 947, alarm code of M16 to M19, keypad text, name."""

    malfunction: int
    code: int
    keypad: str
    name: str

    @property
    def text(self) -> str:
        """``Er5 field bus communications error``."""
        return f"{self.keypad} {self.name}"


ALARMS: Final = (
    Alarm(0x2301, 1, "OC1", "overcurrent during acceleration"),
    Alarm(0x2302, 2, "OC2", "overcurrent during deceleration"),
    Alarm(0x2303, 3, "OC3", "overcurrent at constant speed"),
    Alarm(0x2330, 5, "EF", "grounding fault"),
    Alarm(0x3211, 6, "OU1", "overvoltage during acceleration"),
    Alarm(0x3212, 7, "OU2", "overvoltage during deceleration"),
    Alarm(0x3213, 8, "OU3", "overvoltage at constant speed or stopped"),
    Alarm(0x3220, 10, "LU", "undervoltage"),
    Alarm(0x3130, 11, "Lin", "input phase loss"),
    Alarm(0x5450, 14, "FUS", "blown fuse"),
    Alarm(0x5440, 16, "PbF", "charging circuit fault"),
    Alarm(0x4310, 17, "OH1", "overheating of the heat sink"),
    Alarm(0x9000, 18, "OH2", "external alarm"),
    Alarm(0x4110, 19, "OH3", "inverter overheat"),
    Alarm(0x4310, 20, "OH4", "motor protection (PTC thermistor)"),
    Alarm(0x4210, 22, "dbH", "braking resistor overheated"),
    Alarm(0x2211, 23, "OL1", "motor overload 1"),
    Alarm(0x2212, 24, "OL2", "motor overload 2"),
    Alarm(0x2200, 25, "OLU", "inverter overload"),
    Alarm(0x5500, 31, "Er1", "memory error"),
    Alarm(0x7520, 32, "Er2", "keypad communication error"),
    Alarm(0x5220, 33, "Er3", "CPU error"),
    Alarm(0x7510, 34, "Er4", "interface option communications error"),
    Alarm(0x7511, 35, "Er5", "field bus communications error"),
    Alarm(0xF004, 36, "Er6", "operation protection"),
    Alarm(0x7200, 37, "Er7", "tuning error"),
    Alarm(0xB100, 38, "Er8", "RS-485 communications error"),
    Alarm(0x3300, 46, "OPL", "output phase loss"),
    Alarm(0x6300, 51, "ErF", "data save error due to undervoltage"),
    Alarm(0x7520, 53, "ErP", "RS-485 communications error of the option"),
    Alarm(0x5220, 54, "ErH", "LSI error of the power board"),
)
ER4, ER5 = 34, 35


def alarms(malfunction: int) -> list[Alarm]:
    """The alarms behind a malfunction code of PNU 947, which three times stands for two of them."""
    return [alarm for alarm in ALARMS if alarm.malfunction == malfunction]


#: PNUs (table 8.11)
PNU_PCD_WRITE, PNU_PCD_READ, PNU_ADDRESS, PNU_ACCESS, PNU_ALARMS, PNU_BAUD = 915, 916, 918, 927, 947, 963
PNU_PROFILE, PNU_CTW, PNU_STW, PNU_INITIALISE = 965, 967, 968, 970
#: indexes of the arrays
ARRAYS: Final = {PNU_PCD_WRITE: range(1, 5), PNU_PCD_READ: range(1, 5), PNU_ALARMS: range(1, 33)}
#: function codes that hold the same as an array, index 1 first
SAME: Final = {PNU_PCD_WRITE: 40, PNU_PCD_READ: 48}
#: PNU 963 and its rates
BAUD_INDEX: Final = {baud: index for index, baud in enumerate(BAUD_RATES, 1)}
#: assignments of function codes that can only be read here, and of S06, whose bits 0 and 1 are ignored (8.2 (4))
READ_ONLY_HERE: Final = frozenset({0x0201, 0x0205})
S06: Final = 0x0206
S06_IGNORED: Final = 0x0003
#: addresses up to 125; 126 and more are a data setting error (2.3)
MOST_ADDRESS: Final = 125
#: at both switches; 00: o31
MOST_SWITCHES: Final = 99
#: the inverter misses its option after about this time (4.4), in s
OPTION_OFF_S: Final = 1.0
#: error 11 (table 8.10); which ones is in the inverter's manual: a reading
STANDSTILL_ONLY: Final = frozenset({"F01", "F03", "H03", "initialise"})
#: terminals that go before the bus (11, no. 6): LE off or LOC on, and it has no command
LE, LOC = "LE", "LOC"
#: indexes of PNU 947 that hold an alarm, latest first; the others are 0
ALARM_INDEXES: Final = (1, 9, 17, 25)


_row = partial(ParamSpec, 0)
_assignment = partial(ParamSpec, use=Use.MAP, acts=POWER_ON)
_pnu = partial(ParamSpec, read_only=True)
# Formats of the function codes are in MEH448, which we do not have: decimals of F03, F07, F08, E31, H56 are made up.
PARAMETERS: Final = ParamTable(
    placed(
        address,
        _row("S01", "Frequency reference, per unit", type=ParamType.I16, made_up=True, read_only=True),
        _row("S05", "Frequency reference", 0, 655.35, 0, decimals=2, unit="Hz", made_up=True, read_only=True),
        _row("S06", "Operation command", made_up=True, volatile=True),
        *(_row(f"M{16 + n}", f"Alarm code, {n} before the latest", 0, 254, read_only=True) for n in range(4)),
        _row("F01", "Frequency command source", 0, 10, made_up=True),
        _row("F03", "Maximum frequency", 25, 400, 60, decimals=1, unit="Hz", use=Use.SCALE, made_up=True),
        _row("F07", "Acceleration time", 0, 3600, 1, decimals=1, unit="s", made_up=True),
        _row("F08", "Deceleration time", 0, 3600, 1, decimals=1, unit="s", made_up=True),
        _row("F26", "Motor sound", 0, 15, 2, made_up=True),
        _row("E31", "Frequency detection level, 0: never", 0, 400, 0, decimals=1, unit="Hz", made_up=True),
        _row("H03", "Data initialisation", 0, 1, use=Use.SETTING, made_up=True),
        _row("H56", "Deceleration time for a forced stop", 0, 3600, 0.5, decimals=1, unit="s", made_up=True),
        _row("o27", "Reaction to a communications error", 0, 15),
        _row("o28", "Timer for communications errors", 0, 60, 0, decimals=1, unit="s"),
        _row("o30", "PPO type", 0, 255, use=Use.SETTING, acts=POWER_ON),
        _row("o31", "Station address", 0, 255),
        *(_assignment(0, f"o{40 + n}", f"Write assignment of PCD{n + 1}") for n in range(4)),
        *(_assignment(0, f"o{48 + n}", f"Read assignment of PCD{n + 1}") for n in range(4)),
        _row("W90", "Software version of the option", 0, 9999, 123, made_up=True, read_only=True),
        _row("y98", "Run and frequency command source", 0, 3, use=Use.SOURCE),
        _row("y99", "Commands of the loader: 1 frequency, 2 run, 3 both", 0, 3, use=Use.SOURCE, made_up=True),
        _assignment(PNU_PCD_WRITE, "pcd_write", "Write assignments of PCD1 to PCD4"),
        _assignment(PNU_PCD_READ, "pcd_read", "Read assignments of PCD1 to PCD4"),
        _pnu(PNU_ADDRESS, "node_address", "Node address", 0, MOST_ADDRESS),
        _pnu(PNU_BAUD, "baud_rate", "Baud rate by its index", 0, 10),
        ParamSpec(PNU_INITIALISE, "initialise", "Initialise the inverter, 1 to 0", 0, 1, use=Use.SETTING),
        ParamSpec(PNU_ACCESS, "access_permission", "Write access over PCV", 0, 1, 1),
        _pnu(PNU_ALARMS, "malfunctions", "Malfunction history"),
        _pnu(PNU_PROFILE, "profile_version", "PROFIdrive version", factory=2),
        _pnu(PNU_CTW, "last_ctw", "Last CTW"),
        _pnu(PNU_STW, "last_stw", "Latest STW"),
    )
)


def spec_at(assignment: int) -> ParamSpec | None:
    """The function code with this assignment, if it is known."""
    return PARAMETERS.get((assignment >> 8) + GROUP_OFFSET, assignment & 0xFF)
