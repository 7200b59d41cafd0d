"""``dpstack diag``: a station of literal octets beside its own master, and any station through a run."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import pytest
from api_kit import in_virtual_time
from bus_kit import add_station
from cli_kit import Cli
from faults.devices import Deaf
from octet_slave import sd1, sd2
from plant_files import plant_file

import dpstack
from dpstack.api.config.config import Config, load_config
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import reading_through_run
from dpstack.api.slave.station_report import KnownDevices, StationReading, read_station, station_report
from dpstack.cli.commands import on_bus
from dpstack.dp.master.master import Master
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.units import NEVER

pytestmark = pytest.mark.usefixtures("alone")

LEVEL = {"at": "i16@1", "scale": 0.1, "unit": "bar"}
IO = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI", "2 AI"], "inputs": {"level": LEVEL}}
#: Ext_Diag; an identifier related block for module 1, a channel related one: module 1, channel 0, word, line break
ILL = bytes.fromhex("08 0C 00 06 10D5 42 02 81 40 A6")


@dataclass(eq=False)
class OctetStation(Deaf):
    """A slave that answers with the octets of ``services`` by DSAP; RS to all others. ``asked``: (SA, FC, DSAP)."""

    address: int
    services: dict[int, bytes]
    baud: int = 500_000
    hears_all: bool = False
    asked: list[tuple[int, int, int | None]] = field(default_factory=list)
    plan: list[tuple[int, bytes]] = field(default_factory=list)

    def telegram(self, telegram: Telegram, now: int) -> None:
        if telegram.fc & 0x0F == 0x09:
            answer = sd1(telegram.sa, self.address, 0x00)
        else:
            self.asked.append((telegram.sa, telegram.fc & 0x0F, telegram.dsap))
            if telegram.da != self.address:
                return
            data = self.services.get(telegram.dsap or 0)
            answer = sd1(telegram.sa, self.address, 0x03)
            if data is not None:
                answer = sd2(telegram.sa, self.address, 0x08, telegram.ssap or 0, telegram.dsap or 0, data)
        self.plan = [(now + 40_000, answer)]

    def wake_at(self) -> int:
        return self.plan[0][0] if self.plan else NEVER

    def take_tx(self, now: int) -> bytes | None:
        return self.plan.pop()[1] if self.plan and self.plan[0][0] <= now else None


class Field:
    """Master 6, to which the station of octets at 8 says that it belongs; the commands join their bus."""

    def __init__(self) -> None:
        self.world = dpstack.World(referee=False)
        services = {60: ILL, 59: b"\x10\x51", 56: bytes.fromhex("01 00 20 00 21"), 57: b""}
        self.station = OctetStation(8, services)
        self.world.add(self.station)
        params = BusParams.preset(500_000, address=6, gap=1, hsa=8, t_tr=15_000)
        self.master = add_station(self.world, params, Master(params, []))
        self.world.run_for(100_000_000)

    def bus(self, config: Config, on_event: Any = None, watched: bool = True, world: object = None) -> dpstack.Bus:
        assert world is None
        return dpstack.Bus(config, on_event=on_event, watched=watched, world=self.world)


@pytest.fixture
def field_bus(monkeypatch: pytest.MonkeyPatch) -> Field:
    found = Field()
    monkeypatch.setattr(on_bus, "Bus", found.bus)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    return found


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    return plant_file(tmp_path, IO, port="/dev/ttyNone", cycle_ms=10.0)


def test_station_of_octets_beside_its_master(field_bus: Field, plant: Path, cli: Cli) -> None:
    out, err = cli("diag", str(plant), "io", code=1)
    assert err == ""
    assert out.splitlines() == [
        "slave 8 (io), asked by 0",
        "  dpstack I/O station, ident 0x10D5",
        "  data_exchange, master 6",
        "diagnosis: ext_diag, wd_on",
        "  has something to report in its extended diagnosis: look at the device",
        "  watches its master",
        "  slots with a diagnosis: 2 (2 AI)",
        "  slot 2 (2 AI), input channel 0 (word): line break",
        "configuration: 5 octets of inputs, 0 octets of outputs",
        '  slot 1 "8 DI": inputs 0, 8 channels (10)',
        '  slot 2 "2 AI": inputs 1 to 4, 2 channels (51)',
        "inputs: 5 octets",
        "    0  01 00 20 00 21",
        "  level = 3.2 bar  bad: line break: slot 2 (2 AI), input channel 0",
        "outputs: 0 octets",
        "finding: slots with a diagnosis: 2 (2 AI)",
        "finding: slot 2 (2 AI), input channel 0 (word): line break",
    ]
    # it reads and writes nothing: SRD to the four services only
    asked = [(function, dsap) for sa, function, dsap in field_bus.station.asked if sa != 6]
    assert {dsap for _, dsap in asked} == {60, 59, 56, 57}
    assert {function for function, _ in asked} <= {0x0C, 0x0D}


def test_healthy_station_by_port_alone(field_bus: Field, cli: Cli) -> None:
    field_bus.station.services[60] = bytes.fromhex("00 0C 00 06 10D5")
    told = cli.json("diag", "--port", "/dev/ttyNone", "--baud", "500000", "8")
    assert (told["healthy"], told["findings"], told["slave"]) == (True, [], None)
    assert (told["state"], told["master"], told["source"], told["own"]) == ("data_exchange", 6, "class2", 0)
    assert told["diagnosis"]["octets"] == "000c000610d5"
    assert [one["name"] for one in told["config"]["modules"]] == ["8 DI", "2 AI"]  # of the GSD file dpstack has
    assert told["config"]["modules"][1] == {
        "slot": 2,
        "name": "2 AI",
        "config": "51",
        "text": 'slot 2 "2 AI": inputs 1 to 4, 2 channels',
        "inputs": 4,
        "input_at": 1,
        "input_width": 16,
        "outputs": 0,
        "output_at": 0,
        "output_width": 0,
    }
    assert told["inputs"]["octets"] == "0100200021"
    assert cli.json("diag", "--port", "/dev/ttyNone", "--baud", "500000", "8", "--address", "5")["own"] == 5


@pytest.mark.parametrize(
    ("diagnosis", "text"),
    [
        ("02 05 00 FF 10D5", "is not in data exchange: it waits for parameters, no master has it"),
        ("42 05 00 FF 10D5", "refuses the parameters (prm_fault): compare ident number and parameters"),
        ("06 05 00 FF 10D5", "refuses the configuration (cfg_fault)"),
        ("02 0C 00 06 10D5", "is not in data exchange: master 6 has parameterised it, and it is not ready"),
        ("00 0E 00 06 10D5", "cannot give valid data (stat_diag): look at the device's own fault display"),
        ("00 0C 00 06 10D6", "is another device: ident 0x10D6 instead of 0x10D5 of the configuration"),
        ("00 0C", "answers, and not as a DP slave does"),
        ("", "answers, and refuses Slave_Diag (RS): it may be a master, or no DP slave"),
    ],
)
def test_findings(field_bus: Field, plant: Path, cli: Cli, diagnosis: str, text: str) -> None:
    field_bus.station.services[60] = bytes.fromhex(diagnosis)
    if not diagnosis:
        del field_bus.station.services[60]
    out = cli.out("diag", str(plant), "8", code=1)
    assert f"finding: {text}" in out
    assert "healthy" not in out


def test_another_rack(field_bus: Field, plant: Path, cli: Cli) -> None:
    field_bus.station.services |= {60: bytes.fromhex("00 0C 00 06 10D5"), 59: b"\x51\x10\x99"}
    out = cli.out("diag", str(plant), "8", code=1)
    slot = "slot 1 has 2 AI, the configuration 8 DI (2 more slots differ)"
    assert f"finding: its configuration is another one: {slot}; octet 1 differs, 3 octets 51 10 99 instead of" in out
    assert "  slot 1: inputs 0 to 3, 2 channels (51)" in out
    field_bus.station.services[59] = b"\x51\x10"
    assert '  slot 1 "2 AI": inputs 0 to 3, 2 channels (51)' in cli.out("diag", str(plant), "8", code=1)


def test_nobody_and_a_master(field_bus: Field, plant: Path, cli: Cli) -> None:
    assert "finding: does not answer: check power, cable" in cli.out("diag", str(plant), "77", code=1)
    assert "finding: is a master in the token ring" in cli.out("diag", str(plant), "6", code=1)
    told = cli.json("diag", str(plant), "77", code=1)
    assert (told["answers"], told["healthy"], told["diagnosis"], told["inputs"]) == (False, False, None, None)


def test_gsd_folder_and_texts_that_are_no_escape_sequences(
    field_bus: Field, plant: Path, cli: Cli, tmp_path: Path
) -> None:
    folder = tmp_path / "gsd"
    folder.mkdir()
    text = (
        '#Profibus_DP\nGSD_Revision = 3\nVendor_Name = "A\x1b[2J"\nModel_Name = "B"\nIdent_Number = 0x4711\n'
        'Max_Module = 1\nModular_Station = 1\nUnit_Diag_Bit(0) = "fuse\x1b[31m blown"\n'
        'Module = "M\x1b1" 0x10\n1\nEndModule\n'
    )
    (folder / "own.gsd").write_bytes(text.encode("latin-1"))
    (folder / "broken.gsd").write_text("nothing", encoding="utf-8")
    field_bus.station.services |= {60: bytes.fromhex("08 0C 00 06 4711 02 01"), 59: b"\x10"}
    out, err = cli("diag", "--port", "/dev/ttyNone", "--baud", "500000", "8", "--gsd", str(folder), code=1)
    assert "skipped" in err
    assert "\x1b" not in out + err
    assert r"  A\x1b[2J B, ident 0x4711" in out
    assert r"finding: fuse\x1b[31m blown" in out
    assert r'slot 1 "M\x1b1": inputs 0, 8 channels (10)' in out


@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["8"], "diag takes CONFIG ADDRESS, or --port P ADDRESS"),
        (["PLANT", "8", "9"], "diag takes CONFIG ADDRESS"),
        (["PLANT", "valve"], "'valve' is no station: give its address, 0..126; the configuration has io (8)"),
        (["PLANT", "127"], "'127' is no station"),
        (["--port", "virtual", "8"], 'nobody is on port "virtual"'),
        (["PLANT", "8", "--gsd", "/nowhere/at/all"], "this is no folder"),
        (["/nowhere.toml", "8"], "/nowhere.toml"),
    ],
)
def test_wrong_use_of_diag(plant: Path, cli: Cli, args: list[str], text: str) -> None:
    assert text in cli.err("diag", *(arg.replace("PLANT", str(plant)) for arg in args))


def reading_is_kept(reading: StationReading) -> None:
    """A reading goes through JSON unchanged."""
    text = json.dumps(msgspec.structs.asdict(reading))
    assert msgspec.convert(json.loads(text), StationReading) == reading


@in_virtual_time
async def test_any_station_through_the_run(plant: Path) -> None:
    """The run's own slave, one of another master, and one that is not there."""
    plant_file(plant.parent, IO, port="/dev/plant", cycle_ms=10.0)
    config = load_config(plant)
    world = dpstack.World(referee=False)
    dpstack.simulate(world, config.slaves, baud=500_000)
    theirs = OctetStation(40, {60: bytes.fromhex("00 0C 00 06 1234"), 59: b"\x20"})
    world.add(theirs)
    async with dpstack.open_bus(config, world=world) as bus:
        await bus.operate()
        await bus.ready()
        async with control_run(bus, "/dev/plant"):
            own = await reading_through_run("/dev/plant", config, "8")
            other = await reading_through_run("/dev/plant", None, "40")
            nobody = await reading_through_run("/dev/plant", config, "41")
            with pytest.raises(dpstack.UsageError, match="station 2 is this master itself"):
                await reading_through_run("/dev/plant", config, "2")
            with pytest.raises(dpstack.UsageError, match="'valve' is no ADDRESS"):
                await reading_through_run("/dev/plant", config, "valve")
        direct = await read_station(bus.class2, 8, 2, "run")
        assert bus.slave("io").ready_now
    assert own is not None
    assert other is not None
    assert nobody is not None
    assert own.config == direct.config == "1051"
    report = station_report(own, config.slaves[0], KnownDevices(config.slaves))
    assert (report["healthy"], report["master"], report["inputs"]["fields"]) == (True, 2, {"level": 0.0})
    assert (other.diagnosis, other.config, other.inputs) == (theirs.services[60].hex(), "20", None)
    assert set(other.errors) == {"RD_Inp", "RD_Outp"}
    report = station_report(other)
    assert (report["ident"], report["healthy"], report["master"]) == ("0x1234", True, 6)
    assert station_report(nobody)["answers"] is False
    for reading in (own, other, nobody):
        reading_is_kept(reading)


