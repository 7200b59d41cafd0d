"""State machines of simulated drives: PROFIdrive's, DRIVECOM's, and one made from the tables of a device file."""

from __future__ import annotations

from typing import Final, Protocol

from dpstack.devices.model import WAY, DeviceFile
from dpstack.profile.model.drivecom_states import SHOWN as DRIVECOM_SHOWN
from dpstack.profile.model.drivecom_states import DrivecomMachine
from dpstack.profile.model.profidrive_states import ProfidriveMachine
from dpstack.profile.model.states import Goal, State

_POWERED: Final = frozenset({State.RUNNING, State.STOPPING, State.QUICK_STOP})


class Machine(Protocol):
    """The drive's side of a state machine."""

    state: State

    def obey(self, control: int, *, still: bool) -> None:
        """Take the next step that ``control`` orders. ``still``: the motor stands."""

    def hold(self) -> None:
        """The bus has no command: what runs stops, and nothing starts."""

    def fail(self) -> None: ...
    def reset(self) -> None: ...

    @property
    def powered(self) -> bool: ...

    @property
    def shown(self) -> int:
        """The state in the status word."""


class Profidrive(ProfidriveMachine):
    """PROFIdrive's S1 to S5."""

    __slots__ = ()

    def obey(self, control: int, *, still: bool) -> None:
        self.step(control if control & 0x0400 else 0x0400 | 0x7E, still=still)

    def hold(self) -> None:
        if self.state is not State.FAULT:
            self.state = State.STOPPING if self.powered else State.SWITCH_ON_INHIBITED

    def fail(self) -> None:
        self.state = State.FAULT

    def reset(self) -> None:
        self.state = State.SWITCH_ON_INHIBITED

    @property
    def shown(self) -> int:
        return self.SHOWN[self.state]


class Drivecom(DrivecomMachine):
    """DRIVECOM's states."""

    __slots__ = ()

    def obey(self, control: int, *, still: bool) -> None:
        self.step(control, stops_at_once=False, ack_allowed=True, still=still)

    def hold(self) -> None:
        if self.state not in (State.FAULT, State.SWITCH_ON_INHIBITED):
            self.enter(State.SWITCH_ON_INHIBITED)

    def fail(self) -> None:
        self.enter(State.FAULT)

    def reset(self) -> None:
        self.enter(State.SWITCH_ON_INHIBITED)

    @property
    def powered(self) -> bool:
        return self.state in _POWERED

    @property
    def shown(self) -> int:
        return DRIVECOM_SHOWN[self.state]


class TableMachine:
    """A drive whose words are in its file: it goes one state up at the word that leads on, and down at the others."""

    def __init__(self, file: DeviceFile) -> None:
        self._run, self._steady = file.run, file.steady
        words = [*file.run.values(), *file.steady.values()]
        #: the bits in which the words differ
        self._mask = 0
        for word in words:
            self._mask |= word ^ words[0]
        self._shown = {row.state: row.value for row in reversed(file.table.states.rows)}
        # a drive leaves a state by itself that no word leads on from: the simulated one is never in it
        self._way = [state for state in WAY if state in self._shown and (state in file.run or state is State.RUNNING)]
        self._acknowledge = False
        self.state: State = self._way[0]

    @property
    def powered(self) -> bool:
        return self.state in _POWERED

    @property
    def shown(self) -> int:
        if self.state in self._shown:
            return self._shown[self.state]
        return self._shown[State.RUNNING] if self.powered else self._shown[self._way[0]]

    def obey(self, control: int, *, still: bool) -> None:
        acknowledge = self._is(control, Goal.ACK_HIGH)
        rising, self._acknowledge = acknowledge and not self._acknowledge, acknowledge
        state = self.state
        if state is State.FAULT:
            if rising:
                self.reset()
        elif state in (State.STOPPING, State.QUICK_STOP):
            if self._matches(control, self._run.get(State.RUNNING)) and state is State.STOPPING:
                self.state = State.RUNNING
            elif self._is(control, Goal.COAST):
                self.reset()
            elif still:
                self.state = self._way[-2] if state is State.STOPPING else self._way[0]
        elif self._matches(control, self._run.get(state)):
            if state is not State.RUNNING:
                self.state = self._way[self._way.index(state) + 1]
        elif state is State.RUNNING:
            if self._is(control, Goal.STOP) or self._is(control, Goal.IDLE):
                self.state = State.STOPPING
            elif self._is(control, Goal.QUICK_STOP):
                self.state = State.QUICK_STOP
            else:
                self.reset()
        elif self._is(control, Goal.COAST) and not self._is(control, Goal.STOP):
            self.reset()

    def hold(self) -> None:
        if self.state is State.RUNNING:
            self.state = State.STOPPING
        elif self.state not in (State.FAULT, State.STOPPING, State.QUICK_STOP):
            self.reset()

    def fail(self) -> None:
        self.state = State.FAULT

    def reset(self) -> None:
        self.state = self._way[0]

    def _is(self, control: int, goal: Goal) -> bool:
        return self._matches(control, self._steady.get(goal))

    def _matches(self, control: int, word: int | None) -> bool:
        return word is not None and not (control ^ word) & self._mask


def machine_of(file: DeviceFile) -> Machine:
    """The machine of the simulated drive."""
    if file.machine == "profidrive":
        return Profidrive()
    if file.machine == "drivecom":
        return Drivecom()
    return TableMachine(file)
