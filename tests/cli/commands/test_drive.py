"""``dpstack drive``: every form, alone in the foreground and through a run; what it says and how it ends."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from api_kit import bench_of
from cli_kit import SIMULATED, Cli
from ends.telegrams import told
from far_ends import until
from plant_files import plant_file
from programs import Program, Starter, plant_of

import dpstack
from dpstack.api.bus.bus import Bus
from dpstack.api.control import control_server as server
from dpstack.api.control.client import connect
from dpstack.api.control.commands import ParsedCommand
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import RemoteDrive, find_drive
from dpstack.api.lists.parameter_list import ParameterList, ParameterPlace, ParameterValue
from dpstack.cli.commands.drive import OneDrive
from dpstack.cli.main import main
from dpstack.cli.terminal.signals import StopSignal
from dpstack.errors import BusError, DriveFault, DriveTimeout, ParameterError, UsageError
from dpstack.profile import DriveDevice

Out = pytest.CaptureFixture[str]
MAP = {"map_outputs": "set_frequency", "map_inputs": "frequency fault_code"}
#: the hoist is as delivered: 412 is 44, and nobody may change it
ALL = [
    {"name": "demag", "address": 3, "drive": "demag-dedrive", "options": {"set_412": True}},
    {"name": "fuji", "address": 4, "drive": "fuji-frenic"},
    {"name": "imo", "address": 5, "drive": "imo-hd2", "options": {"set_map": True, **MAP}},
    {"name": "keb", "address": 6, "drive": "keb-f5"},
    {"name": "ls", "address": 7, "drive": "ls-s100"},
]


pytestmark = pytest.mark.usefixtures("alone")


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """The foreground in virtual time."""
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return plant_of(tmp_path)


Drive = Callable[..., tuple[list[str], list[str]]]


def printed(cli: Cli, *args: str, code: int = 0) -> tuple[list[str], list[str]]:
    """Lines on standard output and standard error; that the slaves are simulated is left out."""
    out, err = cli("drive", *args, code=code)
    err = err.replace(SIMULATED, "", 1)
    told = [line for line in err.splitlines() if "its ident number is" not in line]
    return out.splitlines(), told


@pytest.fixture
def drive(cli: Cli, plant: Path) -> Drive:
    return partial(printed, cli, str(plant))


# -- in the foreground --------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("name", ["demag", "fuji", "imo", "keb", "ls"])
def test_every_word_for_every_drive(name: str, tmp_path: Path, cli: Cli) -> None:
    """One command line, five drives: only the name changes."""
    path = plant_file(tmp_path, *ALL, baud=1_500_000)
    file = str(tmp_path / "it.toml")
    words = f"status start speed 0.5 reached frequency 20 reached stop dump {file} compare {file} start quick_stop"
    words = words if name not in ("imo",) else words.replace(" quick_stop", " coast")
    # at a low rate there is less to compute; the IMO's card hears one rate only
    baud = "1500000" if name == "imo" else "93750"
    out, err = printed(cli, str(path), name, *words.split(), "acknowledge", "--json", "--baud", baud)
    assert [line for line in err if not line.startswith(f"dpstack: drive {name}: ")] == []  # what plugins advise
    told = [json.loads(line) for line in out]
    assert [one["order"] for one in told] == [word for word in (*words.split(), "acknowledge") if word.isidentifier()]
    assert {one["drive"] for one in told} == {name}
    assert {one["through"] for one in told} == {"master"}
    assert told[1]["status"]["running"]
    assert told[3]["status"]["speed"] == pytest.approx(0.5, abs=0.02)
    assert told[5]["status"]["frequency_hz"] == pytest.approx(20, abs=1)
    assert not told[6]["status"]["running"]
    assert told[7]["parameters"] == told[8]["same"] + len(told[8]["skipped"]) > 10
    assert told[8]["differences"] == []


@pytest.mark.usefixtures("fast")
def test_parameters_for_people(drive: Drive) -> None:
    out, _ = drive("hoist", "read", "480", "read", "fixed_frequency_1", "--data-set", "3")
    assert out == [
        "hoist: 480 (fixed_frequency_1), data set 3 = 5.0 Hz",
        "hoist: fixed_frequency_1, data set 3 = 5.0 Hz",
    ]
    drive("hoist", "dump", "h.toml", "--data-set", "3")
    out, _ = drive("hoist", "write", "480", "-300", "compare", "h.toml", "--data-set", "3", code=1)
    assert out[:2] == [
        "hoist: 480 (fixed_frequency_1), data set 3 = -300.0 Hz",
        "fixed_frequency_1, data set 3 (Fixed frequency 1): file 5.0 Hz, drive -300.0 Hz",
    ]
    assert out[-1] == "hoist: 17 parameters are as in h.toml, 1 differs"
    assert any(line.startswith("not compared: internal_reference_frequency, ") for line in out)
    out, _ = drive("hoist", "compare", "h.toml", "--all", "--json")
    (told,) = map(json.loads, out)
    assert (told["same"], told["file"]) == (24, "h.toml")
    _, err = drive("fan", "compare", "h.toml", code=2)
    assert err[0].startswith("dpstack: drive fan: PPO3 of fuji-frenic has no parameter channel") or "demag" in err[0]


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ("nobody status", 2, "no drive 'nobody' in this configuration; there are: hoist (3), fan (4)"),
        ("raw start", 2, "slave 9 (raw) is no drive; give it `drive = ...` in its table"),
        ("hoist strat", 2, "a drive does not know 'strat'; did you mean start?"),
        ("hoist quick-stop", 2, "did you mean quick_stop?"),
        ("hoist dance", 2, "it knows status, start, stop, quick_stop"),
        ("hoist speed", 2, "speed takes V, for instance: speed 0.5"),
        ("hoist dump", 2, "dump takes FILE, for instance: dump hoist.toml"),
        ("hoist start --ram", 2, "--ram is for write: leave it out"),
        ("hoist status --data-set 1", 2, "--data-set is for compare, dump, read, write: leave it out"),
        ("hoist speed fast", 2, "'fast' is no number; write for instance 20.5"),
        ("fan speed 9", 2, "drive fan: speed 9 is outside -1..1"),
        ("hoist write 400 2.5", 2, "2.5 kHz lies between two values, the step is 1 kHz: give 2 or 3 kHz"),
        ("fan reached", 2, "the drive is not running (it reports ready_to_switch_on): start it first"),
        ("fan read F26", 2, "PPO3 of fuji-frenic has no parameter channel"),
        ("fan dump f.toml", 2, "PPO3 of fuji-frenic has no parameter channel"),
        ("hoist read 5000", 2, "parameter numbers are 1..999"),
        ("hoist read 999", 1, "parameter 999: error 0, inadmissible parameter number"),
        ("hoist compare none.toml", 2, "none.toml: No such file or directory; make the file by"),
        ("hoist dump no/where.toml", 2, "no/where.toml: cannot be written (No such file or directory)"),
        ("hoist start", 1, "412 is 44: control not by the bus; write 412 = 1 in the active data set (1)"),
    ],
)
def test_an_order_that_cannot_be_done_is_one_line(drive: Drive, words: str, code: int, says: str) -> None:
    """A notice of the drive (412 is 44 as delivered) is another line."""
    out, err = drive(*words.split(), code=code)
    assert out == []
    err = without_notices(err)
    assert len(err) == 1
    assert says in err[0]


def without_notices(lines: list[str]) -> list[str]:
    return [line for line in lines if not line.endswith("start is refused until then")]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("fan start speed 1.5", "drive fan: speed 1.5 is outside -1..1: 100 % is F03"),
        ("fan start speed 1e16", "drive fan: speed: value must be a number up to 1e+15"),
        ("fan start frequency nan", "drive fan: frequency: value must be a number, not nan"),
        ("fan start read F26", "drive fan: PPO3 of fuji-frenic has no parameter channel"),
        ("fan start dump f.toml", "drive fan: PPO3 of fuji-frenic has no parameter channel"),
        ("hoist start speed fast", "'fast' is no number"),
        ("hoist start speed 0.5 raeched", "did you mean reached?"),
        ("hoist start write 400 2.5", "2.5 kHz lies between two values, the step is 1 kHz: give 2 or 3 kHz"),
        ("hoist start write 480 1e9", "drive hoist: 480 (Fixed frequency 1): 1e+09 Hz is outside -999..999 Hz"),
        ("hoist start read 5000", "parameter numbers are 1..999"),
        ("hoist start read ramp", "drive hoist: no parameter is called 'ramp'"),
        ("hoist start read 480 --data-set 5", "data sets are 1..4"),
        ("hoist start dump no/where.toml", "no/where.toml: cannot be written"),
        ("hoist start dump plant.toml", "it is no earlier dump of hoist"),
        ("hoist start dump f.toml --data-set 7", "a demag-dedrive has no data set 7"),
        ("hoist start compare none.toml", "none.toml: No such file or directory"),
    ],
)
def test_all_orders_are_judged_before_the_first_goes_out(
    drive: Drive, words: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither a run is asked nor a master of its own begun: nothing starts that a later word would stop again."""
    begun: list[object] = []
    monkeypatch.setattr("asyncio.run", begun.append)
    out, err = drive(*words.split(), code=2)
    assert (out, begun) == ([], [])
    assert len(err) == 1
    assert says in err[0]


