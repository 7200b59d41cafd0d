"""Checks of the token rules: one token, only its holder sends requests, it goes to the next higher address."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from dpstack.sim.nodes import Node

#: first attempt and two repetitions before the successor counts as absent
PASS_ATTEMPTS: Final = 3
_CIRCLE: Final = 128


class Rule(Enum):
    """The rules that the referee checks."""

    COLLISION = "collision"  # two transmissions overlap
    EARLY = "answer too early"  # before min T_SDR
    LATE = "answer too late"  # after T_SL: the master may have moved on
    UNASKED = "answer nobody asked for"
    IDLE = "missing idle time"  # T_SYN, T_ID1, T_ID2
    SLOT = "slot time cut short"  # the next request or token before T_SL, and nobody had answered
    RIGHT = "sent without the token"
    TWO_TOKENS = "two tokens"
    CLAIM = "token claimed too early"  # before T_TO
    ORDER = "token out of order"  # a member of the ring passed over
    BROKEN = "broken telegram"  # octets that are no telegram, or gaps inside one


class Finding(NamedTuple):
    """A rule that was broken, and how."""

    rule: Rule
    text: str


@dataclass(slots=True)
class _Offer:
    """A token that ``sa`` has sent ``tries`` times and that ``da`` has not used yet."""

    sa: int
    da: int
    tries: int


class TokenWatch:
    """The token rules of one wire. ``ring``: the stations that have used the token and still get it."""

    def __init__(self) -> None:
        self.holder: int | None = None
        self.ring: set[int] = set()
        self._node: Node | None = None  # of the holder: two stations may have one address
        self._offer: _Offer | None = None

    @property
    def offered_by(self) -> int | None:
        """The station that has passed the token and waits for its successor to use it."""
        return None if self._offer is None else self._offer.sa

    def request(self, sa: int, node: Node | None) -> Finding | None:
        offer = self._offer
        if offer is not None and sa == offer.sa and self.holder == sa:
            self._offer = None
            return Finding(Rule.RIGHT, f"station {sa} sends a request after it passed the token to {offer.da}")
        finding = self._check_holder(sa, node, "sends a request")
        if finding is not None:
            self._set_holder(sa, node)
        return finding

    def token(self, sa: int, da: int, node: Node | None, lacks: str | None = None) -> Finding | None:
        """``sa`` sends the token to ``da``.

        ``lacks``: the reason why ``sa`` may not claim the token; "" after a silence of T_TO, None if T_TO is unknown.
        """
        finding = None
        if sa == da and lacks == "":
            self._claim(sa, node)
        else:
            finding = self._check_holder(sa, node, f"passes the token to {da}")
        if finding is not None:
            if sa != da:
                finding = Finding(Rule.TWO_TOKENS, finding.text)
            elif finding.rule is Rule.RIGHT:
                finding = Finding(Rule.CLAIM, f"station {sa} claims the token {lacks}") if lacks else None
            self._claim(sa, node)
        order = self._check_order(sa, da)
        tries = 1 + (self._offer.tries if self._offer is not None and self._offer.da == da else 0)
        self._offer = None if sa == da else _Offer(sa, da, tries)
        return finding or order

    def _claim(self, sa: int, node: Node | None) -> None:
        self._set_holder(sa, node)
        self.ring = {sa}

    def _check_holder(self, sa: int, node: Node | None, does: str) -> Finding | None:
        """Check that ``sa`` may send; its sending confirms that it has received the token."""
        offer = self._offer
        if offer is not None and sa == offer.da:
            self._set_holder(sa, node)
            self.ring |= {offer.sa, sa}
            return None
        if sa != self.holder:
            holds = "nobody has it" if self.holder is None else f"{self.holder} has it"
            return Finding(Rule.RIGHT, f"station {sa} {does} without having the token ({holds})")
        if self._node is not node and node is not None and self._node is not None:
            return Finding(
                Rule.TWO_TOKENS, f"a second station {sa} {does}; another one with this address has the token"
            )
        return None

    def _set_holder(self, sa: int, node: Node | None) -> None:
        self.holder = sa
        self._node = node
        self._offer = None

    def _check_order(self, sa: int, da: int) -> Finding | None:
        offer = self._offer
        if offer is not None and offer.da != da:
            self.ring.discard(offer.da)
            if offer.tries < PASS_ATTEMPTS:
                return Finding(
                    Rule.ORDER, f"station {sa} gave up on {offer.da} after {offer.tries} of {PASS_ATTEMPTS} attempts"
                )
        reach = _distance(sa, da)
        skipped = sorted(m for m in self.ring if m != sa and _distance(sa, m) < reach)
        if not skipped:
            return None
        self.ring -= set(skipped)
        return Finding(Rule.ORDER, f"station {sa} passes the token to {da}, over {', '.join(map(str, skipped))}")


def _distance(start: int, end: int) -> int:
    """Steps upwards in the ring; 128 from a station to itself."""
    return (end - start - 1) % _CIRCLE + 1
