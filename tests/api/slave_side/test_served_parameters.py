"""Record 47 of a slave that users build: literally at MS1, and read by name over a bus."""

from __future__ import annotations

from pathlib import Path

import pytest
from api_kit import serving
from slave_kit import Bench

import dpstack
from dpstack.dp.master.events import SlaveState
from dpstack.dpv1.pdu.read_write import ReadReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.fdl.interface import SC_REPLY
from dpstack.fdl.telegram import Resp
from dpstack.profile import ParamSpec, ParamStore, ParamTable
from dpstack.profile.record47 import (
    Address,
    ErrorValue,
    Limits,
    ParameterServer,
    Rules,
    StoreParameters,
    TimedRecords,
    Values,
)
from dpstack.slave import DpSlave, SlaveDescription
from dpstack.units import NS_PER_MS

pytestmark = pytest.mark.virtual_time

TABLE = ParamTable(
    (
        ParamSpec(number=965, name="profile", title="Profile", factory=0x0328, read_only=True),
        ParamSpec(number=10, name="ramp", title="Ramp", unit="s", decimals=1, factory=50),
    )
)
RIG = SlaveDescription(ident=0x1234, name="rig", configs=(bytes.fromhex("10 20"),), dpv1=True, ms2=1)


def rig(store: ParamStore, busy_ms: int = 0) -> DpSlave:
    server = ParameterServer(StoreParameters(store), Rules(slots=frozenset({1}), busy_ns=busy_ms * NS_PER_MS))

    async def read(slot: int, index: int) -> bytes:
        return bytes((slot, index))

    return DpSlave(RIG, lambda outputs, elapsed: bytes(1), on_read=read, parameters=TimedRecords(server))


def test_literally() -> None:
    bench = Bench(rig(ParamStore(TABLE, {}), busy_ms=5))
    bench.prm_and_cfg(bytes.fromhex("88 01 0A 0B 12 34 00 80 00 00"), bytes.fromhex("10 20"))
    for now, request, response in (
        (0, "5E 01 2F F0", "DE 80 B5 00"),  # nothing was asked
        (0, "5F 02 2F 0A 01 01 01 01 10 00 03 C5 00 00", "DF 80 B2 00"),
        (0, "5F 01 2F 0A 01 01 01 01 10 00 03 C5 00 00", "5F 01 2F 0A"),
        (4, "5E 01 2F F0", "DE 80 B5 00"),
        (6, "5E 01 2F F0", "5E 01 2F 08 01 01 01 01 06 01 03 28"),
        (6, "5E 01 2E F0", "DE 80 B0 00"),
    ):
        bench.now = now * NS_PER_MS
        assert bench.ask(51, bytes.fromhex(request)) == SC_REPLY
        reply = bench.ask(51, b"")
        assert (reply.status, reply.data.hex(" ").upper()) == (Resp.DL, response)


async def test_over_a_bus_by_both_classes_of_master() -> None:
    store = ParamStore(TABLE, {})
    async with serving(rig(store, busy_ms=3)) as (bus, _):
        parameters = bus.slave(9).parameters()
        assert await parameters.read([Address(965), Address(11)]) == [Values(6, (0x0328,)), ErrorValue(0)]
        assert await parameters.change([(Address(10), Values(6, (75,)))]) == [Values(0x40)]
        async with bus.class2.connect(9) as connection:
            assert await connection.parameters().read([Address(10)]) == [Values(6, (75,))]
        assert [one.pnu for one in await parameters.read_out()] == [10, 965]
        assert await bus.slave(9).read(3, 4) == b"\x03\x04"  # the others go to the functions
        assert bus.slave(9).state is SlaveState.DATA_EXCHANGE
    assert store.value("ramp") == 7.5


async def test_a_list_is_read_within_the_limits_that_the_drive_tells() -> None:
    table = ParamTable(ParamSpec(number=n, name=f"p{n}", title="Word") for n in range(1, 60))
    limits = Limits(octets=56, parameters=4)
    server = ParameterServer(StoreParameters(ParamStore(table, {}), limits=limits), Rules(limits=limits))
    slave = DpSlave(RIG, lambda outputs, elapsed: bytes(1), parameters=TimedRecords(server))
    async with serving(slave) as (bus, _):
        parameters = bus.slave(9).parameters()
        assert len(await parameters.read_out()) == 59
        first = parameters.counters.requests
        assert parameters.counters.split == 0  # nothing was tried in vain
        await parameters.read_out()
        assert parameters.counters.requests == 2 * first - 1  # asked for once


class Lengths:
    """Record 47, and how long the Writes and Reads of it were."""

    def __init__(self, server: TimedRecords) -> None:
        self._server = server
        self.written: list[int] = []
        self.read: list[int] = []

    def ask(self, request: RecordRequest) -> None:
        service = request.service
        if isinstance(service, ReadReq):
            self.read.append(service.length)
        else:
            self.written.append(len(service.data))
        self._server.ask(request)


async def test_no_request_is_longer_than_c1_max_data_len(tmp_path: Path) -> None:
    gsd = tmp_path / "drive.gsd"
    gsd.write_text(
        "#Profibus_DP\nGSD_Revision = 5\nIdent_Number = 0x1234\n500_supp = 1\nMaxTsdr_500 = 100\nDPV1_Slave = 1\n"
        "C1_Read_Write_supp = 1\nC1_Max_Data_Len = 64\nMax_User_Prm_Data_Len = 3\n"
        'Ext_User_Prm_Data_Const(0) = 0, 0, 0\nModule = "word" 0x10, 0x20\n1\nEndModule\n'
    )
    table = ParamTable(ParamSpec(number=n, name=f"p{n}", title="Word", factory=n) for n in range(1, 40))
    records = Lengths(TimedRecords(ParameterServer(StoreParameters(ParamStore(table, {})))))
    slave = DpSlave(RIG, lambda outputs, elapsed: bytes(1), parameters=records)
    world = dpstack.World()
    rigged = {"name": "rig", "address": 9, "gsd": str(gsd), "modules": [1]}
    async with (
        dpstack.slave.serve_slave(slave, world=world, address=9),
        dpstack.open_bus(world=world, baud=500_000, slaves=[rigged]) as bus,
    ):
        await bus.ready()
        found = await bus.slave(9).parameters().read([Address(n) for n in range(1, 40)])
        assert found == [Values(6, (n,)) for n in range(1, 40)]
    assert max(records.written) <= 64
    assert set(records.read) == {64}
