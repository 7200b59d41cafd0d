"""``dpstack acyclic``, also with ``--class 2`` beside the slave's own master: every form, in the foreground and
through a run; what it says and how it ends."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from api_kit import RAW, RIG, slave_in
from bus_kit import add_station, setup
from cli_kit import Cli
from ms2_kit import Ms2Server, ms2_in, served
from plant_files import plant_file

import dpstack
from dpstack import Im0, Im1
from dpstack.api.config.config import Config
from dpstack.api.control.commands import ParsedCommand
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import through_run
from dpstack.api.streams import OnEvent
from dpstack.cli.commands import acyclic, on_bus
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.errors import AcyclicError, UsageError
from dpstack.params import BusParams
from dpstack.slave import DpSlave

Out = pytest.CaptureFixture[str]
RIG_TABLE = {**RAW, "name": "rig", "address": 8, "config": "10 20", "user_prm": "00 00 00", "dpv1": True}


pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    return plant_file(tmp_path, RIG_TABLE, {**RAW, "name": "old", "config": "10 20"})


@pytest.fixture
def run(cli: Cli, plant: Path) -> Cli:
    return cli.of("acyclic", str(plant))


def rig() -> DpSlave:
    slave = DpSlave(RIG, lambda outputs, elapsed: outputs, im=[Im0(order_id="RIG", serial_number="7"), Im1("fan")])
    slave.serve_records(RecordTable({(1, 2): bytes(range(0x30, 0x44)), (1, 3): b"\0\0"}, [(1, 3)]))
    return slave


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> None:
    """The foreground in virtual time, with :func:`rig` at 8 and an old one at 9 in its world."""
    monkeypatch.setattr(acyclic, "open_bus", open_bus)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)


def open_bus(config: Config, on_event: OnEvent | None = None) -> dpstack.Bus:
    made = dpstack.World()
    slave_in(made, rig(), 8)
    slave_in(made, MirrorDevice(0x1234, b"\x10\x20"), 9)
    return dpstack.open_bus(config, on_event=on_event, world=made)


# -- as master in the foreground -----------------------------------------------------------------------------------


@pytest.mark.usefixtures("world")
def test_read_and_write(run: Cli) -> None:
    out, err = run("8", "read", "1", "2")
    assert err == ""
    assert out.splitlines() == [
        "slave 8 (rig): slot 1, index 2, 20 octets",
        "  0  30 31 32 33 34 35 36 37 38 39 3A 3B 3C 3D 3E 3F  0123456789:;<=>?",
        " 16  40 41 42 43                                      @ABC",
    ]
    told = run.json("rig", "read", "1", "0x2", "4")
    assert (told["data"], told["through"], told["address"]) == ("30313233", "master", 8)
    out = run.out("8", "write", "1", "3", "12 34")
    assert out == "slave 8 (rig): slot 1, index 3: 2 octets written\n"


@pytest.mark.usefixtures("world")
def test_im(run: Cli) -> None:
    out = run.out("8", "im")
    assert "I&M0    order_id           RIG" in out
    assert "I&M1    tag_function       fan" in out
    assert "I&M2" not in out
    rows = [" ".join(line.split()) for line in out.splitlines()]
    assert "I&M0 version 1.1" in rows
    assert "I&M0 supported I&M1 (0x0002)" in rows
    told = run.json("8", "im")
    assert told["im"]["0"]["serial_number"] == "7"
    assert (told["im"]["0"]["version"], told["im"]["0"]["supported"]) == ([1, 1], 2)
    assert told["im"]["1"] == {"tag_function": "fan", "tag_location": ""}


@pytest.mark.parametrize(
    ("supported", "text"),
    [(0, "I&M0 only (0x0000)"), (0b11110, "I&M1, I&M2, I&M3, I&M4 (0x001E)"), (1, "profile specific (0x0001)")],
)
def test_the_im_records_that_a_slave_has_are_listed(supported: int, text: str, capsys: Out) -> None:
    fields = {"supported": supported, "version": [2, 0]}
    acyclic._show({"order": "im", "address": 8, "slave": "rig", "slot": 0, "im": {"0": fields}})
    out = capsys.readouterr().out
    assert text in out
    assert "version    2.0" in out


def test_a_text_that_is_no_text(capsys: Out) -> None:
    acyclic._show({"order": "im", "address": 8, "slave": "rig", "slot": 0, "im": {"0": {"order_id": "A\x1b[2J\0é"}}})
    assert r"I&M0    order_id  A\x1b[2J\x00é" in capsys.readouterr().out


@pytest.mark.usefixtures("world")
@pytest.mark.parametrize(
    ("args", "code", "text"),
    [
        (["8", "read", "1", "9"], 1, "slave 8 refuses Read of slot 1, index 9: invalid index (80 B0 00"),
        (["8", "write", "1", "3", "12"], 1, "write length error"),
        (["8", "transport", "1", "2"], 2, "Data_Transport is a service of class 2 connections: add --class 2"),
        (["9", "read", "1", "2"], 2, 'put user_prm = "00 00 00" and dpv1 = true into its [[slave]] table'),
        (["7", "read", "1", "2"], 2, "no slave '7' in this configuration; there are: 8 (rig), 9 (old)"),
        (["8", "red", "1", "2"], 2, "dpstack acyclic does not know 'red'; did you mean read?"),
        (["8", "read", "1"], 2, "read takes SLOT INDEX [LENGTH], for instance: read 1 47"),
        (["8", "read", "1", "256"], 2, "'256' is no INDEX: write a number 0..255"),
        (["8", "write", "1", "2", "0G"], 2, "'0G': 'G' is no hex digit"),
    ],
)
def test_refusals(run: Cli, args: list[str], code: int, text: str) -> None:
    out, err = run(*args, code=code)
    assert out == ""
    assert text in err


@pytest.mark.usefixtures("world")
def test_the_fault_that_keeps_a_slave_from_coming_up_is_told_once(run: Cli, plant: Path) -> None:
    plant.write_text(plant.read_text(encoding="utf-8").replace("10 20", "10 21", 1), encoding="utf-8")
    assert run.err("8", "read", "1", "2", code=1) == (
        "dpstack: slave 8 (rig): refuses the configuration (Cfg_Fault): Chk_Cfg was 10 21, it has 10 20: octet 2 "
        'differs; configure config = "10 20" (or its modules) or change the telegram set in the device\n'
    )


@pytest.mark.usefixtures("world")
def test_a_device_without_parameters(run: Cli) -> None:
    assert run.err("8", "parameters", code=1) == (
        "dpstack: drive rig: record 47 of slot 1: the drive refuses the request: error B/0, invalid index; it has no "
        "PROFIdrive parameters there; its manual says whether it has some, in which slot\n"
    )


def test_a_read_only_configuration(run: Cli, plant: Path) -> None:
    plant.write_text(plant.read_text(encoding="utf-8").replace("[bus]", "[bus]\nread_only = true"), encoding="utf-8")
    assert "records need data exchange" in run.err("8", "read", "1", "2")


# -- through a run -------------------------------------------------------------------------------------------------


async def through(config: dpstack.Config) -> None:
    told = await through_run(config, 8, ParsedCommand("read", ["1", "2", "3"], {}))
    assert told is not None
    assert told["data"] == "303132"
    assert await through_run(config, 8, ParsedCommand("write", ["1", "3", "0102"], {})) is not None
    im = await through_run(config, 8, ParsedCommand("im", [], {}))
    assert im is not None
    assert im["im"]["0"]["order_id"] == "RIG"
    with pytest.raises(AcyclicError, match="invalid index") as caught:
        await through_run(config, 8, ParsedCommand("read", ["1", "9"], {}))
    assert (caught.value.address, caught.value.service, caught.value.code_1) == (8, "Read", 0xB0)
    with pytest.raises(UsageError, match="no slave 7 on this bus"):
        await through_run(config, 7, ParsedCommand("read", ["1", "9"], {}))
    with pytest.raises(UsageError, match="dpv1 = true"):
        await through_run(config, 9, ParsedCommand("read", ["1", "9"], {}))
    for word in ("dump", "compare"):
        with pytest.raises(UsageError) as wrong:
            await through_run(config, 8, ParsedCommand(word, ["rig.toml"], {}))
        assert str(wrong.value) == (
            f"ctl acyclic has no files: `dpstack acyclic CONFIG 8 {word} FILE` has, and goes through this run; "
            "parameters gives the same list"
        )
    with pytest.raises(UsageError, match="ctl acyclic does not know 'look'; it knows read, write, parameters, "):
        await through_run(config, 8, ParsedCommand("look", [], {}))


async def test_a_run_carries_the_orders_out(plant: Path) -> None:
    async with open_bus(dpstack.load_config(plant)) as bus, control_run(bus, "virtual"):
        await bus.ready()
        await asyncio.to_thread(asyncio.run, through(dpstack.load_config(plant)))
        assert bus.mode is dpstack.Mode.CLEAR
    assert await through_run(dpstack.load_config(plant), 8, ParsedCommand("read", ["1", "2"], {})) is None


RIG_8 = {**RAW, "name": "rig", "address": 8}


@pytest.fixture
def rig_plant(tmp_path: Path) -> Path:
    return plant_file(tmp_path, RIG_8, port="/dev/ttyNone", cycle_ms=10.0)


class Field:
    """The slave at 8 in data exchange with another master, 2; ``buses``: the buses of the command."""

    def __init__(self) -> None:
        self.world = dpstack.World()
        self.server = ms2_in(self.world, 8)
        params = BusParams.preset(500_000, address=2, gap=1)
        self.owner = Master(params, [setup(8, name="rig", config=bytes.fromhex("20 10"))])
        self.station = add_station(self.world, params, self.owner)
        self.world.run_for(300_000_000)
        self.buses: list[dpstack.Bus] = []

    def open_bus(
        self, config: Config, on_event: OnEvent | None = None, world: dpstack.World | None = None
    ) -> dpstack.Bus:
        assert world is None  # the field is real for the command
        self.buses.append(dpstack.open_bus(config, on_event=on_event, world=self.world))
        return self.buses[-1]

    def check(self) -> None:
        """The owner of the slave has lost no telegram, and no connection is left."""
        handler = self.owner.handlers[8]
        assert handler.state is SlaveState.DATA_EXCHANGE
        counted = self.station.stats.stations[8]
        assert counted.retries == counted.timeouts == 0
        assert self.server.free == [48, 47]
        assert all(not bus.slaves for bus in self.buses)
        assert self.world.referee is not None
        self.world.referee.check()


@pytest.fixture
def field(monkeypatch: pytest.MonkeyPatch) -> Field:
    found = Field()
    monkeypatch.setattr(acyclic, "open_bus", found.open_bus)
    monkeypatch.setattr(on_bus, "Bus", found.open_bus)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    return found


@pytest.fixture
def class_2(cli: Cli, rig_plant: Path) -> Cli:
    return cli.of("acyclic", str(rig_plant), "--class", "2")


def test_beside_a_foreign_master(class_2: Cli, field: Field) -> None:
    out, err = class_2("8", "read", "1", "2")
    assert err == ""
    assert out.splitlines()[0] == "slave 8 (rig): slot 1, index 2, 2 octets"
    assert field.buses[-1].params.address == 0
    told = class_2.json("rig", "transport", "1", "2", "0A 0B", "--address", "7")
    assert (told["data"], told["through"], told["slave"]) == ("0a0b", "master", "rig")
    assert field.buses[-1].params.address == 7
    assert class_2.out("8", "write", "1", "3", "12 34") == ("slave 8 (rig): slot 1, index 3: 2 octets written\n")
    field.check()


def test_a_foreign_master_is_in_the_way_of_class_1(field: Field, rig_plant: Path, cli: Cli) -> None:
    beside = "; or ask beside that master with --class 2, if the slave has it\n"
    assert cli.err("acyclic", str(rig_plant), "8", "read", "1", "2", code=1) == (
        "dpstack: another station on the bus sends as address 2: staying out of the ring; give one of the two another "
        f"address{beside}"
    )
    plant_file(rig_plant.parent, RIG_8, port="/dev/ttyNone", cycle_ms=10.0, address=1)
    assert cli.err("acyclic", str(rig_plant), "8", "read", "1", "2", code=1) == (
        "dpstack: slave 8 (rig): is owned by master 2; it is never taken away: stop master 2, or remove the slave from "
        f"one of the two configurations{beside}"
    )


@pytest.mark.parametrize(
    ("serve", "text"),
    [
        (lambda pdu: b"\xde\x80\xb0\x00", "slave 8 refuses Read of slot 1, index 2: invalid index (80 B0 00"),
        (lambda pdu: b"\x58\x00\x11", "the slave aborted it: a service that is not allowed in this state (ABT_SE)"),
    ],
)
def test_the_slave_refuses(class_2: Cli, field: Field, serve: object, text: str) -> None:
    assert callable(serve)
    field.server.serve = serve
    assert text in class_2.err("8", "read", "1", "2", code=1)
    field.check()


def test_a_simulated_slave_has_no_master(class_2: Cli, rig_plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the port "virtual", too, nobody parameterises it."""
    buses: list[dpstack.Bus] = []

    def spy(config: Config, on_event: OnEvent | None, world: dpstack.World | None) -> dpstack.Bus:
        buses.append(dpstack.open_bus(config, on_event=on_event, world=world))
        return buses[-1]

    monkeypatch.setattr(on_bus, "Bus", spy)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    plant_file(rig_plant.parent, {"name": "fan", "address": 8, "drive": "ls-s100", "telegram": "PPO1"})
    told = class_2.json("fan", "im")
    assert told["im"]["0"]["order_id"] == "CPDP-S100"
    (bus,) = buses
    assert (bus.slaves, bus.class2.connections) == ((), 0)
    class_2("fan", "im", "--baud", "auto", code=2)


