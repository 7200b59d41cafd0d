"""The way to a bus: from a configuration file, or from arguments alone."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dpstack.api.bus import Bus, OnEvent, SlaveTable
from dpstack.api.config import Config, load_config, make_config
from dpstack.errors import ConfigError
from dpstack.sim.world import World


def open_bus(
    config: str | Path | Config | None = None,
    *,
    port: str | None = None,
    baud: int | None = None,
    address: int | None = None,
    slaves: Iterable[SlaveTable] = (),
    on_event: OnEvent | None = None,
    join_timeout: float | None = None,
    world: World | None = None,
    **bus: object,
) -> Bus:
    """A bus from a configuration file (``port``, ``baud``, ``address`` override it), or from arguments alone.

    Use it as ``async with open_bus(...) as bus``: entering listens, joins the token ring and begins to bring the slaves
    up in Clear; ``await bus.operate()`` lets outputs out. ``slaves`` are mappings with the keys of a [[slave]] table,
    ``bus`` further keys of [bus]. ``port="virtual"`` simulates the slaves in this process. ``on_event`` is called for
    every event at once; ``world`` joins an existing simulated bus. ``join_timeout`` in seconds: how long to wait
    for the token beside other masters (default: two passes over a GAP like this master's, 30 s at least).

    Raises ConfigError here; PortError and BusError on entering.
    """
    if config is None:
        if baud is None:
            raise ConfigError("open_bus: no baud; give for instance baud=500000, or a configuration file")
        if port is None and world is None:
            raise ConfigError('open_bus: no port; give for instance port="/dev/ttyUSB0", or "virtual"')
        made = make_config(port or "virtual", baud, 2 if address is None else address, slaves, bus=bus)
    else:
        made = config if isinstance(config, Config) else load_config(config)
        made = made.with_bus(port=port, baud=baud, address=address, **bus).with_slaves(slaves)
    return Bus(made, on_event=on_event, join_timeout=join_timeout, world=world)
