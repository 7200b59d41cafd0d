"""The simulated I/O station in literal octets: modules, faults, pull and plug, alarms, records, I&M."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of, virtual
from octet_class2 import ABORT_REQUEST, INITIATE, RS, Class2
from octet_wire import Wire
from slave_alarm_kit import OctetMaster
from slave_kit import Bench, make_slave
from support import instance

import dpstack
from dpstack import ConfigError, Im0, IoStation
from dpstack.api.config.config import make_config, slave_config
from dpstack.api.gsd_info import check_gsd, read_gsd
from dpstack.api.slave_side.simulation import Simulation
from dpstack.api.slave_side.virtual_bench import device_of
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.drivers.segment.hub import Segment
from dpstack.fdl.interface import RS_REPLY
from dpstack.gsd.configuration import configure
from dpstack.params import BusParams
from dpstack.sim.io_station import GSD, IDENT, NAME
from dpstack.sim.io_station.modules import MODULES

ROW = ["8 DI", "8 DO", "2 AI", "", "16 DI", "16 DO", "2 AO"]
CFG = bytes.fromhex("10 20 51 00 11 21 61")
#: lock, watchdog off, ident 10D5; DPV1_Enable and all its alarms, type mode; parameters of 8 DI, 2 AI, 16 DI
PRM = bytes.fromhex("80 01 01 0B 10 D5 00 80 E4 00 01 01 03")


class Station(OctetMaster):
    """Master 2 and the station at 8, in data exchange."""

    def __init__(self, parameters: bytes = PRM, *, up: bool = True) -> None:
        self.io = IoStation.of(ROW, name="io")
        super().__init__(self.io)
        self.outputs = bytes(7)
        if up:
            self.start_with(parameters, CFG, self.outputs)

    def inputs(self) -> str:
        """The inputs that the master reads."""
        return self.dx(self.outputs).data.hex(" ").upper()

    def outputs_of_slots(self) -> list[str]:
        return [slot.outputs.hex() for slot in self.io.slots if slot is not None and slot.module.outputs]

    def acknowledge_alarm(self, block: str) -> None:
        """Fetch the diagnosis, which begins with this alarm block, and acknowledge the alarm."""
        text = self.fetch()
        assert text.startswith(block), text
        kind, slot, specifier = bytes.fromhex(block)[1:4]
        ack = bytes((slot, kind, specifier)).hex(" ").upper()
        assert self.ack(ack) == f"5C {ack}"

    def record(self, request: str) -> str:
        """The answer to a request over MS1."""
        self.ask(51, bytes.fromhex(request))
        return self.poll()


@pytest.fixture
def bench() -> Station:
    return Station()


def test_inputs_and_outputs(bench: Station) -> None:
    assert bench.inputs() == "00 00 00 00 00 00 00"
    bench.io.set_input(5, b"\x12\x34")
    bench.io.set_input(3, b"\x00\x01\xff\xfe")
    assert bench.inputs() == "00 00 01 FF FE 12 34"
    bench.outputs = bytes.fromhex("AA 01 02 11 22 33 44")
    bench.inputs()
    assert bench.outputs_of_slots() == ["aa", "0102", "11223344"]
    bench.control(b"\x02\x00")
    assert bench.outputs_of_slots()[0] == "00"


def test_edges_raise_process_alarms_as_parameters_say(bench: Station) -> None:
    bench.io.set_input(1, b"\x05")
    bench.acknowledge_alarm("06 02 01 00 05 05")
    bench.io.set_input(1, b"\x06")
    bench.acknowledge_alarm("06 02 01 08 02 06")
    bench.io.set_input(1, b"\x00")  # falling edges are off here
    assert not bench.must_fetch
    bench.io.set_input(5, b"\x80\x01")
    bench.acknowledge_alarm("08 02 05 10 80 01 80 01")
    bench.io.set_input(5, b"\x00\x01")
    bench.acknowledge_alarm("08 02 05 18 80 00 00 01")


def test_a_wire_breaks_and_is_whole_again(bench: Station) -> None:
    bench.io.wire_break(3, 1, True)
    # alarm; module status of seven slots, the third has a fault; slots, module 2; channel: an input, word, line break
    assert bench.fetch() == "06 01 03 01 01 06 06 82 00 00 10 00 42 04 82 41 A6"
    assert bench.diag()[0] == 0x08  # Ext_Diag
    assert bench.inputs() == "00 00 00 7F FF 00 00"
    assert bench.ack("03 01 01") == "5C 03 01 01"
    bench.io.wire_break(3, 0, True)
    bench.acknowledge_alarm("06 01 03 09 00 06 42 04 82 40 A6 82 41 A6")
    bench.io.wire_break(3, 1, False)
    bench.acknowledge_alarm("06 01 03 13 01 06 42 04 82 40 A6")
    bench.io.wire_break(3, 0, False)
    bench.acknowledge_alarm("06 01 03 1A 00 06 06 82 00 00 00 00")
    assert bench.ext() == ""
    assert bench.diag()[0] == 0x00


def test_no_diagnosis_where_parameters_say_so() -> None:
    bench = Station(PRM[:-2] + b"\x00\x00")
    bench.io.wire_break(3, 1, True)
    assert not bench.must_fetch
    assert bench.inputs() == "00 00 00 7F FF 00 00"
    assert bench.record("5F 03 01 01 01") == "5F 03 01 01"  # switched on by its record
    bench.acknowledge_alarm("06 01 03 01 01 06")
    bench.record("5F 03 01 01 00")
    bench.acknowledge_alarm("06 01 03 0A 01 06")


def test_pull_and_plug(bench: Station) -> None:
    bench.io.set_input(1, b"\x05")
    bench.acknowledge_alarm("06 02 01 00 05 05")
    bench.io.pull(1)
    bench.acknowledge_alarm("05 03 01 09 10 06 82 00 00 03 00 42 01")
    assert bench.inputs() == "00 00 00 00 00 00 00"
    bench.io.set_input(1, b"\x07")  # no module is there to see it
    assert not bench.must_fetch
    bench.io.plug(1, "16DO")
    bench.acknowledge_alarm("05 04 01 13 21 06 82 00 00 02 00 42 01")
    bench.io.pull(1)
    bench.acknowledge_alarm("05 03 01 19 21 06 82 00 00 03 00 42 01")
    bench.io.plug(1)
    bench.acknowledge_alarm("05 04 01 22 10 06 82 00 00 00 00")
    assert bench.inputs() == "07 00 00 00 00 00 00"
    assert bench.ext() == ""


def test_a_pulled_module_takes_its_outputs_and_its_channel_faults_along(bench: Station) -> None:
    bench.outputs = b"\xaa" + bytes(6)
    bench.io.wire_break(3, 0, True)
    bench.acknowledge_alarm("06 01 03 01 00 06")
    bench.io.pull(2)
    assert bench.fetch() == "05 03 02 09 20 06 82 00 00 1C 00 42 06 82 40 A6"
    bench.io.pull(3)  # one pull alarm at a time; the channel goes with its module
    assert bench.fetch() == "05 03 02 09 20 06 82 00 00 3C 00 42 06"
    assert bench.outputs_of_slots()[0] == "00"
    assert bench.ack("02 03 09") == "5C 02 03 09"
    bench.acknowledge_alarm("05 03 03 11 51")
    bench.io.plug(3)
    bench.acknowledge_alarm("05 04 03 1B 51 06 82 00 00 1C 00 42 06 82 40 A6")  # the wire is still broken


def test_parameters_changed_at_the_device(bench: Station) -> None:
    bench.io.set_parameter(1, 0x02)
    bench.acknowledge_alarm("05 06 01 00 02")
    assert bench.record("5E 01 01 F0") == "5E 01 01 01 02"
    bench.start_with(PRM, CFG, bytes(7))
    assert bench.record("5E 01 01 F0") == "5E 01 01 01 01"  # those of Set_Prm count again


def test_only_what_is_enabled_and_nothing_without_dpv1() -> None:
    bench = Station(PRM[:7] + b"\x80\x00\x00" + PRM[10:])
    assert bench.io.pull(1) == "slave io: pull alarm, slot 1, appears, slot disturbed: its master did not enable " + (
        'pull_plug alarms in Set_Prm; add "pull_plug" to alarms of [slave.dpv1] there'
    )
    assert bench.fetch() == "06 82 00 00 03 00 42 01"
    bench = Station(PRM[:7] + b"\x00\xfc\x00" + PRM[10:])
    bench.io.pull(1)
    assert bench.fetch() == "42 01"


def test_an_earlier_fault_is_reported_when_data_exchange_begins() -> None:
    bench = Station(up=False)
    bench.io.pull(7)
    bench.start_with(PRM, CFG, bytes(7))
    assert bench.fetch() == "06 82 00 00 00 30 42 40"


def test_more_faults_than_the_diagnosis_holds() -> None:
    io = IoStation.of(["2 AI"] * 8)
    bench = OctetMaster(io)
    bench.start_with(bytes.fromhex("80 01 01 0B 10 D5 00 80 E4 00") + b"\x01" * 8, b"\x51" * 8, b"")
    for slot in range(1, 9):
        for channel in range(2):
            io.wire_break(slot, channel, True)
    assert len(bench.diag()) <= 64
    assert bench.diag()[2] == 0x80  # Ext_Diag_Overflow
    assert bench.ext()[:17] == "06 01 01 01 00 06"


# --- records ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("5E 00 02 F0", "5E 00 02 07 00 00 01 00 00 03 00"),
        ("5F 00 02 01 00", "DF 80 B6 00"),
        ("5E 00 07 F0", "DE 80 B0 00"),
        ("5E 01 01 F0", "5E 01 01 01 01"),
        ("5F 05 01 01 02", "5F 05 01 01"),
        ("5F 05 01 01 04", "DF 80 B7 00"),
        ("5F 05 01 02 01 01", "DF 80 B1 00"),
        ("5E 02 01 F0", "DE 80 B0 00"),  # no parameters
        ("5E 03 02 F0", "5E 03 02 04 01 51 51 02"),
        ("5E 06 02 F0", "5E 06 02 04 03 21 00 00"),
        ("5F 06 02 01 00", "DF 80 B6 00"),
        ("5E 06 01 F0", "DE 80 A2 00"),  # pulled
        ("5E 04 02 F0", "DE 80 B2 00"),  # an empty slot
        ("5E 08 02 F0", "DE 80 B2 00"),
        ("5F 06 FF 04 08 00 FD E8", "DF 80 A2 00"),
        ("5F 01 FF 04 08 00 FD E9", "DF 80 B7 00"),  # I&M1 has the head only
    ],
)
def test_records(bench: Station, request_: str, response: str) -> None:
    bench.io.wire_break(3, 1, True)
    bench.io.pull(6)
    assert bench.record(request_) == response


def test_im_of_every_slot(bench: Station) -> None:
    for slot, order_id in ((0, b"IO-STATION"), (1, b"8 DI"), (7, b"2 AO")):
        assert bench.record(f"5F {slot:02X} FF 04 08 00 FD E8") == f"5F {slot:02X} FF 04"
        read = bytes.fromhex(bench.record(f"5E {slot:02X} FF F0"))
        assert read[4:8] == bytes.fromhex("08 00 FD E8")
        assert read[20:40] == order_id.ljust(20)
        assert read[40:56] == f"{slot:04}".encode().ljust(16)
    written = bytes(10) + b"mixer".ljust(32) + b"hall 3".ljust(22)
    assert bench.record("5F 00 FF 44 08 00 FD E9" + written.hex()) == "5F 00 FF 44"
    assert bench.record("5E 00 FF F0")[24:] == written.hex(" ").upper()


# --- what it is ---------------------------------------------------------------------------------------------------


def test_the_gsd_file_says_the_same() -> None:
    device = read_gsd(NAME).device
    assert [(m.name, m.config) for m in device.modules] == [(m.name, bytes((m.config,))) for m in MODULES.values()]
    chosen = configure(device, ROW)
    own = IoStation.of(ROW)
    assert slave_description(device, chosen, name=NAME, ident=IDENT) == dpstack.slave.SlaveDescription(
        **{name: getattr(own.description, name) for name in own.description.__slots__}
        | {"rates": {speed.baud: speed.max_tsdr for speed in device.speeds}, "min_slave_interval_ns": 100_000}
        | {"vendor": "dpstack", "revision": "1"}
    )
    assert chosen.user_prm().octets() == bytes.fromhex("80 00 00 01 01 01")
    assert GSD.endswith("io-station.gsd")


def test_a_simulated_station_from_a_slave_table() -> None:
    table = {"name": "io", "address": 8, "gsd": "io-station", "modules": ROW}
    device = device_of(slave_config(table))
    assert isinstance(device, IoStation)
    assert (device.name, device.configs) == ("io", (CFG,))
    raw = {"name": "raw", "address": 8, "ident": IDENT, "config": "10", "user_prm": "80 00 00 01"}
    assert isinstance(device_of(slave_config(raw)), IoStation)
    assert isinstance(device_of(slave_config(raw | {"ident": 1})), MirrorDevice)
    with pytest.raises(ConfigError, match="identifier octet 30"):
        device_of(slave_config(raw | {"config": "30"}))


@pytest.mark.parametrize(
    "parameters",
    [
        "80 00 00 04 01 01",  # a bit without a meaning
        "80 00 00 01 02 01",
        "80 00 00 01 01",
        "80 00 00 01 01 01 01",
    ],
)
def test_parameters_that_cannot_be(parameters: str) -> None:
    bench = Bench(IoStation.of(ROW))
    bench.prm(PRM[:7] + bytes.fromhex(parameters))
    assert bench.diag()[0] & 0x40
    assert bench.dx(bytes(7)) == RS_REPLY


def test_switched_off_and_on_it_keeps_what_is_plugged() -> None:
    before, after = IoStation.of(ROW), IoStation.of(ROW)
    before.pull(1)
    before.set_input(5, b"\x11\x22")
    before.wire_break(3, 0, True)
    after.inherit(before)
    bench = OctetMaster(after)
    bench.start_with(PRM, CFG, bytes(7))
    assert bench.fetch() == "06 82 00 00 13 00 42 05 82 40 A6"
    assert bench.dx(bytes(7)).data.hex() == "007fff00001122"


def test_orders_that_cannot_be() -> None:
    io = IoStation.of(ROW)
    io.pull(1)
    misuse: list[tuple[Callable[[], object], str]] = [
        (lambda: io.pull(4), "no module in slot 4; there are: slot 1"),
        (lambda: io.pull(0), "no module in slot 0"),
        (lambda: io.pull(1), "no module is plugged"),
        (lambda: io.plug(2), "pull it first"),
        (lambda: io.plug(1, "9 DI"), "there is no module '9 DI'"),
        (lambda: io.set_input(2, b"\0"), "has 0 octets of inputs, 1 were given"),
        (lambda: io.set_input(5, b"\0"), "has 2 octets of inputs, 1 were given"),
        (lambda: io.wire_break(1, 0, True), "no analogue input channel 0"),
        (lambda: io.wire_break(3, 2, True), "no analogue input channel 2"),
        (lambda: io.set_parameter(5, 4), "bits 04 have no meaning"),
        (lambda: io.set_parameter(2, 0), "has no parameters"),
    ]
    for act, text in misuse:
        with pytest.raises(ValueError, match=text):
            act()
    for row, text in ((["8 DX"], "no module '8 DX'"), ([], "0 slots"), ([""], "1 slots"), (["8 DI"] * 9, "9 slots")):
        with pytest.raises(ConfigError, match=text):
            IoStation.of(row)


# --- The I/O station's class 2 connections: octets on a wire, and beside another master on ptys ---------------------


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
