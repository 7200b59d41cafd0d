"""The PROFIdrive state machine S1 to S5 as data, and its slave side.

Words as PROFIdrive's; a drive gives its own names to bits 8-15. Status values: PROFIdrive V2 as printed by Fuji
(OPC-E1-PDP, 8.2) and others: S1 has bit 6, S2 bit 0, S3 bits 0 and 1, S4 bits 0 to 2; S5 looks like S3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.profile.model.states import ControlTable, Goal, State, StateRow, StateTable
from dpstack.profile.model.words import Word

CONTROL_BITS: Final[Mapping[str, int]] = {
    "on": 0,
    "no_coast": 1,
    "no_quick_stop": 2,
    "enable_operation": 3,
    "enable_ramp": 4,
    "unfreeze_ramp": 5,
    "enable_setpoint": 6,
    "acknowledge": 7,
    "control_by_plc": 10,
}
STATUS_BITS: Final[Mapping[str, int]] = {
    "ready_to_switch_on": 0,
    "ready": 1,
    "operation_enabled": 2,
    "fault": 3,
    "no_coast": 4,
    "no_quick_stop": 5,
    "switch_on_inhibited": 6,
}

STATES: Final = StateTable(
    (
        StateRow(State.FAULT, 0x0008, 0x0008),
        StateRow(State.SWITCH_ON_INHIBITED, 0x0049, 0x0040),  # S1
        StateRow(State.READY_TO_SWITCH_ON, 0x004B, 0x0001),  # S2
        StateRow(State.READY, 0x004F, 0x0003),  # S3, and S5 by one's own command
        StateRow(State.RUNNING, 0x004F, 0x0007),  # S4
    )
)


def table(control: Word, status: Word) -> ControlTable:
    """The master's side for a drive with these words."""
    run = 0x047F
    ready = 0x047E
    return ControlTable(
        control=control,
        status=status,
        states=STATES,
        run={
            State.SWITCH_ON_INHIBITED: ready,
            State.READY_TO_SWITCH_ON: run,
            State.READY: run,
            State.RUNNING: run,
        },
        steady={
            Goal.IDLE: ready,  # OFF1: a drive that was left running ramps down
            Goal.STOP: ready,
            Goal.QUICK_STOP: 0x047A,
            Goal.COAST: 0x047C,
            Goal.ACK_HIGH: 0x0480,
            Goal.ACK_LOW: 0x0400,
        },
        released_mask=0x000F,
        releasing=frozenset({State.READY, State.RUNNING}),
    )


_POWERED: Final = frozenset({State.RUNNING, State.STOPPING, State.QUICK_STOP})
#: the next state after OFF3 (control word bit 2 is 0)
_OFF3: Final = {
    State.READY_TO_SWITCH_ON: State.SWITCH_ON_INHIBITED,
    State.READY: State.SWITCH_ON_INHIBITED,
    State.RUNNING: State.QUICK_STOP,
    State.STOPPING: State.QUICK_STOP,
}


class ProfidriveMachine:
    """The drive's side. Starts in S1.

    ``state``: SWITCH_ON_INHIBITED S1, READY_TO_SWITCH_ON S2, READY S3, RUNNING S4, STOPPING or QUICK_STOP S5 (by OFF1
    or OFF3), FAULT.
    """

    __slots__ = ("_acknowledge", "state")

    #: bits 0-3 and 6 of the status word
    SHOWN: Final[Mapping[State, int]] = {
        State.SWITCH_ON_INHIBITED: 0x40,
        State.READY_TO_SWITCH_ON: 0x01,
        State.READY: 0x03,
        State.RUNNING: 0x07,
        State.STOPPING: 0x03,
        State.QUICK_STOP: 0x03,
        State.FAULT: 0x48,
    }

    def __init__(self) -> None:
        self.state = State.SWITCH_ON_INHIBITED
        self._acknowledge = False

    @property
    def powered(self) -> bool:
        """The power stage is on: S4 and S5."""
        return self.state in _POWERED

    def step(self, control: int, *, still: bool) -> None:
        """Obey ``control`` until nothing follows any more. ``still``: standstill, ends S5."""
        rising = bool(control & 0x80) and not self._acknowledge
        self._acknowledge = bool(control & 0x80)
        if self.state is State.FAULT:
            if rising:
                self.state = State.SWITCH_ON_INHIBITED
            return
        while (target := self._target(control, still)) is not self.state:
            self.state = target

    def _target(self, control: int, still: bool) -> State:
        state = self.state
        on = bool(control & 0x01) and bool(control & 0x40)  # bit 6 = 0 disables bit 0
        off2, off3 = not control & 0x02, not control & 0x04
        if off2:
            return State.SWITCH_ON_INHIBITED  # coasts from anywhere
        if off3 and state in _OFF3:
            return _OFF3[state]
        match state:
            case State.SWITCH_ON_INHIBITED:
                # bit 0 must be 0 here: a drive does not start because the bus comes up with ON set
                return State.READY_TO_SWITCH_ON if not off3 and not control & 0x01 else state
            case State.READY_TO_SWITCH_ON:
                return State.READY if on else state
            case State.READY:
                if not on:
                    return State.READY_TO_SWITCH_ON
                return State.RUNNING if control & 0x08 else state
            case State.RUNNING:
                if not on:
                    return State.STOPPING
                return state if control & 0x08 else State.READY
            case State.STOPPING:
                if on and control & 0x08:
                    return State.RUNNING  # taken back during the ramp
                return State.READY_TO_SWITCH_ON if still else state
            case State.QUICK_STOP:
                return State.SWITCH_ON_INHIBITED if still else state
            case _:
                return state
