"""The fieldbus watchdog of the simulated F5 (docs/reference/drives/keb-f5.md#watchdog-of-the-operator): its start and
its signs of life.

Reading: with both bits of Fb39 either event begins it.
"""

from __future__ import annotations

from enum import IntFlag


class Life(IntFlag):
    """Signs of life, the bits of Fb40."""

    OUTPUTS = 1  # an output telegram to the inverter begins
    REQUEST = 2  # a parameter order begins
    EXCHANGE = 4  # user data were exchanged


class Watchdog:
    """Times in ns."""

    __slots__ = ("_begun", "_fed_at", "_seen", "expired")

    def __init__(self) -> None:
        self._begun = False
        self._seen = Life(0)
        self._fed_at = 0
        #: no sign of life for too long, until the next one
        self.expired = False

    def step(self, life: Life, now: int, *, activation: int, inhibit: int, time_ns: int) -> bool:
        """Signs of life since the last step, Fb39, Fb40, Pn.06 (0 none) -> True when it expires now."""
        self._seen |= life
        wanted = activation & (Life.OUTPUTS | Life.REQUEST)
        if not self._begun and (not wanted or wanted & self._seen):
            self._begun = True
            self._fed_at = now
        if life & inhibit:
            self._fed_at = now
            self.expired = False
        if not self._begun or not time_ns or self.expired or now - self._fed_at < time_ns:
            return False
        self.expired = True
        return True
