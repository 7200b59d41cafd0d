"""Slaves that are given up while the bus runs: safe values as at the end, out of SYNC, then Unlock."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from dpstack.dp.master.slave_handler import SlaveHandler
from dpstack.dp.pdu.requests import GlobalControl
from dpstack.dp.services import unlock_prm
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SAP_GLOBAL_CONTROL, SAP_SET_PRM, SSAP_MS0, Req
from dpstack.units import NS_PER_MS

#: Safe values stand at least so long, because drives look at their outputs only every 4 to 32 ms (drives, row D17)
#: and Clear's zeros mean nothing to some of them (bit 10 of STW1).
SAFE_HOLD: Final = 50 * NS_PER_MS


@dataclass(slots=True)
class Leaving:
    """Who is leaving; the tag of its requests."""

    handler: SlaveHandler
    until: int  # safe values until then
    held: bool  # it is in SYNC or FREEZE: safe values are to reach its outputs
    safe: bool = False  # it was sent safe values


class Farewells:
    """Who is leaving: one request a round to each until it is unlocked."""

    __slots__ = ("_leaving", "_turns")

    def __init__(self) -> None:
        self._leaving: deque[Leaving] = deque()
        self._turns = 0

    def __bool__(self) -> bool:
        return bool(self._leaving)

    def add(self, handler: SlaveHandler, now: int, *, exchanging: bool, held: bool) -> None:
        """Begin with the next round; a slave that was parameterised only has no outputs to make safe.

        ``exchanging``: it has outputs. ``held``: in SYNC or FREEZE by our order.
        """
        if handler.owned and not self.awaits(handler.setup.address):
            self._leaving.append(Leaving(handler, now + SAFE_HOLD if exchanging else now, held and exchanging))

    def awaits(self, address: int) -> bool:
        """Whether the slave at ``address`` is not unlocked yet."""
        return any(leaving.handler.setup.address == address for leaving in self._leaving)

    def clear(self) -> None:
        """Nothing can be sent any more: the slaves' watchdogs do the rest."""
        self._leaving.clear()
        self._turns = 0

    def begin_round(self) -> None:
        """One request to each follows."""
        self._turns = len(self._leaving)

    def request(self, now: int, spaced: Mapping[int, int], *, clear: bool) -> Request | None:
        """The next request of this round, or None. ``clear``: the master is in Clear; ``spaced``: by address, no
        Data_Exchange before this time.
        """
        while self._turns:
            self._turns -= 1
            leaving = self._leaving.popleft()
            request = self._next(leaving, now, spaced, clear)
            if request is not None:
                return request
        return None

    def _next(self, leaving: Leaving, now: int, spaced: Mapping[int, int], clear: bool) -> Request | None:
        setup = leaving.handler.setup
        if leaving.held and leaving.safe:
            leaving.held = False
            self._leaving.append(leaving)
            data = GlobalControl(clear=clear, unsync=True, unfreeze=True).build()
            return Request(setup.address, Req.SDN_HIGH, data, SAP_GLOBAL_CONTROL, SSAP_MS0)
        if now < leaving.until or leaving.held:
            self._leaving.append(leaving)
            if now < spaced.get(setup.address, 0):
                return None
            leaving.safe = True
            safe = leaving.handler.unit.safe_outputs()
            return Request(setup.address, Req.SRD_HIGH, safe, patient=True, tag=leaving)
        leaving.handler.owned = False
        data = unlock_prm(setup, leaving.handler.ident)
        return Request(setup.address, Req.SRD_HIGH, data, SAP_SET_PRM, SSAP_MS0, patient=True)
