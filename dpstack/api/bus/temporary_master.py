"""A temporary master at a free address: joining and leaving the ring; the live list of a port."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from dpstack.api.bus.bus import Bus
from dpstack.dp.master.scanner import Found
from dpstack.errors import BusError
from dpstack.fdl.telegram import StationType
from dpstack.params import MAX_STATION

#: occupied addresses that are tried before the user has to name one
_TRIES: Final = 8

#: Makes a bus at a station address that is not open yet.
MakeBus = Callable[[int], Bus]


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
            if bus.collision is not None and address is None and tries < _TRIES:
                continue
            raise
        break
    try:
        yield bus
    finally:
        await bus.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveListResult:
    """The stations of a bus. ``address``: of this station; ``notes``: one line each."""

    baud: int
    address: int
    stations: tuple[Found, ...]
    unreadable: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """As ``scan --json`` prints it."""
        return {
            "baud": self.baud,
            "stations": [found.as_dict() for found in self.stations],
            "address": self.address,
            "unreadable": list(self.unreadable),
            "notes": list(self.notes),
        }


async def scan_port(make_bus: MakeBus, *, address: int | None = None, configs: bool = False) -> LiveListResult:
    """Join the bus, ask all addresses, leave the ring. On a silent bus then ask the own address from another one.

    ``make_bus`` makes read-only buses; ``address`` as in :func:`joined`.
    Raises PortError, BusError.
    """
    async with joined(make_bus, address) as bus:
        own = bus.params.address
        stations = await bus.scan(configs=configs)
    notes = list(_notes(stations, bus.unreadable))
    if bus.snapshot.claimed:  # otherwise another master polled the own address and got one answer
        taken = {own, *(found.address for found in stations)}
        other = next(free for free in range(MAX_STATION + 1) if free not in taken)
        try:
            async with make_bus(other) as second:
                stations += await second.scan(configs=configs, addresses=(own,))
        except BusError as error:
            notes.append(f"address {own} itself could not be asked from {other}: {error}")
    return LiveListResult(
        baud=bus.params.baud,
        address=own,
        stations=tuple(sorted(stations, key=lambda found: found.address)),
        unreadable=tuple(sorted(bus.unreadable)),
        notes=tuple(notes),
    )


def _notes(stations: tuple[Found, ...], unreadable: Iterable[int]) -> Iterator[str]:
    for address in sorted(unreadable):
        yield f"address {address} answers, but not readably: two stations with one address, or a bad line"
    for found in stations:
        if found.kind is StationType.SLAVE and found.ident is None:
            yield f"station {found.address} does not tell its diagnosis: it may be no DP slave"
