"""Facts of the Demag that plugin and simulated drive share: telegrams, parameters, texts
(docs/reference/drives/demag.md).

Source: Demag, Operating instructions CM-PDP-24, supplement; chapter numbers in the comments are the manual's.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from dpstack.profile import ParamSpec, ParamTable, ParamType, PkwDialect, TelegramSpec, Use, Word, drivecom_states
from dpstack_drives import ppo

IDENT: Final = 0x0696

#: 13.3, GSD file; ten rates, 31.25 kbit/s is not among them
MAX_TSDR: Final = {
    9_600: 60,
    19_200: 60,
    45_450: 250,
    93_750: 60,
    187_500: 60,
    500_000: 100,
    1_500_000: 150,
    3_000_000: 250,
    6_000_000: 450,
    12_000_000: 800,
}

TELEGRAMS: Final = ppo.ppos(4)


def scan_ms(telegram: TelegramSpec) -> int:
    """The internal scan time (10): 16 ms with PPO3, 32 ms with the others."""
    return 16 if telegram.name == "PPO3" else 32


#: 11.2.3, what PZD2 reports by bits 12-14 of the words in PPO1 and PPO3
SELECT_FREQUENCY, SELECT_CURRENT, SELECT_ACTIVE, SELECT_WARNING, SELECT_FAULT = 0, 1, 2, 5, 6
SELECTABLE: Final = frozenset({SELECT_CURRENT, SELECT_ACTIVE, SELECT_WARNING, SELECT_FAULT})

#: 11.1.1 to 11.1.3
PKW: Final = PkwDialect(
    answers={1: (1, 2), 2: (1,), 3: (2,), 6: (4, 5), 7: (4,), 8: (5,)},
    errors={
        0: "inadmissible parameter number",
        1: "the parameter cannot be altered",
        2: "lower or upper limit exceeded",
        3: "faulty data set",
        4: "the parameter has no data sets",
        5: "wrong data type",
        18: "other fault",
        101: "the parameter cannot be read",
        103: "fault while reading the EEPROM",
        104: "fault while writing the EEPROM",
        105: "checksum fault in the EEPROM",
        106: "the parameter must not be written in operation",
        107: "the data sets hold different values",
        108: "unknown order",
    },
)

#: 11.1.3, what the drive's own state makes of an access; the others follow from the order
STATE_ERRORS: Final = (18, 103, 104, 105, 106)
READ_ERRORS: Final = frozenset({103})
WRITE_ERRORS: Final = frozenset({104, 106})

SETS: Final = 4
#: IND of data set n for RAM only is n + 5 (11.1.4)
RAM_ONLY: Final = 5
#: 11.2.1.3, the control word of control by remote contacts; S7 and S8 are reserved
CONTACTS: Final = Word(
    "control word",
    {
        **{f"s{number}": number - 1 for number in range(1, 9)},
        **{name: bit for name, bit in drivecom_states.CONTROL.bits.items() if bit >= 8},
    },
)
#: 12: not to be written in operation. The marks of the list are lost in the text form: a reading, the motor's data
STANDSTILL_ONLY: Final = frozenset({371, 375})
#: fault acknowledgement is locked for this long (11.2.1), in s
FAULT_LOCK_S: Final = 15


# Types of 400 and 480 as in 11.1.6; the others by their range (a reading: the list of types is an extra file).
# Data sets: those the manual names so, 424 and 425 a reading. made_up: factory values and limits not in the manual.
_frequency = partial(ParamSpec, decimals=2, unit="Hz", type=ParamType.U32)
_signed_frequency = partial(_frequency, type=ParamType.I32)
_ramp = partial(_frequency, unit="Hz/s", made_up=True)

PARAMETERS: Final = ParamTable(
    (
        _signed_frequency(
            228, "internal_reference_frequency", "Internal reference frequency", -1000, 1000, read_only=True
        ),
        ParamSpec(249, "active_data_set", "Active data set", 1, 4, 1, read_only=True),
        ParamSpec(250, "digital_inputs", "Digital inputs", 0, 255, read_only=True),
        ParamSpec(270, "warnings", "Warnings", 0, 0xFFFF, read_only=True),
        ParamSpec(281, "dp_master_out", "DP-Master OUT", type=ParamType.TEXT, read_only=True),
        _signed_frequency(282, "reference_bus_frequency", "Reference bus frequency", -1000, 1000, read_only=True),
        _signed_frequency(283, "reference_ramp_frequency", "Reference ramp frequency", -1000, 1000, read_only=True),
        ParamSpec(284, "dp_master_in", "DP-Master IN", type=ParamType.TEXT, read_only=True),
        ParamSpec(
            371, "rated_current", "Rated current", 0.1, 1000, 4, decimals=1, unit="A", per_set=True, made_up=True
        ),
        _frequency(375, "rated_frequency", "Rated frequency", 10, 1000, 50, per_set=True, use=Use.SCALE),
        _frequency(390, "profibus_reference", "Profibus Reference", 0, 999.99, per_set=True, use=Use.SCALE),
        ParamSpec(391, "node_id", "Profibus Node-ID", 0, 126, 126),
        ParamSpec(392, "state_transition_5", "State transition 5", 0, 2, 2),
        ParamSpec(400, "switching_frequency", "Switching frequency", 1, 8, 2, unit="kHz"),
        ParamSpec(412, "local_remote", "Local/Remote", 0, 44, 44, per_set=True, use=Use.SOURCE),
        ParamSpec(414, "data_set_selection", "Data set selection", 0, 4, use=Use.SETTING),
        _ramp(424, "emergency_stop_clockwise", "Emergency stop clockwise", 0.01, 9999.99, 100),
        _ramp(425, "emergency_stop_anticlockwise", "Emergency stop anticlockwise", 0.01, 9999.99, 100),
        ParamSpec(434, "ramp_set_point", "Ramp set point", 1, 3, 3, per_set=True, use=Use.SOURCE),
        _signed_frequency(480, "fixed_frequency_1", "Fixed frequency 1", -999, 999, 5, per_set=True),
        ParamSpec(
            549, "max_control_deviation", "max. Control deviation", 0.01, 20, 1, decimals=2, unit="%", made_up=True
        ),
        ParamSpec(632, "braking_time", "Braking time", 0, 200, 1, decimals=1, unit="s", made_up=True),
        ParamSpec(637, "switch_off_threshold", "Switch-off threshold", 0, 100, 1, decimals=1, unit="%", made_up=True),
        ParamSpec(638, "holding_time", "Holding time", 0, 200, 0.1, decimals=1, unit="s", made_up=True),
        ParamSpec(880, "toggle_bit_reaction", "Toggle bit disturbance behaviour", 0, 3),
        ParamSpec(881, "toggle_bit_time", "Toggle bit time", 0, 5000, 500, unit="ms"),
    )
)

#: 13.1, by bit number
WARNINGS: Final = (
    "Ixt",
    "short-term Ixt",
    "long-term Ixt",
    "heat sink temperature",
    "inside temperature",
    "limit",
    "init",
    "motor temperature",
    "mains failure",
    "motor protective switch",
    "Fmax",
    "analog input MFI1A",
    "analog input A2",
    "system bus",
    "Udc",
    "V-belt",
)
#: warnings that lead to a trip soon, ZSW bit 15: motor temperature, heat sink, inside, Ixt, mains (which is a reading)
TRIPS_SOON: Final = 0x019F

#: 13.2, the hexadecimal digits of the code
FAULTS: Final = {
    0x2061: "failure of the Profibus module",
    0x2062: "Profibus OFF, the DP master failed",
    0x2065: "Profibus configuration fault",
    0x2100: "fieldbus toggle bit OFF",
}
FAULT_MODULE: Final = 0x2061
FAULT_MASTER_LOST: Final = 0x2062
FAULT_CONFIGURATION: Final = 0x2065
FAULT_TOGGLE: Final = 0x2100


def fault_name(code: int) -> str:
    """``F2062 Profibus OFF, the DP master failed``."""
    return f"F{code:04X} {FAULTS.get(code, '')}".rstrip()


def warning_names(mask: int) -> tuple[str, ...]:
    """The warnings of a warning word."""
    return tuple(name for bit, name in enumerate(WARNINGS) if mask >> bit & 1)
