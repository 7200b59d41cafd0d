"""The Demag's description for the commissioning sheet: the facts of its manual over the tables of the plugin."""

from __future__ import annotations

from typing import Final

from msgspec import structs

from dpstack.profile import (
    DescribedMessage,
    DescribedRange,
    DescribedStep,
    DeviceDescription,
    Options,
    described_word,
    drivecom_states,
    messages,
    places,
    speed_range,
    states_of,
)
from dpstack_drives.demag import outpzd
from dpstack_drives.demag import table as t
from dpstack_drives.demag.plugin import MODES, DemagCore

_MANUAL: Final = "Demag, Operating instructions CM-PDP-24, supplement"
_RELEASE: Final = {1: "S1 and one of S2, S3", 2: "S1"}
#: what the manual says about a fault beside its name
_REMEDIES: Final = {
    t.FAULT_TOGGLE: "880 = 2 switches off instead, without a fault; 881 is the time in which the master has to answer",
}
_WIDE_INPUTS: Final = ("frequency", "absolute current", "active current", "warning (bits)", "fault (number)")


def describe(core: DemagCore, basic: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``."""
    wide = core.telegram.inputs == 12
    mode = MODES[str(options["control"])]
    by_contacts = mode != 1
    control = t.CONTACTS if by_contacts else drivecom_states.CONTROL
    extra = (
        f"PZD{number} ({'not used' if field is None else field.kind})"
        for number, field in enumerate(core.outputs_map.fields, outpzd.FIRST)
    )
    first = "ZSW (status word)"
    value = "PZD2: frequency, or what bits 12-14 of STW choose"
    node, *settings = basic.steps
    return structs.replace(
        basic,
        manual=_MANUAL,
        steps=(structs.replace(node, source="6"), *settings, *_steps(mode, by_start=bool(options["set_412"]))),
        outputs=places(core.telegram, outputs=True, names=("STW (control word)", "PZD2 (set point)", *extra)),
        inputs=places(core.telegram, outputs=False, names=(first, *(_WIDE_INPUTS if wide else (value,)))),
        words=(
            structs.replace(described_word(control), name="STW (control word)"),
            structs.replace(
                described_word(drivecom_states.STATUS, states_of(drivecom_states.TABLE)), name="ZSW (status word)"
            ),
        ),
        ranges=(
            speed_range(core, "11.2.2", "390, or 375 if 390 is 0"),
            DescribedRange(
                name="currents", range="-200..+199.99 %", wire="4000h = 100 % of 371 (rated current)", source="11.2.4"
            ),
        ),
        faults=tuple(
            DescribedMessage(code=f"F{code:04X}", text=text, remedy=_REMEDIES.get(code, ""), source="13.2")
            for code, text in t.FAULTS.items()
        ),
        warnings=tuple(
            DescribedMessage(code=f"{1 << bit:04X}h (bit {bit} of 270)", text=text, source="13.1")
            for bit, text in enumerate(t.WARNINGS)
        ),
        acknowledge=f"a fault can be acknowledged {t.FAULT_LOCK_S} s after it came at the earliest; the rising edge of "
        "bit 7 of STW acknowledges with 412 = 1 only, otherwise acknowledge at the drive (11.2.1.2)",
        errors=messages(t.PKW.errors, "{}", "11.1.3"),
        missing={"leds": "this manual describes no LEDs of the module"},
    )


def _steps(mode: int, *, by_start: bool) -> tuple[DescribedStep, ...]:
    own = DescribedStep(
        what=f"412 = {mode}: nothing to set, start() writes it in RAM (option set_412)",
        why="only 1 (state machine) and 2 (remote contacts) let the bus control the drive; PPO3 and PPO4 cannot write "
        "it: set it at the keypad",
        delivered="44",
        source="11.2.1",
    )
    return (
        *((own,) if by_start else ()),
        DescribedStep(
            what=f"hardware release wired and on: {_RELEASE[mode]}",
            why="without it the drive does not obey the control word; bit 9 of ZSW (remote) shows it",
            source="11.2.1.2, 11.2.1.3",
        ),
        DescribedStep(
            what="392: 0 coast, 1 DC brake (v/f characteristic only), 2 ramp",
            why="it decides how the drive stops from operation",
            delivered="2 (0 with torque control)",
            source="11.2.1.2.1",
        ),
        DescribedStep(
            what="414 = 0, or the data set 1 to 4",
            why="390, 375, 412 and 434 exist in each data set: set them in the one that is active; 0 leaves the choice "
            "to contact inputs",
            delivered="0",
            source="11.2.1",
        ),
        DescribedStep(
            what="termination at both ends of the cable",
            why="the one in the bus plug works only while the inverter has power, or the module its external 24 V",
            source="4",
        ),
    )
