"""A device for tests of services at both ends: it takes its time, and each answer can be told from every other one."""

from __future__ import annotations

from typing import Final

from bus_kit import IDENT, PPO1

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_requests import RecordRequest

#: class 2 connections that it has
CONNECTIONS: Final = 2


class Patient(MirrorDevice):
    """Answers after so many exchanges (the index), 99: never, 98: no. The data begin with a serial number."""

    def __init__(self) -> None:
        super().__init__(IDENT, PPO1)
        self.records = self
        self.transport = self.ask
        self.ms2 = CONNECTIONS
        self.serial = 0
        self.working: list[tuple[RecordRequest, int, int]] = []

    def ask(self, request: RecordRequest) -> None:
        self.serial += 1
        if request.service.index == 98:
            request.refuse(Code.INVALID_INDEX, self.serial)
        else:
            self.working.append((request, request.service.index, self.serial))

    def exchange(self, outputs: bytes, now: int) -> bytes:
        for request, left, serial in self.working:
            if left == 0:
                request.answer(bytes((serial, request.service.slot, request.service.index)))
        self.working = [(request, left - 1, serial) for request, left, serial in self.working if left]
        return super().exchange(outputs, now)
