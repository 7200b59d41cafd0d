"""This station's place in the token ring: the LAS, whether it is in the ring, and whose token it takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.fdl.active.las_gap import Announced, Gap, News, Ring
from dpstack.fdl.events import MasterSeen, RingJoined, RingLeft
from dpstack.params import BusParams
from dpstack.trace import Event

_NO_PASS: Final = (-1, -1)


@dataclass(slots=True, eq=False)
class Membership:
    params: BusParams
    ring: Ring
    gap: Gap
    announced: Announced
    events: list[Event]
    in_ring: bool = False
    #: the token was claimed on a silent bus; nobody has passed one since
    claimed: bool = False
    #: it goes offline after this token hold
    leaving: bool = False
    _refused: int = -1  # sender of a token refused once
    _last_pass: tuple[int, int] = _NO_PASS  # SA and DA of the last token between others, while nothing else followed
    _in_vain: int = -1  # who repeated that pass: its NS is silent
    _staggered: int = 0  # so many tokens to ourselves are delayed by TS bit times

    def set_leaving(self, leaving: bool) -> None:
        self.leaving = leaving

    # --- whose token ---
    def accepts(self, sa: int) -> bool:
        """Whether to take a token from ``sa``: only the predecessor may pass it.

        Whoever insists is the new predecessor. So is, at its first token, a station that was heard repeating a pass to
        another one which stayed silent: it has the token, and its ring has changed. (A master that leaves cost the
        others one more T_SL with all the host's slack.)
        """
        if sa not in (self.ring.ps, self._refused, self._in_vain):
            self._refused = sa
            return False
        self._refused = -1
        self.forget_pass()
        self.claimed = False
        return True

    def saw_pass(self, sa: int, da: int) -> None:
        """A token between others while this station does not have it."""
        self._refused = -1
        self._in_vain = sa if (sa, da) == self._last_pass else -1
        self._last_pass = (sa, da)

    def forget_pass(self) -> None:
        """Another telegram followed the last pass between others: it was no pass in vain."""
        self._last_pass = _NO_PASS
        self._in_vain = -1

    def claim(self) -> None:
        """The token is claimed."""
        self.claimed = True
        self.stagger()

    # --- joining and leaving ---
    def join(self, now: int) -> None:
        """The first token hold."""
        self.in_ring = True
        self.gap.restart()
        masters = tuple(sorted(self.ring.members))
        self.events.append(RingJoined(t_ns=now, address=self.params.address, claimed=self.claimed, masters=masters))

    def leave(self, now: int, reason: str) -> None:
        """Out of the ring; reported once."""
        self._refused = -1
        self.forget_pass()
        self.ring.forget()
        self.announced.forget()
        if self.in_ring:
            self.in_ring = False
            self.events.append(RingLeft(t_ns=now, address=self.params.address, reason=reason))

    def listen(self, now: int) -> None:
        """Begin to listen: nothing is known of the ring."""
        self.ring.forget()
        for address in sorted(self.announced.masters):
            self.report_master(address, now)

    # --- the other masters ---
    def report_master(self, address: int, now: int) -> None:
        """Report that a master came or went beyond doubt, unless that was reported."""
        self._report(self.announced.certain(address, address in self.ring.members), now)

    def report_token(self, sa: int, now: int) -> None:
        """A token from ``sa`` is in the LAS: report the masters that certainly came or went."""
        if self.ring.learned or self.in_ring:
            self._report(self.announced.token(sa, frozenset(self.ring.members) - {self.params.address}), now)

    def _report(self, news: News, now: int) -> None:
        for address, present in news:
            before = present and not self.in_ring
            self.events.append(MasterSeen(t_ns=now, address=address, present=present, before=before))

    # --- alone in the ring ---
    def stagger(self) -> None:
        """Alone all at once: another one may be, in step and unheard; a GAP pass long the tokens to ourselves differ.

        With the GAP off nobody else is expected.
        """
        self._staggered = self.params.hsa + 1 if self.gap.enabled else 0

    def stagger_ns(self) -> int:
        """Additional silence before the next token.

        Two holders in step (both lost the other's tokens) hear nothing of each other: their addresses set them apart.
        """
        if self.ring.ns != self.params.address:
            self._staggered = 0
        elif self._staggered:
            self._staggered -= 1
            return self.params.ns(self.params.address)
        return 0
