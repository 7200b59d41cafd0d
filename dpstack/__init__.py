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
    from dpstack.api.alarms import SlaveAlarm
    from dpstack.api.baud import BaudReport, find_baud
    from dpstack.api.bus import Bus
    from dpstack.api.config import Config, load_config
    from dpstack.api.connection import Connection
    from dpstack.api.cycles import Cycle
    from dpstack.api.drive import Drive
    from dpstack.api.events import Event, Mode, SlaveState
    from dpstack.api.opening import open_bus
    from dpstack.api.parameter_dump import ParameterPlace
    from dpstack.api.serving import SlaveServer, serve_slave, serve_slaves
    from dpstack.api.slave import Slave
    from dpstack.api.slave_from_gsd import slave_from_gsd
    from dpstack.api.virtual import IoStation, World, run_virtual, simulate
    from dpstack.dp.dp_slave import DpSlave
    from dpstack.dp.slave_description import SlaveDescription, SlaveModule
    from dpstack.dp.slave_events import DeviceFailed, RequestRefused
    from dpstack.dp.slaveapp import SlaveApp, SlaveAppState
    from dpstack.dp.user_diag import UserDiag, channel_block, device_block, identifier_block, revision_block
    from dpstack.dp.v1.alarms import AlarmType, ModuleState, Specifier, StatusType
    from dpstack.dp.v1.connection import InitiateReq
    from dpstack.dp.v1.im import Im0, Im1, Im2, Im3, Im4
    from dpstack.dp.v1.prm_blocks import PrmBlock
    from dpstack.errors import (
        AcyclicError,
        AlarmError,
        BaudError,
        BusError,
        ConfigError,
        ConnectionEnded,
        DpError,
        DriveError,
        DriveFault,
        DriveTimeout,
        NoInputs,
        OrderDropped,
        ParamError,
        ParameterError,
        PortBusyError,
        PortError,
        RecordRefused,
        ServiceRefused,
        SlaveError,
        SlaveFault,
        SlaveTimeout,
        UnknownAttribute,
        UsageError,
    )
    from dpstack.profile import DriveStatus

__version__ = "0.1.0"

__all__ = [
    "AcyclicError",
    "AlarmError",
    "AlarmType",
    "BaudError",
    "BaudReport",
    "Bus",
    "BusError",
    "Config",
    "ConfigError",
    "Connection",
    "ConnectionEnded",
    "Cycle",
    "DeviceFailed",
    "DpError",
    "DpSlave",
    "Drive",
    "DriveError",
    "DriveFault",
    "DriveStatus",
    "DriveTimeout",
    "Event",
    "Im0",
    "Im1",
    "Im2",
    "Im3",
    "Im4",
    "InitiateReq",
    "IoStation",
    "Mode",
    "ModuleState",
    "NoInputs",
    "OrderDropped",
    "ParamError",
    "ParameterError",
    "ParameterPlace",
    "PortBusyError",
    "PortError",
    "PrmBlock",
    "RecordRefused",
    "RequestRefused",
    "ServiceRefused",
    "Slave",
    "SlaveAlarm",
    "SlaveApp",
    "SlaveAppState",
    "SlaveDescription",
    "SlaveError",
    "SlaveFault",
    "SlaveModule",
    "SlaveServer",
    "SlaveState",
    "SlaveTimeout",
    "Specifier",
    "StatusType",
    "UnknownAttribute",
    "UsageError",
    "UserDiag",
    "World",
    "__version__",
    "channel_block",
    "device_block",
    "find_baud",
    "identifier_block",
    "load_config",
    "open_bus",
    "profile",
    "revision_block",
    "run_virtual",
    "serve_slave",
    "serve_slaves",
    "simulate",
    "slave_from_gsd",
]

_WHERE: Final = {
    "BaudReport": "api.baud",
    "find_baud": "api.baud",
    "Bus": "api.bus",
    "open_bus": "api.opening",
    "Config": "api.config",
    "load_config": "api.config",
    "Connection": "api.connection",
    "Cycle": "api.cycles",
    "Drive": "api.drive",
    "Event": "api.events",
    "Mode": "api.events",
    "SlaveState": "api.events",
    "Slave": "api.slave",
    "SlaveAlarm": "api.alarms",
    "slave_from_gsd": "api.slave_from_gsd",
    "run_virtual": "api.virtual",
    "simulate": "api.virtual",
    "World": "api.virtual",
    "SlaveServer": "api.serving",
    "serve_slave": "api.serving",
    "serve_slaves": "api.serving",
    "DpSlave": "dp.dp_slave",
    "SlaveApp": "dp.slaveapp",
    "SlaveAppState": "dp.slaveapp",
    "SlaveDescription": "dp.slave_description",
    "SlaveModule": "dp.slave_description",
    "DeviceFailed": "dp.slave_events",
    "RequestRefused": "dp.slave_events",
    "UserDiag": "dp.user_diag",
    "channel_block": "dp.user_diag",
    "device_block": "dp.user_diag",
    "identifier_block": "dp.user_diag",
    "revision_block": "dp.user_diag",
    "ParameterPlace": "api.parameter_dump",
    "PrmBlock": "dp.v1.prm_blocks",
    "AlarmType": "dp.v1.alarms",
    "ModuleState": "dp.v1.alarms",
    "Specifier": "dp.v1.alarms",
    "StatusType": "dp.v1.alarms",
    "Im0": "dp.v1.im",
    "Im1": "dp.v1.im",
    "Im2": "dp.v1.im",
    "Im3": "dp.v1.im",
    "Im4": "dp.v1.im",
    "InitiateReq": "dp.v1.connection",
    "DriveStatus": "profile",
    "IoStation": "api.virtual",
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
