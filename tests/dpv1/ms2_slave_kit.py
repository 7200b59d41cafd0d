"""A slave with class 2 connections on a wire, and a master of class 2 in octets."""

from __future__ import annotations

from octet_class2 import (
    IDLE,
    INITIATE,
    OPENED,
    SC,
    Class2,
)
from octet_wire import MS, Wire, framed
from slave_kit import Recorder, make_slave

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_requests import RecordRequest, Records, Transport
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.params import BusParams

READ = "5E 00 01 F0"
READ_RES = "5E 00 01 03 11 22 33"
#: at 500 kbit/s the slave's send time-out is 2 s, longer than the 1 s of INITIATE
TIMEOUT = 2_000 * MS


class Later:
    """Keeps the requests."""

    def __init__(self) -> None:
        self.requests: list[RecordRequest] = []

    def ask(self, request: RecordRequest) -> None:
        self.requests.append(request)


class Slave:
    """Slave 8 on a wire, with ``count`` connections."""

    def __init__(
        self,
        records: Records | None = None,
        count: int = 2,
        *,
        at_once: bool = False,
        transport: Transport | None = None,
        max_len: int = 240,
        device: Device | None = None,
    ) -> None:
        self.device = device or Recorder()
        self.device.records = records or RecordTable({(0, 1): b"\x11\x22\x33", (1, 2): b"\xaa"}, [(1, 2)])
        self.device.ms2 = count
        self.device.ms2_at_once = at_once
        self.device.ms2_max_len = max_len
        self.device.transport = transport
        self.count = count
        station = make_slave(8, self.device, BusParams.preset(500_000))
        self.wire = Wire(station)
        app = station.responder
        assert isinstance(app, SlaveApp)
        self.app = app
        self.master = Class2(self.wire)

    def texts(self) -> list[str]:
        return [event.text.removeprefix("slave 8 (recorder): ") for event in self.wire.station.take_events()]

    def saps(self) -> list[int]:
        return [connection.sap for connection in ms2_of(self.app).connections]

    def state(self) -> SlaveAppState:
        return self.app.state

    def all_free(self) -> bool:
        return ms2_of(self.app).free == self.count and not ms2_of(self.app).connections


def reach(slave: Slave, later: Later, step: str) -> None:
    """A connection of master 1 at SAP 48, up to ``step``; each step is one telegram."""
    steps = ("initiate", "manager", "opened", "asked", "fetched", "idle", "idle answered")
    master = slave.master
    for one in steps[: steps.index(step) + 1]:
        match one:
            case "initiate":
                assert master.ask(49, INITIATE) == SC
            case "manager":
                assert master.manager() == 48
            case "opened":
                assert master.ask(48) == OPENED
            case "asked":
                assert master.ask(48, READ) == SC
            case "fetched":
                later.requests[0].answer()
                assert master.ask(48) == "5E 00 01 00"
            case "idle":
                assert master.ask(48, IDLE) == SC
            case "idle answered":
                assert master.ask(48) == IDLE


def cyclic(slave: Slave, fc: int, unit: str) -> str:
    """Something of the class 1 master 2."""
    da, sa = (0x88, 0x82) if fc & 0x100 else (0x08, 0x02)
    return slave.wire.ask(framed(da, sa, fc & 0xFF, unit))
