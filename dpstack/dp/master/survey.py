"""A live list that is made once while the bus runs, as an order of plain data."""

from __future__ import annotations

from dataclasses import dataclass

from dpstack.dp.master.scanner import Found, Scanner
from dpstack.fdl.livelist import LiveList, live_allowance, long_look
from dpstack.params import BusParams
from dpstack.phy.patience import Patience


@dataclass(frozen=True, slots=True)
class SurveyOrder:
    """Ask ``addresses``; ``skip``: their slaves are not asked further. ``configs``: ask for identifier octets too.

    ``quick``: silent addresses without regard to the port's share for them.
    """

    addresses: tuple[int, ...]
    skip: tuple[int, ...]
    configs: bool
    quick: bool

    def scanner(self, params: BusParams, patience: Patience, now: int) -> Scanner:
        """The link user that does it at the station of ``params``."""
        allowance = None if self.quick else live_allowance(params, patience, now)
        look = long_look(params, patience) if self.quick else None
        live = LiveList(params.address, addresses=self.addresses, allowance=allowance, long_look=look)
        return Scanner(params.address, live, configs=self.configs, skip=self.skip)


@dataclass(frozen=True, slots=True)
class SurveyResult:
    """What came of it, once everything was asked. ``unreadable``: addresses whose answers could not be read."""

    found: tuple[Found, ...]
    unreadable: tuple[int, ...]

    @classmethod
    def of(cls, scanner: Scanner) -> SurveyResult | None:
        """The result of ``scanner``; None while it is not complete."""
        if not scanner.done:
            return None
        found = tuple(found for _, found in sorted(scanner.found.items()))
        return cls(found, tuple(sorted(scanner.live.unreadable)))
