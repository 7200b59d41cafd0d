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
- :mod:`dpstack.fdl`: services of the link layer below DP: requests to any station, service access points of one's own
- :mod:`dpstack.blocking`: the names without ``await``, for scripts, the Python shell, Jupyter
- :mod:`dpstack.ppi`: values, mode and clock of an S7-200 over PPI
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

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack import blocking as blocking
    from dpstack import decode as decode
    from dpstack import events as events
    from dpstack import fdl as fdl
    from dpstack import gsd as gsd
    from dpstack import ppi as ppi
    from dpstack import profile as profile
    from dpstack import slave as slave
    from dpstack import testing as testing
    from dpstack.api.bus.bus import Bus as Bus
    from dpstack.api.bus.cycles import Cycle as Cycle
    from dpstack.api.bus.find_baud import BaudReport as BaudReport
    from dpstack.api.bus.find_baud import find_baud as find_baud
    from dpstack.api.bus.opening import open_bus as open_bus
    from dpstack.api.bus.statistics import BusStats as BusStats
    from dpstack.api.bus.statistics import SlaveStats as SlaveStats
    from dpstack.api.bus.virtual import IoStation as IoStation
    from dpstack.api.bus.virtual import World as World
    from dpstack.api.bus.virtual import run_virtual as run_virtual
    from dpstack.api.bus.virtual import simulate as simulate
    from dpstack.api.commissioning.commissioning import Commissioning as Commissioning
    from dpstack.api.config.config import Config as Config
    from dpstack.api.config.config import load_config as load_config
    from dpstack.api.connectors.publishing import publish as publish
    from dpstack.api.fdl_station.station import open_fdl as open_fdl
    from dpstack.api.lists.parameter_list import ParameterPlace as ParameterPlace
    from dpstack.api.lists.parameter_list import ParameterValue as ParameterValue
    from dpstack.api.slave.alarms import SlaveAlarm as SlaveAlarm
    from dpstack.api.slave.class2 import Connection as Connection
    from dpstack.api.slave.class2 import ProcessData as ProcessData
    from dpstack.api.slave.class2 import ReadDiagnosis as ReadDiagnosis
    from dpstack.api.slave.drive import Drive as Drive
    from dpstack.api.slave.drive import DriveNotice as DriveNotice
    from dpstack.api.slave.hart import HartDevice as HartDevice
    from dpstack.api.slave.hart import HartReading as HartReading
    from dpstack.api.slave.slave import Slave as Slave
    from dpstack.api.slave.typed import Bool as Bool
    from dpstack.api.slave.typed import Inputs as Inputs
    from dpstack.api.slave.typed import Int as Int
    from dpstack.api.slave.typed import Octets as Octets
    from dpstack.api.slave.typed import Outputs as Outputs
    from dpstack.api.slave.typed import Scaled as Scaled
    from dpstack.api.slave.typed import at as at
    from dpstack.api.slave_side.virtual_bench import VirtualBench as VirtualBench
    from dpstack.dp.master.commands import Mode as Mode
    from dpstack.dp.master.events import SlaveState as SlaveState
    from dpstack.dp.pdu.alarm_blocks import AlarmType as AlarmType
    from dpstack.dp.pdu.alarm_blocks import Specifier as Specifier
    from dpstack.dp.pdu.alarm_blocks import StatusType as StatusType
    from dpstack.dp.plan.plan import Plan as Plan
    from dpstack.dpv1.pdu.im import Im0 as Im0
    from dpstack.dpv1.pdu.im import Im1 as Im1
    from dpstack.dpv1.pdu.im import Im2 as Im2
    from dpstack.dpv1.pdu.im import Im3 as Im3
    from dpstack.dpv1.pdu.im import Im4 as Im4
    from dpstack.drivers.snapshots import BusSnapshot as BusSnapshot
    from dpstack.drivers.snapshots import ClockSnapshot as ClockSnapshot
    from dpstack.drivers.snapshots import SentClock as SentClock
    from dpstack.drivers.snapshots import SlaveSnapshot as SlaveSnapshot
    from dpstack.errors import AcyclicError as AcyclicError
    from dpstack.errors import AlarmError as AlarmError
    from dpstack.errors import BaudError as BaudError
    from dpstack.errors import BusError as BusError
    from dpstack.errors import ConfigError as ConfigError
    from dpstack.errors import ConnectionEnded as ConnectionEnded
    from dpstack.errors import CpuRefused as CpuRefused
    from dpstack.errors import DpError as DpError
    from dpstack.errors import DriveError as DriveError
    from dpstack.errors import DriveFault as DriveFault
    from dpstack.errors import DriveTimeout as DriveTimeout
    from dpstack.errors import FdlError as FdlError
    from dpstack.errors import HartError as HartError
    from dpstack.errors import NoInputs as NoInputs
    from dpstack.errors import OrderDropped as OrderDropped
    from dpstack.errors import ParamError as ParamError
    from dpstack.errors import ParameterError as ParameterError
    from dpstack.errors import PortBusyError as PortBusyError
    from dpstack.errors import PortError as PortError
    from dpstack.errors import RecordRefused as RecordRefused
    from dpstack.errors import ServiceRefused as ServiceRefused
    from dpstack.errors import SlaveError as SlaveError
    from dpstack.errors import SlaveFault as SlaveFault
    from dpstack.errors import SlaveTimeout as SlaveTimeout
    from dpstack.errors import UnknownAttribute as UnknownAttribute
    from dpstack.errors import UsageError as UsageError
    from dpstack.params import BusParams as BusParams
    from dpstack.profile import DriveStatus as DriveStatus
    from dpstack.trace import Event as Event
    from dpstack.why.story import Story as Story

__version__ = "0.1.0"

#: module and its public names
_PLACES: Final = """
blocking
decode
events
fdl
gsd
ppi
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
api.fdl_station.station open_fdl
api.slave_side.virtual_bench VirtualBench
api.slave.alarms SlaveAlarm
api.slave.class2 Connection ProcessData ReadDiagnosis
api.slave.drive Drive DriveNotice
api.slave.hart HartDevice HartReading
api.slave.slave Slave
api.slave.typed Bool Inputs Int Octets Outputs Scaled at
dp.master.commands Mode
dp.master.events SlaveState
dp.pdu.alarm_blocks AlarmType Specifier StatusType
dpv1.pdu.im Im0 Im1 Im2 Im3 Im4
profile DriveStatus
trace Event
errors AcyclicError AlarmError BaudError BusError ConfigError ConnectionEnded CpuRefused DpError DriveError DriveFault
errors DriveTimeout FdlError HartError NoInputs OrderDropped ParamError ParameterError PortBusyError PortError
errors RecordRefused
errors ServiceRefused SlaveError SlaveFault SlaveTimeout UnknownAttribute UsageError
api.bus.statistics BusStats SlaveStats
drivers.snapshots BusSnapshot ClockSnapshot SentClock SlaveSnapshot
dp.plan.plan Plan
why.story Story
params BusParams
"""


def _hint(name: str) -> str:
    """Where ``name`` is found instead; empty if it is unknown. (Python asks for names such as ``__path__``.)"""
    from importlib.util import find_spec  # here, as it is for names that there are not

    if not name.startswith("_") and find_spec(f"dpstack.{name}") is None:  # else Python goes on to import it
        for other in ("slave", "events"):
            if name in importlib.import_module(f"dpstack.{other}").__all__:
                return f": it is dpstack.{other}.{name}"
    return ""


if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES, _hint)
    __all__.append("__version__")
