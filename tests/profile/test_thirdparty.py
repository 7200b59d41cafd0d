"""A drive from outside: the example package, found as installed packages are, from CONFIG to running."""

from __future__ import annotations

import ast
import dataclasses
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from acyclic_kit import outcome
from api_kit import RAW, bench_of
from drive_bench import ALONE, DeviceBench, PluginBench
from support import instance, present

import dpstack
from dpstack import profile
from dpstack.cli.main import main
from dpstack.dp.master.events import FaultKind
from dpstack.errors import ConfigError
from dpstack.profile import DriveDevice, DriveProfile

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "thirdparty_drive"


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The package as `pip install` leaves it: on the path, with its metadata and entry points beside it."""
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    info = tmp_path / "dpstack_acme_drive-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    points = "\n".join(f"{name} = {value}" for name, value in project["entry-points"]["dpstack.drives"].items())
    (info / "entry_points.txt").write_text(f"[dpstack.drives]\n{points}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.syspath_prepend(str(EXAMPLE))
    profile.refresh()
    yield EXAMPLE / "plant.toml"
    profile.refresh()


@pytest.fixture
def acme(installed: Path) -> DriveProfile:
    return profile.find("acme-a300")


def simulated(bus: dpstack.Bus) -> DriveDevice:
    return instance(bench_of(bus).device(7), DriveDevice)


def powered(device: DriveDevice) -> bool:
    return device.motor.on


async def whole_day(plant: Path) -> list[str]:
    """Everything a user does with a drive."""
    told = []
    async with dpstack.open_bus(plant) as bus:
        belt = bus.drive("belt")
        await bus.operate()
        await belt.write("source", 0)
        with pytest.raises(dpstack.DriveFault) as refused:
            await belt.start()
        told.append(str(refused.value))
        await belt.write("source", 1)
        await belt.start()
        belt.frequency = -20.0
        await belt.reached()
        told.append(f"{belt.status.speed:.3f} {belt.status.frequency_hz:.1f} {belt.status.reached}")
        with pytest.raises(dpstack.ParameterError, match="error 17, not in this operating state"):
            await belt.write(1, 0)
        with pytest.raises(dpstack.UsageError, match=r"quick_stop: 99 s is outside|Quick stop time\): 99 s is outside"):
            await belt.write("quick_stop", 99)
        with pytest.raises(dpstack.UsageError, match="did you mean acceleration"):
            await belt.read("aceleration")
        told.append(str([await belt.read("starts"), await belt.read(3)]))
        listed = await belt.dump()
        told.append(" ".join(one.name for one in listed.parameters))
        simulated(bus).trip("E07")
        await bus.until(lambda: not belt.status.running, 1)
        told.append(str(belt.status.fault))
        await belt.acknowledge()
        await belt.start()
        await belt.quick_stop()
        told.append(str(belt.status.state))
    return told


def test_a_configuration_that_names_it_runs_it(installed: Path) -> None:
    assert dpstack.run_virtual(whole_day(installed)) == [
        "drive belt: the bus does not control the drive (status bit 3 is 0): set parameter 1 (source) to 1",
        "-0.400 -20.0 True",
        "[1, 0.5]",
        "source acceleration deceleration quick_stop reference starts",
        "E07 motor overload",
        "ready",
    ]


def test_octets_of_its_plugin(acme: DriveProfile) -> None:
    """Literal octets: control word and set point behind the parameter channel; 1388h is 50 %."""
    bench = PluginBench(acme.core("belt", options=ALONE), "00" * 8 + "0008 0000 0000 0000")
    assert bench.out() == "00 00 00 00 00 00 00 00 00 00 00 00"
    token = bench.order("start")
    assert bench.see("00" * 8 + "0008 0000 0000 0000", 60)[24:] == "00 01 00 00"
    assert bench.see("00" * 8 + "0009 0000 0000 0000")[24:] == "00 03 00 00"
    bench.order("speed", value=0.5)
    assert bench.see("00" * 8 + "000B 0000 0190 0000", 2)[24:] == "00 03 13 88"
    assert bench.result(token) == {"type": "result", "token": token, "ok": True, "value": "running"}
    status = bench.core.status()
    assert (status.speed, status.current, status.torque) == (0.0, 0.4, None)
    assert bench.see("00" * 8 + "000C 0000 0000 0009")[24:] == "00 00 13 88"
    assert bench.core.status().faults == ("number 9",)


def test_octets_of_its_simulated_drive(acme: DriveProfile) -> None:
    bench = DeviceBench(acme.device("STD"), "61 53")
    assert bench.send("00 00 00 00") == "00 08 00 00 00 00 00 00"
    assert bench.send("00 01 00 00") == "00 09 00 00 00 00 00 00"
    assert bench.until("00 03 27 10", "00 1B 27 10 01 C0 00 00", 900)[-1] == "00 1B 27 10 01 C0 00 00"
    bench.device.trip("2")
    assert bench.send("00 03 27 10")[:5] == "00 0C"
    with pytest.raises(ValueError, match="known: E01 overcurrent"):
        bench.device.trip("E99")


async def defect(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its cyclic function raises in the middle of a run."""
    from acme_drive.plugin import AcmeCore

    config = dpstack.load_config(plant)
    async with dpstack.open_bus(config, slaves=[RAW]) as bus:
        belt, raw = bus.drive("belt"), bus.slave("raw")
        await bus.operate()
        await bus.ready()
        await belt.start()
        belt.speed = 0.5
        await belt.reached()
        assert belt.slave.outputs.hex() == "00" * 8 + "00031388"

        def defective(self: object) -> None:
            raise ZeroDivisionError("of the plugin's")

        monkeypatch.setattr(AcmeCore, "received", defective)
        raw.outputs = b"\x5a"
        running = bus.stats.rotations
        device = simulated(bus)
        assert powered(device)
        device.set_load(1.0)  # the current changes: new inputs
        await bus.until(lambda: belt.slave.fault is not None, 1)
        fault = present(belt.slave.fault)
        assert fault.kind is FaultKind.PLUGIN
        assert "ZeroDivisionError: of the plugin's" in fault.text
        await bus.rotated(running + 20, 1)
        assert belt.slave.outputs == bytes(12)
        assert not powered(device)  # the safe control word has arrived
        assert raw.inputs == b"\x5a"
        assert raw.fault is None
        with pytest.raises(dpstack.UsageError, match="belt is faulted: its plugin failed"):
            await belt.start()
        await bus.rotated(bus.stats.rotations + 20, 1)


