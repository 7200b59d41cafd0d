"""What is known of the cycles of a master, as plain data: the last one, and the books over all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Final

from dpstack.stats import Histogram


class MissReason(Enum):
    """Why a cycle did not begin when it was due; the values are those of the summary line."""

    OVERRUN = "overrun"  # the round before was not over
    NO_ROOM = "no_room"  # something that fits between no two cycles was sent before it
    SILENCE = "silence"  # a request between two cycles was not answered, and waited for longer than there was room
    TOKEN = "token"  # another master had the token
    LATE = "late"  # none of these: this computer, or its port, was late

    @property
    def text(self) -> str:
        """For people, after a number."""
        return _TEXTS[self]


_TEXTS: Final = {
    MissReason.OVERRUN: "after a long round",
    MissReason.NO_ROOM: "after a request that fits between no two cycles",
    MissReason.SILENCE: "after a service that was not answered",
    MissReason.TOKEN: "waiting for the token",
    MissReason.LATE: "by this computer or its port",
}


def tolerance_ns(cycle_ns: int) -> int:
    """So late a cycle of ``cycle_ns`` may begin without being a deadline miss: a tenth of it."""
    return cycle_ns // 10


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleData:
    """One round with data exchange, published when it is over. Times in ns.

    ``number`` counts fixed cycles by their due times, those that were left out included; free running the rounds.
    ``published`` counts these pictures: who was handed fewer of them knows how many are missing. ``t_ns`` is the first
    bit of its first request, ``due_ns`` when that was due (free running: the same). ``inputs`` are those of every slave
    in data exchange by address, all as they stood at the end of the round; ``fresh`` are the slaves whose inputs came
    in this one. ``missed`` counts the deadline misses up to here.
    """

    number: int
    published: int
    t_ns: int
    due_ns: int
    inputs: Mapping[int, bytes]
    fresh: frozenset[int]
    missed: int

    @property
    def late_ns(self) -> int:
        """How late it began."""
        return self.t_ns - self.due_ns


@dataclass(slots=True)
class CycleBook:
    """The books over all fixed cycles; ``cycle_ns`` 0: free running, and nothing is counted but ``begun``.

    ``late`` is how late the cycles began that did begin. A deadline miss is a cycle that began later than
    ``tolerance_ns`` (``begun_late``), or was left out because it was late by more than half a cycle (``left_out``).
    """

    cycle_ns: int
    begun: int = 0
    begun_late: int = 0
    left_out: int = 0
    late: Histogram = field(default_factory=Histogram)
    reasons: dict[MissReason, int] = field(default_factory=dict)

    @property
    def tolerance_ns(self) -> int:
        """So late a cycle may begin."""
        return tolerance_ns(self.cycle_ns)

    @property
    def missed(self) -> int:
        """All deadline misses."""
        return self.begun_late + self.left_out

    def miss(self, reason: MissReason, *, left_out: int, late: bool) -> None:
        """Count the cycles left out, and one that began late."""
        self.left_out += left_out
        self.begun_late += late
        self.reasons[reason] = self.reasons.get(reason, 0) + left_out + late
