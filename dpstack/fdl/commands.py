"""Orders to an active station's link layer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GoOnline:
    """Leave Offline: listen to the bus, then join the ring or claim the token."""


@dataclass(frozen=True, slots=True)
class GoOffline:
    """Leave the ring in order (the token is passed on first) and stay silent."""
