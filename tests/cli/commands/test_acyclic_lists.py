"""``dpstack acyclic ... parameters|dump|compare``: a device's own list, every format, arrays whole, both ways to it."""

from __future__ import annotations

import asyncio
import json
import tomllib
from pathlib import Path

import pytest
from api_kit import RAW, slave_in
from cli_kit import Cli
from plant_files import plant_file

import dpstack
from dpstack.api.config.config import Config
from dpstack.api.control.commands import ParsedCommand
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import through_run
from dpstack.api.streams import OnEvent
from dpstack.cli.commands import acyclic, on_bus
from dpstack.cli.main import main
from dpstack.profile.record47 import (
    Address,
    Description,
    ErrorValue,
    ParameterModel,
    ParameterServer,
    Result,
    TimedRecords,
    Values,
)
from dpstack.slave import DpSlave, SlaveDescription

Out = pytest.CaptureFixture[str]
RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="pump", dpv1=True)


class Device(ParameterModel):
    """Parameters of many formats; what a format is called and what its octets mean is written down in the tests."""

    def __init__(self) -> None:
        self.values: dict[int, Values] = {
            980: Values(6, (11, 12, 13, 14, 15, 16, 17, 18, 0)),
            11: Values(6, (7,)),
            12: Values(3, (1, -2, 3)),
            13: Values(8, (0.5,)),
            14: Values(9, (b'say "hi"\x1b',)),
            15: Values(10, (b"\x00\xff",)),
            16: Values(1, (1,)),
            17: Values(0x42, (0xC000,)),
        }
        self.read_only = {11}

    def read(self, address: Address) -> Result:
        if address.pnu == 18:
            return ErrorValue(0x0B)
        found = self.values.get(address.pnu)
        if found is None:
            return ErrorValue(0)
        if found.format in (9, 10):
            return found
        end = address.subindex + max(address.elements, 1)
        return (
            Values(found.format, found.raws[address.subindex : end]) if end <= len(found.raws) else ErrorValue(3, end)
        )

    def describe(self, address: Address) -> Result:
        found = self.values.get(address.pnu)
        if found is None:
            return ErrorValue(9)
        form = {17: 113}.get(address.pnu, found.format)  # N2, answered as a word
        size = len(found.raws[0]) if isinstance(found.raws[0], bytes) else len(found.raws)
        name = {11: "Node address", 12: "Ramps", 17: "Speed"}.get(address.pnu, "")
        octets = Description(
            form, size, name, address.pnu in self.read_only, size > 1, False, 1.0, 0, bytes(4), bytes(4)
        ).build()
        return Values(10, (octets,))

    def text(self, address: Address) -> Result:
        return ErrorValue(0x0F)

    def change(self, address: Address, values: Values) -> ErrorValue | None:
        found = self.values[address.pnu]
        if address.pnu in self.read_only or found.format != values.format:
            return ErrorValue(1 if address.pnu in self.read_only else 5)
        raws = list(found.raws)
        raws[address.subindex : address.subindex + len(values.raws)] = values.raws
        self.values[address.pnu] = Values(found.format, tuple(raws))
        return None


pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    pump = {**RAW, "name": "pump", "address": 8, "config": "10 20", "user_prm": "00 00 00", "dpv1": True}
    return plant_file(tmp_path, pump)


@pytest.fixture
def run(cli: Cli, plant: Path) -> Cli:
    return cli.of("acyclic", str(plant))


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Device:
    """The foreground in virtual time, with the device at 8 in its world."""
    made = Device()
    for module, name in ((acyclic, "open_bus"), (on_bus, "Bus")):
        monkeypatch.setattr(module, name, lambda config, on_event=None, world=None: open_bus(made, config, on_event))
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    return made


def open_bus(device: Device, config: Config, on_event: OnEvent | None = None) -> dpstack.Bus:
    world = dpstack.World()
    slave = DpSlave(RIG, lambda outputs, elapsed: outputs, ms2=1)
    slave.serve_records(TimedRecords(ParameterServer(device), lambda at: 0))
    slave_in(world, slave, 8)
    return dpstack.open_bus(config, on_event=on_event, world=world)


