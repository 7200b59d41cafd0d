"""Membership in the token ring: the LAS, whether this station is in the ring, and whose token it accepts."""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from dpstack.fdl.active.las_gap import Announced, Gap, News, Ring
from dpstack.fdl.events import MasterSeen, RingJoined, RingLeft
from dpstack.params import BusParams
from dpstack.trace import Event

_NO_PASS: Final = (-1, -1)


class Membership(Struct, eq=False):
    params: BusParams
    ring: Ring
    gap: Gap
    announced: Announced
    events: list[Event]
    in_ring: bool = False
    #: this station claimed the token on a silent bus and has got no token from another master since
    claimed: bool = False
    #: the station goes offline after this token hold
    leaving: bool = False
    _refused: int = -1  # sender of a token that the station refused once
    _last_pass: tuple[int, int] = _NO_PASS  # SA and DA of the last token between others, while nothing else followed
    _in_vain: int = -1  # the sender that repeated that pass: its NS is silent
    _staggered: int = 0  # number of tokens to itself that the station still delays by TS bit times

    # --- accepting a token ---
    def accepts(self, sa: int) -> bool:
        """Whether to accept a token from ``sa``: only the predecessor may pass it.

        A station that passes the token a second time is the new predecessor. At its first token already, so is a
        station that has repeated a pass to a silent successor: it has the token, and its ring has changed. (Without
        this exception each master that left the ring cost one more T_SL with all the host's slack.)
        """
        if sa not in (self.ring.ps, self._refused, self._in_vain):
            self._refused = sa
            return False
        self._refused = -1
        self.forget_pass()
        self.claimed = False
        return True

    def saw_pass(self, sa: int, da: int) -> None:
        """Another station passed the token to a third one."""
        self._refused = -1
        self._in_vain = sa if (sa, da) == self._last_pass else -1
        self._last_pass = (sa, da)

    def forget_pass(self) -> None:
        """Another telegram followed the last pass between others: the successor was not silent."""
        self._last_pass = _NO_PASS
        self._in_vain = -1

    def claim(self) -> None:
        """This station has claimed the token."""
        self.claimed = True
        self.stagger()

    # --- joining and leaving ---
    def join(self, now: int) -> None:
        """The first token hold begins."""
        self.in_ring = True
        self.gap.restart()
        masters = tuple(sorted(self.ring.members))
        self.events.append(RingJoined(t_ns=now, address=self.params.address, claimed=self.claimed, masters=masters))

    def leave(self, now: int, reason: str) -> None:
        """Leave the ring; the event is reported once."""
        self._refused = -1
        self.forget_pass()
        self.ring.forget()
        self.announced.forget()
        if self.in_ring:
            self.in_ring = False
            self.events.append(RingLeft(t_ns=now, address=self.params.address, reason=reason))

    def listen(self, now: int) -> None:
        """Begin to listen with an empty LAS."""
        self.ring.forget()
        for address in sorted(self.announced.masters):
            self.report_master(address, now)

    # --- the other masters ---
    def report_master(self, address: int, now: int) -> None:
        """Report a master that certainly joined or left, unless the station has already reported it."""
        self._report(self.announced.certain(address, address in self.ring.members), now)

    def report_token(self, sa: int, now: int) -> None:
        """Report the masters that certainly joined or left by a token from ``sa``, which is in the LAS."""
        if self.ring.learned or self.in_ring:
            self._report(self.announced.token(sa, frozenset(self.ring.members) - {self.params.address}), now)

    def _report(self, news: News, now: int) -> None:
        for address, present in news:
            before = present and not self.in_ring
            self.events.append(MasterSeen(t_ns=now, address=address, present=present, before=before))

    # --- alone in the ring ---
    def stagger(self) -> None:
        """Delay the tokens to itself for one pass over the GAP: this station is suddenly alone in its ring.

        Another station may be alone too, in step and unheard. With the GAP off the user expects no other master.
        """
        self._staggered = self.params.hsa + 1 if self.gap.enabled else 0

    def stagger_ns(self) -> int:
        """Additional silence before the next token.

        Two token holders in step (each lost the other's tokens) do not hear each other: their addresses make their
        times differ.
        """
        if self.ring.ns != self.params.address:
            self._staggered = 0
        elif self._staggered:
            self._staggered -= 1
            return self.params.ns(self.params.address)
        return 0