def test_a_slave_without_class_2_connections(class_2: Cli, field: Field) -> None:
    field.server.free.clear()
    err = class_2.err("8", "read", "1", "2", code=1)
    assert "slave 8 refuses Initiate (RS at SAP 49): all its class 2 connections are in use, or it has none" in err


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["8", "transport", "1", "2", "0G"], "'0G': 'G' is no hex digit"),
        (["8", "transport", "1"], "transport takes SLOT INDEX [HEX], for instance: transport 0 1 00FF"),
        (["7", "read", "1", "2"], "no slave '7' in this configuration"),
    ],
)
def test_wrong_use(class_2: Cli, args: list[str], text: str) -> None:
    assert text in class_2.err(*args)


def test_services_and_options_of_the_other_class_are_refused(rig_plant: Path, cli: Cli) -> None:
    assert "Data_Transport is a service of class 2 connections: add --class 2" in cli.err(
        "acyclic", str(rig_plant), "8", "transport", "1", "2"
    )
    assert "--address is for --class 2" in cli.err("acyclic", str(rig_plant), "8", "read", "1", "2", "--address", "5")


def test_a_read_only_configuration_of_class_2(class_2: Cli, rig_plant: Path) -> None:
    plant_file(rig_plant.parent, RIG_8, port="/dev/ttyNone", read_only=True)
    assert "a connection is to be opened; leave read_only out" in class_2.err("8", "im")


