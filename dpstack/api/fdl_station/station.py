"""``open_fdl``, ``open_ppi``: a master station on the bus with the FDL services and without DP, and an S7-200 asked by
one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Final, Literal

from dpstack.api.bus.core import BusCore
from dpstack.api.config.bus import BusConfig
from dpstack.api.config.config import Config, load_config, make_config
from dpstack.api.fdl.fdl import Fdl
from dpstack.api.ppi.cpu import USUAL_S, Cpu
from dpstack.api.streams import EventStream, OnEvent
from dpstack.argcheck import instance, plain_function
from dpstack.drivers.snapshots import BusSnapshot
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.events import StationFound
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.fdl.services.identity import Ident
from dpstack.fdl.telegram import StationType
from dpstack.params import BusParams
from dpstack.text import did_you_mean
from dpstack.toml.table import keys_of
from dpstack.trace import Event
from dpstack.units import baud_text

if TYPE_CHECKING:
    from dpstack.sim.world import World

#: keys of [bus] that only mean something with slaves
_OF_DP: Final = (
    "cycle_ms",
    "cycle_freeze",
    "cycle_sync",
    "after_stall",
    "application_watchdog_ms",
    "on_connector_loss",
    "auto_clear",
    "data_control_time_ms",
    "read_only",
)


class FdlStation(Fdl):
    """A running master station without DP: FDL services, own SAPs, token ring, live list. Made by
    :func:`dpstack.open_fdl`. It sends as many requests in a token hold as T_TH permits."""

    def __init__(
        self,
        config: Config,
        *,
        on_event: OnEvent | None = None,
        join_timeout: float | None = None,
        world: World | None = None,
        ident: Ident | None = None,
    ) -> None:
        core = BusCore(config, self._watch, join_timeout=join_timeout, world=world, watched=False, dp=False)
        super().__init__(core.fdl_link(per_hold=0, ident=ident))
        self._core = core
        self._on_event = on_event
        self._stations: dict[int, StationType] = {}
        self._seal(FdlStation)

    def __repr__(self) -> str:
        core = self._core
        if core.searching:
            return f"<FdlStation {core.config.port} searching for its rate>"
        where = f"{core.config.port} {baud_text(core.params.baud)}"
        return f"<FdlStation {core.params.address} on {where}{'' if core.is_open else ' not open'}>"

    # --- from beginning to end ----------------------------------------------------------------------------------
    async def __aenter__(self) -> FdlStation:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Listen, then join the token ring, or make it on a silent bus. Raises PortError, BusError."""
        await self._core.open()

    async def close(self) -> None:
        """Leave the ring in order and release the port. May be repeated."""
        await self._core.close()

    @property
    def is_open(self) -> bool:
        """True between a successful opening and the end."""
        return self._core.is_open

    # --- the station as it is -----------------------------------------------------------------------------------
    @property
    def config(self) -> Config:
        """The configuration, with the arguments of ``open_fdl``."""
        return self._core.config

    @property
    def params(self) -> BusParams:
        """The bus parameters in use; ``params.address`` is the station address. Raises UsageError while the rate "auto"
        has not been found."""
        return self._core.params

    @property
    def driver(self) -> str:
        """The driver: "asyncio", "process", or "virtual" on a simulated bus."""
        return self._core.driver

    @property
    def world(self) -> World | None:
        """The simulated bus when there is one."""
        return self._core.world

    @property
    def snapshot(self) -> BusSnapshot:
        """The last snapshot: whether it is in the ring (``in_ring``), the masters in it (``las``)."""
        return self._core.snapshot

    @property
    def collision(self) -> str | None:
        """Text of the address collision with another station; None without one."""
        return self._core.collision

    @property
    def seconds(self) -> float:
        """Bus time since the start in seconds."""
        return self._core.seconds

    @property
    def stations(self) -> dict[int, StationType]:
        """The stations that GAP polls have found, by address: those between this master and the next one."""
        return dict(self._stations)

    async def live_list(
        self, *, addresses: Iterable[int] = ALL_ADDRESSES, quick: bool | None = None
    ) -> dict[int, StationType]:
        """The type of each station that answers FDL status, by address. ``addresses``: those that are asked, 0..126.

        ``quick``: ask silent addresses without pauses (default: True while no other master is in the ring).
        """
        asked = tuple(addresses)
        if quick is None:
            quick = len(self.snapshot.las) <= 1
        found = await self._core.scan(addresses=asked, quick=quick, types_only=True)
        return {one.address: one.kind for one in found}

    def events(self) -> EventStream:
        """The events since the start, an async iterator: RingJoined, RingLeft, MasterSeen, TokenLost, StationFound,
        AddressCollision, PortLost, PortBack, Notice. It keeps 1000; ``dropped`` counts the lost ones."""
        return self._core.event_stream()

    async def until(self, condition: Callable[[], bool], timeout: float | None = None) -> None:
        """Wait until ``condition()``, evaluated after every event, is true. Raises TimeoutError, and the reason of the
        end when the station ends meanwhile."""
        plain_function("condition", condition, "until(lambda: 5 in fdl.stations)")
        await self._core.until(condition, timeout)

    def _watch(self, event: Event) -> None:
        if isinstance(event, StationFound):
            if event.kind is None:
                self._stations.pop(event.address, None)
            else:
                self._stations[event.address] = event.kind
        if self._on_event is not None:
            self._on_event(event)


