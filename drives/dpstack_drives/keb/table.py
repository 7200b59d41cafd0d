"""Facts of the F5 that plugin and simulated drive share: parameters, error texts, names of bits
(docs/reference/drives/keb-f5.md).

Source: KEB, COMBICOM F5-Profibus (slides of a training course); the names in the comments are its headings. The bits
of sy.50 and sy.51, the unit of sy.52 and most addresses are in the inverter's application manual, which we do not
have. What is made up here for the simulated drive is marked so and never used towards a real drive by itself.
"""

from __future__ import annotations

import re
from functools import partial
from typing import Final, NamedTuple

from dpstack.profile import ParamSpec, ParamTable, ParamType, Use
from dpstack_drives.codes import placed

#: a guess from the name of the GSD file, keb305EB.gsd
IDENT: Final = 0x05EB

#: GSD-File
MAX_TSDR: Final = {
    9_600: 60,
    19_200: 60,
    93_750: 60,
    187_500: 60,
    500_000: 100,
    1_500_000: 150,
    3_000_000: 250,
    6_000_000: 450,
    12_000_000: 800,
}

#: Application Parameters: 2000h + the address of the application manual
INVERTER: Final = range(0x2000, 0x5F00)
INTERFACE: Final = range(0x5F00, 0x6000)
SETS: Final = 8

CONTROL_WORD, STATUS_WORD, SET_SPEED, ACTUAL_SPEED = 0x2032, 0x2033, 0x2034, 0x2035
#: sy.43, sy.44; sy.50 and sy.51 are their low halves
CONTROL_LONG, STATUS_LONG = 0x202B, 0x202C
#: the parameters that the manual itself maps as words
WORDS: Final = frozenset({CONTROL_WORD, STATUS_WORD, SET_SPEED, ACTUAL_SPEED})
INVERTER_STATE: Final = 0x2200
#: Saving of the F5 PB-Operator Configuration: the map as the inverter has it, sy.16 to sy.31 and sy.58 to sy.73. Of
#: each block and direction the first definition (an address without 2000h, -1 off); its sets and the next ones follow
ACTIVE_INPUTS, ACTIVE_OUTPUTS = (0x2010, 0x203A), (0x2018, 0x2042)
#: values of a block, each a definition and its sets
BLOCK_VALUES: Final = 4
#: a definition of nothing, as 16 bits
OFF: Final = 0xFFFF
#: Changing the PD-Assignment: the records of the map, and their enables
MAP_INPUTS, MAP_OUTPUTS = 0x6000, 0x6001
ENABLE_INPUTS, ENABLE_OUTPUTS = 0x5FF8, 0x6002
ENABLED: Final = 0xFF
RECORDS: Final = {
    MAP_INPUTS: "process data map of the inputs",
    MAP_OUTPUTS: "process data map of the outputs",
    ENABLE_INPUTS: "enable of the inputs",
    ENABLE_OUTPUTS: "enable of the outputs",
}
#: the manual's two readings: when a new map acts
AT_POWER_ON, WITH_ENABLE = "power-on", "enable"

#: groups whose address the manual shows
GROUPS: Final = {"sy": 0x20, "ru": 0x22, "oP": 0x23, "LE": 0x2D, "cS": 0x2F}
#: made up (by their place in the order of groups): the simulated drive has them there
GROUPS_MADE_UP: Final = {"Pn": 0x24, "ud": 0x28, "Fr": 0x29, "di": 0x2B, "Fb": 0x5F}
_NAME: Final = re.compile(r"([A-Za-z]{2})[. ]?(\d{1,3})")


def index_of(name: str) -> int | None:
    """The index of a parameter such as ``oP.3`` (or ``op03``) of a group whose address the manual shows, else None."""
    return _index(name, GROUPS)


def _index(name: str, groups: dict[str, int]) -> int | None:
    match = _NAME.fullmatch(name.strip())
    if match is None or int(match[2]) > 0xFF:
        return None
    group = next((high for text, high in groups.items() if text.lower() == match[1].lower()), None)
    return None if group is None else group << 8 | int(match[2])


def why_not_read(spec: ParamSpec) -> str | None:
    """Why a parameter of the table cannot be read by its name; None if it can."""
    if index_of(spec.name) is not None:
        return None
    return "the address of its group is not in the manual: read it by its index (0x2000 + the address)"


def looks_like_name(name: str) -> bool:
    """A group and a number, known or not."""
    return _NAME.fullmatch(name.strip()) is not None


def name_of(index: int) -> str:
    """``oP.3 (2303h)`` if the group is known."""
    group = next((text for text, high in GROUPS.items() if high == index >> 8), None)
    return f"{index:04X}h" if group is None else f"{group}.{index & 0xFF:02} ({index:04X}h)"


