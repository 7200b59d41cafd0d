"""Whose turn it is in a cycle: the rate groups while the bus runs (their offsets: :mod:`dpstack.dp.rate_groups`).

A turn that could not be taken (the cycle was left out) is taken in the next cycle, the one after that in its own.
"""

from __future__ import annotations

from collections.abc import Sequence

from dpstack.dp.rate_groups import offsets, round_interval_ns
from dpstack.dp.slave_params import SlaveSetup
from dpstack.dp.telegram_times import share
from dpstack.params import BusParams


class RateTurns:
    """The slaves that are not due in every cycle. Free running the rounds are counted the same way."""

    __slots__ = ("_due", "_params", "_rare", "_setups")

    def __init__(self, params: BusParams) -> None:
        self._params = params
        self._setups: Sequence[SlaveSetup] = ()
        #: by address: n and offset, and the number of the next turn
        self._rare: dict[int, tuple[int, int]] = {}
        self._due: dict[int, int] = {}

    def arrange(self, setups: Sequence[SlaveSetup]) -> None:
        """The slaves there are, whether they are in data exchange or not; who was there keeps its offset."""
        if setups == self._setups:
            return
        self._setups = setups
        kept = {address: offset for address, (_, offset) in self._rare.items()}
        chosen = offsets((share(self._params, s) for s in setups), kept)
        rare = {s.address: (s.every, chosen[s.address]) for s in setups if s.every > 1}
        self._due = {a: at for a, at in self._due.items() if rare.get(a) == self._rare[a]}
        self._rare = rare

    @property
    def uneven(self) -> bool:
        """Somebody is not due in every cycle."""
        return bool(self._rare)

    def due(self, address: int, number: int) -> bool:
        """Whether the slave at ``address`` has a turn in cycle ``number``, or one it could not take before."""
        spread = self._rare.get(address)
        if spread is None:
            return True
        at = self._due.get(address)
        if at is None:
            every, offset = spread
            at = self._due[address] = number + (offset - number) % every
        return number >= at

    def taken(self, address: int, number: int) -> None:
        """It had its turn in cycle ``number``."""
        spread = self._rare.get(address)
        if spread is not None:
            every, offset = spread
            self._due[address] = number + 1 + (offset - number - 1) % every

    def away(self, address: int) -> None:
        """It left data exchange: when it comes back it takes the next turn of its own."""
        self._due.pop(address, None)

    @staticmethod
    def interval_ns(setups: Sequence[SlaveSetup]) -> int:
        """The shortest time between the beginnings of two free running rounds that leave out who has no turn."""
        return round_interval_ns((s.every, s.min_slave_interval_ns) for s in setups)
