"""Book-keeping of the token ring: list of active stations (LAS), GAP list, reported masters.

These classes neither send nor wait. Addresses are 0..127, the ring ascends and wraps.

Every token changes the LAS at once, as the standard demands. But a token has no check sequence: at a wrong rate, or on
a disturbed line, three octets in a row look like a token now and then. So the station reports that a master joined or
left only after two tokens without unreadable octets between them. The answer to a GAP poll has a check sequence: it
counts at once.
"""

from __future__ import annotations

from typing import Final

from dpstack.fdl.allowance import Allowance
from dpstack.fdl.interface import DecoderStats
from dpstack.fdl.telegram import StationType
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience

_CIRCLE: Final = 128
#: a claim consists of two tokens to itself; a third one in a row proves that the sender regards itself as alone
CLAIM_TOKENS: Final = 2


def distance(start: int, end: int) -> int:
    """Steps upwards from ``start`` to ``end``, 1..128; from a station to itself 128."""
    return (end - start - 1) % _CIRCLE + 1


class Ring:
    """The list of active stations (LAS) as station ``ts`` knows it; ``ts`` is always a member.

    ``ns`` and ``ps`` are the next and previous station (``ts`` itself when alone).
    """

    def __init__(self, ts: int) -> None:
        self.ts = ts
        self.forget()

    def forget(self) -> None:
        """Reset the LAS to TS alone."""
        self.members: set[int] = {self.ts}
        self.ns = self.ps = self.ts
        self.learned = False
        self._order: list[int] = []
        self._rotation: frozenset[int] = frozenset()
        self._last_self = -1
        self._self_tokens = 0

    def learn(self, sa: int, da: int) -> bool:
        """Use a token received while listening; True after two identical rotations (then each token is observed).

        A rotation ends when a station sends the token a second time. The same sender twice in a row is a repeated
        pass, not a rotation, unless it sends to itself.
        """
        if self.learned:
            self.observe(sa, da)
            return True
        order = self._order
        if order and order[-1] == sa and sa != da:
            return False
        if sa in order:
            rotation = frozenset(order[order.index(sa) :])
            if rotation == self._rotation:
                self.learned = True
                self.members = {*rotation, self.ts}
                self._neighbours()
            self._rotation = rotation
            order.clear()
        order.append(sa)
        return self.learned

    def observe(self, sa: int, da: int) -> bool:
        """A token from ``sa`` to ``da``: both are in the ring, no station between them is. True when the LAS changed.

        TS stays a member; :meth:`skips` says whether the token passed it over.
        """
        if sa == da and not self._believes_alone(sa):
            return self.add(sa)
        if sa != da:
            self._self_tokens = 0
        reach = distance(sa, da)
        keep = {m for m in self.members if distance(sa, m) >= reach or m == self.ts}
        keep |= {sa, da}
        if keep == self.members:
            return False
        self.members = keep
        self._neighbours()
        return True

    def _believes_alone(self, sa: int) -> bool:
        self._self_tokens = self._self_tokens + 1 if sa == self._last_self else 1
        self._last_self = sa
        return self._self_tokens > CLAIM_TOKENS

    def skips(self, sa: int, da: int) -> bool:
        """Whether an observed token from ``sa`` to ``da`` passes TS over: TS is not in the LAS of its sender."""
        if sa == da:
            return sa != self.ts and self._last_self == sa and self._self_tokens > CLAIM_TOKENS
        return distance(sa, self.ts) < distance(sa, da)

    def add(self, address: int) -> bool:
        """``address`` is ready for the token. True when it was not in the LAS."""
        if address in self.members:
            return False
        self.members = {*self.members, address}
        self._neighbours()
        return True

    def drop(self, address: int) -> bool:
        """``address`` does not take the token. True when it was in the LAS; TS is never dropped."""
        if address == self.ts or address not in self.members:
            return False
        self.members = self.members - {address}
        self._neighbours()
        return True

    def _neighbours(self) -> None:
        self.ns = min(self.members, key=lambda m: distance(self.ts, m))
        self.ps = min(self.members, key=lambda m: distance(m, self.ts))


