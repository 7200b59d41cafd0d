"""Orders to an active station's link layer."""

from __future__ import annotations

from dataclasses import dataclass

from dpstack.fdl.user import LinkUser


@dataclass(frozen=True, slots=True)
class GoOnline:
    """Leave Offline: listen to the bus, then join the ring or claim the token."""


@dataclass(frozen=True, slots=True)
class GoOffline:
    """Leave the ring in order (the token is passed on first) and stay silent."""


@dataclass(frozen=True, slots=True)
class AttachUser:
    """One more user of the link layer, asked after those there are; it costs nothing before and after."""

    user: LinkUser


@dataclass(frozen=True, slots=True)
class DetachUser:
    """Ask ``user`` no more; the end of a request of its under way is not told."""

    user: LinkUser
