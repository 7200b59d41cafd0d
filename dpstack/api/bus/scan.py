"""The live list of a running bus, and of a port that nobody holds yet."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dpstack.api.bus.temporary_master import MakeBus, joined
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.scanner import Found, SlaveView, SurveyOrder, view_of
from dpstack.errors import BusError, DpError
from dpstack.fdl.telegram import StationType
from dpstack.params import MAX_STATION

if TYPE_CHECKING:
    from dpstack.api.bus.bus import Bus
    from dpstack.api.slave.slave import Slave


async def scan_on(bus: Bus, *, configs: bool, addresses: Iterable[int], quick: bool | None) -> tuple[Found, ...]:
    """See ``Bus.scan``."""
    if quick is None:
        quick = not any(slave.ready_now for slave in bus.slaves if not bus.master.read_only)
    own = bus.params.address
    mine = {} if bus.master.read_only else {slave.address: slave for slave in bus.slaves}
    order = SurveyOrder(tuple(addresses), tuple(mine), configs=configs, quick=quick)
    survey = bus.parts.survey(bus.command, order)
    try:
        await bus.until(lambda: survey.result is not None)
        result = survey.result
    finally:
        with contextlib.suppress(DpError):  # the bus may have ended meanwhile
            survey.end()
    assert result is not None
    bus.unreadable = frozenset(result.unreadable)
    return tuple(_of_ours(found, mine.get(found.address), own) for found in result.found)


def _of_ours(found: Found, slave: Slave | None, own: int) -> Found:
    """What the master knows of a slave of its own; asking it again would take a diagnosis away from the master."""
    if slave is None or found.kind is not StationType.SLAVE:
        return found
    exchanging = slave.state is SlaveState.DATA_EXCHANGE
    return dataclasses.replace(
        found,
        state=SlaveView.DATA_EXCHANGE if exchanging else view_of(slave.diagnosis),
        ident=None if slave.diagnosis is None else slave.diagnosis.ident,
        master=own if exchanging else None,
        config=slave.config.config if exchanging else None,
        diagnosis=slave.diagnosis,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveListResult:
    """What is on a bus. ``address`` is the one that this station asked from; ``notes`` are worth a line each."""

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
    """Join the bus, ask everybody, leave in order; on a silent bus then ask the own address from another one.

    ``make_bus`` makes read-only buses; ``address`` as in :func:`~dpstack.api.bus.temporary_master.joined`.
    Raises PortError, BusError.
    """
    async with joined(make_bus, address) as bus:
        own = bus.params.address
        stations = await bus.scan(configs=configs)
    notes = list(_notes(stations, bus.unreadable))
    if bus.station.claimed:  # else another master asked the own address and understood the one answer it got
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
