"""The orders that the machines of a bus know, all of them plain data."""

from __future__ import annotations

from typing import Final

from dpstack.dp.acyclic.class2 import ChangeAddress, ReadService
from dpstack.dp.acyclic.queue import CancelService
from dpstack.dp.master.commands import (
    ActivateSlave,
    AddSlave,
    Alive,
    DeactivateSlave,
    DriveCommand,
    RemoveSlave,
    ReparameteriseSlave,
    SendControl,
    SetMode,
    Shutdown,
)
from dpstack.dpv1.master.alarm_events import AcknowledgeAlarm, HoldAlarms
from dpstack.dpv1.master.ms1 import ReadRecord, WriteRecord
from dpstack.dpv1.master.ms2_commands import (
    CloseConnection,
    CloseConnections,
    OpenConnection,
    ReadOver,
    TransportOver,
    WriteOver,
)
from dpstack.fdl.commands import GoOffline, GoOnline

#: orders that end something: a driver carries them out however late they come
ENDING_ORDERS: Final = (Shutdown, CloseConnections, CloseConnection, GoOffline, CancelService)

MACHINE_ORDERS: Final[tuple[type, ...]] = (
    SetMode,
    Alive,
    Shutdown,
    AddSlave,
    RemoveSlave,
    DeactivateSlave,
    ActivateSlave,
    ReparameteriseSlave,
    SendControl,
    DriveCommand,
    ReadService,
    ChangeAddress,
    ReadRecord,
    WriteRecord,
    CancelService,
    HoldAlarms,
    AcknowledgeAlarm,
    OpenConnection,
    ReadOver,
    WriteOver,
    TransportOver,
    CloseConnection,
    CloseConnections,
    GoOnline,
    GoOffline,
)