FILE = """\
# Parameters of a device; `dpstack acyclic CONFIG ADDRESS compare FILE` shows where a device differs.
format = 1
kind = "record 47"
name = "pump"
address = 8
ident = 0x1234
slot = 1
object = 1
time = "TIME"
parameters = [
  { number = 11, name = "Node address", format = "Unsigned16", values = [7], read_only = true },
  { number = 12, name = "Ramps", format = "Integer16", values = [1, -2, 3] },
  { number = 13, format = "FloatingPoint", values = [0.5] },
  { number = 14, format = "VisibleString", values = ["say \\"hi\\"\\u001b"] },
  { number = 15, format = "OctetString", values = ["00 ff"] },
  { number = 16, format = "Boolean", values = [true] },
  { number = 17, name = "Speed", format = "N2", values = [-1.0] },
  { number = 18, unreadable = "error 11, no operation priority" },
]
"""


@pytest.mark.usefixtures("device")
def test_the_list_as_a_table_and_as_json(run: Cli) -> None:
    out, err = run("pump", "parameters")
    assert err == ""
    assert out.splitlines() == [
        "slave 8 (pump): 8 parameters of slot 1, object 1",
        "number  name          format         values",
        "11      Node address  Unsigned16     7                                                ro",
        "12      Ramps         Integer16      1, -2, 3",
        "13                    FloatingPoint  0.5",
        "14                    VisibleString  'say \"hi\"\\x1b'",
        "15                    OctetString    '00 ff'",
        "16                    Boolean        true",
        "17      Speed         N2             -1.0",
        "18                                   cannot be read: error 11, no operation priority",
    ]
    told = run.json("pump", "parameters", "1")
    assert (told["order"], told["ident"], told["through"], len(told["parameters"])) == (
        "parameters",
        0x1234,
        "master",
        8,
    )
    assert told["parameters"][1] == {"number": 12, "name": "Ramps", "format": "Integer16", "values": [1, -2, 3]}


@pytest.mark.parametrize("class2", [(), ("--class", "2")])
def test_one_parameter_is_read_and_written(run: Cli, device: Device, class2: tuple[str, ...]) -> None:
    for order, line in (
        ("11", "parameter 11 (Node address) = 7 (Unsigned16)"),
        ("0xC", "parameter 12 (Ramps) = 1, -2, 3 (Integer16)"),
        ("12:1", "parameter 12 (Ramps)[1] = -2 (Integer16)"),
        ("12:1=5", "parameter 12 (Ramps)[1] = 5 (Integer16, written and read back)"),
        ("13=2", "parameter 13 = 2.0 (FloatingPoint, written and read back)"),
        ("17=-0.5", "parameter 17 (Speed) = -0.5 (N2, written and read back)"),  # N2, which it answers as a word
        ("14=abc", "parameter 14 = 'abc' (VisibleString, written and read back)"),
    ):
        assert run.out("8", "parameter", order, *class2).splitlines() == [f"slave 8 (pump): {line}"], order
    assert device.values[13] == Values(8, (2.0,))
    assert device.values[17] == Values(0x42, (0xE000,))
    told = run.json("pump", "parameter", "12:1", "1", "1", *class2)
    assert (told["slot"], told["object"], told["index"], told["written"]) == (1, 1, 1, False)
    assert told["parameter"] == {"number": 12, "name": "Ramps", "format": "Integer16", "values": [5]}


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("order", "code", "text"),
    [
        ("18", 1, "pump: parameter 18: error 11, no operation priority"),
        ("12:9", 1, "pump: parameter 12[9]: error 3, invalid subindex"),
        ("11=8", 1, "pump: parameter 11: error 1, the value cannot be modified"),
        ("12=8", 2, "parameter 12 has 3 values: write an element of it, 12:0=VALUE"),
        ("13=x", 2, "parameter 13 = x: "),
        ("17=0.1", 2, "parameter 17 = 0.1: N2: 0.1 lies between two values"),
        ("70000", 2, "'70000' is no PNU: write a number 0..65535"),
        ("12:", 2, "'12:': write a parameter as 1120, 947:3 (an element of an array) or 1120=2.5"),
    ],
)
def test_one_parameter_that_cannot_be_had(run: Cli, order: str, code: int, text: str) -> None:
    assert text in run.err("8", "parameter", order, code=code)


