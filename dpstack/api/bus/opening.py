"""``open_bus``, and the early start of a bus process. Its call imports the modules of a bus, beside that process."""

from __future__ import annotations

import gc
import os
import stat
import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Final, Literal

if TYPE_CHECKING:
    from pathlib import Path

    from dpstack.api.bus.bus import Bus, SlaveTable
    from dpstack.api.config.config import Config
    from dpstack.api.streams import OnEvent
    from dpstack.sim.world import World

_BUS: Final = "dpstack.api.bus.bus"
_PROCESS: Final = "process"
_VIRTUAL: Final = "virtual"
#: a longer configuration file is not read twice
_LONGEST: Final = 1 << 20


def open_bus(
    config: str | Path | Config | None = None,
    *,
    port: str | None = None,
    baud: int | Literal["auto"] | None = None,
    address: int | None = None,
    driver: Literal["auto", "asyncio", "process"] | None = None,
    slaves: Iterable[SlaveTable] = (),
    ppi: Iterable[Mapping[str, object]] = (),
    on_event: OnEvent | None = None,
    join_timeout: float | None = None,
    world: World | None = None,
    **bus: object,
) -> Bus:
    """A bus from a configuration file (``port``, ``baud``, ``address`` override it), or from arguments alone.

    Use it as ``async with open_bus(...) as bus``: entering listens, joins the token ring and begins to bring the slaves
    up in Clear; ``await bus.operate()`` lets outputs out. ``slaves`` are mappings with the keys of a [[slave]] table,
    ``ppi`` mappings with the keys of an S7-200 CPU, ``bus`` further keys of [bus]. ``driver="process"``: the bus runs
    in a process of its own, which the application cannot hold up (docs/explanation/drivers.md). ``port="virtual"``
    simulates the stations in this process. ``on_event`` is called for every event at once; ``world`` joins an existing
    simulated bus (see :func:`simulate`). ``join_timeout`` in seconds: how long to wait for the token beside other
    masters (default: two passes over a GAP like this master's, 30 s at least).

    ``baud="auto"``: entering listens for the rate first. Until it is found ``bus.searching`` is true, and what depends
    on it (``plan``, ``params``, slaves and drives) raises UsageError. After 5 s of silence it gives up: a master that
    is alone on its bus must give the rate.

    Raises ConfigError here, with "auto" on entering; PortError and BusError on entering.
    """
    early = world is None and _begin_early(config, port, driver)
    imports = _BUS not in sys.modules
    collects = gc.isenabled()
    gc.disable()
    try:
        from dpstack.api.bus.bus import Bus, check_arguments
        from dpstack.api.config.config import Config, load_config, make_config
        from dpstack.errors import ConfigError

        check_arguments(config, slaves, on_event, world, bus)
        if config is None:
            if baud is None:
                raise ConfigError("open_bus: no baud; give for instance baud=500000, or a configuration file")
            if port is None and world is None:
                raise ConfigError('open_bus: no port; give for instance port="/dev/ttyUSB0", or "virtual"')
            cpus = tuple(ppi)
            own = (0 if cpus else 2) if address is None else address
            made = make_config(port or "virtual", baud, own, slaves, bus={"driver": driver, **bus}).with_ppi(cpus)
        else:
            made = config if isinstance(config, Config) else load_config(config)
            made = made.with_bus(port=port, baud=baud, address=address, driver=driver, **bus)
            made = made.with_slaves(slaves).with_ppi(ppi)
        return Bus(made, on_event=on_event, join_timeout=join_timeout, world=world)
    except BaseException:
        if early:
            from dpstack.drivers.process import early_start

            early_start.drop()
        raise
    finally:
        if collects:
            if imports:
                _make_old()
            gc.enable()


def _make_old() -> None:
    """Have only a full collection look at the objects that there are: modules stay, and the next collection of young
    objects, which else looks at all that the imports have made, would take as long as a twelfth of the first call.

    Only if there were imports: to count frozen objects takes as long as a look at each of them, 0.1 s for a million.
    """
    if not gc.get_freeze_count():  # else the program has frozen objects, and they would not be any longer
        gc.freeze()
        gc.unfreeze()


def begin_for_command(words: Sequence[str]) -> None:
    """Start a bus process early if ``dpstack run WORDS`` is going to need one."""
    driver = next((value for word, value in pairwise(words) if word == "--driver"), None)
    given = [word.partition("=")[2] for word in words if word.startswith("--driver=")]
    files = (word for word in words if not word.startswith("-"))
    any(_begin_early(name, None, given[-1] if given else driver) for name in files)


def _begin_early(config: object, port: str | None, driver: str | None) -> bool:
    """Start the bus process of this configuration, if it needs one. Returns whether it does."""
    if not _wants_process(config, port, driver):
        return False
    from dpstack.drivers.process import early_start  # here, as other buses need nothing of it

    early_start.begin()
    return True


def _wants_process(config: object, port: str | None, driver: str | None) -> bool:
    """Whether a bus of this configuration, file or object, runs in a process of its own. Without a doubt only: with
    the driver "auto" its other parts decide, which takes the imports."""
    if port == _VIRTUAL or driver not in (None, _PROCESS):
        return False
    if not isinstance(config, str | os.PathLike):
        return driver == _PROCESS
    try:
        about = os.stat(config)
        if not stat.S_ISREG(about.st_mode) or about.st_size > _LONGEST:
            return False
        with open(config, "rb") as file:
            octets = file.read(_LONGEST)
        if driver is None and _PROCESS.encode() not in octets:
            return False
        import tomllib  # here, as most files name no driver

        bus = tomllib.loads(octets.decode()).get("bus")
    except (OSError, ValueError, RecursionError):  # the reader of the configuration says why
        return False
    return isinstance(bus, dict) and _PROCESS in (driver, bus.get("driver")) and bus.get("port") != _VIRTUAL
