"""Physical, function and transducer blocks: the block object and the parameters of each class.

A parameter stands at the index of its block object plus its relative index. Sources: docs/reference/decisions/pa.md.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Final, NamedTuple

from dpstack.errors import PduError
from dpstack.pa.datatypes import parse_value

PHYSICAL, FUNCTION, TRANSDUCER = 1, 2, 3
#: short names of the kinds of blocks, as technicians write them
PREFIX: Final = {PHYSICAL: "PB", FUNCTION: "FB", TRANSDUCER: "TB"}

#: a line: relative index, name, data type, access (r, rw; rm: written in mode MAN or O/S only; w), storage
#: (S static: a write counts ST_REV up; N kept; D dynamic; C constant)
_STANDARD: Final = """
0 BLOCK_OBJECT block r C
1 ST_REV u16 r N
2 TAG_DESC text32 rw S
3 STRATEGY u16 rw S
4 ALERT_KEY u8 rw S
5 TARGET_MODE u8 rw S
6 MODE_BLK mode r D
7 ALARM_SUM alarm_sum r D
"""
_PHYSICAL: Final = """
8 SOFTWARE_REVISION text16 r C
9 HARDWARE_REVISION text16 r C
10 DEVICE_MAN_ID u16 r C
11 DEVICE_ID text16 r C
12 DEVICE_SER_NUM text16 r C
13 DIAGNOSIS octets4 r D
14 DIAGNOSIS_EXTENSION octets6 r D
15 DIAGNOSIS_MASK octets4 r C
16 DIAGNOSIS_MASK_EXTENSION octets6 r C
17 DEVICE_CERTIFICATION text32 r C
18 WRITE_LOCKING u16 rw N
19 FACTORY_RESET u16 rw S
20 DESCRIPTOR text32 rw S
21 DEVICE_MESSAGE text32 rw S
22 DEVICE_INSTAL_DATE text16 rw S
23 LOCAL_OP_ENA u8 rw N
24 IDENT_NUMBER_SELECTOR u8 rw S
25 HW_WRITE_PROTECTION u8 r D
26 FEATURE feature r N
27 COND_STATUS_DIAG u8 rw S
28 DIAG_EVENT_SWITCH octets50 rw S
"""
_BATCH: Final = "8 BATCH batch rw S\n"
_AI: Final = """
10 OUT value rm D
11 PV_SCALE range rw S
12 OUT_SCALE scaling rw S
13 LIN_TYPE u8 rw S
14 CHANNEL u16 rw S
16 PV_FTIME f32 rw N
17 FSAFE_TYPE u8 rw S
18 FSAFE_VALUE f32 rw S
19 ALARM_HYS f32 rw S
21 HI_HI_LIM f32 rw S
23 HI_LIM f32 rw S
25 LO_LIM f32 rw S
27 LO_LO_LIM f32 rw S
30 HI_HI_ALM alarm r D
31 HI_ALM alarm r D
32 LO_ALM alarm r D
33 LO_LO_ALM alarm r D
34 SIMULATE simulate rw S
35 OUT_UNIT_TEXT text16 rw S
"""
_DI: Final = """
10 OUT_D value_d rm D
14 CHANNEL u16 rw S
15 INVERT u8 rw S
20 FSAFE_TYPE u8 rw S
21 FSAFE_VAL_D u8 rw S
24 SIMULATE simulate_d rw S
"""
_AO: Final = """
9 SP value rw D
11 PV_SCALE scaling rw S
12 READBACK value r D
14 RCAS_IN value rw D
21 IN_CHANNEL u16 rw S
22 OUT_CHANNEL u16 rw S
23 FSAFE_TIME f32 rw S
24 FSAFE_TYPE u8 rw S
25 FSAFE_VALUE f32 rw S
27 RCAS_OUT value r D
31 POS_D value_d r D
32 SETP_DEVIATION f32 r D
33 CHECK_BACK octets3 r D
34 CHECK_BACK_MASK octets3 r C
35 SIMULATE simulate rw S
36 INCREASE_CLOSE u8 rw S
37 OUT value rm D
38 OUT_SCALE scaling rw S
"""
_DO: Final = """
9 SP_D value_d rw D
10 OUT_D value_d rm D
12 READBACK_D value_d r D
14 RCAS_IN_D value_d rw D
17 CHANNEL u16 rw S
18 INVERT u8 rw S
19 FSAFE_TIME f32 rw S
20 FSAFE_TYPE u8 rw S
21 FSAFE_VAL_D u8 rw S
22 RCAS_OUT_D value_d r D
24 SIMULATE simulate_d rw S
33 CHECK_BACK octets3 r D
34 CHECK_BACK_MASK octets3 r C
"""
_TOTALISER: Final = """
10 TOTAL value rm N
11 UNIT_TOT unit rw S
12 CHANNEL u16 rw S
13 SET_TOT u8 rw N
14 MODE_TOT u8 rw N
15 FAIL_TOT u8 rw S
16 PRESET_TOT f32 rw S
17 ALARM_HYS f32 rw S
18 HI_HI_LIM f32 rw S
19 HI_LIM f32 rw S
20 LO_LIM f32 rw S
21 LO_LO_LIM f32 rw S
22 HI_HI_ALM alarm r D
23 HI_ALM alarm r D
24 LO_ALM alarm r D
25 LO_LO_ALM alarm r D
"""
_PRESSURE: Final = """
8 SENSOR_VALUE f32 r D
9 SENSOR_HI_LIM f32 r N
10 SENSOR_LO_LIM f32 r N
11 CAL_POINT_HI f32 rw S
12 CAL_POINT_LO f32 rw S
13 CAL_MIN_SPAN f32 r N
14 SENSOR_UNIT unit rw S
15 TRIMMED_VALUE value r D
16 SENSOR_TYPE u16 r N
17 SENSOR_SERIAL_NUMBER u32 r N
18 PRIMARY_VALUE value r D
19 PRIMARY_VALUE_UNIT unit rw S
20 PRIMARY_VALUE_TYPE u16 rw S
21 SENSOR_DIAPHRAGM_MATERIAL u16 rw S
22 SENSOR_FILL_FLUID u16 rw S
23 SENSOR_MAX_STATIC_PRESSURE f32 r N
24 SENSOR_O_RING_MATERIAL u16 rw S
25 PROCESS_CONNECTION_TYPE u16 rw S
26 PROCESS_CONNECTION_MATERIAL u16 rw S
27 TEMPERATURE value r D
28 TEMPERATURE_UNIT unit rw S
29 SECONDARY_VALUE_1 value r D
30 SECONDARY_VALUE_1_UNIT unit rw S
31 SECONDARY_VALUE_2 value r D
32 SECONDARY_VALUE_2_UNIT unit rw S
33 LIN_TYPE u8 rw S
34 SCALE_IN range rw S
35 SCALE_OUT range rw S
36 LOW_FLOW_CUT_OFF f32 rw S
37 FLOW_LIN_SQRT_POINT f32 rw S
38 TAB_ACTUAL_NUMBER u8 r N
39 TAB_ENTRY u8 rw D
40 TAB_MAX_NUMBER u8 r N
41 TAB_MIN_NUMBER u8 r N
42 TAB_OP_CODE u8 rw D
43 TAB_STATUS u8 r D
44 TAB_X_Y_VALUE point rw D
45 MAX_SENSOR_VALUE f32 rw N
46 MIN_SENSOR_VALUE f32 rw N
47 MAX_TEMPERATURE f32 rw N
48 MIN_TEMPERATURE f32 rw N
"""
_TEMPERATURE: Final = """
8 PRIMARY_VALUE value r D
9 PRIMARY_VALUE_UNIT unit rw S
10 SECONDARY_VALUE_1 value r D
11 SECONDARY_VALUE_2 value r D
12 SENSOR_MEAS_TYPE u8 rw S
13 INPUT_RANGE u8 rw S
14 LIN_TYPE u8 rw S
19 BIAS_1 f32 rw S
20 BIAS_2 f32 rw S
21 UPPER_SENSOR_LIMIT f32 r N
22 LOWER_SENSOR_LIMIT f32 r N
24 INPUT_FAULT_GEN u8 r D
25 INPUT_FAULT_1 u8 r D
26 INPUT_FAULT_2 u8 r D
27 SENSOR_WIRE_CHECK_1 u8 rw S
28 SENSOR_WIRE_CHECK_2 u8 rw S
29 MAX_SENSOR_VALUE_1 f32 rw N
30 MIN_SENSOR_VALUE_1 f32 rw N
31 MAX_SENSOR_VALUE_2 f32 rw N
32 MIN_SENSOR_VALUE_2 f32 rw N
33 RJ_TEMP f32 r D
34 RJ_TYPE u8 rw S
35 EXTERNAL_RJ_VALUE f32 rw S
36 SENSOR_CONNECTION u8 rw S
37 COMP_WIRE1 f32 rw S
38 COMP_WIRE2 f32 rw S
39 EMISSIVITY f32 rw S
40 PEAK_TRACK u8 rw S
41 DECAY_RATE f32 rw S
42 PEAK_TIME f32 rw S
43 TRACK_HOLD u8 rw S
44 SPECT_FILT_SET u8 rw S
45 TAB_ENTRY u8 rw D
46 TAB_X_Y_VALUE point rw D
47 TAB_MIN_NUMBER u8 r N
48 TAB_MAX_NUMBER u8 r N
49 TAB_OP_CODE u8 rw D
50 TAB_STATUS u8 r D
51 TAB_ACTUAL_NUMBER u8 r N
"""
_LEVEL: Final = """
8 PRIMARY_VALUE value r D
9 PRIMARY_VALUE_UNIT unit rw S
10 LEVEL f32 r D
11 LEVEL_UNIT unit rw S
12 SENSOR_VALUE f32 r D
13 SENSOR_UNIT unit rw S
14 SECONDARY_VALUE_1 value r D
15 SECONDARY_VALUE_1_UNIT unit rw S
16 SECONDARY_VALUE_2 value r D
17 SECONDARY_VALUE_2_UNIT unit rw S
18 SENSOR_OFFSET f32 rw S
19 CAL_TYPE u8 rw S
20 CAL_POINT_LO f32 rw S
21 CAL_POINT_HI f32 rw S
22 LEVEL_LO f32 rw S
23 LEVEL_HI f32 rw S
24 LEVEL_OFFSET f32 rw S
25 LIN_TYPE u8 rw S
26 LIN_DIAMETER f32 rw S
27 LIN_VOLUME f32 rw S
28 SENSOR_HIGH_LIMIT f32 r N
29 SENSOR_LOW_LIMIT f32 r N
30 MAX_SENSOR_VALUE f32 rw N
31 MIN_SENSOR_VALUE f32 rw N
32 TEMPERATURE f32 r D
33 TEMPERATURE_UNIT unit rw S
34 MAX_TEMPERATURE f32 rw N
35 MIN_TEMPERATURE f32 rw N
36 TAB_ENTRY u8 rw D
37 TAB_X_Y_VALUE point rw D
38 TAB_MIN_NUMBER u8 r N
39 TAB_MAX_NUMBER u8 r N
40 TAB_OP_CODE u8 rw D
41 TAB_STATUS u8 r D
42 TAB_ACTUAL_NUMBER u8 r N
"""
_FLOW: Final = """
8 CALIBR_FACTOR f32 rw S
9 LOW_FLOW_CUTOFF f32 rw S
10 MEASUREMENT_MODE u8 rw S
11 FLOW_DIRECTION u8 rw S
12 ZERO_POINT f32 rw S
13 ZERO_POINT_ADJUST u8 rw N
14 ZERO_POINT_UNIT unit rw S
15 NOMINAL_SIZE f32 rw S
16 NOMINAL_SIZE_UNITS unit rw S
17 VOLUME_FLOW value r D
18 VOLUME_FLOW_UNITS unit rw S
19 VOLUME_FLOW_LO_LIMIT f32 r N
20 VOLUME_FLOW_HI_LIMIT f32 r N
21 MASS_FLOW value r D
22 MASS_FLOW_UNITS unit rw S
23 MASS_FLOW_LO_LIMIT f32 r N
24 MASS_FLOW_HI_LIMIT f32 r N
25 DENSITY value r D
26 DENSITY_UNITS unit rw S
27 DENSITY_LO_LIMIT f32 r N
28 DENSITY_HI_LIMIT f32 r N
29 TEMPERATURE value r D
30 TEMPERATURE_UNITS unit rw S
31 TEMPERATURE_LO_LIMIT f32 r N
32 TEMPERATURE_HI_LIMIT f32 r N
33 VORTEX_FREQ value r D
34 VORTEX_FREQ_UNITS unit rw S
35 VORTEX_FREQ_LO_LIMIT f32 r N
36 VORTEX_FREQ_HI_LIMIT f32 r N
37 SOUND_VELOCITY value r D
38 SOUND_VELOCITY_UNITS unit rw S
39 SOUND_VELOCITY_LO_LIMIT f32 r N
40 SOUND_VELOCITY_HI_LIMIT f32 r N
41 SAMPLING_FREQ value r D
42 SAMPLING_FREQ_UNITS unit rw S
"""
_ACTUATOR: Final = """
9 ACT_STROKE_TIME_DEC f32 r N
10 ACT_STROKE_TIME_INC f32 r N
17 TAB_ENTRY u8 rw D
18 TAB_X_Y_VALUE point rw D
19 TAB_MIN_NUMBER u8 r N
20 TAB_MAX_NUMBER u8 r N
21 TAB_ACTUAL_NUMBER u8 r N
22 DEADBAND f32 rw S
23 DEVICE_CALIB_DATE octets8 rw S
24 DEVICE_CONFIG_DATE octets8 rw S
25 LIN_TYPE u8 rw S
32 RATED_TRAVEL value r N
33 SELF_CALIB_CMD u8 w N
34 SELF_CALIB_STATUS u8 r N
38 SETP_CUTOFF_DEC f32 rw S
39 SETP_CUTOFF_INC f32 rw S
45 TOTAL_VALVE_TRAVEL f32 rw N
46 TOTAL_VALVE_TRAVEL_LIMIT f32 rw S
47 TRAVEL_LIMIT_LOW value rw S
48 TRAVEL_LIMIT_UP value rw S
49 TRAVEL_RATE_DEC f32 rw S
50 TRAVEL_RATE_INC f32 rw S
60 ACTUATOR_MAN text16 rw S
62 ACTUATOR_TYPE u8 r N
63 ACTUATOR_ACTION u8 rw S
65 ACTUATOR_SER_NUM text16 rw S
66 ADD_GEAR_SER_NUM text16 rw S
68 ADD_GEAR_ID text16 rw S
"""

_FB_PARENTS: Final = {
    1: "input",
    2: "output",
    3: "control",
    4: "advanced control",
    5: "calculation",
    6: "auxiliary",
    7: "alert",
}
_FB_CLASSES: Final = {
    (1, 1): ("AI", "analogue input", _AI),
    (1, 2): ("DI", "discrete input", _DI),
    (2, 1): ("AO", "analogue output", _AO),
    (2, 2): ("DO", "discrete output", _DO),
    (3, 1): ("PID", "PID controller", ""),
    (3, 2): ("FB", "sample selector", ""),
    (5, 8): ("TOT", "totaliser", _TOTALISER),
    (6, 1): ("FB", "ramp", ""),
    (6, 2): ("FB", "logbook", ""),
    (6, 3): ("FB", "sample", ""),
}
_TB_PARENTS: Final = {
    1: ("pressure", _PRESSURE),
    2: ("temperature", _TEMPERATURE),
    3: ("flow", _FLOW),
    4: ("level", _LEVEL),
    5: ("actuator", _ACTUATOR),
    6: ("discrete I/O", ""),
    7: ("analyser", ""),
    8: ("auxiliary", ""),
    9: ("alarm", ""),
}
_TB_CLASSES: Final = {
    1: "differential, absolute, gauge, pressure + level + flow, pressure + level, pressure + flow, mixed",
    2: "thermocouple, resistance thermometer, pyrometer",
    3: "electromagnetic, vortex, Coriolis, thermal mass, ultrasonic, variable area, differential pressure",
    4: "hydrostatic, echo, radiometric, capacitive",
    5: "electric, electro-pneumatic, electro-hydraulic",
    6: "sensor input, actuator",
}
_TEMPERATURE_CLASSES: Final = {
    16: "thermocouple + voltage",
    17: "resistance thermometer + resistance",
    18: "all sensors",
}
_PB_PARENTS: Final = {
    1: "transmitter",
    2: "actuator",
    3: "discrete I/O",
    4: "controller",
    5: "analyser",
    6: "laboratory device",
    127: "multivariable device",
}


#: a class that the device does not say
_NOT_USED: Final = 250


class Parameter(NamedTuple):
    """One parameter of a class of blocks."""

    #: relative index: the index of the block object plus this is the parameter's index
    relative: int
    #: name of the profile in small letters
    name: str
    #: data type, see :func:`~dpstack.pa.datatypes.datatype`
    kind: str
    #: ``r``, ``rw``, ``w``, or ``rm``: written in the modes MAN and O/S only
    access: str
    #: ``S`` static (a write counts ST_REV up), ``N`` kept without supply, ``D`` dynamic, ``C`` constant
    storage: str


class BlockClass(NamedTuple):
    """A class of blocks. ``short``: the prefix of its blocks' names; ``words``: for people."""

    short: str
    words: str
    parameters: Mapping[str, Parameter]


