"""Getting into the token ring, and why it did not work, for people."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dpstack.errors import BusError
from dpstack.fdl.active import ActiveStation

if TYPE_CHECKING:
    from dpstack.api.bus import Bus


async def join(bus: Bus, timeout: float) -> None:
    """Wait until the station is in the ring. Raises BusError."""

    def joined() -> bool:
        if bus.collision is not None:
            raise BusError(bus.collision)
        return bus.station.in_ring

    try:
        await bus.until(joined, timeout)
    except TimeoutError:
        raise BusError(why_not_joined(bus.station, timeout)) from None


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
