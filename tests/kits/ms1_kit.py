"""A master with slaves of octets that have MS1, and what came of its services.

The slave knows telegrams as numbers only; nothing of the project is used to read or to make them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from octet_slave import DL, RS, SC, OctetSlave, sd1, sd2
from ring_bus import RingBus

from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams

MS = 1_000_000
#: how a slave answers a request at MS1: its octets in, the answer's telegram out
Ms1 = Callable[[bytes], bytes | None]


def setup(address: int, dpv1: Dpv1 | None) -> SlaveParams:
    """A slave with one octet of inputs and DPV1_Status in its parameters."""
    return SlaveParams(
        address=address,
        name=f"s{address}",
        ident=0x1234,
        config=b"\x10",
        user_prm=bytes(3),
        watchdog_ms=0,
        dpv1=dpv1,
    )


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
        if octets[0] == 0x68 and not octets[4] & 0x80:
            body = bytes((octets[5] & 0x7F, self.address, DL)) + self.inputs
            length = len(body)
            return self.delay, bytes((0x68, length, length, 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))
        if octets[0] == 0x10 and octets[3] != 0x49:
            body = bytes((octets[2] & 0x7F, self.address, DL)) + self.inputs
            length = len(body)
            return self.delay, bytes((0x68, length, length, 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))
        return super().__call__(octets, now)

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
class Ms1Bus:
    """Station 2, its slaves at ``addresses`` in data exchange."""

    addresses: tuple[int, ...] = (4,)
    mode: str = "whole"
    dpv1: Dpv1 | None = field(default_factory=Dpv1)
    kind: type[OctetMs1Slave] = OctetMs1Slave
    baud: int = 500_000
    bus: RingBus = field(init=False)
    tokens: int = 0

    def __post_init__(self) -> None:
        self.bus = RingBus(self.baud, self.mode)
        self.slaves = {address: self.kind(self.bus, address) for address in self.addresses}
        params = BusParams.preset(self.baud, address=2, gap=0)
        self.master = Master(params, [setup(address, self.dpv1) for address in self.addresses])
        self.acyclic = acyclic_services(2, self.master)
        self.station = ActiveStation(params, [self.master, self.acyclic])
        self.bus.stations.append(self.station)
        self.bus.command(self.station, GoOnline())
        self.until_exchanging()

    def until_exchanging(self) -> None:
        """All slaves in data exchange."""
        for _ in range(3_000):
            if all(handler.state is SlaveState.DATA_EXCHANGE for handler in self.master.handlers.values()):
                return
            self.bus.run(MS)
        raise AssertionError("not all slaves in data exchange")

    @property
    def slave(self) -> OctetMs1Slave:
        """The first."""
        return self.slaves[self.addresses[0]]

    def send(self, command: object) -> None:
        """An order."""
        self.bus.command(self.station, command)

    def read(self, slot: int = 1, index: int = 2, length: int = 240, *, address: int = 4) -> RecordDone:
        """The end of one Read."""
        return self.end(self.order_read(slot, index, length, address=address))

    def order_read(self, slot: int = 1, index: int = 2, length: int = 240, *, address: int = 4) -> int:
        """Ordered only."""
        self.tokens += 1
        self.send(RecordOrder(self.tokens, Function.READ, slot, index, length, address=address))
        return self.tokens

    def write(self, slot: int, index: int, data: bytes, *, address: int = 4) -> RecordDone:
        """The end of one Write."""
        self.tokens += 1
        self.send(RecordOrder(self.tokens, Function.WRITE, slot, index, data=data, address=address))
        return self.end(self.tokens)

    def end(self, token: int, within_ns: int = 20_000 * MS) -> RecordDone:
        """Run until the service has its end."""
        limit = self.bus.now + within_ns
        while not (found := [done for done in self.done if done.token == token]):
            assert self.bus.now < limit, "no end"
            self.bus.run(MS)
        (one,) = found
        return one

    @property
    def done(self) -> list[RecordDone]:
        """All ends so far."""
        return [event for event in self.bus.events if isinstance(event, RecordDone)]


__all__ = ["DL", "RS", "SC", "Ms1Bus", "OctetMs1Slave", "answer", "status"]
