"""All that ``bus.events()`` yields, to be matched by class, and the values in it.

::

    async for event in bus.events():
        match event:
            case SlaveFaulted(name=name, fault=fault):
                print(event.time, name, fault.kind.value, fault.remedy)
            case events.Event(severity=Severity.ERROR):
                print(event.text)

Every event has ``t_ns`` (the machine's clock), ``time`` (the wall clock, UTC), ``severity``, and ``text``, one line for
people. Its other fields are for programs.
"""

from dpstack.api.bus.core import BusFailed
from dpstack.api.injected import Injected, ScenarioEvent
from dpstack.api.streams import SlaveFlapping
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import (
    ApplicationSilent,
    AutoCleared,
    Blocked,
    CyclesMissed,
    DriveEvent,
    Fault,
    FaultKind,
    ForcedClear,
    MasterStopped,
    ModeChanged,
    OperateWaits,
    SlaveDiagnosis,
    SlaveEvent,
    SlaveFaulted,
    SlaveRemark,
    SlaveState,
    SlaveStateChanged,
    Stalled,
)
from dpstack.dp.master.scanner import Found, SlaveView, StationSeen
from dpstack.dp.pdu.alarm_blocks import Alarm, AlarmType, Specifier, Status, StatusType
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dpv1.master.orders import AlarmRaised, ConnectionOver, StatusTold
from dpstack.drivers.runtime import (
    BehindRealTime,
    BusProcessBack,
    BusProcessSilent,
    OutputsDropped,
    PortBack,
    PortDisturbed,
    PortLost,
)
from dpstack.fdl.events import AddressCollision, DoesNotFit, MasterSeen, RingJoined, RingLeft, StationFound, TokenLost
from dpstack.fdl.telegram import StationType
from dpstack.trace import Event, Notice, Severity

__all__ = [
    "AddressCollision",
    "Alarm",
    "AlarmRaised",
    "AlarmType",
    "ApplicationSilent",
    "AutoCleared",
    "BehindRealTime",
    "Blocked",
    "BusFailed",
    "BusProcessBack",
    "BusProcessSilent",
    "ConnectionOver",
    "CyclesMissed",
    "Diagnosis",
    "DoesNotFit",
    "DriveEvent",
    "Event",
    "Fault",
    "FaultKind",
    "ForcedClear",
    "Found",
    "Injected",
    "MasterSeen",
    "MasterStopped",
    "Mode",
    "ModeChanged",
    "Notice",
    "OperateWaits",
    "OutputsDropped",
    "PortBack",
    "PortDisturbed",
    "PortLost",
    "RingJoined",
    "RingLeft",
    "ScenarioEvent",
    "Severity",
    "SlaveDiagnosis",
    "SlaveEvent",
    "SlaveFaulted",
    "SlaveFlapping",
    "SlaveRemark",
    "SlaveState",
    "SlaveStateChanged",
    "SlaveView",
    "Specifier",
    "Stalled",
    "StationFound",
    "StationSeen",
    "StationType",
    "Status",
    "StatusTold",
    "StatusType",
    "TokenLost",
]
