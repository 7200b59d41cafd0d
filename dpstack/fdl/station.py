"""What the medium needs from a station beyond the machine contract."""

from __future__ import annotations

from typing import Protocol

from dpstack.fdl.telegram import Telegram
from dpstack.machine import Machine


class BusStation(Machine, Protocol):
    """A station that can be on a simulated medium: it can be handed whole telegrams instead of octets."""

    @property
    def address(self) -> int:
        """The station address, 0..126."""

    @property
    def hears_all(self) -> bool:
        """True for ring members, referees and listeners: every telegram concerns them, not only their own."""

    def activity(self, now: int) -> None:
        """A start edge on a silent line. What follows is a telegram, octets, or nothing that can be read.

        Only told to stations that hear all, and to the addressee. Ports that cannot see edges never call it.
        """

    def telegram(self, telegram: Telegram, now: int) -> None:
        """A whole, intact telegram whose last bit was on the wire at ``now``, decoded once for all receivers."""