@pytest.mark.usefixtures("fast")
def test_a_file_that_an_earlier_order_makes_is_not_looked_for(drive: Drive) -> None:
    out, err = drive("hoist", "dump", "new.toml", "compare", "new.toml")
    assert without_notices(err) == []
    assert out[-1].endswith("parameters are as in new.toml, 0 differ")


async def test_a_run_is_told_nothing_when_a_later_word_is_wrong(plant: Path, capsys: Out) -> None:
    async with dpstack.open_bus(plant) as bus, control_run(bus, "virtual"):
        await bus.operate()
        await bus.ready()
        fan, slave = bus.drive("fan"), bus.slave(4)
        await fan.settled()
        before = slave.outputs_sent
        assert await asyncio.to_thread(main, ["drive", str(plant), "fan", "start", "speed", "1.5"]) == 2
        await bus.rotated(bus.stats.rotations + 100, 5)
        assert (fan.status.running, fan.speed, slave.outputs_sent) == (False, 0.0, before)
    assert "outside -1..1" in capsys.readouterr().err


@pytest.mark.usefixtures("fast")
def test_a_set_point_alone_moves_nothing(drive: Drive) -> None:
    out, err = drive("4", "frequency", "12", "--seconds", "1")
    assert out == [
        "fan: ready_to_switch_on at 0.0% (0.0 Hz), set point 20.0%",
        "master in the foreground until Ctrl-C, which ends",
    ]
    assert err == ["dpstack: fan does not run: `start` starts it, for instance: fan start speed 0.5"]


