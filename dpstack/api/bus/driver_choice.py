"""The choice of the driver: asyncio, process or virtual. The rule of "auto" is by measurements
(docs/explanation/drivers.md)."""

from __future__ import annotations

import os
import sys
from typing import Final

from dpstack.api.config.config import Config
from dpstack.ports import Delivery, Port, open_port
from dpstack.units import BAUD_RATES

ASYNCIO: Final = "asyncio"
PROCESS: Final = "process"
VIRTUAL: Final = "virtual"
_IN_PROGRAM: Final = 'with driver = "asyncio" the bus runs in the process of the program'


def driver_for(config: Config, port: Port | None) -> str:
    """ASYNCIO or PROCESS for ``port``; VIRTUAL without a port (simulated bus).

    Raises ConfigError if "process" or the processor of a bus process is configured and impossible.
    """
    wanted = config.bus.driver
    if wanted == PROCESS:
        refusal = _why_no_process(port)
        if refusal is not None:
            why, todo = refusal
            raise config.source.error(("bus", "driver"), f'[bus]: driver = "process": {why}', todo)
        return PROCESS
    if port is None:
        return VIRTUAL
    if config.bus.cpus:
        refusal = _why_no_process(port) if wanted == "auto" else (_IN_PROGRAM, 'take driver = "process"')
        if refusal is None:
            return PROCESS
        why, todo = refusal
        raise config.source.error(
            ("bus", "cpu"), f"[bus]: cpu is for a bus process: {why}", f"leave cpu out, or {todo}"
        )
    return PROCESS if wanted == "auto" and _process_pays(port) else ASYNCIO


def is_free_for_process(config: Config) -> bool:
    """Whether the configuration leaves the driver open, and its port can have a bus process."""
    if config.bus.driver != "auto" or config.port == VIRTUAL:
        return False
    return _why_no_process(open_port(config.port, BAUD_RATES[0])) is None


def _process_pays(port: Port) -> bool:
    """Whether a bus process is possible and useful: real line, second processor, real-time priority."""
    if sys.platform != "linux" or port.delivery is not Delivery.ADAPTER:
        return False
    from dpstack.drivers.realtime.rights import rights  # here, as it loads ctypes, and only "auto" asks

    return len(os.sched_getaffinity(0)) > 1 and not rights().no_priority() and _why_no_process(port) is None


def _why_no_process(port: Port | None) -> tuple[str, str] | None:
    """The reason why the bus of ``port`` cannot run in a process of its own, and advice; None if it can."""
    take_asyncio = 'take driver = "asyncio"'
    if port is None:
        return "a simulated bus lives in the program's own process", "leave driver out"
    if sys.platform != "linux":
        return f"the bus process needs Linux, this is {sys.platform}", take_asyncio
    if not sys.executable or getattr(sys, "frozen", False):  # sys.executable is the program, no interpreter
        return "this program is one file without a Python beside it", take_asyncio
    if type(port).open_now is Port.open_now:
        return f"the port {port.name} is of a kind that needs asyncio", take_asyncio
    return None
