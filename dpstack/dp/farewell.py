"""Slaves that are given up while the bus runs: safe values as at the end, then Unlock."""

from __future__ import annotations

from collections import deque
from typing import Final

from dpstack.dp.events import SlaveState
from dpstack.dp.ms0 import unlock_prm
from dpstack.dp.slave_handler import SlaveHandler
from dpstack.fdl.telegram import SAP_SET_PRM, SSAP_MS0, Req
from dpstack.fdl.user import Request
from dpstack.units import NS_PER_MS

#: Safe values stand at least so long, because drives look at their outputs only every 4 to 32 ms (drives, row D17)
#: and Clear's zeros mean nothing to some of them (bit 10 of STW1).
SAFE_HOLD: Final = 50 * NS_PER_MS


class Farewells:
    """Who is leaving: one request a round to each until it is unlocked."""

    __slots__ = ("_leaving", "_turns")

    def __init__(self) -> None:
        self._leaving: deque[tuple[SlaveHandler, int]] = deque()
        self._turns = 0

    def __bool__(self) -> bool:
        return bool(self._leaving)

    def add(self, handler: SlaveHandler, now: int) -> None:
        """Begin with the next round; a slave that was parameterised only has no outputs to make safe."""
        if handler.owned:
            exchanging = handler.state is SlaveState.DATA_EXCHANGE
            self._leaving.append((handler, now + SAFE_HOLD if exchanging else now))

    def awaits(self, address: int) -> bool:
        """Whether the slave at ``address`` is not unlocked yet."""
        return any(handler.setup.address == address for handler, _ in self._leaving)

    def clear(self) -> None:
        """Nothing can be sent any more: the slaves' watchdogs do the rest."""
        self._leaving.clear()
        self._turns = 0

    def begin_round(self) -> None:
        """One request to each follows."""
        self._turns = len(self._leaving)

    def request(self, now: int) -> Request | None:
        """The next request of this round, or None."""
        if not self._turns:
            return None
        self._turns -= 1
        handler, until = self._leaving.popleft()
        setup = handler.setup
        if now < until:
            self._leaving.append((handler, until))
            return Request(setup.address, Req.SRD_HIGH, setup.safe_outputs, patient=True)
        data = unlock_prm(setup, handler.ident or 0)
        return Request(setup.address, Req.SRD_HIGH, data, SAP_SET_PRM, SSAP_MS0, patient=True)
