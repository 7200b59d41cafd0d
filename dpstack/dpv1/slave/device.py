"""A device with DP-V1: its records, alarms and class 2 connections, beside what every device has."""

from __future__ import annotations

from collections.abc import Callable

from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave.events import Report
from dpstack.dp.slave.extension import SlaveService
from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE
from dpstack.dpv1.slave.alarms import AlarmServer
from dpstack.dpv1.slave.ms1 import Ms1Server
from dpstack.dpv1.slave.record_requests import AcyclicDevice
from dpstack.dpv1.slave.resource_manager import MAX_CONNECTIONS, Ms2Server
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA


class Device(AcyclicDevice):
    """A device as its author writes it: subclass it, override what differs.

    ``alarm_server``: its alarms, None where the device has none.
    """

    alarm_server: AlarmServer | None = None

    def services(self, report: Report) -> tuple[SlaveService, ...]:
        """MS1 and MS2."""
        if not 0 <= self.ms2 <= MAX_CONNECTIONS:
            raise ConfigError(f"device {self.name}: ms2 = {self.ms2} connections; 0 to {MAX_CONNECTIONS} are possible")
        if not 0 < self.ms2_max_len <= MAX_RECORD:
            raise ConfigError(f"device {self.name}: ms2_max_len {self.ms2_max_len} is outside 1..{MAX_RECORD}")
        if not LEAST_INITIATE <= self.ms2_max_initiate <= MAX_DATA:
            what = f"ms2_max_initiate {self.ms2_max_initiate} is outside {LEAST_INITIATE}..{MAX_DATA}"
            raise ConfigError(f"device {self.name}: {what}")
        return Ms1Server(self.records, report, self.alarm_server), Ms2Server(self, report)


#: From the outputs and the time since data exchange began in ns to the inputs.
OnCycle = Callable[[bytes, int], bytes | bytearray]


class FunctionDevice(Device):
    """A device that is one function from outputs and elapsed time (ns since entry) to inputs."""

    def __init__(self, ident: int, config: bytes, function: OnCycle, name: str = "device") -> None:
        self.ident = ident
        self.configs = (config,)
        self.name = name
        self._function = function
        self._since = 0

    def enter(self, config: bytes, now: int) -> None:
        self._since = now

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """Hand over to the function, which may return a bytearray that it goes on writing to."""
        inputs = self._function(outputs, now - self._since)
        return bytes(inputs) if isinstance(inputs, bytearray) else inputs