async def through_class_2(config: dpstack.Config) -> None:
    told = await through_run(config, 8, ParsedCommand("read", ["1", "2"], {}), master=2)
    assert told is not None
    assert told["data"] == "0102"
    told = await through_run(config, 8, ParsedCommand("transport", ["1", "2", "0A"], {}), master=2)
    assert told is not None
    assert told["data"] == "0a"
    with pytest.raises(AcyclicError, match="invalid index") as caught:
        await through_run(config, 8, ParsedCommand("read", ["1", "9"], {}), master=2)
    assert (caught.value.address, caught.value.code_1) == (8, 0xB0)
    with pytest.raises(dpstack.ConnectionEnded, match="ABT_SE") as ended:
        await through_run(config, 8, ParsedCommand("read", ["1", "10"], {}), master=2)
    assert (ended.value.address, ended.value.abort) == (8, (0, 1, 1))
    with pytest.raises(UsageError, match="no slave 7 on this bus"):
        await through_run(config, 7, ParsedCommand("read", ["1", "9"], {}), master=2)
    with pytest.raises(UsageError, match="add --class 2"):
        await through_run(config, 8, ParsedCommand("transport", ["1", "9"], {}))


def odd(pdu: bytes) -> bytes | None:
    """Index 9 is refused, at index 10 the connection is aborted."""
    return {9: b"\xde\x80\xb0\x00", 10: b"\x58\x00\x11"}.get(pdu[2] if len(pdu) > 2 else 0) or served(pdu)


async def test_a_run_carries_the_orders_of_class_2_out(rig_plant: Path) -> None:
    world = dpstack.World()
    server: Ms2Server = ms2_in(world, 8)
    server.serve = odd
    plant_file(rig_plant.parent, RIG_8, cycle_ms=10.0)
    async with dpstack.open_bus(rig_plant, world=world) as bus, control_run(bus, "virtual"):
        await bus.ready()
        await asyncio.to_thread(asyncio.run, through_class_2(dpstack.load_config(rig_plant)))
        assert bus.slave(8).ready_now
        assert bus.class2.connections == 0
    assert not server.sessions