class BlockObject(NamedTuple):
    """The block object (DS-32) at relative index 0 of each block."""

    object: int
    parent_class: int
    block_class: int
    profile: int
    profile_revision: int
    parameters: int
    #: slot (high octet) and index of view 1; 0: none
    view_1: int
    views: int

    @classmethod
    def parse(cls, octets: bytes) -> BlockObject:
        """Raises :class:`~dpstack.errors.PduError` for another length than 20 octets."""
        fields = parse_value("block", octets)
        assert isinstance(fields, Mapping)
        names = ("object", "parent_class", "class", "profile", "profile_revision", "parameters", "view_1", "views")
        return cls(*(int(fields[name]) for name in names))

    @property
    def is_block(self) -> bool:
        """Whether octet 1 names a physical, function or transducer block."""
        return self.object in PREFIX

    @property
    def revision(self) -> str:
        """The profile's revision, for instance ``3.02``."""
        return f"{self.profile_revision >> 8}.{self.profile_revision & 0xFF:02}"

    @property
    def block_class_of(self) -> BlockClass:
        """The class with its parameters; a maker's class has the standard parameters alone."""
        return block_class(self.object, self.parent_class, self.block_class)


@functools.cache
def parameters_of(table: str) -> Mapping[str, Parameter]:
    """The parameters of a table above, by name."""
    rows = (line.split() for line in table.splitlines() if line)
    return {name.lower(): Parameter(int(at), name.lower(), *rest) for at, name, *rest in rows}


