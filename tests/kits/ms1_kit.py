"""A master with slaves of octets that have MS1, and the ends of its services.

The slave knows telegrams as numbers only; nothing of the project is used to read or to make them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from bus_kit import all_exchange, setup
from octet_slave import DL, RS, SC, OctetSlave, frame, sd1, sd2
from order_bus import MS, OrderBus

from dpstack.dp.master.master import Master
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function

#: how a slave answers a request at MS1: its octets in, the answer's telegram out
Ms1 = Callable[[bytes], bytes | None]


def is_data_exchange(octets: bytes) -> bool:
    """Whether a request has no SAPs and is no FDL status request."""
    return not octets[4] & 0x80 if octets[0] == 0x68 else octets[3] != 0x49


@dataclass
class OctetMs1Slave(OctetSlave):
    """In data exchange with whoever parameterises it. ``ms1`` answers at SAP 51 (data of the request in); ``prm``
    is the last Set_Prm. ``mute``: it answers nothing any more."""

    inputs: bytes = b"\x07"
    ms1: Ms1 = lambda data: SC
    prm: bytes = b""
    mute: bool = False
    asked: list[bytes] = field(default_factory=list)

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        if self.mute:
            return None
        return (self.delay, self.data_exchange(octets)) if is_data_exchange(octets) else super().__call__(octets, now)

    def data_exchange(self, octets: bytes, control: int = DL) -> bytes:
        """The answer to a Data_Exchange."""
        sa = octets[5] if octets[0] == 0x68 else octets[2]
        return frame(bytes((sa & 0x7F, self.address, control)) + self.inputs)

    def service(self, octets: bytes) -> bytes | None:
        match octets[7]:
            case 61:
                self.prm = octets[9:-2]
                self.master = octets[5] & 0x7F
                return SC
            case 62:
                return SC
            case 51:
                assert octets[8] == 51
                self.asked.append(octets[9:-2])
                return self.ms1(octets[9:-2])
        return super().service(octets)


def answer(address: int, data: str, fc: int = DL) -> bytes:
    """From SAP 51 of ``address`` to SAP 51 of station 2."""
    return sd2(2, address, fc, 51, 51, bytes.fromhex(data))


def status(address: int, fc: int) -> bytes:
    """RS, RR, NR ... without data."""
    return sd1(2, address, fc)


def first_an_old_one(slave: OctetMs1Slave) -> list[str]:
    """Polls fetch what it owes (11), then nothing; a request is answered at once (22). What is still owed is given."""
    owed = ["5E 01 02 01 11"]

    def ms1(data: bytes) -> bytes:
        if data:
            return answer(4, "5E 01 02 01 22")
        return answer(4, owed.pop()) if owed else SC

    slave.ms1 = ms1
    return owed


@dataclass
class Ms1Bus(OrderBus[OctetMs1Slave]):
    """Station 2 with a DP master, its slaves at ``addresses`` in data exchange."""

    addresses: tuple[int, ...] = (4,)
    dpv1: Dpv1 | None = field(default_factory=Dpv1)
    kind: type[OctetMs1Slave] = field(default=OctetMs1Slave, kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.until_exchanging()

    def until_exchanging(self) -> None:
        """Run until all slaves are in data exchange."""
        self.until(lambda: all_exchange(self.master), 3_000)

    def setups(self) -> list[SlaveParams]:
        return [self.setup(address) for address in self.addresses]

    def setup(self, address: int, **changes: Any) -> SlaveParams:
        """A slave with one octet of inputs and DPV1_Status in its parameters."""
        return setup(address, self.dpv1, **{"config": b"\x10", "user_prm": bytes(3), "watchdog_ms": 0, **changes})

    @property
    def master(self) -> Master:
        return self.masters[0]

    def read(self, slot: int = 1, index: int = 2, length: int = 240, *, address: int = 4) -> RecordDone:
        """The end of one Read."""
        return self.end(self.order_read(slot, index, length, address=address))

    def order_read(self, slot: int = 1, index: int = 2, length: int = 240, *, address: int = 4, run_ms: int = 0) -> int:
        """Order a Read, and run for ``run_ms``; its token."""
        token = self.next_token()
        self.send(RecordOrder(token, Function.READ, slot, index, length, address=address))
        if run_ms:
            self.run(run_ms)
        return token

    def write(self, slot: int, index: int, data: bytes, *, address: int = 4) -> RecordDone:
        """The end of one Write."""
        token = self.next_token()
        self.send(RecordOrder(token, Function.WRITE, slot, index, data=data, address=address))
        return self.end(token)

    def end(self, token: int) -> RecordDone:
        """Run until the service has ended."""
        return self.end_of(token, RecordDone)

    @property
    def done(self) -> list[RecordDone]:
        """The ends of all services so far."""
        return self.events_of(RecordDone)


__all__ = ["DL", "MS", "RS", "SC", "Ms1Bus", "OctetMs1Slave", "answer", "status"]