@pytest.mark.usefixtures("fast")
def test_the_end_of_the_time_stops_it_by_its_ramp(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    speeds: list[float] = []
    close = Bus.close

    async def closing(bus: Bus) -> None:
        speeds.append(bus.drive("fan").status.speed or 0.0)
        await close(bus)

    monkeypatch.setattr(Bus, "close", closing)
    out, err = drive("fan", "start", "speed", "50%", "reached", "--seconds", "1")
    (notice,) = err
    assert "drive fan: settings not checked: PPO3 has no parameter channel" in notice
    assert "fan: stopping by its ramp; a second Ctrl-C makes its outputs safe at once" in out
    assert out[-1] == "fan: ready_to_switch_on at 0.0% (0.0 Hz), set point 50.0%"
    assert speeds == [0.0]  # before the bus put out safe values


@pytest.mark.usefixtures("fast")
def test_a_second_signal_cuts_the_ramp_short(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first stops the drive by its ramp, which takes seconds; after a later one there are safe values and Clear."""
    telegrams: list[bytes] = []
    times: list[float] = []

    def interrupt_in(seconds: float) -> None:
        loop = asyncio.get_running_loop()
        times.append(loop.time())
        loop.call_later(seconds, os.kill, os.getpid(), signal.SIGINT)

    async def holding(one: OneDrive, seconds: float | None) -> None:
        interrupt_in(0.1)
        await held(one, seconds)

    async def stopping(fan: dpstack.Drive) -> None:
        interrupt_in(0.5)  # two seconds of the clock below; the ramp takes one second of the loop
        await stop(fan)

    async def closing(bus: Bus) -> None:
        await close(bus)
        assert bus.world is not None
        telegrams.extend(entry.octets for entry in bus.world.log)
        times.append(asyncio.get_running_loop().time())

    held, stop, close = OneDrive.held, dpstack.Drive.stop, Bus.close
    monkeypatch.setattr(OneDrive, "held", holding)
    monkeypatch.setattr(dpstack.Drive, "stop", stopping)
    monkeypatch.setattr(Bus, "close", closing)
    monkeypatch.setattr(StopSignal.__init__, "__defaults__", (lambda: 4 * asyncio.get_running_loop().time(),))
    out, err = drive("fan", "start", "speed", "100%", "reached", code=130)
    (notice,) = err
    assert "drive fan: settings not checked: PPO3 has no parameter channel" in notice
    assert out[-1].startswith("fan: stopping at ")
    assert 0.5 <= times[2] - times[1] < 0.7
    assert told(telegrams, 4)[-1] == "clear"


@pytest.mark.usefixtures("fast")
def test_a_drive_that_trips_ends_it(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    operate = Bus.operate

    async def trip(bus: Bus) -> None:
        await bus.until(lambda: bus.drive("fan").status.running)
        device = bench_of(bus).device(4)
        assert isinstance(device, DriveDevice)
        device.trip("OL1")

    async def operating(bus: Bus) -> None:
        await operate(bus)
        tripping.append(asyncio.ensure_future(trip(bus)))

    tripping: list[asyncio.Task[None]] = []
    monkeypatch.setattr(Bus, "operate", operating)
    out, err = drive("fan", "start", code=1)
    assert out[-1].startswith("fan: fault at ")
    assert err[-1] == (
        "dpstack: drive fan stopped by itself: fault without a name: PPO3 and PPO4 do not carry it, the keypad shows it"
    )


@pytest.mark.usefixtures("fast")
def test_a_read_only_configuration_gives_no_orders(drive: Drive, plant: Path) -> None:
    plant.write_text(plant.read_text().replace("[bus]", "[bus]\nread_only = true"), encoding="utf-8")
    assert "no drive can be given an order" in drive("fan", "status", code=2)[1][0]


# -- through a run ------------------------------------------------------------------------------------------------


async def order(drive: RemoteDrive, word: str, *texts: str) -> dict[str, Any]:
    return await drive.carry_out(ParsedCommand(word, texts, {}))


async def through(plant: Path, bus: Bus) -> None:
    found = await find_drive(dpstack.load_config(plant), "hoist")
    assert found is not None
    assert (found.kind, found.address) == ("demag-dedrive", 3)
    with pytest.raises(DriveFault, match="412 is 44"):
        await order(found, "start")
    with pytest.raises(ParameterError, match="error 0, inadmissible") as refused:
        await order(found, "read", "999")
    assert (refused.value.drive, refused.value.number) == ("hoist", 0)
    wrong, there = await found.read_many([ParameterPlace(999), ParameterPlace(480, data_set=2)])
    assert isinstance(wrong, ParameterError)
    assert (wrong.drive, wrong.number, str(wrong)) == ("hoist", 0, str(refused.value))
    assert isinstance(there, ParameterValue)
    assert (there.number, there.data_set) == (480, 2)
    for several in ("7", "[1]", '[{"numero":1}]', "["):
        with pytest.raises(UsageError, match="write for instance"):
            await order(found, "read_many", several)
    with pytest.raises(UsageError, match="parameter numbers are"):
        await order(found, "read", "5000")
    for args, says in (
        (("read", "480", "data_set=x"), "data_set=x: write for instance data_set=1"),
        (("read", "480", "ram=true"), "read has no ram; it is for write"),
        (("write", "480", "5", "ram=maybe"), "ram=maybe: write for instance ram=true"),
        (("start", "timeout=nan"), "timeout=nan: write for instance timeout=1"),
        (("status", "now"), "status takes no arguments, for instance: status"),
    ):
        with pytest.raises(UsageError, match=says):
            await order(found, *args)
    told = await order(found, "write", "480", "0x7", "data_set=2", "ram=true", "timeout=3")
    assert told["parameter"]["value"] == 7
    await order(found, "write", "412", "1")
    listed = await (await found.listed()).dump(plant.with_name("remote.toml"), data_set=2)
    assert listed == ParameterList.load(plant.with_name("remote.toml"))
    assert [one.value for one in listed.parameters if one.number == 480] == [7.0]
    # it starts, and goes on when the connection is gone
    await order(found, "start")
    found.client.close()
    assert bus.drive("hoist").status.running
    with connect("virtual") as client:  # as `dpstack ctl` does
        assert client.call("drive", "hoist", "status")["status"]["running"]


async def test_a_run_carries_the_orders_out(plant: Path) -> None:
    async with dpstack.open_bus(plant) as bus, control_run(bus, "virtual"):
        await bus.operate()
        await bus.ready()
        work = asyncio.ensure_future(asyncio.to_thread(asyncio.run, through(plant, bus)))
        await work
        with pytest.raises(UsageError, match="no drive 'valve' on this bus; there are: hoist, fan"):
            await find_drive(dpstack.load_config(plant), "valve")
    assert await find_drive(dpstack.load_config(plant), "hoist") is None


async def test_a_client_that_hangs_up_ends_the_order(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A start that waits for the bus to operate must not come true when nobody waits for it any more."""
    monkeypatch.setattr(server, "_SIGN_OF_LIFE_S", 0.02)
    begun: list[float] = []
    ended: list[float] = []
    walk = dpstack.Drive.start

    async def noted(drive: dpstack.Drive, timeout: float = 5.0) -> None:
        begun.append(timeout)
        try:
            await walk(drive, timeout)
        finally:
            ended.append(timeout)

    monkeypatch.setattr(dpstack.Drive, "start", noted)
    async with dpstack.open_bus(plant) as bus, control_run(bus, "virtual"):
        await bus.ready()  # in Clear
        found = await find_drive(dpstack.load_config(plant), "fan")
        assert found is not None
        assert await asyncio.to_thread(lambda: found.client.pid) == os.getpid()
        says = r"the bus is in Clear, nothing reaches fan: .* \(of a run: dpstack ctl virtual operate\)"
        with pytest.raises(DriveTimeout, match=says):
            await order(found, "start", "timeout=0.01")
        starting = asyncio.ensure_future(order(found, "start", "timeout=60"))
        await until(lambda: 60 in begun, "the order reaches the run")
        assert not starting.done()
        starting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await starting
        await until(lambda: 60 in ended, "the run notices that the client has gone")
        await bus.operate()
        await bus.until(lambda: bus.drive("fan").status.state == "ready_to_switch_on", 5)
        await bus.rotated(bus.stats.rotations + 100, 5)
        assert not bus.drive("fan").status.running


async def test_a_run_that_can_give_no_orders_says_so(plant: Path) -> None:
    config = dpstack.load_config(plant)
    async with dpstack.open_bus(config, read_only=True) as bus, control_run(bus, "virtual"):
        with pytest.raises(BusError, match="this run is read only"):
            await find_drive(dpstack.load_config(plant), "fan")


async def test_a_drive_that_is_not_there_is_told_with_its_reason(plant: Path) -> None:
    async with dpstack.open_bus(plant) as bus, control_run(bus, "virtual"):
        await bus.operate()
        await bus.ready()
        bench_of(bus).power(4, False)
        await bus.until(lambda: not bus.slave(4).ready_now, 5)
        found = await find_drive(dpstack.load_config(plant), "fan")
        assert found is not None
        says = "slave 4 is not in data exchange: stopped answering"
        with found.client, pytest.raises((DriveTimeout, dpstack.DriveError), match=says):
            await order(found, "start", "timeout=0.2")


# -- programs -----------------------------------------------------------------------------------------------------


def port_of(program: Any) -> str:
    program.wait_for('"port"')
    return str(program.lines[0]["port"])


def through_the_run(drive: Drive, plant: Path, run: Program, cli: Cli) -> None:
    port = dpstack.load_config(plant).port
    out, err = drive("fan", "acknowledge", "start", "speed", "0.3", "reached")
    assert err == []
    assert out[-1] == (
        f"it keeps running under the run on {port} (pid {run.process.pid}): "
        f"`dpstack drive {plant} fan stop` stops it, and so does the end of that run"
    )
    (told,) = (json.loads(line) for line in drive("fan", "status", "--json")[0])
    assert (told["through"], told["status"]["running"]) == ("run", True)
    assert told["status"]["speed"] == pytest.approx(0.3, abs=0.02)
    other = plant.with_name("other.toml")
    other.write_text(plant.read_text(), encoding="utf-8")
    _, err = printed(cli, str(other), "fan", "stop", code=2)
    assert err == [
        f"dpstack: the run on {port} (pid {run.process.pid}) has the configuration {plant}, not {other}: give the one "
        "that the run has, or end that run"
    ]
    was = plant.read_text()
    plant.write_text(was.replace("address = 4", "address = 5"), encoding="utf-8")
    _, err = drive("fan", "stop", code=2)
    assert "but a fuji-frenic at 4 for the run on" in err[0]
    plant.write_text(was, encoding="utf-8")
    out, _ = drive("fan", "stop", "status")
    assert out[0].startswith("fan: ready_to_switch_on at 0.0%")


def test_alone_on_a_port_until_ctrl_c_then_through_a_run(drive: Drive, plant: Path, start: Starter, cli: Cli) -> None:
    sim = start("sim", str(plant), "--port", "pty", "--json")
    port = port_of(sim)
    plant_of(plant.parent, port)
    hand = start("drive", str(plant), "fan", "start", "speed", "0.2", "reached")
    hand.wait_for("master in the foreground until Ctrl-C, which stops the drive by its ramp and ends")
    _, err = drive("fan", "status", code=1)
    assert f"pid {hand.process.pid}" in err[0]
    assert hand.end(signal.SIGINT) == 0
    told = [line for line in hand.out.splitlines() if line.startswith("fan: ")]
    assert told[0].startswith("fan: running at 0.0%")
    assert "fan: stopping by its ramp; a second Ctrl-C makes its outputs safe at once" in told
    assert told[-1] == "fan: ready_to_switch_on at 0.0% (0.0 Hz), set point 20.0%"
    sim.wait_for('"why":"watchdog expired"')
    # a run at the same end; `dpstack ctl` still finds the sim, which was there first
    run = start("run", str(plant), "--json")
    run.wait_for_slaves(3)
    for _ in range(100):  # in data exchange, and in Operate a moment later
        (status,) = (json.loads(line) for line in drive("fan", "status", "--json")[0])
        if status["status"]["state"] != "offline":
            break
    assert status["through"] == "run"
    # Er5: its watchdog ended the data exchange with the first master (docs/reference/drives/fuji.md#lost-communication)
    assert status["status"]["state"] == "fault"
    assert cli.out("ctl", port).startswith("sim on ")
    through_the_run(drive, plant, run, cli)
    assert run.end(signal.SIGTERM) == 0
    assert sim.end(signal.SIGTERM) == 0


@pytest.mark.usefixtures("virtual_time")
def test_all_is_read_and_there_is_no_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    config = plant_of(tmp_path)
    there = tmp_path / "disk" / "h.toml"
    there.parent.mkdir()

    def fsync(file: int) -> None:
        if os.fstat(file).st_size:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    out, err = cli("drive", str(config), "hoist", "dump", str(there), "--data-set", "3", code=2)
    assert out == ""
    assert err.startswith(SIMULATED)
    assert err.endswith(
        f"dpstack: {there}: cannot be written (No space left on device); make room there, or name a file elsewhere\n"
    )
    assert list(there.parent.iterdir()) == []


SEVERAL = """
[bus]
port = "virtual"
baud = 500000
[[slave]]
name = "cu320"
address = 5
ident = 0x80E5
drives = [{ name = "axis1", file = "profidrive" }, { name = "axis2", file = "profidrive", telegram = "2" }]
"""


@pytest.mark.usefixtures("fast")
def test_one_of_several_drives_by_its_name(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "several.toml"
    path.write_text(SEVERAL)
    out, _ = cli(
        "drive", str(path), "axis2", "speed", "0.5", "start", "reached", "status", "--seconds", "0.1", "--json"
    )
    answers = [json.loads(line) for line in out.splitlines()]
    told = [(one["order"], one["drive"], one["address"]) for one in answers if "order" in one]
    assert told == [(word, "axis2", 5) for word in ("speed", "start", "reached", "status")]
    assert {one["drive"] for one in answers} == {"axis2"}
    for name, text in (("cu320", "has several drives: name one of axis1, axis2"), ("axis3", "axis1 (5), axis2 (5)")):
        _, err = cli("drive", str(path), name, "start", code=2)
        assert text in err