def _parameters(table: str) -> Mapping[str, Parameter]:
    return parameters_of(_STANDARD + table)


@functools.cache
def block_class(kind: int, parent: int, number: int) -> BlockClass:
    """The class of blocks of octets 1 to 3 of a block object.

    Raises :class:`~dpstack.errors.PduError` if the first is neither physical, function nor transducer block.
    """
    if kind == PHYSICAL:
        words = _words("physical block", _PB_PARENTS.get(parent, _class(parent)))
        return BlockClass("PB", words, _parameters(_PHYSICAL))
    if kind == FUNCTION:
        return _function_class(parent, number)
    if kind == TRANSDUCER:
        name, table = _TB_PARENTS.get(parent, (_class(parent), ""))
        words = _words("transducer block", name, _transducer_words(parent, number))
        return BlockClass("TB", words, _parameters(table))
    raise PduError(f"no block object: octet 1 is {kind}, not 1 (physical), 2 (function) or 3 (transducer block)")


def _function_class(parent: int, number: int) -> BlockClass:
    if known := _FB_CLASSES.get((parent, number)):
        short, words, table = known
        return BlockClass(short, f"function block, {words}", _parameters(_BATCH + table))
    words = _words("function block", _FB_PARENTS.get(parent, _class(parent)), _class(number))
    return BlockClass("FB", words, _parameters(_BATCH))


def _transducer_words(parent: int, number: int) -> str:
    if parent == 2 and number in _TEMPERATURE_CLASSES:
        return _TEMPERATURE_CLASSES[number]
    names = _TB_CLASSES.get(parent, "").split(", ")
    return names[number - 1] if 0 < number <= len(names) and names[0] else _class(number)


def _words(*parts: str) -> str:
    return ", ".join(part for part in parts if part)


def _class(number: int) -> str:
    if number == _NOT_USED:
        return ""
    return f"maker's class {number}" if number >= 128 else f"class {number}"