def test_a_defect_of_its_plugin_is_its_own(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dpstack.run_virtual(defect(installed, monkeypatch))


def test_a_defect_while_it_is_driven_by_hand(
    installed: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], runtime_directory: str
) -> None:
    """`dpstack drive` ends with the reason, and leaves the bus in order."""
    from acme_drive.plugin import AcmeCore

    def defective(self: profile.DriveCore) -> None:
        if self.words[1] > 0x0400:  # 10 %
            raise ZeroDivisionError("of the plugin's")

    monkeypatch.setenv("XDG_RUNTIME_DIR", f"{runtime_directory}/nobody")
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    monkeypatch.setattr(AcmeCore, "received", defective)
    assert main(["drive", str(installed), "belt", "start", "speed", "0.5"]) == 1
    printed = capsys.readouterr()
    assert printed.out.splitlines()[1] == "belt: running at 0.0% (0.0 Hz), set point 50.0%"
    assert "its plugin failed (ZeroDivisionError: of the plugin's): outputs are at their safe values" in printed.err
    assert "stopping by its ramp" not in printed.out  # no plugin is left that could


def test_it_needs_the_profile_only() -> None:
    for path in EXAMPLE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert all(name == "dpstack.profile" for name in names if name.startswith("dpstack")), path


def test_its_parameters_go_over_record_47_where_it_has_it(
    installed: Path, acme: DriveProfile, monkeypatch: pytest.MonkeyPatch
) -> None:
    from acme_drive.plugin import AcmeCore

    queue = profile.record47.RecordQueue()
    assert acme.core("belt", "STD", records=queue).access is None  # it declares no slot
    monkeypatch.setattr(AcmeCore, "record_slot", 1)
    core = acme.core("belt", "STD", ALONE, records=queue)
    bench = PluginBench(core, "00 09 00 00 00 00 00 00")
    token = bench.order("read", number=1)
    for answer in ("", "01 01 01 01 06 01 00 01"):
        bench.run()
        pending = present(queue.take())
        asked = pending.request
        octets = asked.data if isinstance(asked, profile.record47.WriteReq) else b""
        assert octets.hex(" ").upper() in ("01 01 01 01 10 00 00 01 00 00", "")
        assert (asked.slot, asked.index) == (1, 47)
        pending.outcome = outcome(answer)
    bench.run()
    assert bench.value(token) == 1


def test_its_sheet_is_made_of_its_tables_alone(acme: DriveProfile) -> None:
    """A plugin without ``details`` has a description, too: nobody has to write one."""
    device = acme.describe(7, options={"reference_hz": 60})
    assert [step.what for step in device.steps] == ["reference = 60 Hz"]
    core = acme.core("belt")
    assert [one.text for one in device.faults] == list(core.fault_names.values())
    assert device.faults
    assert {bit.name for bit in device.words[0].bits} == set(core.table.control.bits)
    assert [one.name for one in device.inputs][2:] == ["speed", "current", "fault"]
    assert device.ranges[0].wire == "2710h = 60 Hz (the reference), two's complement"
    assert {one.title for one in device.parameters} == {spec.title for spec in core.parameter_table or ()}


def test_a_defect_of_its_description_is_one_line(acme: DriveProfile) -> None:
    for details in ("acme_drive.nothing:describe", "acme_drive.table:PARAMETERS"):
        broken = dataclasses.replace(acme, details=details)
        with pytest.raises(ConfigError, match=f"drive acme-a300 cannot be described: .*; repair {details}"):
            broken.describe(7)
