"""The FRENIC's description for the commissioning sheet: the facts of its manual over the tables of the plugin."""

from __future__ import annotations

from typing import Final

from msgspec import structs

from dpstack.profile import (
    DescribedLed,
    DescribedMessage,
    DescribedStep,
    DeviceDescription,
    Options,
    described_word,
    messages,
    places,
    speed_range,
    states_of,
)
from dpstack_drives.fuji import table as t
from dpstack_drives.fuji.plugin import FujiCore

_MANUAL: Final = "Fuji, PROFIBUS DP Interface Option OPC-E1-PDP, instruction manual"
_LEDS: Final = "2.5, table 2.1"
_TROUBLE: Final = "11"
#: chapter 11, by the alarm code
_REMEDIES: Final = {
    t.ER4: "see that the option is installed properly and has power; otherwise it is defective (11, no. 2)",
    t.ER5: "the watchdog of the master may be too short, o31 126 or more, the cable no PROFIBUS cable, or the option "
    "not grounded (11, no. 5)",
}
_NO_LINK: Final = (
    "compare GSD file and station address with the master's, look for a second station with the address, and at cable "
    "and terminating resistors (11, no. 3)"
)
LEDS: Final = (
    DescribedLed(
        name="all",
        shows="off",
        meaning="no power",
        remedy="switch inverter and option on; see that the option is installed properly (11, no. 1)",
        source=_TROUBLE,
    ),
    DescribedLed(name="PWR", shows="green", meaning="normal", source=_LEDS),
    DescribedLed(name="PWR", shows="green, blinking", meaning="self-test after power-on, about 0.5 s", source=_LEDS),
    DescribedLed(name="PWR", shows="red, blinking", meaning="communications error: Er5", remedy=_NO_LINK, source=_LEDS),
    DescribedLed(
        name="PWR",
        shows="red",
        meaning="hardware error: Er4",
        remedy=_REMEDIES[t.ER4],
        source=_LEDS,
    ),
    DescribedLed(
        name="ERR",
        shows="red, blinking",
        meaning="o30 is another PPO type than the master's, or the address is 126 or more (Er5)",
        remedy="set o30 to the PPO type of the master, then switch inverter and option off and on (11, no. 4)",
        source=_LEDS,
    ),
    DescribedLed(name="ONL", shows="green", meaning="online", source=_LEDS),
    DescribedLed(name="ONL", shows="off", meaning="not online", source=_LEDS),
    DescribedLed(name="OFFL", shows="red", meaning="not connected to PROFIBUS", remedy=_NO_LINK, source=_LEDS),
    DescribedLed(name="OFFL", shows="off", meaning="not offline", source=_LEDS),
)


def describe(core: FujiCore, basic: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``."""
    written, read = (
        [f"PCD{n} ({'not used' if one is None else one.name})" for n, one in enumerate(own.fields, 1)]
        for own in (core.outputs_map, core.inputs_map)
    )
    return structs.replace(
        basic,
        manual=_MANUAL,
        steps=(*_address(address), *_telegram(core), *basic.steps[1:], *_others()),
        outputs=places(core.telegram, outputs=True, names=("CTW (control word)", "MRV (set point)", *written)),
        inputs=places(core.telegram, outputs=False, names=("STW (status word)", "MAV (actual speed)", *read)),
        words=(described_word(t.CONTROL), described_word(t.STATUS, states_of(t.TABLE))),
        ranges=(speed_range(core, "8.2 (3)", "F03, the maximum frequency; set points end there"),),
        faults=tuple(
            DescribedMessage(
                code=f"{alarm.keypad} (M16: {alarm.code}, PNU 947: {alarm.malfunction:04X}h)",
                text=alarm.name,
                remedy=_REMEDIES.get(alarm.code, ""),
                source="10, table 10.1",
            )
            for alarm in t.ALARMS
        ),
        acknowledge="remove the cause, then bit 7 of CTW: 0480h cancels the trip, 0400h follows (7.2)",
        errors=messages(t.PKW.errors, "{}", "8.3, table 8.10"),
        leds=LEDS,
        missing={"warnings": "this manual has no warnings"},
    )


def _address(address: int) -> tuple[DescribedStep, ...]:
    by_switches = 1 <= address <= t.MOST_SWITCHES
    what = f"SW1 = {address // 10}, SW2 = {address % 10}" if by_switches else f"SW1 = SW2 = 0, and o31 = {address}"
    why = "the master asks for the drive at this station address; switch inverter and option off before, on afterwards"
    return (DescribedStep(what=what, why=why, source="2.3"),)


def _telegram(core: FujiCore) -> tuple[DescribedStep, ...]:
    number = t.O30[core.telegram.name]
    return (
        DescribedStep(
            what=f"o30 = {number}, then power off and on",
            why=f"the PPO type is that of the master ({core.telegram.name}); another one is a configuration fault, and "
            "ERR blinks",
            delivered="0 (PPO1)",
            source="5, table 5.1",
        ),
    )


def _others() -> tuple[DescribedStep, ...]:
    return (
        DescribedStep(
            what="terminal LE on (if it is assigned), LOC off, y99 = 0",
            why="they go before the bus: run or frequency command would not come from CTW and MRV",
            source="11, no. 6",
        ),
        DescribedStep(
            what="o27: 0 coast and Er5 at once, 1 coast after o28, 2 coast unless data return within o28, 3 go on, 10 "
            "decelerate and Er5, 11 decelerate after o28, 12 decelerate unless data return within o28",
            why="it decides what the drive does when the master stops; it needs the watchdog of the slave. The ramp of "
            "10 to 12 is F08",
            delivered="0",
            source="9, table 9.1",
        ),
        DescribedStep(
            what="o28 = 0.0 to 60.0 s", why="the time of o27 = 1, 2, 11, 12", delivered="0 s", source="9, table 9.1"
        ),
    )
