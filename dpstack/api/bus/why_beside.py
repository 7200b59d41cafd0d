"""The story of a slave for a station that is not its master: a class 2 look at the bus, beside the other masters."""

from __future__ import annotations

import dataclasses

from msgspec import structs

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.live_list import joined
from dpstack.api.bus.opening import open_bus
from dpstack.api.bus.virtual import World, simulate
from dpstack.api.bus.why import untold
from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.streams import OnEvent
from dpstack.errors import BusError
from dpstack.why.story import Story


async def why_beside(
    config: Config, slave: SlaveConfig, *, address: int | None = None, on_event: OnEvent | None = None
) -> Story:
    """Join the bus of ``config`` read-only, ask ``slave``, and leave the ring. The source of the story is "class2".

    ``address``: of the asking station, None: the lowest one that is not heard and not in the configuration.
    Where the ring cannot be joined, the story tells that. On "virtual" the slaves are simulated for this call. Raises
    PortError.
    """
    world = None
    if config.virtual:
        world = World()
        simulate(world, config.slaves, baud=config.baud)
    made: list[Bus] = []

    def make_bus(own: int) -> Bus:
        settings = structs.replace(
            config.bus, address=own, read_only=True, cycle_ms=None, cycle_freeze=(), cycle_sync=(), auto_clear=False
        )
        bus = open_bus(dataclasses.replace(config, bus=settings), on_event=on_event, world=world)
        made.append(bus)
        return bus

    master = config.bus.address
    try:
        async with joined(make_bus, address, avoid={master, *(one.address for one in config.slaves)}) as bus:
            return await bus.why(slave.address, master=master)
    except BusError as error:
        if not made or made[-1].searching:
            raise
        return untold(core_of(made[-1]), made[-1].slave(slave.address), master, str(error))
