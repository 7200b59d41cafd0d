"""A device with DP-V1: its records, alarms and class 2 connections, beside what every device has."""

from __future__ import annotations

from dpstack.dp.slave.events import Report
from dpstack.dp.slave.extension import SlaveService
from dpstack.dpv1.slave.alarms import AlarmServer
from dpstack.dpv1.slave.ms1 import Ms1Server
from dpstack.dpv1.slave.record_requests import AcyclicDevice
from dpstack.dpv1.slave.resource_manager import Ms2Server, check_ms2


class Device(AcyclicDevice):
    """A device as its author writes it: subclass it, override what differs.

    ``alarm_server``: its alarms, None where the device has none.
    """

    alarm_server: AlarmServer | None = None

    def services(self, report: Report) -> tuple[SlaveService, ...]:
        """MS1 and MS2."""
        check_ms2(f"device {self.name}", self.ms2, self.ms2_max_len, self.ms2_max_initiate)
        return Ms1Server(self.records, report, self.alarm_server), Ms2Server(self, report)