class Code(NamedTuple):
    """An error of the parameter channel: class, code, additional code."""

    kind: int
    code: int
    more: int

    @classmethod
    def of(cls, number: int) -> Code:
        """From :attr:`number`."""
        return cls(number >> 24, number >> 16 & 0xFF, number & 0xFFFF)

    def __str__(self) -> str:
        return f"{self.kind}/{self.code}/{self.more:04X}"

    @property
    def number(self) -> int:
        """The four octets EB5 to EB8 as one number."""
        return self.kind << 24 | self.code << 16 | self.more


READ_AND_WRITE: Final = Code(5, 4, 0)
NO_INVERTER: Final = Code(6, 2, 0)
WRITE_PROTECTED: Final = Code(6, 3, 0)
PASSWORD: Final = Code(6, 3, 0x30)
BAD_INDEX: Final = Code(6, 4, 0)
BAD_MAP: Final = Code(6, 5, 0)
BAD_SUBINDEX: Final = Code(6, 5, 0x11)
BUSY: Final = Code(8, 0, 0x22)
BAD_VALUE: Final = Code(8, 0, 0x30)
BAD_SET: Final = Code(8, 0, 0x33)
NOT_POSSIBLE: Final = Code(8, 0, 0x34)

#: Error messages of the parameterizing channel
ERRORS: Final = {
    READ_AND_WRITE: "read and write asked for at once",
    NO_INVERTER: "the operator has no connection to the inverter",
    WRITE_PROTECTED: "the parameter is write protected",
    PASSWORD: "not accessible with the present password (ud.01)",
    BAD_INDEX: "there is no such parameter (index)",
    BAD_MAP: "invalid process data description",
    BAD_SUBINDEX: "invalid subindex",
    BUSY: "the inverter is busy",
    BAD_VALUE: "the value is outside its range",
    BAD_SET: "there is no such parameter set",
    NOT_POSSIBLE: "the operation is not possible",
}

#: the section that says what makes the inverter obey sy.50 and sy.52
BASIC: Final = "Basic Adjustments"
#: its parameters in their order: value, and what the value is
RECIPE_STEPS: Final = {
    "ud.01": (440, "password"),
    "Fr.01": (-4, "copy parameter set: default values, customer and system, in all sets; so before all that follows"),
    "Fr.02": (5, "parameter set source: the control word sy.50"),
    "oP.00": (5, "reference source: the set speed sy.52"),
    "oP.01": (9, "rotation source: the control word sy.50, with an absolute set speed"),
    "di.01": (1, "select signal source: ST"),
    "di.02": (1, "digital input setting: ST"),
}
#: the same for the simulated drive
READY: Final = {name: value for name, (value, _) in RECIPE_STEPS.items()}
#: and for people
RECIPE: Final = (
    f"{', '.join(f'{name} = {value}' for name, value in READY.items())} (F5-C also ud.05 = 2; F5-B, -C and -G need the "
    "rated motor speed)"
)

#: made up: what the bits mean in the simulated drive
CONTROL_BITS: Final = "enable=0 reset=1 run=2 reverse=3 quick_stop=8"
STATUS_BITS: Final = "ready=0 fault=1 run=2 reverse=3 reached=4"
#: made up: trips of the simulated drive, as ru.00 shows them; E.buS is the manual's
TRIPS: Final = {"E.OP": 1, "E.UP": 2, "E.OC": 4, "E.OH": 8, "E.OL": 16, "E.buS": 18, "E.EF": 31}
E_BUS: Final = 18
#: made up: ru.00 without a trip
RU_OFF, RU_STANDING, RU_RAMP, RU_CONSTANT = 0, 70, 64, 66


#: in place of bits: those that are made up for the simulated drive
SIMULATED_BITS: Final = "simulated"


def bits(text: str, made_up: str, what: str) -> dict[str, int]:
    """Names of bits given as ``run=2 reverse=3``; ``simulated`` stands for ``made_up``. Raises ValueError."""
    if text.strip() == SIMULATED_BITS:
        text = made_up
    found: dict[str, int] = {}
    for word in text.replace(",", " ").split():
        name, equals, number = word.partition("=")
        if not (name.isidentifier() and equals and number.isdecimal() and int(number) <= 15):
            raise ValueError(f"{what}: {word!r} is no bit; write names with their bit 0..15, e.g. {CONTROL_BITS!r}")
        if name in found or int(number) in found.values():
            raise ValueError(f"{what}: {word!r} names a bit or a name a second time")
        found[name] = int(number)
    return found


def _place(name: str) -> tuple[int, int] | None:
    index = _index(name, {**GROUPS, **GROUPS_MADE_UP})
    return None if index is None else (index, 0)


