"""Orders to the link layer of an active station, and actions at a passive station."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from dpstack.fdl.interface import LinkUser
from dpstack.machine import Order
from dpstack.params import BusParams
from dpstack.phy.patience import Patience


class GoOnline(Order):
    """Leave Offline: listen to the bus, then join the ring or claim the token."""


class GoOffline(Order):
    """Leave the ring in order (the token is passed on first) and stay silent."""

    ENDS = True


class AttachUser(Order):
    """Add a user of the link layer; the station asks it after the present users.

    ``token``: :class:`DetachUser` has the same.
    """

    token: int

    def link_user(self, params: BusParams, patience: Patience, now: int) -> LinkUser:
        """The user, for a station with ``params`` at a port with ``patience``. Each derived class has it."""
        raise NotImplementedError


class DetachUser(Order):
    """Remove the user with the order ``token``, if there is one. It gets no result of its current request."""

    ENDS = True

    token: int


class AtStation(Struct, frozen=True):
    """An action at a passive station other than a telegram (its switch, its keys): the station calls ``act(now)``.

    Afterwards the station checks deadlines, address and events. An exception of ``act`` reaches the caller.
    """

    act: Callable[[int], None]
