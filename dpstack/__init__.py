"""PROFIBUS-DP for Python: a soft master for asyncio applications, simulated slaves, drive profiles, virtual time.

::

    async with dpstack.open_bus("plant.toml") as bus:
        await bus.operate()
        mixer = bus.drive("mixer")
        await mixer.start()
        mixer.speed = 0.5
        await mixer.reached()

The names here are public; the rest may change without notice. Each name is loaded at its first use, so that a drive
plugin or a child process that needs one layer does not load all of them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from dpstack import profile
    from dpstack.api.bus.bus import Bus, open_bus
    from dpstack.api.bus.cycles import Cycle
    from dpstack.api.bus.find_baud import BaudReport, find_baud
    from dpstack.api.bus.virtual import IoStation, World, run_virtual, simulate
    from dpstack.api.commissioning.commissioning import Commissioning
    from dpstack.api.config.config import Config, load_config
    from dpstack.api.lists.parameter_list import ParameterPlace
    from dpstack.api.server.server import SlaveServer, serve_slave, serve_slaves, slave_from_gsd
    from dpstack.api.slave.alarms import SlaveAlarm
    from dpstack.api.slave.class2 import Connection
    from dpstack.api.slave.drive import Drive
    from dpstack.api.slave.slave import Slave
    from dpstack.dp.master.commands import Mode
    from dpstack.dp.master.events import SlaveState
    from dpstack.dp.pdu.alarm_blocks import AlarmType, ModuleState, Specifier, StatusType
    from dpstack.dp.pdu.diag_blocks import UserDiag, channel_block, device_block, identifier_block, revision_block
    from dpstack.dp.pdu.prm_blocks import PrmBlock
    from dpstack.dp.slave.application import SlaveApp, SlaveAppState
    from dpstack.dp.slave.events import DeviceFailed, RequestRefused
    from dpstack.dpv1.pdu.im import Im0, Im1, Im2, Im3, Im4
    from dpstack.dpv1.pdu.ms2 import InitiateReq
    from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
    from dpstack.dpv1.slave.user_slave import DpSlave
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
    from dpstack.trace import Event

__version__ = "0.1.0"

__all__ = [
    "AcyclicError",
    "AlarmError",
    "AlarmType",
    "BaudError",
    "BaudReport",
    "Bus",
    "BusError",
    "Commissioning",
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
    "SlaveParameter",
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

#: module and its public names; all others are in errors
_PLACES: Final = """
api.bus.bus Bus open_bus
api.bus.cycles Cycle
api.bus.find_baud BaudReport find_baud
api.bus.virtual run_virtual simulate World IoStation
api.commissioning.commissioning Commissioning
api.config.config Config load_config
api.lists.parameter_list ParameterPlace
api.server.server SlaveServer serve_slave serve_slaves slave_from_gsd
api.slave.alarms SlaveAlarm
api.slave.class2 Connection
api.slave.drive Drive
api.slave.slave Slave
dp.master.commands Mode
dp.master.events SlaveState
dp.pdu.alarm_blocks AlarmType ModuleState Specifier StatusType
dp.pdu.diag_blocks UserDiag channel_block device_block identifier_block revision_block
dp.pdu.prm_blocks PrmBlock
dp.slave.application SlaveApp SlaveAppState
dp.slave.events DeviceFailed RequestRefused
dpv1.pdu.im Im0 Im1 Im2 Im3 Im4
dpv1.pdu.ms2 InitiateReq
dpv1.slave.description SlaveDescription SlaveModule SlaveParameter
dpv1.slave.user_slave DpSlave
profile DriveStatus
trace Event
"""
_WHERE: Final = {name: module for module, *names in map(str.split, _PLACES.strip().splitlines()) for name in names}


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
    return __all__
