"""Visiting a bus for one errand: into its token ring at an address that nobody uses, and out of it in order."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Collection
from typing import TYPE_CHECKING, Final

from dpstack.errors import BusError
from dpstack.params import MAX_STATION

if TYPE_CHECKING:
    from dpstack.api.bus.bus import Bus

#: so many addresses in use are tried before somebody has to name one
_TRIES: Final = 8

#: Makes a bus at a station address that is not open yet.
MakeBus = Callable[[int], "Bus"]


@contextlib.asynccontextmanager
async def joined(make_bus: MakeBus, address: int | None = None, *, avoid: Collection[int] = ()) -> AsyncIterator[Bus]:
    """A bus in the ring, closed in order at the end.

    Its address is the lowest that is not heard (0 is the one kept for tools) and not to be avoided, unless given.
    Raises PortError, BusError.
    """
    candidates = [own for own in range(MAX_STATION + 1) if own not in avoid] if address is None else [address]
    for tries, own in enumerate(candidates):
        bus = make_bus(own)
        try:
            await bus.open()
        except BusError:
            if bus.collided and address is None and tries < _TRIES:
                continue
            raise
        break
    try:
        yield bus
    finally:
        await bus.close()