def test_one_parameter_of_a_drive_with_a_plugin(cli: Cli, tmp_path: Path) -> None:
    drives = [
        {"name": "fan", "address": 7, "drive": "fuji-frenic"},
        {"name": "pump", "address": 8, "drive": "ls-s100"},
    ]
    run = cli.of("acyclic", str(plant_file(tmp_path, *drives)))
    assert run.out("pump", "parameter", "930") == "slave 8 (pump): parameter 930 = 1 (Unsigned16)\n"
    # past the plugin nothing is written, whose rules protect the motor
    assert "`dpstack drive CONFIG pump write 930 1` writes it" in run.err("pump", "parameter", "930=1", "--class", "2")
    said = run.err("fan", "parameter", "947")
    assert "`dpstack drive CONFIG fan read 947` asks over the parameter channel of its telegram" in said


@pytest.mark.usefixtures("device")
def test_over_a_class_2_connection_it_is_the_same(run: Cli, tmp_path: Path) -> None:
    table = run.out("8", "parameters")
    assert run.out("8", "parameters", "--class", "2") == table
    path = tmp_path / "pump.toml"
    run("8", "dump", str(path), "--class", "2")
    assert run.out("8", "compare", str(path), "--all", "--class", "2").splitlines()[-1] == (
        f"slave 8 (pump): 7 parameters are as in {path}, 0 differ"
    )


def test_into_a_file_and_against_it(run: Cli, device: Device, tmp_path: Path) -> None:
    path = tmp_path / "pump.toml"
    out = run.out("8", "dump", str(path))
    assert out.splitlines() == [
        f"slave 8 (pump): 7 parameters are in {path}",
        "not read: parameter 18: error 11, no operation priority",
    ]
    text = path.read_text(encoding="utf-8")
    assert text == FILE.replace("TIME", tomllib.loads(text)["time"])
    out = run.out("8", "compare", str(path))
    assert out.splitlines() == [
        "not compared: parameter 11 (Node address): it is read only",
        "not compared: parameter 18: it could not be read when the file was made: error 11, no operation priority",
        f"slave 8 (pump): 6 parameters are as in {path}, 0 differ",
    ]
    device.values[11] = Values(6, (8,))
    device.values[12] = Values(3, (1, 5, -3))
    device.values[14] = Values(9, (b"bye",))
    device.values[16] = Values(5, (1,))
    del device.values[15]
    device.values[980] = Values(6, (11, 12, 13, 14, 15, 16, 19, 0))
    device.values[19] = Values(6, (1,))
    out = run.out("8", "compare", str(path), "--all", code=1)
    assert out.splitlines() == [
        "parameter 11 (Node address): file 7, device 8",
        "parameter 12 (Ramps): [1] file -2, device 5; [2] file 3, device -3",
        "parameter 14: file 'say \"hi\"\\x1b', device 'bye'",
        "parameter 15: file '00 ff', device cannot be read: error 0, illegal parameter number",
        "parameter 16: file true as Boolean, device 1 as Unsigned8",
        "not compared: parameter 17 (Speed): the device does not have it",
        "not compared: parameter 18: it could not be read when the file was made: error 11, no operation priority",
        "not compared: parameter 19: it is not in the file",
        f"slave 8 (pump): 1 parameter is as in {path}, 5 differ",
    ]
    told = run.json("8", "compare", str(path), code=1)
    assert (told["order"], told["address"], told["same"], len(told["differences"])) == ("compare", 8, 1, 4)
    assert told["differences"][0]["elements"] == [1, 2]
    told = run.json("8", "dump", str(path))
    assert (told["parameters"], [one["number"] for one in told["unreadable"]]) == (7, [15])


