"""Orders to a station: to an active one's link layer, and what is done at a passive one itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dpstack.fdl.interface import LinkUser


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


@dataclass(frozen=True, slots=True)
class AtStation:
    """Something happens at a passive station that is no telegram (its switch, its keys): ``act(now)``, in its time.

    Deadlines, address and events are looked at afterwards. What ``act`` raises is the caller's.
    """

    act: Callable[[int], None]