@in_virtual_time
async def test_through_a_run_that_only_reads(plant: Path) -> None:
    plant_file(plant.parent, IO, port="/dev/plant")
    config = load_config(plant).with_bus(read_only=True)
    world = dpstack.World(referee=False)
    station = OctetStation(8, {60: bytes.fromhex("00 0C 00 06 10D5"), 59: b"\x10\x51", 56: bytes(5)})
    world.add(station)
    async with dpstack.open_bus(config, world=world) as bus, control_run(bus, "/dev/plant"):
        reading = await reading_through_run("/dev/plant", config, "io")
    assert reading is not None
    assert (reading.config, reading.inputs, set(reading.errors)) == ("1051", "0000000000", {"RD_Outp"})
    assert station_report(reading, config.slaves[0])["healthy"]
    assert {dsap for _, _, dsap in station.asked} == {60, 59, 56, 57}


@in_virtual_time
async def test_no_run_answers(plant: Path) -> None:
    assert await reading_through_run("/dev/ttyNone", load_config(plant), "8") is None
    assert await reading_through_run("/dev/ttyNone", None, "8") is None


@in_virtual_time
async def test_the_only_run_on_virtual_and_one_by_its_name(plant: Path) -> None:
    plant_file(plant.parent, IO)
    async with dpstack.open_bus(load_config(plant)) as bus:
        await bus.operate()
        await bus.ready()
        async with control_run(bus, "virtual") as control:
            assert control.name != "virtual"
            for port in ("virtual", control.name):
                reading = await reading_through_run(port, None, "8")
                assert reading is not None
                assert reading.config == "1051"
