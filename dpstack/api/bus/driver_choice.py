"""The choice of the driver: asyncio, process or virtual; for "auto" by measurements (docs/drivers.md)."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import Final

from dpstack.api.config.config import Config
from dpstack.drivers.realtime.rights import rights
from dpstack.errors import ConfigError
from dpstack.ports import Delivery, Port

ASYNCIO: Final = "asyncio"
PROCESS: Final = "process"
VIRTUAL: Final = "virtual"


def driver_for(config: Config, port: Port | None) -> str:
    """ASYNCIO or PROCESS for ``port``; VIRTUAL without a port (simulated bus).

    Raises ConfigError where "process" is configured and impossible.
    """
    wanted = config.bus.driver
    if port is None:
        if wanted == PROCESS:
            raise _refusal(config, "a simulated bus lives in the program's own process", "leave driver out")
        return VIRTUAL
    if wanted == PROCESS:
        if sys.platform != "linux":
            raise _refusal(config, f"the bus process needs Linux, this is {sys.platform}", 'take driver = "asyncio"')
        if _frozen():
            raise _refusal(config, "this program is one file without a Python beside it", 'take driver = "asyncio"')
        if _needs_asyncio(port):
            raise _refusal(config, f"the port {config.port} is of a kind that needs asyncio", 'take driver = "asyncio"')
        if why := _no_messages():
            what = 'install it beside the program (a zip archive cannot hold it), or take driver = "asyncio"'
            raise _refusal(config, f"msgspec, which it needs, cannot be imported ({why})", what)
        return PROCESS
    return PROCESS if wanted == "auto" and _worth_it(port) else ASYNCIO


def _worth_it(port: Port) -> bool:
    """True with a real line, a second processor and real-time priority."""
    if sys.platform != "linux" or port.delivery is not Delivery.ADAPTER or _needs_asyncio(port) or _frozen():
        return False
    return len(os.sched_getaffinity(0)) > 1 and not rights().no_priority() and not _no_messages()


def _frozen() -> bool:
    """True in a packed program: its executable starts the program, not an interpreter."""
    return not sys.executable or bool(getattr(sys, "frozen", False))


def _no_messages() -> str:
    """Why msgspec, needed for the messages between both processes, cannot be imported; a zipapp cannot hold it."""
    try:
        import_module("msgspec")
    except ImportError as error:
        return str(error)
    return ""


def _needs_asyncio(port: Port) -> bool:
    return type(port).open_now is Port.open_now


def _refusal(config: Config, why: str, what: str) -> ConfigError:
    return config.source.error(("bus", "driver"), f'[bus]: driver = "process": {why}', what)
