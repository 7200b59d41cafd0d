"""Stations asked by this one: known and slow stations, late answers that may still come, odd answers."""

from __future__ import annotations

from typing import Final

from msgspec import Struct, field

from dpstack.fdl.active.fcb import FrameCount
from dpstack.fdl.active.las_gap import Gap
from dpstack.fdl.active.services import answers, same_answer
from dpstack.fdl.events import le3_notice
from dpstack.fdl.interface import LinkStats, Request
from dpstack.fdl.telegram import Telegram
from dpstack.trace import Event, Notice, Severity

#: an answer may be late by this number of slot times with the port's slack
_LATE_SLOTS: Final = 4
#: numbers of surplus answers, and of requests with unreadable answers, among ``_OF_REQUESTS`` that are reported
_DOUBLED: Final = 10
_UNREADABLE: Final = 50
_OF_REQUESTS: Final = 100


class _OddAnswers(Struct):
    """Odd answers of one station since its request number ``since``."""

    since: int
    superfluous: int = 0
    unreadable: int = 0
    reported_doubled: bool = False
    reported_unreadable: bool = False


class Peers(Struct, eq=False):
    """The stations asked by this one.

    ``due``: by address, the request whose answer may still come, and the end of that time in ns. ``gap`` knows the
    stations that answered a GAP poll, ``fcb`` those that answer requests.
    """

    gap: Gap
    fcb: FrameCount
    stats: LinkStats
    events: list[Event]
    due: dict[int, tuple[Request, int]] = field(default_factory=dict)
    #: stations that answered late: they get the slack of a known station until they are silent again
    _slow: set[int] = field(default_factory=set)
    #: stations that left a request unanswered since their last GAP poll: no additional slack for the next one
    _doubted: set[int] = field(default_factory=set)
    _odd: dict[int, _OddAnswers] = field(default_factory=dict)
    _le3: set[int] = field(default_factory=set)

    def knows(self, address: int) -> bool:
        """Whether ``address`` answered the last GAP poll (late, too) or the last request: its silence would be news."""
        if self.fcb.operational[address] or address in self._slow:
            return True
        return address in self.gap.stations and address not in self._doubted

    def is_slow(self, address: int) -> bool:
        return address in self._slow

    def silent(self, address: int) -> None:
        """``address`` left a request unanswered."""
        self._slow.discard(address)
        self._doubted.add(address)

    def polled(self, address: int, answered: bool) -> None:
        """The GAP poll of ``address`` is over."""
        self._doubted.discard(address)
        if not answered:
            self._slow.discard(address)

    def left_ring(self, address: int) -> None:
        """``address`` took none of three tokens: its GAP poll gets the slack of an unknown address."""
        self._slow.discard(address)
        self.gap.forget(address)

    # --- answers that may still come ---
    def expect_late(self, request: Request, now: int, slot_ns: int) -> None:
        """``request`` was given up or repeated after the slot time ``slot_ns``: its answer may still come."""
        self.due[request.da] = (request, now + _LATE_SLOTS * slot_ns)

    def expect_none(self, address: int) -> None:
        """The answer of ``address`` that was due has come."""
        self.due.pop(address, None)

    def due_from(self, telegram: Telegram, now: int) -> int:
        """The station whose late answer ``telegram`` may be, or -1. Forgets answers that are overdue."""
        due = self.due
        for address in [a for a, (_, until) in due.items() if now > until]:
            del due[address]
        for address, (request, _) in due.items():
            if answers(request, telegram):
                return address
        return -1

    def may_confuse(self, request: Request, now: int) -> bool:
        """Whether a late answer to an earlier request would fit ``request``, too."""
        return any(until >= now and same_answer(due, request) for due, until in self.due.values())

    # --- odd answers ---
    # Recognises two stations with one address: a station gives at most one answer to each attempt. A late answer
    # follows a failed attempt.
    def late(self, address: int, now: int) -> None:
        """``address`` gave a late answer."""
        self._slow.add(address)
        self.stats.late += 1
        self.stats.station(address).late += 1
        self.superfluous(address, now)

    def superfluous(self, address: int, now: int) -> None:
        """``address`` gave an answer without request. More answers than attempts come from two stations."""
        odd = self._odd_of(address)
        odd.superfluous += 1
        if odd.superfluous >= _DOUBLED and not odd.reported_doubled:
            odd.reported_doubled = True
            self._warn(
                f"station {address} gives more answers than it gets requests ({odd.superfluous} more): two stations "
                f"have address {address}, and what is read may be of either; switch one off, and give it another "
                "address",
                now,
            )

    def attempt_failed(self, address: int) -> None:
        """An attempt at ``address`` had no answer in time: the answer may come late."""
        odd = self._odd.get(address)
        if odd is not None and odd.superfluous:
            odd.superfluous -= 1

    def unreadable(self, address: int, first: bool, now: int) -> None:
        """The answer to an attempt at ``address`` was unreadable. ``first``: the first attempt of its request."""
        odd = self._odd_of(address)
        if first:
            odd.unreadable += 1
        if odd.unreadable >= _UNREADABLE and not odd.reported_unreadable:
            odd.reported_unreadable = True
            self._warn(
                f"half of the answers of station {address} cannot be read: check its cable, shielding and the "
                f"termination, and look for a second station with address {address}",
                now,
            )

    def empty_le3(self, address: int, now: int) -> None:
        """Report once that ``address`` sends SD2 telegrams with LE = 3."""
        if address not in self._le3:
            self._le3.add(address)
            self.events.append(le3_notice("fdl", address, now))

    def knows_only_fcv(self, address: int, now: int) -> None:
        self._warn(
            f"station {address} answered a request with FCV = 1 after three silent ones with FCV = 0: it was switched "
            "on just then, its answers came too late, or it does not know the standard's first request",
            now,
        )

    def _warn(self, text: str, now: int) -> None:
        self.events.append(Notice(t_ns=now, source="fdl", message=text, severity=Severity.WARNING))

    def _odd_of(self, address: int) -> _OddAnswers:
        requests = self.stats.station(address).requests
        odd = self._odd.get(address)
        if odd is None:
            odd = self._odd[address] = _OddAnswers(requests)
        elif requests - odd.since > _OF_REQUESTS:
            odd.since, odd.superfluous, odd.unreadable = requests, 0, 0
        return odd