#: 80 per Hz of oP.3 by arithmetic (docs/reference/drives/keb-f5.md#example-of-the-parameter-channel). Limits and
#: factory values are not in the manual
_row = partial(ParamSpec, 0, per_unit=1, made_up=True, by_name=True)
_ANY: Final = 0x7FFF_FFFF
#: sy.06, the station address
ADDRESS: Final = 0x2006
#: of the simulated drive; the plugin takes only the titles from it
PARAMETERS: Final = ParamTable(
    placed(
        _place,
        _row("sy.06", "PROFIBUS address", high=126, factory=126),
        _row("sy.09", "HSP5 watchdog time", high=10, per_unit=100, unit="s"),
        *(
            _row(
                f"sy.{first + 2 * n + more:02}",
                f"process {way} data {at + n} {what}",
                low,
                high,
                factory=low,
                type=kind,
                read_only=True,
                made_up=False,
                use=Use.MAP,
            )
            for first, way, at in ((16, "read", 1), (24, "write", 1), (58, "read", 5), (66, "write", 5))
            for n in range(BLOCK_VALUES)
            for more, what, low, high, kind in (
                (0, "definition", -1, 0x7FFF, ParamType.I16),
                (1, "set", 1, 0xFF, ParamType.U16),
            )
        ),
        _row("sy.43", "control word (long)", -_ANY, _ANY, type=ParamType.I32, volatile=True),
        _row("sy.44", "status word (long)", -_ANY, _ANY, type=ParamType.I32, read_only=True),
        _row("sy.50", "control word (low)", volatile=True),
        _row("sy.51", "status word (low)", read_only=True),
        _row("sy.52", "set speed value", type=ParamType.I16, volatile=True),
        _row("sy.53", "actual speed value", type=ParamType.I16, read_only=True),
        _row("ru.00", "inverter state", read_only=True),
        _row("ru.12", "actual torque display", -_ANY, _ANY, type=ParamType.I32, read_only=True),
        _row("ru.39", "OL counter display", read_only=True),
        _row("oP.00", "reference source", high=10, use=Use.SOURCE),
        _row("oP.01", "rotation source", high=10, factory=2, use=Use.SOURCE),
        _row("oP.03", "digital setpoint setting", -400, 400, type=ParamType.I16, per_unit=80, unit="Hz", per_set=True),
        _row("oP.10", "max reference forward", 0, 400, 70, per_unit=80, unit="Hz", per_set=True),
        _row("oP.28", "acceleration time", 0, 300, 1, per_unit=100, unit="s", per_set=True),
        _row("oP.30", "deceleration time", 0, 300, 1, per_unit=100, unit="s", per_set=True),
        _row("oP.59", "motorpoti ramp time", 0, 50_000, 66, type=ParamType.U32, per_set=True),
        _row("LE.00", "switching level", -30_000, 30_000, type=ParamType.I32, per_set=True),
        _row("cS.19", "abs. torque reference", -32_000, 32_000, type=ParamType.I32, per_set=True),
        # at indexes that are made up
        _row("Pn.05", "E.buS stopping mode", high=6, factory=6),
        _row("Pn.06", "watchdog time", high=40, per_unit=100, unit="s"),
        _row("ud.01", "password", -32_767, 32_767, type=ParamType.I16),
        _row("ud.05", "auto store", high=2, factory=2),
        _row("Fr.01", "copy parameter set", -9, 7, type=ParamType.I16),
        _row("Fr.02", "parameter set source", high=5),
        _row("di.01", "select signal source", high=4095),
        _row("di.02", "digital input setting", high=4095),
        _row("Fb.09", "PD_In_Cycle", high=10_000, factory=25, unit="ms", made_up=False),
        _row("Fb.23", "Take Stored PD-Map", high=ENABLED, factory=ENABLED, made_up=False),
        _row("Fb.37", "Master_PDIN_Len", read_only=True),
        _row("Fb.38", "Master_PDOUT_Len", read_only=True),
        _row("Fb.39", "watchdog activation", high=3, made_up=False),
        _row("Fb.40", "watchdog inhibit", high=7, factory=7, made_up=False),
        *(
            ParamSpec(index, f"{index:04X}h", title, use=Use.MAP, by_name=True, made_up=True)
            for index, title in RECORDS.items()
        ),
    )
)
#: counts per unit that the manual shows (oP.3: 0640h is 20 Hz); everything else goes as the integer on the wire
SCALES: Final = {0x2303: (80, "Hz")}


#: made up: record and enable of block 2 in the simulated drive (docs/reference/drives/keb-f5.md#second-block)
BLOCK2_INPUTS, BLOCK2_OUTPUTS = "5FE0 5FE1", "5FE2 5FE3"


def record_and_enable(text: str) -> tuple[int, int] | None:
    """Two indexes in hex, of block 2's record and enable; None if there is no text. Raises ValueError."""
    words = text.split()
    if not words:
        return None
    try:
        record, enable = (int(word, 16) for word in words)
    except ValueError:
        raise ValueError(
            f"block 2: {text!r} is not two indexes in hex (record, enable), e.g. {BLOCK2_INPUTS!r}"
        ) from None
    return record, enable
