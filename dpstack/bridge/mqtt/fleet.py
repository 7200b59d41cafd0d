"""All segments of a broker as their statuses, births, deaths and wills show them: messages in, changed segments out.

Knows no network and no clock. Whatever a broker sends, memory is bounded: :data:`MOST_SEGMENTS` segments, each with a
bounded status; what does not fit is counted. ``now``: s by a clock that nobody sets and that goes on while the computer
sleeps.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Final

from dpstack.bridge.mqtt.payload import BDSEQ, read_command, rebirth_command
from dpstack.bridge.mqtt.plant_node import SPARKPLUG
from dpstack.bridge.mqtt.session_file import NUMBERS
from dpstack.bridge.mqtt.status import ENDED, EXPIRY_S, FAILED, RENEW_S, RUNNING, Status, read_status
from dpstack.bridge.names import SPARKPLUG_ID
from dpstack.monitor.verdict import CRITICAL, GOOD, UNKNOWN, WARNING
from dpstack.text import printable

MOST_SEGMENTS: Final = 10_000
#: characters of a group or node
_MOST_NAME: Final = 120
_STATUS: Final = "status"
#: of a gateway with plain JSON
_ONLINE: Final = "online"
#: s by which the clock of a gateway may be ahead of that of this computer, if only ``sent`` dates a status
_MOST_AHEAD_S: Final = 2.0
#: s for which a status counts that the broker had kept: nobody has heard its gateway yet, and it sends one by then
_KEPT_S: Final = RENEW_S + 2.0
_NOT_DATED: Final = "the broker had kept its status without a message expiry: nobody knows how old it is"
_BORN: Final = "its gateway has begun anew; no status has come since"
#: s for which a segment is not ok whose session has a number of before: two gateways that take the connection over from
#: each other do so once a minute
_FLIPS_S: Final = 300.0
_FLIPPING: Final = "its session has gone back: another gateway uses this node's name, or its state folder was lost"
_ENDED_AFTER_DEATH: Final = "after its death came a status that says: ended"


class State(Enum):
    """State of a segment, worst first."""

    #: the broker has published its NDEATH, or its will in plain JSON
    DEAD = "dead"
    #: no status for 30 s
    SILENT = "silent"
    LOST = "lost slaves"
    CRITICAL = "critical"
    UNKNOWN = "unknown"
    WARNING = "warning"
    ENDED = "ended"
    OK = "ok"


#: states that make the end of ``dpstack fleet`` a finding
BAD: Final = frozenset({State.DEAD, State.SILENT, State.LOST, State.CRITICAL})
_STATES: Final = {GOOD: State.OK, WARNING: State.WARNING, CRITICAL: State.CRITICAL}
_RANK: Final = {state: number for number, state in enumerate(State)}


@dataclass(slots=True)
class Segment:
    """``heard``: when its gateway published ``status``; ``until``: when that is too old; ``since``: when ``state``
    began."""

    group: str
    node: str
    status: Status
    heard: float
    until: float
    dead: bool = False
    state: State = State.UNKNOWN
    since: float = 0.0
    #: when a session began whose number was used already; and whether that was within :data:`_FLIPS_S`
    went_back: float = -math.inf
    flips: bool = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """The reasons of its state."""
        return (_FLIPPING, *self.status.reasons) if self.flips else self.status.reasons


@dataclass(slots=True)
class Fleet:
    """``group``: of the segments that are taken; None: all. ``left_out``: messages of segments for which there was no
    room; ``broken``: messages that are no status, with the reason of the last one in ``why_broken``."""

    group: str | None = None
    most: int = MOST_SEGMENTS
    left_out: int = 0
    broken: int = 0
    why_broken: str = ""
    _segments: dict[tuple[str, str], Segment] = field(default_factory=dict)
    #: in their order, and their number by state; None: a segment is new or has another state since
    _sorted: list[Segment] | None = None
    _counts: dict[State, int] | None = None

    @property
    def subscriptions(self) -> tuple[str, ...]:
        group = "+" if self.group is None else self.group
        # in this order: a will that the broker has kept comes behind the status of its session
        return (
            f"{SPARKPLUG}/{group}/NDEATH/+",
            f"{SPARKPLUG}/{group}/NBIRTH/+",
            f"dpstack/{group}/+/{_STATUS}",
            f"dpstack/{group}/+/{_ONLINE}",
        )

    def __len__(self) -> int:
        return len(self._segments)

    def __iter__(self) -> Iterator[Segment]:
        """The worst first, then by group and node."""
        if self._sorted is None:
            self._sorted = sorted(self._segments.values(), key=lambda one: (_RANK[one.state], one.group, one.node))
        return iter(self._sorted)

    def get(self, group: str, node: str) -> Segment | None:
        return self._segments.get((group, node))

    def counts(self) -> dict[State, int]:
        """The number of segments in each state that there is, worst first."""
        if self._counts is None:
            found = Counter(one.state for one in self._segments.values())
            self._counts = {state: found[state] for state in State if found[state]}
        return self._counts

    def receive(
        self,
        topic: str,
        payload: bytes,
        now: float,
        *,
        expiry: int | None = None,
        session: int | None = None,
        retained: bool = False,
        wall: float = 0.0,
    ) -> Segment | None:
        """Take a message; ``expiry``: s of its message expiry that are left; ``session``: the number of the session
        whose will it is; ``retained``: the broker had kept it; ``wall``: s since 1970 by the clock of this computer.
        Nothing that it may hold raises. Returns the segment if people should see a change."""
        match topic.split("/", 4):
            case ["dpstack", group, node, end] if end == _STATUS:
                age = EXPIRY_S - expiry if expiry is not None and expiry <= EXPIRY_S else None
                return self._take_status(group, node, payload, now, age, retained=retained, wall=wall)
            case ["dpstack", group, node, end] if end == _ONLINE:
                # without a session the gateway says it itself: its bus is gone, which its status says, too
                segment = self._segments.get((group, node))
                if segment is None or session is None or session != segment.status.session:
                    return None
                segment.dead = True
                return self._judge(segment, now)
            case [name, group, kind, node] if name == SPARKPLUG:
                segment = self._segments.get((group, node))
                if segment is None:
                    return None
                if kind == "NBIRTH":
                    return self._take_birth(segment, payload, now)
                if kind == "NDEATH" and _session_of(payload) == segment.status.session:
                    segment.dead = True
                return self._judge(segment, now)
        return None

    def tick(self, now: float) -> list[Segment]:
        """The segments that have become silent."""
        return [one for one in self._segments.values() if self._judge(one, now) is not None]

    def _take_birth(self, segment: Segment, payload: bytes, now: float) -> Segment | None:
        session = _session_of(payload)
        is_new = isinstance(session, int) and session != segment.status.session
        if not segment.dead and not is_new:
            return None  # a host has asked for births
        segment.dead = False
        if isinstance(session, int) and _was_used(segment.status.session, session):
            segment.went_back = now
        segment.status = _not_known(segment.status, _BORN)
        if isinstance(session, int):
            segment.status = replace(segment.status, session=session)
        segment.heard, segment.until = now, now + EXPIRY_S
        return self._judge(segment, now) or segment

    def _take_status(
        self, group: str, node: str, payload: bytes, now: float, age: float | None, *, retained: bool, wall: float
    ) -> Segment | None:
        """``age``: s since it was published, by its message expiry."""
        if not payload:
            return None  # somebody has removed the retained message: the segment becomes silent
        for name in (group, node):
            if not 0 < len(name) <= _MOST_NAME or SPARKPLUG_ID.valid(name) != name:
                self._refuse("a name of group or node that Sparkplug does not permit")
                return None
        if self.group is not None and group != self.group:
            return None
        try:
            status = read_status(payload)
        except ValueError as error:
            self._refuse(f"{printable(group)}/{printable(node)}: {error}")
            return None
        segment = self._segments.get((group, node))
        if age is None:
            age = _age_by_clocks(status, wall) if retained else 0.0
        if age is None:
            age = 0.0
            if status.state == RUNNING:
                if segment is not None and status.sent <= segment.status.sent:
                    return None  # the same status again, at another connection of this program
                status = _not_known(status, _NOT_DATED)
        if segment is None:
            if len(self._segments) >= self.most:
                self.left_out += 1
                return None
            segment = Segment(group, node, status, now, now)
            self._segments[group, node] = segment
            before = None
        else:
            before = segment.status
            # in the session that has died, or an end without births: a death is not taken back by it
            is_old = retained and status.session == before.session
            segment.dead = segment.dead and (is_old or (status.state == ENDED and not retained))
            if status.session != before.session and _was_used(before.session, status.session):
                segment.went_back = now  # of plain JSON, or its birth was lost
            if segment.dead and status.state == ENDED and before.state != ENDED:
                status = replace(status, state=RUNNING, reasons=(_ENDED_AFTER_DEATH, *status.reasons))
        segment.status = status
        age = min(age, EXPIRY_S)
        segment.heard, segment.until = now - age, now - age + (_KEPT_S if retained else EXPIRY_S)
        changed = before is None or _seen(before) != _seen(status)
        return self._judge(segment, now) or (segment if changed else None)

    def _refuse(self, why: str) -> None:
        self.broken += 1
        self.why_broken = why

    def _judge(self, segment: Segment, now: float) -> Segment | None:
        """The segment if its state has changed."""
        status, segment.flips = segment.status, now - segment.went_back < _FLIPS_S
        if status.state == ENDED:
            state = State.ENDED
        elif status.state == FAILED:
            state = State.CRITICAL  # its gateway says more than its death
        elif segment.dead:
            state = State.DEAD
        elif now >= segment.until:
            state = State.SILENT
        elif status.lost_count:
            state = State.LOST
        else:
            state = _STATES.get(status.verdict, State.UNKNOWN)
            if segment.flips and state is not State.CRITICAL:
                state = State.WARNING
        if state is segment.state and segment.since:
            return None
        segment.state = state
        self._sorted = self._counts = None
        segment.since = segment.heard if state is State.SILENT else now
        return segment


def _age_by_clocks(status: Status, wall: float) -> float | None:
    """s since ``status`` was sent, if the clocks of its gateway and of this computer may agree; else None. A clock
    that is wrong by less than 30 s is not noticed."""
    age = wall - status.sent
    return max(0.0, age) if -_MOST_AHEAD_S <= age < EXPIRY_S else None


def _not_known(status: Status, why: str) -> Status:
    """``status`` without all that may not be so any more."""
    return replace(status, state=RUNNING, verdict=UNKNOWN, reasons=(why,), lost=(), more_lost=0)


def _was_used(before: int, session: int) -> bool:
    """Whether the gateway of the session ``before`` cannot have come to ``session``: each try has the next number."""
    return not 0 < (session - before) % NUMBERS < NUMBERS // 2


def _seen(status: Status) -> tuple[object, ...]:
    """The part of a status that people see, without its time."""
    return (status.state, status.verdict, status.reasons, status.lost, status.more_lost, status.versions)


def _session_of(payload: bytes) -> object:
    """The bdSeq of an NDEATH; None without one."""
    try:
        metrics = read_command(payload).metrics
    except ValueError:
        return None
    return next((one.value for one in metrics if one.name == BDSEQ.name), None)


def rebirth_of(group: str, node: str, now_ms: int) -> tuple[str, bytes]:
    """Topic and payload of the request for all births of an edge node."""
    return f"{SPARKPLUG}/{group}/NCMD/{node}", rebirth_command(now_ms)
