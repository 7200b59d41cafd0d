"""``open_bus``: a bus from a configuration file or from arguments."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from dpstack.api.bus.bus import Bus, SlaveTable
from dpstack.api.config.config import Config, load_config, make_config
from dpstack.api.streams import OnEvent
from dpstack.errors import ConfigError
from dpstack.sim.world import World


def open_bus(
    config: str | Path | Config | None = None,
    *,
    port: str | None = None,
    baud: int | Literal["auto"] | None = None,
    address: int | None = None,
    driver: Literal["auto", "asyncio", "process"] | None = None,
    slaves: Iterable[SlaveTable] = (),
    on_event: OnEvent | None = None,
    join_timeout: float | None = None,
    world: World | None = None,
    **bus: object,
) -> Bus:
    """A bus from a configuration file (``port``, ``baud``, ``address`` override it), or from arguments alone.

    Use it as ``async with open_bus(...) as bus``: entering listens, joins the token ring and begins to bring the slaves
    up in Clear; ``await bus.operate()`` lets outputs out. ``slaves`` are mappings with the keys of a [[slave]] table,
    ``bus`` further keys of [bus]. ``driver="process"``: the bus runs in a process of its own, which the application
    cannot hold up (docs/drivers.md). ``port="virtual"`` simulates the slaves in this process. ``on_event`` is called
    for every event at once; ``world`` joins an existing simulated bus (see :func:`simulate`). ``join_timeout`` in
    seconds: how long to wait for the token beside other masters (default: two passes over a GAP like this master's,
    30 s at least).

    ``baud="auto"``: entering listens for the rate first. Until it is found ``bus.searching`` is true, and what depends
    on it (``plan``, ``params``, slaves and drives) raises UsageError. After 5 s of silence it gives up: a master that
    is alone on its bus must give the rate.

    Raises ConfigError here, with "auto" on entering; PortError and BusError on entering.
    """
    if config is None:
        if baud is None:
            raise ConfigError("open_bus: no baud; give for instance baud=500000, or a configuration file")
        if port is None and world is None:
            raise ConfigError('open_bus: no port; give for instance port="/dev/ttyUSB0", or "virtual"')
        own = 2 if address is None else address
        made = make_config(port or "virtual", baud, own, slaves, bus={"driver": driver, **bus})
    else:
        made = config if isinstance(config, Config) else load_config(config)
        made = made.with_bus(port=port, baud=baud, address=address, driver=driver, **bus).with_slaves(slaves)
    return Bus(made, on_event=on_event, join_timeout=join_timeout, world=world)
