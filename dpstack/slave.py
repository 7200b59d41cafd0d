"""For slaves of one's own: their description, the server that puts them on a port, their events, diagnosis and alarms.

::

    async with dpstack.slave.serve_slave(valves, port="/dev/ttyUSB0", baud=500_000, address=5) as server:
        await server.serve_forever()

docs/how-to/slave.md is the guide. The events of a slave application are given to its ``on_event``.
"""

from dpstack.api.slave_side.slave_server import SlaveServer as SlaveServer
from dpstack.api.slave_side.slave_server import serve_slave as serve_slave
from dpstack.api.slave_side.slave_server import serve_slaves as serve_slaves
from dpstack.api.slave_side.slave_server import slave_from_gsd as slave_from_gsd
from dpstack.dp.pdu.alarm_blocks import AlarmType as AlarmType
from dpstack.dp.pdu.alarm_blocks import ModuleState as ModuleState
from dpstack.dp.pdu.alarm_blocks import Specifier as Specifier
from dpstack.dp.pdu.alarm_blocks import StatusType as StatusType
from dpstack.dp.pdu.diag_blocks import UserDiag as UserDiag
from dpstack.dp.pdu.diag_blocks import channel_block as channel_block
from dpstack.dp.pdu.diag_blocks import device_block as device_block
from dpstack.dp.pdu.diag_blocks import identifier_block as identifier_block
from dpstack.dp.pdu.diag_blocks import revision_block as revision_block
from dpstack.dp.pdu.prm_blocks import PrmBlock as PrmBlock
from dpstack.dp.slave.application import SlaveApp as SlaveApp
from dpstack.dp.slave.application import SlaveAppState as SlaveAppState
from dpstack.dp.slave.auto_baud import BaudStateChanged as BaudStateChanged
from dpstack.dp.slave.auto_baud import PortBaudChanged as PortBaudChanged
from dpstack.dp.slave.events import AddressChanged as AddressChanged
from dpstack.dp.slave.events import DeviceFailed as DeviceFailed
from dpstack.dp.slave.events import RequestRefused as RequestRefused
from dpstack.dp.slave.events import SlaveAppEvent as SlaveAppEvent
from dpstack.dp.slave.events import SlaveAppStateChanged as SlaveAppStateChanged
from dpstack.dp.slave.events import WatchdogExpired as WatchdogExpired
from dpstack.dpv1.pdu.im import Im0 as Im0
from dpstack.dpv1.pdu.im import Im1 as Im1
from dpstack.dpv1.pdu.im import Im2 as Im2
from dpstack.dpv1.pdu.im import Im3 as Im3
from dpstack.dpv1.pdu.im import Im4 as Im4
from dpstack.dpv1.pdu.ms2 import InitiateReq as InitiateReq
from dpstack.dpv1.slave.clock_receiver import ClockJumped as ClockJumped
from dpstack.dpv1.slave.clock_receiver import ClockLost as ClockLost
from dpstack.dpv1.slave.clock_receiver import ClockSet as ClockSet
from dpstack.dpv1.slave.clock_receiver import PlantClock as PlantClock
from dpstack.dpv1.slave.description import SlaveDescription as SlaveDescription
from dpstack.dpv1.slave.description import SlaveModule as SlaveModule
from dpstack.dpv1.slave.description import SlaveParameter as SlaveParameter
from dpstack.dpv1.slave.description_to_gsd import gsd_octets as gsd_octets
from dpstack.dpv1.slave.device import AlarmAcknowledged as AlarmAcknowledged
from dpstack.dpv1.slave.dxb_links import DxbSupport as DxbSupport
from dpstack.dpv1.slave.dxb_links import LinkChanged as LinkChanged
from dpstack.dpv1.slave.dxb_links import SlaveLink as SlaveLink
from dpstack.dpv1.slave.resource_manager import ConnectionClosed as ConnectionClosed
from dpstack.dpv1.slave.resource_manager import ConnectionOpened as ConnectionOpened
from dpstack.dpv1.slave.user_slave import DpSlave as DpSlave
from dpstack.errors import AlarmError as AlarmError
from dpstack.errors import RecordRefused as RecordRefused

__all__ = sorted(name for name in globals() if name[0].isalpha())
