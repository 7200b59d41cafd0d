"""PROFIBUS-DP for Python: a soft master for asyncio applications, simulated slaves, drive profiles, virtual time.

::

    async with dpstack.open_bus("plant.toml") as bus:
        await bus.operate()
        mixer = bus.drive("mixer")
        await mixer.start()
        mixer.speed = 0.5
        await mixer.reached()

The names here and in these namespaces are public; the rest may change without notice:

- :mod:`dpstack.events`: the classes of all events of a bus, to be matched
- :mod:`dpstack.slave`: slaves of one's own
- :mod:`dpstack.blocking`: the names without ``await``, for scripts, the Python shell, Jupyter
- :mod:`dpstack.profile`: for authors of drive plugins
- :mod:`dpstack.gsd`: GSD files
- :mod:`dpstack.decode`: telegrams explained to the bit
- :mod:`dpstack.testing`: tests of applications and of drive plugins

Each name is loaded at its first use, so that a drive plugin or a child process that needs one layer does not load all
of them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

from dpstack.namespaces import loader

if TYPE_CHECKING:
    from dpstack import blocking, decode, events, gsd, profile, slave, testing
    from dpstack.api.bus.bus import Bus
    from dpstack.api.bus.cycles import Cycle
    from dpstack.api.bus.find_baud import BaudReport, find_baud
    from dpstack.api.bus.opening import open_bus
    from dpstack.api.bus.statistics import BusStats, SlaveStats
    from dpstack.api.bus.virtual import IoStation, World, run_virtual, simulate
    from dpstack.api.commissioning.commissioning import Commissioning
    from dpstack.api.config.config import Config, load_config
    from dpstack.api.connectors.publishing import publish
    from dpstack.api.lists.parameter_list import ParameterPlace, ParameterValue
    from dpstack.api.slave.alarms import SlaveAlarm
    from dpstack.api.slave.class2 import Connection, ProcessData, ReadDiagnosis
    from dpstack.api.slave.drive import Drive, DriveNotice
    from dpstack.api.slave.slave import Slave
    from dpstack.api.slave.typed import Bool, Inputs, Int, Octets, Outputs, Scaled, at
    from dpstack.api.slave_side.virtual_bench import VirtualBench
    from dpstack.dp.master.commands import Mode
    from dpstack.dp.master.events import SlaveState
    from dpstack.dp.pdu.alarm_blocks import AlarmType, Specifier, StatusType
    from dpstack.dp.plan.plan import Plan
    from dpstack.dpv1.pdu.im import Im0, Im1, Im2, Im3, Im4
    from dpstack.drivers.snapshots import BusSnapshot, SlaveSnapshot
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
    from dpstack.params import BusParams
    from dpstack.profile import DriveStatus
    from dpstack.trace import Event
    from dpstack.why.story import Story

__version__ = "0.1.0"

__all__ = [
    "AcyclicError",
    "AlarmError",
    "AlarmType",
    "BaudError",
    "BaudReport",
    "Bool",
    "Bus",
    "BusError",
    "BusParams",
    "BusSnapshot",
    "BusStats",
    "Commissioning",
    "Config",
    "ConfigError",
    "Connection",
    "ConnectionEnded",
    "Cycle",
    "DpError",
    "Drive",
    "DriveError",
    "DriveFault",
    "DriveNotice",
    "DriveStatus",
    "DriveTimeout",
    "Event",
    "Im0",
    "Im1",
    "Im2",
    "Im3",
    "Im4",
    "Inputs",
    "Int",
    "IoStation",
    "Mode",
    "NoInputs",
    "Octets",
    "OrderDropped",
    "Outputs",
    "ParamError",
    "ParameterError",
    "ParameterPlace",
    "ParameterValue",
    "Plan",
    "PortBusyError",
    "PortError",
    "ProcessData",
    "ReadDiagnosis",
    "RecordRefused",
    "Scaled",
    "ServiceRefused",
    "Slave",
    "SlaveAlarm",
    "SlaveError",
    "SlaveFault",
    "SlaveSnapshot",
    "SlaveState",
    "SlaveStats",
    "SlaveTimeout",
    "Specifier",
    "StatusType",
    "Story",
    "UnknownAttribute",
    "UsageError",
    "VirtualBench",
    "World",
    "__version__",
    "at",
    "blocking",
    "decode",
    "events",
    "find_baud",
    "gsd",
    "load_config",
    "open_bus",
    "profile",
    "publish",
    "run_virtual",
    "simulate",
    "slave",
    "testing",
]

#: module and its public names
_PLACES: Final = """
blocking
decode
events
gsd
profile
slave
testing
api.bus.bus Bus
api.bus.cycles Cycle
api.bus.find_baud BaudReport find_baud
api.bus.virtual run_virtual simulate World IoStation
api.commissioning.commissioning Commissioning
api.config.config Config load_config
api.connectors.publishing publish
api.lists.parameter_list ParameterPlace ParameterValue
api.bus.opening open_bus
api.slave_side.virtual_bench VirtualBench
api.slave.alarms SlaveAlarm
api.slave.class2 Connection ProcessData ReadDiagnosis
api.slave.drive Drive DriveNotice
api.slave.slave Slave
api.slave.typed Bool Inputs Int Octets Outputs Scaled at
dp.master.commands Mode
dp.master.events SlaveState
dp.pdu.alarm_blocks AlarmType Specifier StatusType
dpv1.pdu.im Im0 Im1 Im2 Im3 Im4
profile DriveStatus
trace Event
errors AcyclicError AlarmError BaudError BusError ConfigError ConnectionEnded DpError DriveError DriveFault
errors DriveTimeout NoInputs OrderDropped ParamError ParameterError PortBusyError PortError RecordRefused
errors ServiceRefused SlaveError SlaveFault SlaveTimeout UnknownAttribute UsageError
api.bus.statistics BusStats SlaveStats
drivers.snapshots BusSnapshot SlaveSnapshot
dp.plan.plan Plan
why.story Story
params BusParams
"""


def _hint(name: str) -> str:
    """Where ``name`` is found instead; empty if it is unknown. (Python asks for names such as ``__path__``.)"""
    from importlib.util import find_spec  # here, as it is for names that there are not

    if not name.startswith("_") and find_spec(f"dpstack.{name}") is None:  # else Python goes on to import it
        for namespace in ("slave", "events"):
            if name in importlib.import_module(f"dpstack.{namespace}").__all__:
                return f": it is dpstack.{namespace}.{name}"
    return ""


if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__ = loader(__name__, _PLACES, _hint)


def __dir__() -> list[str]:
    return __all__
