"""For slaves of one's own: their description, the server that puts them on a port, their events, diagnosis and alarms.

::

    async with dpstack.slave.serve_slave(valves, port="/dev/ttyUSB0", baud=500_000, address=5) as server:
        await server.serve_forever()

docs/how-to/slave.md is the guide. The events of a slave application are given to its ``on_event``.
"""

from dpstack.api.slave_side.slave_server import SlaveServer, serve_slave, serve_slaves, slave_from_gsd
from dpstack.dp.pdu.alarm_blocks import AlarmType, ModuleState, Specifier, StatusType
from dpstack.dp.pdu.diag_blocks import UserDiag, channel_block, device_block, identifier_block, revision_block
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.auto_baud import BaudStateChanged, PortBaudChanged
from dpstack.dp.slave.events import (
    AddressChanged,
    DeviceFailed,
    RequestRefused,
    SlaveAppEvent,
    SlaveAppStateChanged,
    WatchdogExpired,
)
from dpstack.dpv1.pdu.im import Im0, Im1, Im2, Im3, Im4
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.description_to_gsd import gsd_octets
from dpstack.dpv1.slave.device import AlarmAcknowledged
from dpstack.dpv1.slave.resource_manager import ConnectionClosed, ConnectionOpened
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import AlarmError, RecordRefused

__all__ = [
    "AddressChanged",
    "AlarmAcknowledged",
    "AlarmError",
    "AlarmType",
    "BaudStateChanged",
    "ConnectionClosed",
    "ConnectionOpened",
    "DeviceFailed",
    "DpSlave",
    "Im0",
    "Im1",
    "Im2",
    "Im3",
    "Im4",
    "InitiateReq",
    "ModuleState",
    "PortBaudChanged",
    "PrmBlock",
    "RecordRefused",
    "RequestRefused",
    "SlaveApp",
    "SlaveAppEvent",
    "SlaveAppState",
    "SlaveAppStateChanged",
    "SlaveDescription",
    "SlaveModule",
    "SlaveParameter",
    "SlaveServer",
    "Specifier",
    "StatusType",
    "UserDiag",
    "WatchdogExpired",
    "channel_block",
    "device_block",
    "gsd_octets",
    "identifier_block",
    "revision_block",
    "serve_slave",
    "serve_slaves",
    "slave_from_gsd",
]
