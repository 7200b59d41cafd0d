"""The I/O station's class 2 connections: octets on a wire, and beside another master on ptys."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of, virtual
from octet_class2 import ABORT_REQUEST, INITIATE, RS, Class2
from octet_wire import Wire
from slave_kit import make_slave
from support import instance

import dpstack
from dpstack import Im0, IoStation
from dpstack.api.config.config import make_config
from dpstack.api.gsd_info import check_gsd, read_gsd
from dpstack.api.slave_side.simulation import Simulation
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.drivers.segment.hub import Segment
from dpstack.params import BusParams
from dpstack.sim.io_station import NAME

IO: dict[str, object] = {
    "name": "io",
    "address": 8,
    "gsd": "io-station",
    "modules": ["8 DI", "8 DO", "2 AI"],
    "dpv1": {"alarms": []},
}


class Field:
    """The station at 8 of a wire, which nobody has parameterised."""

    def __init__(self) -> None:
        self.io = IoStation.of(["8 DI", "8 DO", "2 AI"], name="io")
        station = make_slave(8, self.io, BusParams.preset(500_000))
        self.app = instance(station.responder, SlaveApp)
        self.wire = Wire(station)


def test_records_by_slot_before_any_parameters() -> None:
    field = Field()
    master = Class2(field.wire)
    sap = master.connect()
    assert sap == 48
    assert master.service(sap, "5E 01 01 F0") == "5E 01 01 01 01"
    assert master.service(sap, "5F 01 01 01 02") == "5F 01 01 01"
    assert master.service(sap, "5E 01 01 F0") == "5E 01 01 01 02"
    field.io.pull(2)
    assert master.service(sap, "5E 00 02 F0") == "5E 00 02 03 00 03 00"
    assert master.service(sap, "5E 02 02 F0") == "5E 02 02 04 03 20 00 00"
    assert master.service(sap, "5F 02 FF 04 08 00 FD E8") == "DF 80 A2 00"
    assert master.service(sap, "5E 09 02 F0") == "DE 80 B2 00"
    assert master.service(sap, "5F 03 FF 04 08 00 FD E8") == "5F 03 FF 04"
    assert bytes.fromhex(master.service(sap, "5E 03 FF F0"))[20:40] == b"2 AI".ljust(20)


def test_the_head_returns_transported_octets() -> None:
    field = Field()
    master = Class2(field.wire)
    sap = master.connect()
    assert master.service(sap, "51 00 00 03 61 62 63") == "51 00 00 03 61 62 63"
    assert master.service(sap, "51 00 00 00") == "51 00 00 00"
    assert master.service(sap, "51 00 01 01 55") == "D1 80 B0 00"
    assert master.service(sap, "51 01 00 01 55") == "D1 80 B2 00"


def test_two_connections_of_its_gsd_file_with_im_of_their_own() -> None:
    field = Field()
    one, two = Class2(field.wire, 1), Class2(field.wire, 3)
    first, second = one.connect(), two.connect()
    assert Class2(field.wire, 5).ask(49, INITIATE) == RS
    assert one.service(first, "5F 00 FF 04 08 00 FD E8") == "5F 00 FF 04"
    assert two.service(second, "5E 00 FF F0") == "DE 80 B5 00"  # that was the call of master 1
    dpv1 = read_gsd(NAME).device.dpv1
    assert (dpv1.c2_read_write, dpv1.c2_max_count_channels, dpv1.c2_max_data_len) == (True, field.io.ms2, 0xF0)
    assert (ms2_of(field.app).free, field.io.ms2_max_initiate) == (0, dpv1.max_initiate_pdu_length)


def test_an_initiate_longer_than_its_gsd_file_says() -> None:
    master = Class2(Field().wire)
    longest = INITIATE[: 3 * 12] + "01 22 00 02" + 34 * " 00" + " 00 00"  # 16 octets and addresses of 34 and 2
    assert len(bytes.fromhex(longest)) == 52
    assert master.ask(master.initiate(longest)).startswith("57 F0")
    sap = master.initiate(longest.replace("01 22 00 02", "01 23 00 02") + " 00")
    assert master.ask(sap) == ABORT_REQUEST
    assert master.ask(sap) == RS


def test_its_gsd_file_contradicts_nothing() -> None:
    assert check_gsd(NAME) == ()


def test_im_that_a_master_wrote_is_kept_when_it_is_switched_off() -> None:
    before, after = Field(), IoStation.of(["8 DI", "8 DO", "2 AI"])
    master = Class2(before.wire)
    sap = master.connect()
    written = bytes(10) + b"mixer".ljust(32) + b"hall 3".ljust(22)
    assert master.service(sap, "5F 00 FF 44 08 00 FD E9" + written.hex()) == "5F 00 FF 44"
    after.inherit(before.io)
    again = Class2(Wire(make_slave(8, after, BusParams.preset(500_000))))
    sap = again.connect()
    assert again.service(sap, "5F 00 FF 04 08 00 FD E9") == "5F 00 FF 04"
    assert again.service(sap, "5E 00 FF F0")[24:] == written.hex(" ").upper()


async def everything(connection: dpstack.Connection, timeout: float = 10.0) -> None:
    """Each service once."""
    assert await connection.read(0, 2, timeout=timeout) == bytes(3)
    await connection.write(1, 1, b"\x03", timeout=timeout)
    assert await connection.read(1, 1, timeout=timeout) == b"\x03"
    assert await connection.transport(0, 0, b"abc", timeout=timeout) == b"abc"
    im0 = instance(await connection.im(slot=3, timeout=timeout), Im0)
    assert im0.order_id == "2 AI"
    with pytest.raises(dpstack.AcyclicError, match="invalid slot"):
        await connection.read(4, 2, timeout=timeout)


def test_on_the_virtual_bus_beside_its_own_master() -> None:
    async def main() -> None:
        async with bus_of(IO) as bus:
            await bus.operate()
            await bus.ready()
            async with bus.class2.connect("io") as connection:
                assert connection.max_data_len == 240
                await everything(connection)
            assert bus.slave("io").ready_now

    virtual(main())


async def test_on_ptys_beside_a_foreign_class_1_master(tmp_path: Path) -> None:
    """Three stations: the simulation, whoever runs the plant, and one without slaves that only asks."""
    unhurried: dict[str, Any] = {"hsa": 4, "max_retry": 15}  # a busy computer loses nobody
    async with Segment(3, tmp_path / "bus", baud=1_500_000) as segment:
        config = make_config(segment.paths[0], 1_500_000, 2, [IO])
        async with (
            Simulation(config, segment.paths[0], 1_500_000) as simulation,
            dpstack.open_bus(
                port=segment.paths[1],
                baud=1_500_000,
                address=2,
                gap=1,
                slaves=[{**IO, "watchdog_ms": 10_000}],
                **unhurried,
            ) as plant,
        ):
            await plant.operate()
            await plant.ready(20)
            async with (
                dpstack.open_bus(port=segment.paths[2], baud=1_500_000, address=1, **unhurried) as visitor,
                visitor.class2.connect(8, timeout=20, response_timeout=20) as connection,
            ):
                await everything(connection, 20)
                assert simulation.slaves[0].app.master == 2
            assert plant.slave("io").ready_now
            assert await plant.slave("io").read(1, 1, timeout=20) == b"\x03"
