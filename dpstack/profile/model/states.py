"""States of a drive by common names, decoded from the status word; control words that lead to a wanted state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum, StrEnum
from typing import NamedTuple

from msgspec import Struct

from dpstack.profile.model.words import Word


class State(StrEnum):
    """State of a drive, with the same names for every drive; the values are those of the JSON lines."""

    OFFLINE = "offline"  # no inputs of a drive in data exchange
    UNKNOWN = "unknown"  # a status word that is in no row of the drive's table
    NOT_READY = "not_ready"  # switched off, initialising
    SWITCH_ON_INHIBITED = "switch_on_inhibited"
    READY_TO_SWITCH_ON = "ready_to_switch_on"
    READY = "ready"  # switched on, power stage blocked
    RUNNING = "running"
    STOPPING = "stopping"
    QUICK_STOP = "quick_stop"
    FAULT_REACTION = "fault_reaction"
    FAULT = "fault"


#: States in which the power stage may turn the motor.
MOVING = frozenset({State.RUNNING, State.STOPPING, State.QUICK_STOP, State.FAULT_REACTION})
#: States that only an acknowledgement ends.
FAULTED = frozenset({State.FAULT, State.FAULT_REACTION})


class StateRow(NamedTuple):
    """A status word with ``word & mask == value`` means ``state``."""

    #: state that the status word means
    state: State
    #: bits that count
    mask: int
    #: their value
    value: int


class StateTable:
    """Decodes status words. Construction checks that no word can match two rows. Raises ValueError."""

    __slots__ = ("_known", "_mask", "rows")

    def __init__(self, rows: Iterable[StateRow]) -> None:
        #: the rows, in the order given
        self.rows: tuple[StateRow, ...] = tuple(rows)
        self._known: dict[int, State] = {}
        self._mask = 0
        for number, row in enumerate(self.rows):
            if row.value & ~row.mask:
                raise ValueError(f"state {row.state}: value {row.value:#06x} has bits outside mask {row.mask:#06x}")
            for other in self.rows[:number]:
                common = row.mask & other.mask
                if other.state is not row.state and row.value & common == other.value & common:
                    raise ValueError(f"a status word can match both {other.state} and {row.state}")
            self._mask |= row.mask

    def decode(self, word: int) -> State:
        """The state of the first row that matches ``word``, else UNKNOWN. Never raises."""
        key = word & self._mask
        state = self._known.get(key)
        if state is None:
            state = next((row.state for row in self.rows if key & row.mask == row.value), State.UNKNOWN)
            self._known[key] = state
        return state


class Goal(Enum):
    """Goal of the control word."""

    IDLE = "idle"
    RUN = "run"
    STOP = "stop"
    QUICK_STOP = "quick stop"
    COAST = "coast"
    ACK_HIGH = "acknowledge, edge"
    ACK_LOW = "acknowledge, between edges"


class ControlTable(Struct, frozen=True, kw_only=True):
    """Everything about a control and a status word that differs between drives, as data.

    ``run``: the control word that leads on from each state towards RUNNING. ``released_mask``: bits of one's own
    control word that must all be set for RUNNING to mean running; without them ``releasing`` states read as STOPPING (a
    status word alone does not show it). Bits of ``status`` by name, as far as the drive has them: ``reached``,
    ``remote``, ``warning``.
    """

    #: bits of the control word
    control: Word
    #: bits of the status word by name, as far as the drive has them: ``reached``, ``remote``, ``warning``
    status: Word
    #: the state of each status word
    states: StateTable
    run: Mapping[State, int]
    #: control words of the other goals
    steady: Mapping[Goal, int]
    released_mask: int
    #: states that read as STOPPING while bits of ``released_mask`` are missing
    releasing: frozenset[State]

    def word(self, goal: Goal, state: State) -> int:
        """The control word for ``goal`` while the drive reports ``state``."""
        if goal is Goal.RUN:
            return self.run.get(state, self.steady[Goal.IDLE])
        return self.steady[goal]

    def state(self, status: int, own: int) -> State:
        """The state of a drive with the status word ``status`` whose master last sent the control word ``own``."""
        state = self.states.decode(status)
        if state in self.releasing and own & self.released_mask != self.released_mask:
            return State.STOPPING
        return state