def test_a_device_without_a_list(run: Cli, plant: Path, device: Device, tmp_path: Path) -> None:
    path = tmp_path / "pump.toml"
    run("8", "dump", str(path))
    mine = path.read_text(encoding="utf-8")
    del device.values[980]
    err = run.err("8", "dump", str(path), code=1)
    assert "parameter 980: error 0, illegal parameter number; it has no list of its parameters: read them by" in err
    assert path.read_text(encoding="utf-8") == mine
    assert set(tmp_path.iterdir()) == {plant, path}


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("ident = 0x1234", "ident = 0x4711", "a device of the type 0x4711; slave 8 (pump) is 0x1234"),
        ('kind = "record 47"', 'kind = "other"', "this is no list of parameters of `dpstack acyclic`"),
        ("slot = 1\n", "", "slot is missing or of the wrong type"),
        ("slot = 1\n", "slot = 1\ncolour = 3\n", "there is no key 'colour'"),
        ("number = 12", "number = 11", "parameter 11 (Ramps) is there twice"),
        ("number = 12, ", "", "entry 2: needs number"),
        ('name = "Ramps"', "name = 4", "entry 2 (parameter 12): name = 4 is of the wrong type"),
        ("values = [1, -2, 3]", "values = [1, [2], 3]", "(parameter 12): element 1 of its values, [2], is neither"),
        (", values = [1, -2, 3]", "", "(parameter 12): needs either values or unreadable"),
        ("read_only", "readonly", "(parameter 11): there is no key 'readonly'"),
        ("parameters = [", "parameters = [1,", "entry 1: is no table"),
        ("format = 1", "format = ", "no TOML"),
    ],
)
def test_a_file_that_is_none(run: Cli, tmp_path: Path, old: str, new: str, text: str) -> None:
    path = tmp_path / "pump.toml"
    assert old in FILE
    path.write_text(FILE.replace(old, new, 1), encoding="utf-8")
    assert text in run.err("8", "compare", str(path))


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("args", "text"),
    [
        (["dump"], "dump takes FILE [SLOT] [OBJECT], for instance: dump pump.toml"),
        (["dump", "/nowhere/x"], "/nowhere/x: cannot be written"),
        (["compare", "/nowhere/x"], "/nowhere/x: No such file"),
        (["parameters", "256"], "'256' is no SLOT: write a number 0..254"),
        (["parameters", "1", "x"], "'x' is no OBJECT: write a number 0..255"),
        (["dumb", "x"], "dpstack acyclic does not know 'dumb'; did you mean dump?"),
        (["parameters", "--all"], "--all is for compare: leave it out"),
        (["pa"], "dpstack acyclic does not know 'pa'"),
    ],
)
def test_wrong_use(run: Cli, args: list[str], text: str) -> None:
    assert text in run.err("8", *args)


async def test_through_a_run_it_comes_in_pieces_with_progress(
    plant: Path, capsys: Out, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dpstack.api.control.record_orders._IN_A_LINE", 3)
    monkeypatch.setattr("dpstack.api.control.control_server._SIGN_OF_LIFE_S", 0.01)
    device = Device()
    told: list[tuple[object, ...]] = []
    async with open_bus(device, dpstack.load_config(plant)) as bus, control_run(bus, "virtual"):
        await bus.ready()

        def ask() -> object:
            return asyncio.run(
                through_run(
                    dpstack.load_config(plant), 8, ParsedCommand("parameters", [], {}), lambda *one: told.append(one)
                )
            )

        found = await asyncio.to_thread(ask)
        assert isinstance(found, dict)
        assert [one["number"] for one in found["parameters"]] == list(range(11, 19))
        assert (found["slot"], found["object"], found["slave"]) == (1, 1, "pump")
        capsys.readouterr()
        assert await asyncio.to_thread(main, ["ctl", "virtual", "acyclic", "8", "parameters", "--json"]) == 0
        shown = json.loads(capsys.readouterr().out)["result"]
        assert [one["number"] for one in shown["parameters"]] == list(range(11, 19))
        assert await asyncio.to_thread(main, ["ctl", "virtual", "acyclic", "8", "dump", "f.toml"]) == 2
        assert "ctl acyclic has no files: `dpstack acyclic CONFIG 8 dump FILE` has" in capsys.readouterr().err
        del device.values[980]
        with pytest.raises(dpstack.ParameterError, match="it has no list of its parameters") as caught:
            await asyncio.to_thread(ask)
        assert (caught.value.drive, caught.value.number) == ("pump", 0)
        assert bus.slave(8).ready_now
    for what, done, of in told:
        assert what in ("descriptions", "values")
        assert 0 <= int(str(done)) <= int(str(of)) == 8
