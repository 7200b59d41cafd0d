"""The DRIVECOM state machine as data: words, commands, states and transitions; its slave side steps through them.

Numbers of the transitions are DRIVECOM's profile 21; commands and status values as in Demag's CM-PDP manual, 11.2.1.2.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from dpstack.profile.model.states import ControlTable, Goal, State, StateRow, StateTable
from dpstack.profile.model.words import Word

CONTROL: Final = Word(
    "control word",
    {
        "switch_on": 0,
        "enable_voltage": 1,
        "no_quick_stop": 2,
        "enable_operation": 3,
        "reset_fault": 7,
        "toggle": 8,
        "select_1": 12,
        "select_2": 13,
        "select_3": 14,
    },
)
STATUS: Final = Word(
    "status word",
    {
        "ready_to_switch_on": 0,
        "ready": 1,
        "operation_enabled": 2,
        "fault": 3,
        "voltage_inhibited": 4,
        "no_quick_stop": 5,
        "switch_on_inhibited": 6,
        "warning": 7,
        "toggle": 8,
        "remote": 9,
        "reached": 10,
        "limit": 11,
        "select_1": 12,
        "select_2": 13,
        "select_3": 14,
        "warning_2": 15,
    },
)

#: bit 5 is 'x' in the rows with mask 4F; bit 4 is in no row
STATES: Final = StateTable(
    (
        StateRow(State.NOT_READY, 0x4F, 0x00),
        StateRow(State.SWITCH_ON_INHIBITED, 0x4F, 0x40),
        StateRow(State.READY_TO_SWITCH_ON, 0x6F, 0x21),
        StateRow(State.READY, 0x6F, 0x23),
        StateRow(State.RUNNING, 0x6F, 0x27),
        StateRow(State.QUICK_STOP, 0x6F, 0x07),
        StateRow(State.FAULT, 0x4F, 0x08),
        StateRow(State.FAULT_REACTION, 0x4F, 0x0F),
    )
)


class Command(Enum):
    """Commands by mask and value of the control word's low bits; each control word is exactly one of them."""

    VOLTAGE_INHIBIT = (0x02, 0x00)
    QUICK_STOP = (0x06, 0x02)
    SHUTDOWN = (0x07, 0x06)
    OPERATION_INHIBIT = (0x0F, 0x07)  # from ready to switch on: switch on
    OPERATION_ENABLE = (0x0F, 0x0F)  # from ready to switch on: switch on, then enable


def command(control: int) -> Command:
    """The command in a control word."""
    return _COMMANDS[control & 0x0F]


_COMMANDS: Final = tuple(
    next(c for c in Command if low & c.value[0] == c.value[1])  # the five cover all sixteen
    for low in range(16)
)


class Transition(NamedTuple):
    """``number``: DRIVECOM's; 0 is the manufacturer's short cut."""

    number: int
    source: State
    command: Command
    target: State


_SOI, _RTSO, _READY, _RUN, _QUICK = (
    State.SWITCH_ON_INHIBITED,
    State.READY_TO_SWITCH_ON,
    State.READY,
    State.RUNNING,
    State.QUICK_STOP,
)

#: Transitions by command; 1 is power-up, 13 and 14 a fault, 15 its acknowledgement (:class:`DrivecomMachine`).
TRANSITIONS: Final = (
    Transition(0, _SOI, Command.OPERATION_ENABLE, _RUN),
    Transition(2, _SOI, Command.SHUTDOWN, _RTSO),
    Transition(3, _RTSO, Command.OPERATION_INHIBIT, _READY),
    Transition(3, _RTSO, Command.OPERATION_ENABLE, _READY),
    Transition(4, _READY, Command.OPERATION_ENABLE, _RUN),
    Transition(5, _RUN, Command.OPERATION_INHIBIT, _READY),
    Transition(6, _READY, Command.SHUTDOWN, _RTSO),
    Transition(7, _RTSO, Command.VOLTAGE_INHIBIT, _SOI),
    Transition(8, _RUN, Command.SHUTDOWN, _RTSO),
    Transition(9, _RUN, Command.VOLTAGE_INHIBIT, _SOI),
    Transition(10, _READY, Command.VOLTAGE_INHIBIT, _SOI),
    Transition(11, _RUN, Command.QUICK_STOP, _QUICK),
    Transition(12, _QUICK, Command.VOLTAGE_INHIBIT, _SOI),
)
_NEXT: Final = {(t.source, t.command): t for t in TRANSITIONS}

#: bits 0-6 of the status word by state
SHOWN: Final = {row.state: row.value for row in STATES.rows}

#: the master's side: shutdown, switch on, enable; stop is transition 5, quick stop 11, coast 9
TABLE: Final = ControlTable(
    control=CONTROL,
    status=STATUS,
    states=STATES,
    run={
        State.NOT_READY: 0x0006,
        State.SWITCH_ON_INHIBITED: 0x0006,
        State.READY_TO_SWITCH_ON: 0x0007,
        State.READY: 0x000F,
        State.RUNNING: 0x000F,
    },
    steady={
        Goal.IDLE: 0x0000,
        Goal.STOP: 0x0007,
        Goal.QUICK_STOP: 0x0002,
        Goal.COAST: 0x0000,
        Goal.ACK_HIGH: 0x0080,
        Goal.ACK_LOW: 0x0000,
    },
    released_mask=0x000F,
    releasing=frozenset({State.RUNNING}),
)


class DrivecomMachine:
    """The drive's side: one transition a step at most. Starts in switch-on inhibited (transition 1)."""

    __slots__ = ("_reset", "state", "stopping")

    def __init__(self) -> None:
        self.state = State.SWITCH_ON_INHIBITED
        #: transition 5 has begun: the drive ramps down
        self.stopping = False
        self._reset = False

    def power_up(self) -> None:
        """Transition 1."""
        self.enter(State.SWITCH_ON_INHIBITED)
        self._reset = False

    def enter(self, state: State) -> None:
        """Go to ``state`` for a reason of the drive's own (a fault, 13 and 14; release lost)."""
        self.state = state
        self.stopping = False

    def step(self, control: int, *, stops_at_once: bool, ack_allowed: bool, still: bool) -> None:
        """Obey ``control``.

        ``stops_at_once``: transition 5 coasts, else it waits for ``still`` and can be taken back. ``ack_allowed``: a
        rising edge of bit 7 acknowledges now. ``still``: standstill as the drive judges it, ends a quick stop (12).
        """
        rising = bool(control & 0x80) and not self._reset
        self._reset = bool(control & 0x80)
        if self.state is State.FAULT:
            if rising and ack_allowed:
                self.enter(State.SWITCH_ON_INHIBITED)  # 15
            return
        order = command(control)
        transition = _NEXT.get((self.state, order))
        if transition is None:
            if self.state is State.RUNNING and order is Command.OPERATION_ENABLE:
                self.stopping = False  # 0F during the ramp brings it back
            elif self.state is State.QUICK_STOP and still:
                self.enter(State.SWITCH_ON_INHIBITED)  # 12
            return
        if transition.number == 5 and not stops_at_once:
            if self.stopping and still:
                self.enter(State.READY)
            else:
                self.stopping = True
            return
        self.enter(transition.target)
