"""Getting into the token ring: at an address that nobody uses; and why it did not work, for people."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Collection
from typing import TYPE_CHECKING, Final

from dpstack.errors import BusError
from dpstack.fdl.active import ActiveStation
from dpstack.params import MAX_STATION

if TYPE_CHECKING:
    from dpstack.api.bus import Bus

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


def why_not_joined(station: ActiveStation, after_s: float) -> str:
    """One line that says what was heard instead, and what to do."""
    own = station.address
    late = f"station {own} is not in the token ring after {after_s:g} s"
    others = sorted(station.las - {own})
    if others:
        return (
            f"{late}: masters {', '.join(map(str, others))} do not let it in; "
            f"their HSA must be {own} or more and their GAP on"
        )
    if station.decoder_stats.octets:
        return f"{late}: what is heard is no PROFIBUS at this rate; check the baud rate, A and B, the termination"
    return f"{late}: nothing is heard and nothing could be sent; check port and cable"


def what_was_heard(station: ActiveStation) -> str:
    """One line: what a station that has just joined heard before, of its own address nothing."""
    heard, bad = station.stats.heard, station.decoder_stats.bad
    others = sorted(station.las - {station.address})
    unreadable = f"{bad} damaged" if heard else f"{bad} damaged telegrams, no readable one: is this the right rate?"
    words = [f"{heard} telegrams"] if heard else []
    words += [unreadable] if bad else []
    words += [f"master{'s' if len(others) > 1 else ''} {', '.join(map(str, others))}"] if others else []
    return f"listened first: {', '.join(words) or 'silence'}; nobody has address {station.address}"
