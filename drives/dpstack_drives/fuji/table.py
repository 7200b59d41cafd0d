"""Function codes of the FRENIC, and the facts of its device file that are looked at by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, NamedTuple

from dpstack.devices.finding import drive_file_at
from dpstack.profile import ParamSpec

FILE: Final = drive_file_at(Path(__file__).with_name("fuji-frenic.toml"))
TABLE: Final = FILE.table
CONTROL, STATUS = TABLE.control, TABLE.status
PKW: Final = FILE.channel.of_pkw
PARAMETERS: Final = FILE.parameters

#: Table 5.1: the telegrams that o30 chooses, all others are PPO1
BY_O30: Final = {2: "PPO2", 3: "PPO3", 4: "PPO4", 5: "PPO2"}

#: Table 8.8
GROUPS: Final = {name: number for number, name in enumerate("SMFECPH-o---JyWXZ", 0x02) if name != "-"}
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


ALARMS: Final = tuple(Alarm(one.malfunction or 0, code, one.code, one.text) for code, one in FILE.fault.facts.items())
ER4, ER5 = 34, 35


def alarms(malfunction: int) -> list[Alarm]:
    """The alarms behind a malfunction code of PNU 947, which three times stands for two of them."""
    return [alarm for alarm in ALARMS if alarm.malfunction == malfunction]


#: PNUs (table 8.11)
PNU_PCD_WRITE, PNU_PCD_READ, PNU_ADDRESS, PNU_ACCESS, PNU_ALARMS, PNU_BAUD = 915, 916, 918, 927, 947, 963
PNU_CTW, PNU_STW, PNU_INITIALISE = 967, 968, 970
#: indexes of the arrays
ARRAYS: Final = {PNU_PCD_WRITE: range(1, 5), PNU_PCD_READ: range(1, 5), PNU_ALARMS: range(1, 33)}
#: function codes that hold the same as an array, index 1 first
SAME: Final = {PNU_PCD_WRITE: 40, PNU_PCD_READ: 48}
#: PNU 963 and its rates
BAUD_INDEX: Final = {baud: index for index, baud in enumerate(FILE.bus.rates, 1)}
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
#: terminals that go before the bus (11, no. 6): LE off or LOC on, and it has no command
LE, LOC = "LE", "LOC"
#: indexes of PNU 947 that hold an alarm, latest first; the others are 0
ALARM_INDEXES: Final = (1, 9, 17, 25)


def spec_at(assignment: int) -> ParamSpec | None:
    """The function code with this assignment, if it is known."""
    return PARAMETERS.get((assignment >> 8) + GROUP_OFFSET, assignment & 0xFF)
