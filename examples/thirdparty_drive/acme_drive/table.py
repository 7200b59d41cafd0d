"""Facts that plugin and simulated drive share, from the manual of the drive: words, states, texts, parameters."""

from __future__ import annotations

from typing import Final

from dpstack.profile import (
    NS_PER_MS,
    ControlTable,
    Goal,
    ParamSpec,
    ParamTable,
    ParamType,
    Scale,
    State,
    StateRow,
    StateTable,
    TelegramSpec,
    Word,
)

#: 2 words to the drive, 4 from it: 61 and 53; F3 in front is the parameter channel of 4 words
TELEGRAMS: Final = {
    "PKW": TelegramSpec(name="PKW", config=bytes.fromhex("F3 61 53"), outputs=4, inputs=8, channel=True),
    "STD": TelegramSpec(name="STD", config=bytes.fromhex("61 53"), outputs=4, inputs=8),
}

CONTROL: Final = Word("control word", {"power": 0, "run": 1, "quick_stop": 2, "reset": 7})
STATUS: Final = Word("status word", {"ready": 0, "running": 1, "fault": 2, "remote": 3, "reached": 4})

STATES: Final = StateTable(
    (
        StateRow(State.FAULT, 0x0004, 0x0004),
        StateRow(State.NOT_READY, 0x0007, 0x0000),
        StateRow(State.READY, 0x0007, 0x0001),
        StateRow(State.RUNNING, 0x0007, 0x0003),
    )
)

#: which control word leads on from each state, and which one stands for each of the other goals
TABLE: Final = ControlTable(
    control=CONTROL,
    status=STATUS,
    states=STATES,
    run={State.NOT_READY: 0x0001, State.READY: 0x0003, State.RUNNING: 0x0003},
    steady={
        Goal.IDLE: 0x0000,
        Goal.STOP: 0x0001,  # power on, run off: the ramp
        Goal.QUICK_STOP: 0x0005,
        Goal.COAST: 0x0000,
        Goal.ACK_HIGH: 0x0080,
        Goal.ACK_LOW: 0x0000,
    },
    # the status word says "running" down to standstill: without our own run bit that is stopping
    released_mask=CONTROL.mask("power", "run"),
    releasing=frozenset({State.RUNNING}),
)

SOURCE: Final = 1
PARAMETERS: Final = ParamTable(
    (
        ParamSpec(number=SOURCE, name="source", title="Control source, 1: bus", high=1, factory=1),
        ParamSpec(number=2, name="acceleration", title="Acceleration time", decimals=1, unit="s", high=60, factory=0.5),
        ParamSpec(number=3, name="deceleration", title="Deceleration time", decimals=1, unit="s", high=60, factory=0.5),
        ParamSpec(number=4, name="quick_stop", title="Quick stop time", decimals=1, unit="s", high=60, factory=0.1),
        ParamSpec(number=5, name="reference", title="Reference", decimals=1, unit="Hz", low=1, high=400, factory=50),
        ParamSpec(number=10, name="starts", title="Starts so far", type=ParamType.U32, read_only=True),
    )
)

FAULTS: Final = {1: "E01 overcurrent", 2: "E02 overvoltage", 7: "E07 motor overload"}

#: the drive obeys and reports every 10 ms
SCAN_NS: Final = 10 * NS_PER_MS
SPEED: Final = Scale("speed", full=10_000)  # 2710h = 100 % of the reference
CURRENT: Final = Scale("current", full=1_000)