def open_fdl(
    config: Config | str | None = None,
    *,
    port: str | None = None,
    baud: int | Literal["auto"] | None = None,
    address: int | None = None,
    driver: Literal["auto", "asyncio", "process"] | None = None,
    on_event: OnEvent | None = None,
    join_timeout: float | None = None,
    world: World | None = None,
    ident: Ident | None = None,
    **bus: object,
) -> FdlStation:
    """A master station with the FDL services and without DP, from arguments or from the [bus] table of a file.

    Use it as ``async with open_fdl(port=..., baud=..., address=...) as fdl``: entering listens and joins the token
    ring, or makes it on a silent bus. ``port="virtual"`` is a simulated bus; ``world`` joins an existing one.
    ``ident``: the own answer to Request Ident. ``bus``: further keys of [bus] (``t_sl``, ``hsa``, ``gap`` ...). Other
    arguments as those of :func:`dpstack.open_bus`. Slaves of a file do not count: nobody parameterises them.

    Raises ConfigError here; PortError and BusError on entering.
    """
    known = [name for name in keys_of(BusConfig) if name not in _OF_DP]
    for name in bus:
        if name in _OF_DP:
            raise ConfigError(f"open_fdl: {name} is for a bus with DP slaves: leave it out, or use open_bus")
        if name not in known:
            hint = did_you_mean(name.lower(), known, f"known: {', '.join(known)}", quoted=True)
            raise ConfigError(f"open_fdl: unknown argument {name!r}; {hint}")
    if on_event is not None:
        plain_function("open_fdl: on_event", on_event, "on_event=print", ConfigError)
    if ident is not None:
        instance("open_fdl: ident", ident, Ident, 'Ident("maker", "gateway")', ConfigError)
        try:
            ident.build()
        except UsageError as error:
            raise ConfigError(f"open_fdl: {error}") from None
    if world is not None:
        from dpstack.sim.world import World  # here, as a station on a wire needs none

        instance("open_fdl: world", world, World, "world = dpstack.World()", ConfigError)
    if config is None:
        if baud is None:
            raise ConfigError("open_fdl: no baud; give for instance baud=500000")
        if port is None and world is None:
            raise ConfigError('open_fdl: no port; give for instance port="/dev/ttyUSB0", or "virtual"')
        own = 2 if address is None else address
        made = make_config(port or "virtual", baud, own, where="open_fdl", bus={"driver": driver or "auto", **bus})
    else:
        made = config if isinstance(config, Config) else load_config(config)
        made = made.with_bus(port=port, baud=baud, address=address, driver=driver, **bus)
    return FdlStation(without_dp(made), on_event=on_event, join_timeout=join_timeout, world=world, ident=ident)


def without_dp(config: Config) -> Config:
    """``config`` without slaves, connectors and the settings of [bus] that are for slaves."""

    from msgspec import structs

    defaults = BusConfig()
    settings = structs.replace(config.bus, **{name: getattr(defaults, name) for name in _OF_DP})
    return dataclasses.replace(config, bus=settings, slaves=(), ppi=(), connectors={})


class CpuConnection(Cpu):
    """One S7-200, and the station of its own that asks it. Made by :func:`open_ppi`."""

    def __init__(self, station: FdlStation, address: int, *, timeout: float) -> None:
        super().__init__(station, address, timeout=timeout)
        self._station = station
        self._seal(CpuConnection)

    async def __aenter__(self) -> CpuConnection:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Join the token ring, or make it on a silent line. Raises PortError, BusError."""
        await self._station.open()

    async def close(self) -> None:
        """Leave the ring in order and release the port. May be repeated."""
        await self._station.close()

    @property
    def station(self) -> FdlStation:
        """The station that asks: its ring, its live list, its events."""
        return self._station


def open_ppi(
    address: int = 2, *, own: int = 0, baud: int = 9600, timeout: float = USUAL_S, **fdl: Any
) -> CpuConnection:
    """The S7-200 at ``address``, asked by a station of its own: ``async with open_ppi(2, port="/dev/ttyUSB0") as cpu``.

    ``own``: address of this station, 0 as Siemens' tools have it; ``baud``: 9600 as delivered, 19200 or 187500.
    ``fdl``: other arguments of :func:`dpstack.open_fdl`. With other masters on the wire (PPI advanced) the station
    joins their token ring. Raises ConfigError and UsageError here; PortError and BusError on entering.
    """
    return CpuConnection(open_fdl(address=own, baud=baud, **fdl), address, timeout=timeout)
