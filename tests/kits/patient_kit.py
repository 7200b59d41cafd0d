"""A device for tests of services at both ends: it takes its time, and each answer can be told from every other one."""

from __future__ import annotations

from typing import Final

from bus_kit import IDENT, PPO1

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_requests import RecordRequest, TransportRequest

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
        self.working: list[tuple[RecordRequest | TransportRequest, int, int]] = []

    def ask(self, ticket: RecordRequest | TransportRequest) -> None:
        self.serial += 1
        if ticket.request.index == 98:
            ticket.refuse(Code.INVALID_INDEX, self.serial)
        else:
            self.working.append((ticket, ticket.request.index, self.serial))

    def exchange(self, outputs: bytes, now: int) -> bytes:
        for ticket, left, serial in self.working:
            if left == 0:
                ticket.answer(bytes((serial, ticket.request.slot, ticket.request.index)))
        self.working = [(ticket, left - 1, serial) for ticket, left, serial in self.working if left]
        return super().exchange(outputs, now)
