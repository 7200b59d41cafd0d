"""``dpstack acyclic --class 2``: beside the slave's own master in the foreground, and through a run."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from cli_kit import Cli
from ms2_kit import Ms2Server, ms2_in, served

import dpstack
from dpstack.api.config.config import Config
from dpstack.api.control.commands import ParsedCommand
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import through_run
from dpstack.api.streams import OnEvent
from dpstack.cli.commands import acyclic, on_bus
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import AcyclicError, UsageError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.params import BusParams

Out = pytest.CaptureFixture[str]
PLANT = """
[bus]
port = "PORT"
baud = 500000
cycle_ms = 10.0

[[slave]]
name = "rig"
address = 8
ident = 0x1234
config = "20 10"
"""


pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    path = tmp_path / "plant.toml"
    path.write_text(PLANT.replace("PORT", "/dev/ttyNone"), encoding="utf-8")
    return path


class Field:
    """The slave at 8 in data exchange with another master, 2; ``buses``: the buses of the command."""

    def __init__(self) -> None:
        self.world = dpstack.World()
        self.server = ms2_in(self.world, 8)
        params = BusParams.preset(500_000, address=2, gap=1)
        setup = SlaveParams(address=8, name="rig", ident=0x1234, config=bytes.fromhex("20 10"))
        self.owner = Master(params, [setup])
        self.station = ActiveStation(params, [self.owner], now=self.world.now)
        self.world.add(self.station)
        self.world.command(self.station, GoOnline())
        self.world.command(self.station, SetMode(Mode.OPERATE))
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
def run(cli: Cli, plant: Path) -> Cli:
    return cli.of("acyclic", str(plant), "--class", "2")


def test_beside_a_foreign_master(run: Cli, field: Field) -> None:
    out, err = run("8", "read", "1", "2")
    assert err == ""
    assert out.splitlines()[0] == "slave 8 (rig): slot 1, index 2, 2 octets"
    assert field.buses[-1].params.address == 0
    told = run.json("rig", "transport", "1", "2", "0A 0B", "--address", "7")
    assert (told["data"], told["through"], told["slave"]) == ("0a0b", "master", "rig")
    assert field.buses[-1].params.address == 7
    assert run.out("8", "write", "1", "3", "12 34") == ("slave 8 (rig): slot 1, index 3: 2 octets written\n")
    field.check()


def test_a_foreign_master_is_in_the_way_of_class_1(field: Field, plant: Path, cli: Cli) -> None:
    beside = "; or ask beside that master with --class 2, if the slave has it\n"
    assert cli.err("acyclic", str(plant), "8", "read", "1", "2", code=1) == (
        "dpstack: another station on the bus sends as address 2: staying out of the ring; give one of the two another "
        f"address{beside}"
    )
    plant.write_text(plant.read_text(encoding="utf-8").replace("[bus]", "[bus]\naddress = 1"), encoding="utf-8")
    assert cli.err("acyclic", str(plant), "8", "read", "1", "2", code=1) == (
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
def test_the_slave_refuses(run: Cli, field: Field, serve: object, text: str) -> None:
    assert callable(serve)
    field.server.serve = serve
    assert text in run.err("8", "read", "1", "2", code=1)
    field.check()


def test_a_simulated_slave_has_no_master(run: Cli, plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the port "virtual", too, nobody parameterises it."""
    buses: list[dpstack.Bus] = []

    def spy(config: Config, on_event: OnEvent | None, world: dpstack.World | None) -> dpstack.Bus:
        buses.append(dpstack.open_bus(config, on_event=on_event, world=world))
        return buses[-1]

    monkeypatch.setattr(on_bus, "Bus", spy)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    settings = '[bus]\nport = "virtual"\nbaud = 500000\n[[slave]]\nname = "fan"\n'
    plant.write_text(f'{settings}address = 8\ndrive = "ls-s100"\ntelegram = "PPO1"\n', encoding="utf-8")
    told = run.json("fan", "im")
    assert told["im"]["0"]["order_id"] == "CPDP-S100"
    (bus,) = buses
    assert (bus.slaves, bus.class2.connections) == ((), 0)
    run("fan", "im", "--baud", "auto", code=2)


def test_a_slave_without_class_2_connections(run: Cli, field: Field) -> None:
    field.server.free.clear()
    err = run.err("8", "read", "1", "2", code=1)
    assert "slave 8 refuses Initiate (RS at SAP 49): all its class 2 connections are in use, or it has none" in err


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["8", "transport", "1", "2", "0G"], "'0G': 'G' is no hex digit"),
        (["8", "transport", "1"], "transport takes SLOT INDEX [HEX], for instance: transport 0 1 00FF"),
        (["7", "read", "1", "2"], "no slave '7' in this configuration"),
    ],
)
def test_wrong_use(run: Cli, args: list[str], text: str) -> None:
    assert text in run.err(*args)


def test_services_and_options_of_the_other_class_are_refused(plant: Path, cli: Cli) -> None:
    assert "Data_Transport is a service of class 2 connections: add --class 2" in cli.err(
        "acyclic", str(plant), "8", "transport", "1", "2"
    )
    assert "--address is for --class 2" in cli.err("acyclic", str(plant), "8", "read", "1", "2", "--address", "5")


def test_a_read_only_configuration(run: Cli, plant: Path) -> None:
    plant.write_text(PLANT.replace("[bus]", "[bus]\nread_only = true").replace("cycle_ms = 10.0\n", ""))
    assert "a connection is to be opened; leave read_only out" in run.err("8", "im")


async def through(config: dpstack.Config) -> None:
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


async def test_a_run_carries_the_orders_out(plant: Path) -> None:
    world = dpstack.World()
    server: Ms2Server = ms2_in(world, 8)
    server.serve = odd
    plant.write_text(PLANT.replace("PORT", "virtual"), encoding="utf-8")
    async with dpstack.open_bus(plant, world=world) as bus, control_run(bus, "virtual"):
        await bus.ready()
        await asyncio.to_thread(asyncio.run, through(dpstack.load_config(plant)))
        assert bus.slave(8).ready_now
        assert bus.class2.connections == 0
    assert not server.sessions
