"""Orders to a station: to an active one's link layer, and what is done at a passive one itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from dpstack.fdl.interface import LinkUser
from dpstack.machine import Order
from dpstack.params import BusParams
from dpstack.phy.patience import Patience


class GoOnline(Order):
    """Leave Offline: listen to the bus, then join the ring or claim the token."""


class GoOffline(Order):
    """Leave the ring in order (the token is passed on first) and stay silent."""

    ENDS = True


class AttachUser(Order, ABC):
    """One more user of the link layer, asked after those there are. It costs nothing before and after.

    ``token``: :class:`DetachUser` has the same.
    """

    token: int

    @abstractmethod
    def link_user(self, params: BusParams, patience: Patience, now: int) -> LinkUser:
        """The user, for a station with ``params`` at a port with ``patience``."""


class DetachUser(Order):
    """Ask the user that came with the order ``token`` no more, if it is there. The end of its request under way is not
    reported."""

    ENDS = True

    token: int


@dataclass(frozen=True, slots=True)
class AtStation:
    """Something happens at a passive station that is no telegram (its switch, its keys): ``act(now)``, in its time.

    Deadlines, address and events are looked at afterwards. What ``act`` raises is the caller's.
    """

    act: Callable[[int], None]
