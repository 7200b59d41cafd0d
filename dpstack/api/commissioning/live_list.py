"""The live list of a port, read by a temporary master, and a configuration skeleton made from it."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from msgspec import Struct

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.config.channel_names import name_lines, slot_remarks
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diagnosis import SlaveView
from dpstack.dp.slot_map import SlotMap, slot_map
from dpstack.errors import BusError, ConfigError
from dpstack.fdl.telegram import MAX_DATA, StationType
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import MAX_STATION
from dpstack.toml.reading import comment, table_lines

if TYPE_CHECKING:
    from dpstack.profile import DriveProfile

_FIRST_MASTER: Final = 2
#: occupied addresses after which the user has to name a free one
_TRIES: Final = 8

#: Makes a bus at a station address that is not open yet.
MakeBus = Callable[[int], Bus]


class Joins(Protocol):
    """A station that joins the ring when it is opened."""

    @property
    def collision(self) -> str | None: ...
    async def open(self) -> None: ...
    async def close(self) -> None: ...


StationT = TypeVar("StationT", bound=Joins)


@contextlib.asynccontextmanager
async def joined(
    make_bus: Callable[[int], StationT], address: int | None = None, *, avoid: Collection[int] = ()
) -> AsyncIterator[StationT]:
    """A bus, or an FDL station, in the ring, for the duration of a block.

    ``address`` None: the lowest address at which no station sends and that is not in ``avoid``.
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


class Chosen(Struct, frozen=True):
    """The description of a slave: its ``keys`` of [[slave]], and its slots with the names of its modules (None: without
    modules)."""

    keys: Mapping[str, object]
    slots: SlotMap | None = None


class LiveListResult(Struct, frozen=True, kw_only=True):
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
            "stations": [found.as_dict() | cause_dict(found) for found in self.stations],
            "address": self.address,
            "unreadable": list(self.unreadable),
            "notes": list(self.notes),
        }


def cause_dict(found: Found) -> dict[str, object]:
    """``cause``: the likely cause why a slave is not in data exchange, as far as a scan knows; empty for others."""
    from dpstack.why.story import glance  # here, as the scan of a run shows no causes

    cause = glance(found)
    return {"cause": cause} if cause else {}


async def scan_port(make_bus: MakeBus, *, address: int | None = None, configs: bool = False) -> LiveListResult:
    """Join the bus, ask all addresses, leave the ring. On a bus without other masters, join it again at another address
    and ask the first one: a slave may have it.

    ``make_bus`` makes read-only buses; ``address`` as in :func:`joined`. Raises PortError, BusError.
    """
    async with joined(make_bus, address) as bus:
        own = bus.params.address
        stations = await bus.scan(configs=configs)
    notes = list(answer_notes(stations, core_of(bus).unreadable))
    if bus.snapshot.claimed:  # no other master has polled this address
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
        unreadable=tuple(sorted(core_of(bus).unreadable)),
        notes=tuple(notes),
    )


def answer_notes(stations: Iterable[Found], unreadable: Iterable[int]) -> Iterator[str]:
    """Remarks about stations that answer, but not as a DP slave does, and about answers that nobody can read."""
    for address in sorted(unreadable):
        yield f"address {address} answers, but not readably: two stations with one address, or a bad line"
    for found in stations:
        if found.kind is StationType.SLAVE and found.ident is None:
            yield f"station {found.address} does not answer Slave_Diag: it may be no DP slave"


def drive_of(found: Found) -> DriveProfile | None:
    """The known drive with the ident number of ``found``, if there is one."""
    from dpstack.devices import finding  # here, as most scans of a program do not ask for drives

    return None if found.ident is None else next(iter(finding.with_ident(found.ident)), None)


def config_skeleton(result: LiveListResult, port: str, chosen: Mapping[int, Chosen] | None = None) -> str:
    """The text of a configuration file with every slave found.

    ``chosen``: by address, what goes before the keys made of ident number and identifier octets. Stations that cannot
    be configured (no identifier octets, address 126) are comments with the reason. The slots of each slave, and names
    for the channels of those without a drive plugin, are comments.
    """
    lines = [
        "# Made by dpstack scan from what was found on the bus. Compare it with the GSD files of the devices:",
        "# user parameters (user_prm) and names are not to be had by asking.",
        *table_lines("[bus]", {"port": port, "baud": result.baud, "address": _free_address(result)}),
    ]
    masters = [found for found in result.stations if found.kind is not StationType.SLAVE]
    if masters:
        lines.append(f"# other masters on this bus: {', '.join(str(found.address) for found in masters)}")
    for found in result.stations:
        if found.kind is StationType.SLAVE:
            lines += ["", *_slave(found, (chosen or {}).get(found.address))]
    return "\n".join(lines) + "\n"


def _free_address(result: LiveListResult) -> int:
    taken = {found.address for found in result.stations}
    candidates: list[int] = [*range(_FIRST_MASTER, MAX_STATION + 1), 0, 1]
    return next(address for address in candidates if address not in taken)


def _slave(found: Found, chosen: Chosen | None) -> list[str]:
    why = _why_unusable(found)
    table = list(_table(found, None if chosen is None else chosen.keys))
    if why is None:
        slots = slot_map(found.config or b"") if chosen is None or chosen.slots is None else chosen.slots
        is_drive = any(line.startswith("drive = ") for line in table)
        return [*table, *slot_remarks(slots), *([] if is_drive else name_lines(slots))]
    return [comment(why), *(f"# {line}" for line in table)]


def _why_unusable(found: Found) -> str | None:
    """The reason why the answers of a slave are not enough to configure it; None if they are."""
    if found.address > MAX_STATION:
        return f"station {found.address} is a slave as delivered: give it an address of its own first"
    if found.ident is None or found.config is None:
        return f"slave {found.address} did not give its {'ident number' if found.ident is None else 'configuration'}"
    try:
        inputs, outputs = io_lengths(found.config)
    except ConfigError as error:
        return f"slave {found.address}: its configuration cannot be read ({error})"
    if not found.config or max(inputs, outputs) > MAX_DATA:
        return f"slave {found.address}: its configuration cannot be ({inputs} input, {outputs} output octets)"
    return None


def _table(found: Found, chosen: Mapping[str, object] | None) -> Iterator[str]:
    drive = drive_of(found)
    telegrams = [] if drive is None else [t.name for t in drive.telegrams_of(found.config or b"")]
    if found.master is not None and found.state is SlaveView.DATA_EXCHANGE:
        yield f"# in data exchange with master {found.master}, which keeps it until it is stopped or gives it free"
    name = f"{'slave' if drive is None else drive.name.partition('-')[0]}{found.address}"
    keys: dict[str, object] = {"name": name, "address": found.address}
    remarks = {}
    if chosen is not None:
        keys |= chosen
    elif drive is not None and telegrams:
        keys |= {"drive": drive.name, "telegram": telegrams[0], "ident": found.ident if drive.ident_made_up else None}
        remarks = {"telegram": f"or {', '.join(telegrams[1:])}"} if telegrams[1:] else {}
    else:
        octets = None if found.config is None else found.config.hex(" ").upper()
        keys |= {"ident": found.ident, "config": octets}
    lines = table_lines("[[slave]]", keys, remarks)
    if drive is not None and chosen is None and not telegrams:
        lines.insert(3, f"# by its ident number {drive.title}, but with none of its telegrams")
    yield from lines
