"""Start times of the rounds over the slaves: as fast as the bus allows, or on an equidistant grid (best effort).

With a fixed cycle the grid begins with the first request of the first round with data exchange. A round begins with the
first token held at or after its grid time; until then the token goes round. After a delay the grid stays: a round that
is late by up to half a cycle begins late, and the master leaves out a round that is later. So two rounds never begin
less than half a cycle apart (but for a token and the idle time between the decision and the first bit). The master also
leaves out a late round that fits into a cycle but would make the next one late too: if rounds take nearly the whole
cycle, no delay could be made good. While the master goes to a lower mode, and while no slave is in data exchange,
rounds run free.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from msgspec import Struct, field

from dpstack.dp.master.events import CyclesMissed
from dpstack.dp.master.settings import MasterContext
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import ConfigError
from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.stats import Histogram
from dpstack.text import TextEnum
from dpstack.units import NEVER, NS_PER_S, ms_text


class MissReason(TextEnum):
    """Why a cycle did not begin when it was due; the values are those of the summary line, the texts stand after a
    number."""

    #: the round before was not over
    OVERRUN = "overrun", "after a long round"
    #: something that fits between no two cycles was sent before it
    NO_ROOM = "no_room", "after a request that fits between no two cycles"
    #: a request between two cycles was not answered, and waited for longer than there was room
    SILENCE = "silence", "after a service that was not answered"
    #: another master had the token
    TOKEN = "token", "waiting for the token"
    #: none of these: this computer, or its port, was late
    LATE = "late", "by this computer or its port"


def tolerance_ns(cycle_ns: int) -> int:
    """The delay in ns up to which a cycle is no deadline miss: a tenth of ``cycle_ns``."""
    return cycle_ns // 10


class CycleData(Struct, frozen=True, kw_only=True):
    """One round with data exchange, published when it is over. Times in ns.

    ``number`` counts fixed cycles by their due times, those that were left out included; free running the rounds.
    ``published`` counts these objects, so that a program sees how many it did not receive. ``t_ns`` is the first bit of
    the first request of the round, ``due_ns`` the time when it was due (free running: the same). ``inputs``: of each
    slave in data exchange by address, at the end of the round. ``fresh``: the slaves whose inputs came in this round.
    ``missed`` counts the deadline misses up to this round. ``announced``: the slaves that have announced a diagnosis
    which is not read yet.
    """

    number: int
    published: int
    t_ns: int
    due_ns: int
    inputs: Mapping[int, bytes]
    fresh: frozenset[int]
    missed: int
    announced: frozenset[int] = frozenset()

    @property
    def late_ns(self) -> int:
        return self.t_ns - self.due_ns


class CycleStats(Struct):
    """Statistics of all fixed cycles; ``cycle_ns`` 0: free running, and only ``begun`` counts.

    ``late``: the delays of the cycles that began. A deadline miss is a cycle that began later than
    :func:`tolerance_ns` (``begun_late``), or that the master left out because it was late (``left_out``).
    """

    #: fixed cycle in ns; 0: free running, only ``begun`` counts
    cycle_ns: int
    #: cycles that began
    begun: int = 0
    #: cycles that began later than the tolerance allows
    begun_late: int = 0
    #: cycles that the master left out because it was late
    left_out: int = 0
    late: Histogram = field(default_factory=Histogram)
    #: number of deadline misses by reason
    reasons: dict[MissReason, int] = field(default_factory=dict)

    @property
    def missed(self) -> int:
        """Deadline misses: cycles that began late, and cycles left out."""
        return self.begun_late + self.left_out

    def miss(self, reason: MissReason, count: int, *, left_out: bool) -> None:
        """Count ``count`` cycles that were left out, or began late."""
        if left_out:
            self.left_out += count
        else:
            self.begun_late += count
        self.reasons[reason] = self.reasons.get(reason, 0) + count


#: why a cycle did not begin when it was due, and a text for people
Cause = tuple[MissReason, str]
#: after this long without a report the master reports a miss at once; else it sums up the misses of this time
_REPORT_EVERY: Final = NS_PER_S
#: the grid begins with the first bit of its first round
_OPEN: Final = -1


class Cadence:
    """The grid of the fixed cycle, or none. ``window`` is for the link layer, ``book`` the statistics.

    ``number`` of the last round; ``started_at``: its first bit in ns; ``due_at``: the time when it was due.
    """

    def __init__(self, context: MasterContext) -> None:
        self.book = CycleStats(context.settings.cycle_ns)
        self.window = CycleWindow()
        self.number = 0
        self.started_at = 0
        self.due_at = 0
        #: rounds are on the grid now
        self.fixed = False
        self._next = NEVER  # the grid
        self._begun_at = 0
        self._interval = 0  # the shortest time to the next round, free running
        self._over_at = 0
        #: durations in ns of the last round and of the one before it, with the idle time after its last answer
        self._took = self._took_before = 0
        self._idle = context.params.ns(context.params.t_id1)
        self._tolerance = tolerance_ns(context.settings.cycle_ns)
        self._context = context
        #: the cause for the round under way, should it turn out to be late
        self._cause: Cause = (MissReason.LATE, "")
        #: number of misses without a report; of the worst one the delay in ns, the number of its cycle and the reason
        self._unreported = 0
        self._worst = (0, 0, "")
        self._reported_at = -_REPORT_EVERY

    def due(self, now: int, interval: int = 0) -> bool:
        """Whether a round may begin with the token held ``now``; free running not before ``interval`` after the last
        begin."""
        if not self.fixed:
            return now >= self._begun_at + (interval if interval > self._interval else self._interval)
        late = now - self._next
        cycle_ns = self.book.cycle_ns
        if late > self._tolerance:
            left_out = -((cycle_ns // 2 - late) // cycle_ns)
            left_out += self._delays_the_next(late - left_out * cycle_ns + self._idle)
            if left_out:
                self._miss(self._find_cause(), left_out, late, self.number + 1, now, left_out=True)
                self.number += left_out
                self._next += left_out * cycle_ns
                self.window.next_at = self._next
        return now >= self._next

    def begin(self, now: int, *, fixed: bool, interval: int) -> None:
        """A round begins; ``fixed``: on the grid, else the next one not earlier than ``interval`` after ``now``."""
        cycle_ns = self.book.cycle_ns
        self.number += 1
        self._begun_at, self._interval = now, interval
        if fixed and cycle_ns:
            going, self.fixed = self.fixed, True
            self.due_at = self._next if going else _OPEN
            self._cause = self._find_cause()
            self._next = (self.due_at if going else now) + cycle_ns
            self.window.begin(self._next)
        elif self.fixed:
            self.stop(now)

    def started(self, at: int) -> None:
        """The first bit of the round's first request is on the line at ``at``."""
        self.started_at = at
        if not self.fixed:
            self.due_at = at
            return
        book = self.book
        if self.due_at == _OPEN:
            self.due_at = at
            self.window.next_at = self._next = at + book.cycle_ns
        late = at - self.due_at
        book.begun += 1
        book.late.add(late)
        if late > self._tolerance:
            self._miss(self._cause, 1, late, self.number, at, left_out=False)
        elif self._unreported:
            self._report(at)

    def over(self, now: int) -> None:
        """The cyclic part of the round is over."""
        self._over_at = now
        if self.fixed:
            # a round without any request has no first bit
            self._took_before, self._took = self._took, now + self._idle - max(self.started_at, self._begun_at)

    def pause(self, until: int) -> None:
        """Let the token go round until the round goes on at ``until``."""
        self.window.next_at = min(until, self._next)

    def resume(self) -> None:
        self.window.next_at = self._next

    def stop(self, now: int) -> None:
        """End the grid; from now on rounds run free."""
        self.fixed, self._next = False, NEVER
        self.window.end()
        self._report_all(now)

    def forget(self) -> None:
        """Let the next round begin at once, because all slaves are lost."""
        self._begun_at = self._interval = 0

    def check(self, setup: SlaveParams) -> None:
        """Raises ConfigError if the fixed cycle is too fast for a slave."""
        turn_ns = self.book.cycle_ns * setup.every
        interval_ns = setup.min_slave_interval_ns
        if turn_ns and interval_ns > turn_ns:
            raise ConfigError(
                f"{setup.who}: its Min_Slave_Interval of {ms_text(interval_ns)} is longer "
                f"than {ms_text(turn_ns)}, the time between its turns; give it every = "
                f"{-(-interval_ns // self.book.cycle_ns)}, or take a longer cycle"
            )

    def _delays_the_next(self, late_ns: int) -> bool:
        """Whether a round whose first bit is ``late_ns`` after its due time is a deadline miss, fits into a cycle, and
        makes the next one a deadline miss too.

        The shorter of the last two rounds is the measure, because a repetition lengthens only one of them.
        """
        cycle_ns, takes = self.book.cycle_ns, min(self._took, self._took_before)
        return late_ns > self._tolerance and takes <= cycle_ns and late_ns + takes > cycle_ns + self._tolerance

    def _find_cause(self) -> Cause:
        """Why the cycle that is due could not begin."""
        if self._over_at > self._next:
            return MissReason.OVERRUN, f"the round before took {ms_text(self._over_at - self.started_at)}"
        if self.window.forced_service:
            return MissReason.NO_ROOM, f"{self.window.forced_service} fits between no two cycles and was sent before"
        if self.window.unanswered:
            return MissReason.SILENCE, f"{self.window.unanswered} was not answered"
        if not self.window.alone:
            return MissReason.TOKEN, "the token came late from another master"
        return MissReason.LATE, "this computer or its port was late"

    def _miss(self, cause: Cause, count: int, late_ns: int, number: int, now: int, *, left_out: bool) -> None:
        """Count deadline misses, and report them unless something was reported less than a second ago."""
        self.book.miss(cause[0], count, left_out=left_out)
        if not self._unreported or late_ns > self._worst[0]:
            self._worst = late_ns, number, cause[1]
        self._unreported += count
        self._report(now)

    def _report(self, now: int) -> None:
        """Report the first miss at once, and the misses of the following second in one line."""
        if now - self._reported_at >= _REPORT_EVERY:
            self._reported_at = now
            self._report_all(now)

    def _report_all(self, now: int) -> None:
        if self._unreported:
            late_ns, number, why = self._worst
            missed = self.book.missed
            self._context.emit(
                CyclesMissed(
                    t_ns=now, count=self._unreported, missed=missed, number=number, late_ns=late_ns, reason=why
                )
            )
            self._unreported = 0