class Gap:
    """The GAP list: addresses from TS + 1 to NS - 1, wrapping at HSA to 0, polled in passes G x T_TR apart.

    docs/reference/protocol.md#gap-update. ``stations`` are those that answered, with their type.
    """

    def __init__(self, params: BusParams) -> None:
        self._ts = params.address
        self._hsa = params.hsa
        self._t_gud_ns = params.gap * params.ns(params.t_tr)
        self.enabled = params.gap > 0
        self.stations: dict[int, StationType] = {}
        #: token holds in a row that left no time for a poll that was due
        self.skipped = 0
        self._cursor = -1
        self._next_pass_at = 0
        self.limit(EXACT, 0, 0)

    def limit(self, patience: Patience, cost_ns: int, now: int) -> None:
        """Limit the bus time for silent polls of ``cost_ns`` each by ``patience`` and the size of the GAP."""
        self._patience = patience
        self._cost_ns = cost_ns
        #: bus time for silent polls of unknown addresses
        self.allowance = Allowance(0, cost_ns, now)
        self._ns = -1  # the NS for which the share was calculated

    def restart(self) -> None:
        """Begin a new pass over the GAP at the next opportunity."""
        self._cursor = -1
        self._next_pass_at = 0

    def due(self, ns: int, now: int) -> int:
        """The address to poll next, -1 when none is due. The call does not move on; NS ends the GAP."""
        if not self.enabled:
            return -1
        if ns != self._ns:
            self._ns = ns
            self.allowance.divisor = self._patience.gap_divisor(self._size(ns), self._cost_ns)
        if self._cursor < 0:
            if now < self._next_pass_at:
                return -1
            self._next_pass_at = now + self._t_gud_ns
            self._cursor = self._after(self._ts)
        if not distance(self._ts, self._cursor) < distance(self._ts, ns):
            self._cursor = -1
            return -1
        return self._cursor

    def polled(self, address: int, kind: StationType | None) -> bool:
        """The poll of ``address`` has ended. ``kind``: its type, None when silent. True when that is news."""
        self._cursor = self._after(address)
        self.skipped = 0
        known = self.stations.get(address)
        if kind is None:
            return self.stations.pop(address, None) is not None
        self.stations[address] = kind
        return kind is not known

    def forget(self, address: int) -> None:
        """Forget the station at ``address``, which does not take the token."""
        self.stations.pop(address, None)

    def passed(self, address: int) -> None:
        """The answer to the poll of ``address`` was unreadable: move on without a conclusion."""
        self._cursor = self._after(address)
        self.skipped = 0

    def _size(self, ns: int) -> int:
        return sum(1 for address in range(self._hsa + 1) if distance(self._ts, address) < distance(self._ts, ns))

    def _after(self, address: int) -> int:
        # TS itself ends a pass even when NS lies above HSA, where the wrap would jump over it
        return 0 if address >= self._hsa else address + 1


#: addresses of masters that joined (True) or left (False)
News = list[tuple[int, bool]]


class Announced:
    """The masters that the station has reported. ``received``: counters of the receiver, with unreadable octets."""

    def __init__(self, received: DecoderStats) -> None:
        self._received = received
        self._skipped = 0  # up to the last token
        self.masters: frozenset[int] = frozenset()
        self._heard: set[int] = set()  # masters that have sent one token
        self._missing: dict[
            int, int
        ] = {}  # reported masters that a token removed from the LAS, with the sender of that token

    def forget(self) -> None:
        """Forget all reported masters."""
        self.masters = frozenset()
        self._heard.clear()
        self._missing.clear()

    def certain(self, address: int, present: bool) -> News:
        """The master ``address`` is certainly present, or certainly not: the changes to report."""
        if present is (address in self.masters):
            return []
        self.masters = self.masters ^ {address}
        return [(address, present)]

    def token(self, sa: int, members: frozenset[int]) -> News:
        """The changes to report after a token from ``sa``; ``members``: the other masters in the LAS now."""
        if self._received.skipped != self._skipped:
            self._skipped = self._received.skipped
            self._heard.clear()
            self._missing.clear()
        again = sa in self._heard
        self._heard.add(sa)
        if members == self.masters:
            self._missing.clear()
            return []
        gone = self.masters - members
        left = {a for a in gone if self._missing.get(a) == sa}
        self._missing = {a: self._missing.get(a, sa) for a in gone - left}
        joined = {sa} if again and sa in members - self.masters else set()
        self.masters = self.masters - left | joined
        return sorted([(a, True) for a in joined] + [(a, False) for a in left])
