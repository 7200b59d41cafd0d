"""The F5's description for the commissioning sheet: the facts of its PROFIBUS manual over the tables of the plugin."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from msgspec import structs

from dpstack.profile import (
    MADE_UP,
    DescribedCode,
    DescribedMessage,
    DescribedRange,
    DescribedStep,
    DescribedWord,
    DeviceDescription,
    Options,
    Word,
    described_word,
    places,
    speed_range,
    states_of,
)
from dpstack_drives.keb import table as t
from dpstack_drives.keb.pdmap import PdMap
from dpstack_drives.keb.plugin import KebCore

_MANUAL: Final = "KEB, COMBICOM F5-Profibus"
_SUPERVISION: Final = "Communication Supervision"
#: what has to be done about errors of the parameter channel, as far as the table says it
_REMEDIES: Final = {t.PASSWORD: "write ud.01 = 440", t.BUSY: "repeat the request"}


def describe(core: KebCore, basic: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``. Names of bits are those of the options: they are in the inverter's application manual."""
    made_up = str(options["status_bits"]).strip() == t.SIMULATED_BITS
    source = MADE_UP if made_up else "by option"
    table = core.table
    unnamed = "no names yet: give the options control_bits and status_bits, from the inverter's application manual"
    trips = t.TRIPS if made_up else {"E.buS": t.E_BUS}
    rpm = float(options["rpm_per_count"])
    node, *settings = basic.steps
    return structs.replace(
        basic,
        manual=_MANUAL,
        steps=(*_recipe(basic), structs.replace(node, source=t.BASIC), *settings, *_others()),
        outputs=places(core.telegram, outputs=True, names=_names(core.outputs_map)),
        inputs=places(core.telegram, outputs=False, names=_names(core.inputs_map)),
        words=tuple(
            structs.replace(described_word(word, states_of(table) if word is table.status else ()), name=name)
            if word.bits
            else DescribedWord(name=name, codes=(DescribedCode("bits", unnamed),))
            for word, name in _words(table.control, table.status, source)
        ),
        ranges=(speed_range(core, "the option rpm_per_count", f"{rpm:g} rpm a count of sy.52 and sy.53"),)
        if rpm
        else (
            DescribedRange(
                name="sy.52 set speed, sy.53 actual speed",
                range="",
                wire="the unit is in the inverter's application manual: give the option rpm_per_count",
                source="the application manual",
            ),
        ),
        faults=tuple(
            DescribedMessage(
                code=name if name == "E.buS" and not made_up else f"{name} (ru.00 = {number})",
                text="watchdog error: no activity on PROFIBUS" if name == "E.buS" else "",
                remedy="Pn.06 is the time, Pn.05 the reaction; Fb.39 and Fb.40 say what the watchdog watches"
                if name == "E.buS"
                else "",
                source=_SUPERVISION if name == "E.buS" else MADE_UP,
            )
            for name, number in trips.items()
        ),
        acknowledge="by the bit reset of the option control_bits, or at the inverter (its application manual)",
        errors=tuple(
            DescribedMessage(
                code=str(code),
                text=text,
                remedy=_REMEDIES.get(code, ""),
                source="Error messages of the parameterizing channel",
            )
            for code, text in t.ERRORS.items()
        ),
        missing={
            "leds": "this manual describes no LEDs of the operator",
            "warnings": "this manual has no warnings; the texts of ru.00 are in the inverter's application manual",
        },
    )


def _words(control: Word, status: Word, source: str) -> Iterator[tuple[Word, str]]:
    yield control, f"sy.50 (control word), bits {source}"
    yield status, f"sy.51 (status word), bits {source}"


def _names(own: PdMap) -> Iterator[tuple[str, int]]:
    for entry in own.fields:
        yield entry.name, entry.octets


def _recipe(basic: DeviceDescription) -> Iterator[DescribedStep]:
    compared = {step.what for step in basic.steps}
    for name, (value, meaning) in t.RECIPE_STEPS.items():
        if (what := f"{name} = {value}") not in compared:
            yield DescribedStep(what=what, why=meaning, source=t.BASIC)
    yield DescribedStep(
        what="F5-C only: ud.05 = 2", why="auto store: OFF, so that values of the bus are never stored", source=t.BASIC
    )
    yield DescribedStep(
        what="F5-B, F5-C, F5-G: the rated motor speed in the motor data",
        why="sy.52 is a speed and no frequency",
        source=t.BASIC,
    )


def _others() -> Iterator[DescribedStep]:
    yield DescribedStep(
        what="Pn.06 = time, other than 0",
        why="with 0 no watchdog error acts: the inverter goes on when the master stops",
        delivered="0 (off)",
        source=_SUPERVISION,
    )
    yield DescribedStep(
        what="Pn.05 = the reaction to a watchdog error",
        why="as delivered (6) it is only a warning by a digital output",
        delivered="6",
        source=_SUPERVISION,
    )
    yield DescribedStep(
        what="Fb.39: 0 at once, bit 0 after the first output data, bit 1 after the first parameter request",
        why="it says when the watchdog of the operator becomes active",
        delivered="0",
        source=_SUPERVISION,
    )
    yield DescribedStep(
        what="Fb.40: bit 0 output telegrams, bit 1 parameter orders, bit 2 data exchange",
        why="they keep the watchdog alive; bit 0 alone starves if the outputs do not change",
        delivered="7",
        source=_SUPERVISION,
    )
    yield DescribedStep(
        what="Fb.23 = FFh",
        why="with 0 the default process data map comes back at power-on",
        delivered="255",
        source="Saving of the F5 PB-Operator Configuration",
    )
