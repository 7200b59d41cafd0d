"""The S100's description for the commissioning sheet: the facts of its manual over the tables of the plugin."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from msgspec import structs

from dpstack.profile import (
    OTHER_MANUAL,
    DescribedLed,
    DescribedMessage,
    DescribedRange,
    DescribedStep,
    DeviceDescription,
    Options,
    described_word,
    messages,
    places,
    speed_range,
    states_of,
)
from dpstack_drives.ls import table as t
from dpstack_drives.ls import telegrams
from dpstack_drives.ls.plugin import LsCore, profile_of

_MANUAL: Final = "LS ELECTRIC, LSLV-S100 Profibus-DP Module, user's manual V1.40"
_LEDS: Final = "3.2, table 7"
_CONNECTION: Final = "check the connection between module and inverter, and whether the inverter has tripped"
_OFFLINE: Final = (
    "start the master; check cable, connector, termination, the length of the segment and the number of its stations "
    "(at most 32); the station address is that of COM-07, and no other station has it"
)
LEDS: Final = (
    DescribedLed(
        name="CPU",
        shows="off",
        meaning="no power",
        remedy=f"check the power supply of the inverter; {_CONNECTION}",
        source=_LEDS,
    ),
    DescribedLed(name="CPU", shows="flashes every second", meaning="normal", source=_LEDS),
    DescribedLed(name="ERROR", shows="off", meaning="normal", source=_LEDS),
    DescribedLed(
        name="ERROR",
        shows="flashes every second, together with CPU",
        meaning="no communication between module and inverter",
        remedy=_CONNECTION,
        source=_LEDS,
    ),
    DescribedLed(
        name="ERROR",
        shows="flashes every second (CPU LED)",
        meaning="the master's configuration is not that of the module",
        remedy="compare the configuration at the master with that in the inverter (the number of status and control "
        "words: COM-30, COM-50)",
        source=_LEDS,
    ),
    DescribedLed(
        name="ERROR",
        shows="single flash: 0.2 s on, 0.8 s off",
        meaning="EEPROM error after power-on",
        remedy="ask the maker's service",
        source=_LEDS,
    ),
    DescribedLed(
        name="ERROR",
        shows="double flash: 0.2 s on, 0.2 s off, 0.2 s on, 0.4 s off",
        meaning="lost command: the connection with the master failed",
        remedy=f"as for ONLINE off: {_OFFLINE}",
        source=_LEDS,
    ),
    DescribedLed(
        name="ERROR",
        shows="on",
        meaning="fault of the inverter",
        remedy="check the fault history of the inverter",
        source=_LEDS,
    ),
    DescribedLed(name="ONLINE", shows="off", meaning="offline", remedy=_OFFLINE, source=_LEDS),
    DescribedLed(name="ONLINE", shows="on", meaning="online", source=_LEDS),
)
#: what the manual says about a trip beside its name
_REMEDIES: Final = {t.LOST_COMMAND: _OFFLINE}


def describe(core: LsCore, basic: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``."""
    kind = profile_of(core.telegram, str(options["profile"]))
    own = kind == t.IO
    control, status = ("0006 operation command", "000E operating status") if own else ("control word", "status word")
    front_out, front_in = ((), ()) if own else (("control word", "set point"), ("status word", "actual speed"))
    table = core.table
    section = {t.IO: OTHER_MANUAL, t.PROFIDRIVE: "5.1.1, 5.1.2", t.LS_DRIVE: "5.3.1, 5.3.2"}[kind]
    node, *settings = basic.steps
    return structs.replace(
        basic,
        manual=_MANUAL,
        steps=(structs.replace(node, source="4.2.2"), *settings, *_steps(core)),
        outputs=places(core.telegram, outputs=True, names=(*front_out, *_names(core, "COM", 51, outputs=True))),
        inputs=places(core.telegram, outputs=False, names=(*front_in, *_names(core, "COM", 31, outputs=False))),
        words=(
            structs.replace(described_word(table.control), name=f"{table.control.name}, {control} ({section})"),
            structs.replace(
                described_word(table.status, states_of(table)), name=f"{table.status.name}, {status} ({section})"
            ),
        ),
        ranges=(_range(core, kind, rpm=options["speed_unit"] == "rpm"),),
        faults=tuple(
            DescribedMessage(code=str(number), text=text, remedy=_REMEDIES.get(number, ""), source="7.2")
            for number, text in t.TRIPS.items()
        ),
        warnings=(
            DescribedMessage(
                code="PNU 953 (0334h)", text="warning word; its bits are in the inverter's manual", source="7.1"
            ),
        ),
        acknowledge="a rising edge of the bit acknowledge of the control word (7.2)",
        errors=messages(t.PKW.errors, "{:02X}h", "6.2.1"),
        leds=LEDS,
    )


def _names(core: LsCore, group: str, first: int, *, outputs: bool) -> Iterator[str]:
    own = core.outputs_map if outputs else core.inputs_map
    for place, one in enumerate(own.fields):
        spec = None if one is None else t.spec_at(one.key)
        title = "" if spec is None else f", {spec.title}"
        yield f"{group}-{first + place}: {'not used' if one is None else f'{one.name}{title}'}"


def _range(core: LsCore, kind: int, *, rpm: bool) -> DescribedRange:
    if kind != t.PROFIDRIVE:
        return DescribedRange(
            name="frequencies",
            range="0..655.35 Hz, the direction is in the control and status word",
            wire="0.01 Hz a count",
            source="5.3.3" if kind == t.LS_DRIVE else OTHER_MANUAL,
        )
    if rpm:
        return DescribedRange(
            name="set point, actual speed", range="-32768..32767 rpm", wire="1 rpm a count, signed", source="4.2.14"
        )
    return speed_range(core, "5.1.3", "dr-20, the maximum frequency; set points end there")


def _steps(core: LsCore) -> Iterator[DescribedStep]:
    number = telegrams.number_of(core.telegram)
    yield DescribedStep(
        what=f"telegram {number}: nothing to set",
        why="the module takes the telegram from the master; COM-10 shows it"
        if number != telegrams.VENDOR
        else "the module takes the telegram and the numbers of words COM-50 and COM-30 from the master",
        delivered="1",
        source="4.2.10",
    )
    yield DescribedStep(
        what="COM-94 = 1 after all others",
        why="what was written to the COM codes acts from then on",
        delivered="0",
        source="4.2.8",
    )
    yield DescribedStep(
        what="PRT-12: 0 none, 1 coast, 2 ramp, 3 hold input, 4 hold output, 5 preset; PRT-13 = time",
        why="they decide what the inverter does when the master stops (lost command)",
        source=OTHER_MANUAL,
    )
