"""What plugin and simulated drive share: telegrams, parameters, texts. Passages: docs/drives/demag.md.

Source: Demag, Operating instructions CM-PDP-24, supplement; chapter numbers in the comments are the manual's.
"""

from __future__ import annotations

from typing import Final

from dpstack.profile import ParamSpec, ParamTable, PkwDialect, TelegramSpec

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

TELEGRAMS: Final = {
    spec.name: spec
    for spec in (
        TelegramSpec(name="PPO1", config=bytes.fromhex("F3 71"), outputs=4, inputs=4, channel=True),
        TelegramSpec(name="PPO2", config=bytes.fromhex("F3 75"), outputs=12, inputs=12, channel=True),
        TelegramSpec(name="PPO3", config=bytes.fromhex("71"), outputs=4, inputs=4),
        TelegramSpec(name="PPO4", config=bytes.fromhex("75"), outputs=12, inputs=12),
    )
}


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
#: fault acknowledgement is locked for this long (11.2.1), in s
FAULT_LOCK_S: Final = 15

# Types of 400 and 480 as in 11.1.6; the others by their range (a reading: the list of types is an extra file).
# Data sets: those the manual names so, 424 and 425 a reading. made_up: factory values and limits not in the manual.
PARAMETERS: Final = ParamTable(
    (
        ParamSpec(
            number=228,
            name="internal_reference_frequency",
            title="Internal reference frequency",
            long=True,
            decimals=2,
            unit="Hz",
            low=-1000,
            high=1000,
            read_only=True,
        ),
        ParamSpec(
            number=249, name="active_data_set", title="Active data set", low=1, high=4, factory=1, read_only=True
        ),
        ParamSpec(number=250, name="digital_inputs", title="Digital inputs", high=255, read_only=True),
        ParamSpec(number=270, name="warnings", title="Warnings", high=0xFFFF, read_only=True),
        ParamSpec(number=281, name="dp_master_out", title="DP-Master OUT", text=True, read_only=True),
        ParamSpec(
            number=282,
            name="reference_bus_frequency",
            title="Reference bus frequency",
            long=True,
            decimals=2,
            unit="Hz",
            low=-1000,
            high=1000,
            read_only=True,
        ),
        ParamSpec(
            number=283,
            name="reference_ramp_frequency",
            title="Reference ramp frequency",
            long=True,
            decimals=2,
            unit="Hz",
            low=-1000,
            high=1000,
            read_only=True,
        ),
        ParamSpec(number=284, name="dp_master_in", title="DP-Master IN", text=True, read_only=True),
        ParamSpec(
            number=371,
            name="rated_current",
            title="Rated current",
            decimals=1,
            unit="A",
            low=0.1,
            high=1000,
            factory=4,
            per_set=True,
            made_up=True,
        ),
        ParamSpec(
            number=375,
            name="rated_frequency",
            title="Rated frequency",
            long=True,
            decimals=2,
            unit="Hz",
            low=10,
            high=1000,
            factory=50,
            per_set=True,
        ),
        ParamSpec(
            number=390,
            name="profibus_reference",
            title="Profibus Reference",
            long=True,
            decimals=2,
            unit="Hz",
            high=999.99,
            per_set=True,
        ),
        ParamSpec(number=391, name="node_id", title="Profibus Node-ID", high=126, factory=126),
        ParamSpec(number=392, name="state_transition_5", title="State transition 5", high=2, factory=2),
        ParamSpec(
            number=400, name="switching_frequency", title="Switching frequency", unit="kHz", low=1, high=8, factory=2
        ),
        ParamSpec(number=412, name="local_remote", title="Local/Remote", high=44, factory=44, per_set=True),
        ParamSpec(number=414, name="data_set_selection", title="Data set selection", high=4),
        ParamSpec(
            number=424,
            name="emergency_stop_clockwise",
            title="Emergency stop clockwise",
            long=True,
            decimals=2,
            unit="Hz/s",
            low=0.01,
            high=9999.99,
            factory=100,
            made_up=True,
        ),
        ParamSpec(
            number=425,
            name="emergency_stop_anticlockwise",
            title="Emergency stop anticlockwise",
            long=True,
            decimals=2,
            unit="Hz/s",
            low=0.01,
            high=9999.99,
            factory=100,
            made_up=True,
        ),
        ParamSpec(number=434, name="ramp_set_point", title="Ramp set point", low=1, high=3, factory=3, per_set=True),
        ParamSpec(
            number=480,
            name="fixed_frequency_1",
            title="Fixed frequency 1",
            long=True,
            decimals=2,
            unit="Hz",
            low=-999,
            high=999,
            factory=5,
            per_set=True,
        ),
        ParamSpec(
            number=549,
            name="max_control_deviation",
            title="max. Control deviation",
            decimals=2,
            unit="%",
            low=0.01,
            high=20,
            factory=1,
            made_up=True,
        ),
        ParamSpec(
            number=632,
            name="braking_time",
            title="Braking time",
            decimals=1,
            unit="s",
            high=200,
            factory=1,
            made_up=True,
        ),
        ParamSpec(
            number=637,
            name="switch_off_threshold",
            title="Switch-off threshold",
            decimals=1,
            unit="%",
            high=100,
            factory=1,
            made_up=True,
        ),
        ParamSpec(
            number=638,
            name="holding_time",
            title="Holding time",
            decimals=1,
            unit="s",
            high=200,
            factory=0.1,
            made_up=True,
        ),
        ParamSpec(number=880, name="toggle_bit_reaction", title="Toggle bit disturbance behaviour", high=3),
        ParamSpec(number=881, name="toggle_bit_time", title="Toggle bit time", unit="ms", high=5000, factory=500),
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
