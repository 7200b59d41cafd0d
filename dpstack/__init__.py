"""PROFIBUS-DP for Python: a soft master for asyncio applications, simulated slaves, drive profiles, virtual time.

::

    async with dpstack.open_bus("plant.toml") as bus:
        await bus.operate()
        mixer = bus.drive("mixer")
        await mixer.start()
        mixer.speed = 0.5
        await mixer.reached()

What is named here is public; the rest may change without notice. The names are loaded when they are first used, so
that a drive plugin or a child process that needs one layer does not load all of them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from dpstack import profile
    from dpstack.api.baud import BaudReport, find_baud
    from dpstack.api.bus import Bus
    from dpstack.api.config import Config, load_config
    from dpstack.api.drive import Drive
    from dpstack.api.events import Event, Mode, SlaveState
    from dpstack.api.opening import open_bus
    from dpstack.api.slave import Slave
    from dpstack.api.virtual import World, run_virtual, simulate
    from dpstack.dp.slaveapp import SlaveApp
    from dpstack.errors import (
        BaudError,
        BusError,
        ConfigError,
        DpError,
        DriveError,
        DriveFault,
        DriveTimeout,
        ParamError,
        ParameterError,
        PortBusyError,
        PortError,
        ServiceRefused,
        SlaveError,
        SlaveFault,
        SlaveTimeout,
        UsageError,
    )
    from dpstack.profile import DriveStatus

__version__ = "0.1.0"

__all__ = [
    "BaudError",
    "BaudReport",
    "Bus",
    "BusError",
    "Config",
    "ConfigError",
    "DpError",
    "Drive",
    "DriveError",
    "DriveFault",
    "DriveStatus",
    "DriveTimeout",
    "Event",
    "Mode",
    "ParamError",
    "ParameterError",
    "PortBusyError",
    "PortError",
    "ServiceRefused",
    "Slave",
    "SlaveApp",
    "SlaveError",
    "SlaveFault",
    "SlaveState",
    "SlaveTimeout",
    "UsageError",
    "World",
    "__version__",
    "find_baud",
    "load_config",
    "open_bus",
    "profile",
    "run_virtual",
    "simulate",
]

_WHERE: Final = {
    "BaudReport": "api.baud",
    "find_baud": "api.baud",
    "Bus": "api.bus",
    "open_bus": "api.opening",
    "Config": "api.config",
    "load_config": "api.config",
    "Drive": "api.drive",
    "Event": "api.events",
    "Mode": "api.events",
    "SlaveState": "api.events",
    "Slave": "api.slave",
    "run_virtual": "api.virtual",
    "simulate": "api.virtual",
    "World": "api.virtual",
    "SlaveApp": "dp.slaveapp",
    "DriveStatus": "profile",
}


def __getattr__(name: str) -> object:
    """Load a public name at its first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module 'dpstack' has no attribute {name!r}")
    if name == "profile":
        return importlib.import_module("dpstack.profile")
    value: object = getattr(importlib.import_module(f"dpstack.{_WHERE.get(name, 'errors')}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names."""
    return __all__
