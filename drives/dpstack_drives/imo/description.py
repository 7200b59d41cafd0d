"""The HD2's description for the commissioning sheet: the facts of its manual over the tables of the plugin."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from msgspec import structs

from dpstack.profile import (
    OTHER_MANUAL,
    READING,
    DescribedCode,
    DescribedMessage,
    DescribedRange,
    DescribedStep,
    DeviceDescription,
    Options,
    described_word,
    messages,
    places,
)
from dpstack_drives.imo import table as t
from dpstack_drives.imo.plugin import ImoCore
from dpstack_drives.imo.pzd import Function, PzdMap

_MANUAL: Final = "IMO, HD2 PROFIBUS Communication Card, instruction manual"
_COMMANDS: Final = {
    t.Command.NONE: "no command (a reading)",
    t.Command.FORWARD: "run forward",
    t.Command.REVERSE: "run reverse",
    t.Command.INCH_FORWARD: "inch forward",
    t.Command.INCH_REVERSE: "inch reverse",
    t.Command.STOP: "decelerate to a stop",
    t.Command.COAST: "coast to a stop (emergency stop)",
    t.Command.RESET: "fault reset",
    t.Command.INCH_STOP: "stop inching",
    t.Command.PRE_EXCITE: "pre-excitation",
}
_RUNNING: Final = {
    t.Running.FORWARD: "runs forward",
    t.Running.REVERSE: "runs reverse",
    t.Running.STOPPED: "stopped",
    t.Running.FAULT: "fault",
    t.Running.POFF: "POFF",
    t.Running.PRE_EXCITED: "pre-excitation",
}


def describe(core: ImoCore, basic: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``. Its maps are those of the options, which ``write_map`` writes: the drive's own are read
    over the bus."""
    inputs, outputs = core.present_maps()
    node, *settings = basic.steps
    return structs.replace(
        basic,
        manual=_MANUAL,
        steps=(
            structs.replace(node, source="2.5, 3. Node address"),
            *settings,
            *_steps(int(options["baud_index"]), inputs, outputs),
        ),
        outputs=places(core.telegram, outputs=True, names=("CW (control word)", *_names(outputs))),
        inputs=places(core.telegram, outputs=False, names=("SW (status word)", *_names(inputs))),
        words=(
            described_word(t.CONTROL, _codes(_COMMANDS)),
            described_word(
                t.STATUS,
                (
                    *_codes(_RUNNING),
                    *(DescribedCode(f"bits 13-14 = {int(one)}", f"source: {one.name.lower()}") for one in t.Source),
                ),
            ),
        ),
        ranges=tuple(_range(one, way) for way, own in (("out", outputs), ("in", inputs)) for one in own.fields if one),
        faults=tuple(
            DescribedMessage(code=str(code), text=name, source="the option fault_names")
            for code, name in t.faults(str(options["fault_names"])).items()
        ),
        warnings=(DescribedMessage(code="SW bit 12", text="overload pre-alarm", source="table 2-7"),),
        acknowledge="CW bits 0-7 = 7 (table 2-5)",
        errors=messages(t.ERRORS, "{}", "table 2-11"),
        missing={
            "leds": "this manual describes no LEDs of the card",
            "faults": "the fault codes are in the inverter's manual: give their names by the option fault_names",
        },
    )


def _codes(names: dict[t.Command, str] | dict[t.Running, str]) -> tuple[DescribedCode, ...]:
    return tuple(DescribedCode(f"bits 0-7 = {int(number)}", name) for number, name in names.items())


def _names(own: PzdMap) -> Iterator[str]:
    for number, function in enumerate(own.fields, t.FIRST_PZD):
        yield f"PZD{number} ({'not used' if function is None else function.name})"


def _range(one: Function, way: str) -> DescribedRange:
    unit = f" {one.unit}" if one.unit else ""
    step = f"{1 / one.per_unit:g}{unit} a count"
    return DescribedRange(
        name=f"{one.name} ({way})",
        range=f"{one.low:g}..{one.high:g}{unit}",
        wire=f"{step}{', signed' if one.low < 0 else ''}",
        source="table 2-6" if way == "out" else "table 2-8",
    )


def _steps(rate: int, inputs: PzdMap, outputs: PzdMap) -> Iterator[DescribedStep]:
    yield DescribedStep(
        what=f"baud rate of the card = {rate} (by its number)",
        why=f"the card hears only the rate it is set to: {t.RATE_SETTING.rates[rate]} bit/s",
        delivered=f"{t.RATE_FACTORY} (1.5 Mbit/s)",
        source="table 2-4",
    )
    for what, codes, own in (("written", t.RECEIVED, outputs), ("read", t.TRANSMITTED, inputs)):
        for number, function in zip(codes, own.fields, strict=True):
            if function is not None:
                yield DescribedStep(
                    what=f"{t.name_of(number)} = {function.number} ({function.name})",
                    why=f"the word that is {what} for {function.name}; the plugin reads the map from the drive, "
                    "`write_map` writes this one",
                    delivered="0",
                    source="table 2-6" if what == "written" else "table 2-8",
                )
    yield DescribedStep(
        what="run command channel of the inverter = communication",
        why="with keypad or terminals the drive ignores CW",
        source=OTHER_MANUAL,
    )
    yield DescribedStep(
        what="reaction to a lost master in the inverter",
        why="the card's manual does not say what the drive does then: reckon with one that runs on",
        source=READING,
    )
