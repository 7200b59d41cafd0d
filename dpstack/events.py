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

from dpstack.api.bus.core import BusFailed as BusFailed
from dpstack.api.injected import Injected as Injected
from dpstack.api.injected import ScenarioEvent as ScenarioEvent
from dpstack.api.refused_orders import OrdersRefused as OrdersRefused
from dpstack.api.refused_orders import RefusedOrder as RefusedOrder
from dpstack.api.slave.quality_events import QualityChanged as QualityChanged
from dpstack.api.slave.quality_events import ValueQuality as ValueQuality
from dpstack.api.streams import SlaveFlapping as SlaveFlapping
from dpstack.dp.master.commands import Mode as Mode
from dpstack.dp.master.events import ApplicationSilent as ApplicationSilent
from dpstack.dp.master.events import AutoCleared as AutoCleared
from dpstack.dp.master.events import Blocked as Blocked
from dpstack.dp.master.events import CyclesMissed as CyclesMissed
from dpstack.dp.master.events import DriveEvent as DriveEvent
from dpstack.dp.master.events import Fault as Fault
from dpstack.dp.master.events import FaultKind as FaultKind
from dpstack.dp.master.events import ForcedClear as ForcedClear
from dpstack.dp.master.events import MasterStopped as MasterStopped
from dpstack.dp.master.events import ModeChanged as ModeChanged
from dpstack.dp.master.events import OperateWaits as OperateWaits
from dpstack.dp.master.events import OutputsWithheld as OutputsWithheld
from dpstack.dp.master.events import SlaveDiagnosis as SlaveDiagnosis
from dpstack.dp.master.events import SlaveEvent as SlaveEvent
from dpstack.dp.master.events import SlaveFaulted as SlaveFaulted
from dpstack.dp.master.events import SlaveRemark as SlaveRemark
from dpstack.dp.master.events import SlaveState as SlaveState
from dpstack.dp.master.events import SlaveStateChanged as SlaveStateChanged
from dpstack.dp.master.events import Stalled as Stalled
from dpstack.dp.master.scanner import Found as Found
from dpstack.dp.master.scanner import StationSeen as StationSeen
from dpstack.dp.pdu.alarm_blocks import Alarm as Alarm
from dpstack.dp.pdu.alarm_blocks import AlarmType as AlarmType
from dpstack.dp.pdu.alarm_blocks import Specifier as Specifier
from dpstack.dp.pdu.alarm_blocks import Status as Status
from dpstack.dp.pdu.alarm_blocks import StatusType as StatusType
from dpstack.dp.pdu.diagnosis import Diagnosis as Diagnosis
from dpstack.dp.pdu.diagnosis import SlaveView as SlaveView
from dpstack.dpv1.master.alarm_orders import AlarmRaised as AlarmRaised
from dpstack.dpv1.master.alarm_orders import ConnectionOver as ConnectionOver
from dpstack.dpv1.master.alarm_orders import StatusTold as StatusTold
from dpstack.drivers.runtime import BehindRealTime as BehindRealTime
from dpstack.drivers.runtime import BusProcessBack as BusProcessBack
from dpstack.drivers.runtime import BusProcessSilent as BusProcessSilent
from dpstack.drivers.runtime import OutputsDropped as OutputsDropped
from dpstack.drivers.runtime import PortBack as PortBack
from dpstack.drivers.runtime import PortDisturbed as PortDisturbed
from dpstack.drivers.runtime import PortLost as PortLost
from dpstack.fdl.events import AddressCollision as AddressCollision
from dpstack.fdl.events import DoesNotFit as DoesNotFit
from dpstack.fdl.events import MasterSeen as MasterSeen
from dpstack.fdl.events import RingJoined as RingJoined
from dpstack.fdl.events import RingLeft as RingLeft
from dpstack.fdl.events import StationFound as StationFound
from dpstack.fdl.events import TokenLost as TokenLost
from dpstack.fdl.telegram import StationType as StationType
from dpstack.trace import Event as Event
from dpstack.trace import Notice as Notice
from dpstack.trace import Severity as Severity

__all__ = sorted(name for name in globals() if name[0].isalpha())
