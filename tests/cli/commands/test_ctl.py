"""``dpstack ctl`` against programs as users start them, and the commands against what they act on."""

from __future__ import annotations

import asyncio
import json
import signal
from pathlib import Path
from typing import Any

import pytest
from api_kit import bench_of
from cli_kit import Cli
from far_ends import eventually, until
from programs import Starter, plant_of

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.control.client import connect
from dpstack.api.control.control_server import ControlServer
from dpstack.api.control.handlers import control_run
from dpstack.api.control.simulation_handlers import control_segment, control_sim
from dpstack.api.slave_side.simulation import Segment, Simulation
from dpstack.cli.main import main
from dpstack.errors import DpError, UsageError
from dpstack.profile import DriveDevice

Out = pytest.CaptureFixture[str]


def ctl(cli: Cli, *args: str, code: int = 0) -> str:
    out, err = cli("ctl", *args, code=code)
    return err if code else out


def test_three_programs_are_told_what_to_do(tmp_path: Path, start: Starter, cli: Cli) -> None:
    bus = tmp_path / "bus"
    segment = start.segment(bus)
    config = plant_of(tmp_path, bus / "1")
    sim = start("sim", str(config), "--port", str(bus / "0"))
    sim.wait_for("raw")
    run = start("run", str(config), "--json")
    run.wait_for_slaves(3)

    assert "trip SLAVE CODE" in ctl(cli, str(bus / "0"))
    assert ctl(cli, str(bus / "0"), "trip", "hoist", "F2100") == "ok\n"
    assert ctl(cli, str(bus / "1"), "outputs", "9=A5") == "ok\n"
    sim.wait_for("slave 3 (hoist): trip F2100 (dpstack ctl)\n")
    assert "injected trip F2100\n" in ctl(cli, str(bus / "0"), "status")
    run.wait_for('"hoist"', 1)
    status = json.loads(ctl(cli, str(bus / "1"), "status", "--json"))["result"]
    assert status["mode"] == "operate"
    assert status["slaves"]["9"]["outputs"] == "a5"
    ctl(cli, str(bus / "0"), "silence", "4")
    run.wait_for('"kind":"lost"', 1)
    ctl(cli, str(bus / "0"), "resume", "4")
    run.wait_for('"state":"data_exchange"', 4)
    ctl(cli, str(bus / "0"), "power-off", "9")
    run.wait_for('"kind":"lost"', 2)
    ctl(cli, str(bus / "0"), "power-on", "9")
    run.wait_for('"state":"data_exchange"', 5)
    ctl(cli, str(bus), "noise", "1e-4")
    segment.wait_for(" s  the segment: noise 1e-4 (dpstack ctl)\n")
    assert "error_rate: 0.0001" in ctl(cli, str(bus), "status")
    ctl(cli, str(bus), "noise", "0")
    assert "stations 0:" in ctl(cli, str(bus), "stats")

    assert "trip is a command of `dpstack sim`, this is a run" in ctl(cli, str(bus / "1"), "trip", "3", "1", code=2)
    assert "did you mean silence" in ctl(cli, str(bus / "0"), "silense", "3", code=2)
    assert "no slave '77' is simulated here; there are: hoist (3)" in ctl(
        cli, str(bus / "0"), "trip", "77", "1", code=2
    )
    error = ctl(cli, "/dev/ttyUSB77", "status", code=1)
    assert error.startswith("dpstack: nobody answers for /dev/ttyUSB77; there is: ")
    assert f"segment on {bus}" in error
    assert f"sim on {bus / '0'}" in error
    assert run.end(signal.SIGTERM) == 0
    assert "nobody answers" in ctl(cli, str(bus / "1"), "status", code=1)


async def ask(server: ControlServer, *order: str) -> Any:
    """Through the socket, as any client would."""

    def call() -> Any:
        with connect(server.port) as client:
            return client.call(*order)

    return await asyncio.to_thread(call)


async def test_a_run_in_the_virtual_world_has_its_slaves_commands(tmp_path: Path) -> None:
    path = plant_of(tmp_path)
    async with dpstack.open_bus(path) as bus, control_run(bus, "virtual") as server:
        await ask(server, "operate")
        await bus.ready()
        hoist = bus.drive("hoist")
        await ask(server, "trip", "3", "F2100")
        await until(lambda: bool(hoist.status.fault), "the fault")
        await ask(server, "warn", "4", "0080")
        await ask(server, "load", "fan", "0.6")
        fan = bench_of(bus).device(4)
        assert isinstance(fan, DriveDevice)
        assert fan.warning_mask == 0x0080
        assert fan.motor.load == 0.6
        await ask(server, "release", "fan", "off")
        assert fan.released is False
        with pytest.raises(UsageError, match="fuji-frenic has no jog terminals here"):
            await ask(server, "jog", "fan", "forward")

        await ask(server, "power-off", "raw")
        await until(lambda: not bus.slave("raw").ready_now, "its loss")
        status = await ask(server, "status")
        assert status["slaves"]["3"]["drive"]["faults"]
        assert status["masters"] == [2]
        assert (await ask(server, "stats"))["slaves"]["9"]["name"] == "raw"
        await ask(server, "clear")
        await until(lambda: bus.mode.name == "CLEAR", "Clear")


async def treat(path: Path) -> None:
    """Slaves in the virtual world, silenced and switched, in its time."""
    async with dpstack.open_bus(path) as bus:
        bench, lost = bench_of(bus), bus.slave("raw")
        await bus.ready()

        async def gone(timeout: float = 5.0) -> None:
            await bus.until(lambda: not lost.ready_now, timeout)

        bench.silence(9, 100_000_000)
        await gone()
        await lost.ready()
        bench.silence(9, None)
        bench.silence(9, 60_000_000_000)  # the later word counts
        await gone()
        bench.resume(9)
        bench.resume(9)
        await lost.ready()
        bench.silence(9, 200_000_000)
        bench.silence(9, None)
        await gone()
        with pytest.raises(dpstack.SlaveTimeout):
            await lost.ready(5)
        bench.power(9, False)
        bench.power(9, False)
        bench.silence(9, None)
        bench.resume(9)
        with pytest.raises(dpstack.SlaveTimeout):
            await lost.ready(5)
        bench.power(9, True)
        bench.power(9, True)
        await lost.ready()
        await bus.add_slave({"name": "late", "address": 11, "ident": 0x4321, "config": "20 10"})
        await bus.slave(11).ready()
        assert bench.names() == {3: "hoist", 4: "fan", 9: "raw", 11: "late"}


def test_simulated_slaves_are_silenced_and_switched(tmp_path: Path) -> None:
    path = plant_of(tmp_path)
    dpstack.run_virtual(treat(path))


@pytest.mark.parametrize(
    ("order", "says"),
    [
        (("trip", "3", "nonsense"), "is no fault number such as F"),
        (("trip", "9", "F2100"), "slave 9 (raw) is no simulated drive"),
        (("warn", "3", "12345"), "no word of four hex digits"),
        (("warn", "3", "xx"), "no word of four hex digits"),
        (("load", "3", "nan"), "'nan' is no number from -10 to 10"),
        (("load", "3", "much"), "'much' is no number"),
        (("release", "3", "yes"), "'yes' is neither on nor off"),
        (("jog", "3", "left"), "'left' is neither forward nor reverse nor off"),
        (("silence", "3", "soon"), "'soon' is no time; write it as 2s or 500ms"),
        (("silence", "3", "0s"), "'0s' is no time"),
        (("outputs", "9"), "'9' is not SLAVE=HEX"),
        (("outputs", "9=5"), "write it as 9=00FF"),
        (("outputs", "9=0102"), "slave 9 (raw): 2 octets of outputs given, the slave's configuration has 1"),
        (("outputs", "9=01", "3=00"), "slave 3 (hoist): its drive plugin makes the outputs"),
        (("outputs", "5=01"), "no slave '5' here"),
    ],
)
async def test_wrong_arguments_of_a_run(tmp_path: Path, order: tuple[str, ...], says: str) -> None:
    path = plant_of(tmp_path)
    async with dpstack.open_bus(path) as bus, control_run(bus, "virtual") as server:
        with pytest.raises(UsageError) as caught:
            await ask(server, *order)
        assert says in str(caught.value)
        assert bus.slave("raw").outputs == b"\x00"


async def test_a_simulation_and_its_segment(tmp_path: Path) -> None:
    path = plant_of(tmp_path, "/dev/elsewhere")
    config = dpstack.load_config(path)
    async with Segment(2, tmp_path / "bus") as segment, control_segment(segment) as wire:
        async with (
            Simulation(config, segment.paths[0], 500_000) as simulation,
            control_sim(simulation, segment.paths[0]) as server,
            # lost after twice 50 ms, so that a silence of a second is long enough on a busy computer, too
            dpstack.open_bus(config.with_bus(port=segment.paths[1], max_retry=1)) as bus,
        ):
            await bus.ready(60)
            await ask(server, "power-off", "9")
            await ask(server, "power-off", "9")
            await ask(server, "silence", "9")
            await ask(server, "resume", "9")
            assert (await ask(server, "status"))["slaves"]["9"]["state"] == "off"
            await until(lambda: not bus.slave(9).ready_now, "its loss")
            await ask(server, "power-on", "9")
            await until(lambda: bus.slave(9).ready_now, "its return")
            await ask(server, "silence", "3", "1s")
            await until(lambda: not bus.slave(3).ready_now, "its loss")
            await until(lambda: bus.slave(3).ready_now, "its return")
            before = segment.stats()
            await ask(wire, "silence", "0", "1s")
            await until(lambda: not bus.slave(3).ready_now, "its loss")
            await until(lambda: bus.slave(3).ready_now, "its return")
            assert before != segment.stats()
            await ask(wire, "silence", "0")
            await until(lambda: not bus.slave(3).ready_now, "its loss")
            await ask(wire, "resume", "0")
            await until(lambda: bus.slave(3).ready_now, "its return")
        for order, says in (
            (("noise", "1"), "leaves nothing"),
            (("noise", "-1"), "is no number from 0 to 1"),
            (("silence", "2"), "no station 2 on this segment; it has 0 to 1"),
            (("silence", "x"), "is no station of the segment"),
        ):
            with pytest.raises(DpError, match=says):
                await ask(wire, *order)


async def test_a_pty_is_found_by_its_path() -> None:
    config = make_config("pty", 500_000, 2, [{"address": 4, "drive": "fuji-frenic", "telegram": "PPO3"}])
    async with Simulation(config, "pty", 500_000) as simulation, control_sim(simulation, "pty") as server:
        assert server.port.startswith("/dev/pts/")
        assert (await ask(server, "help"))["kind"] == "sim"


def test_each_run_on_virtual_has_a_name_of_its_own(tmp_path: Path, start: Starter, capsys: Out, cli: Cli) -> None:
    """An order goes where configuration file and port agree. Each program has a bus "virtual" of its own: where no run
    has this file, the command goes on by itself."""
    mine, theirs = (plant_of(tmp_path).rename(tmp_path / name) for name in ("mine.toml", "theirs.toml"))
    first = start("run", str(theirs))
    first.wait_for("operate")
    one = f"virtual:{first.process.pid}"
    assert ctl(cli, "virtual").startswith(f"run on {one} (pid {first.process.pid})\nconfiguration: {theirs}\n")
    assert "mode: operate" in ctl(cli, "virtual", "status")
    for order in (("drive", str(mine), "fan", "status"), ("acyclic", str(mine), "9", "im"), ("why", str(mine), "9")):
        main(list(order))  # slave 9 has no I&M
        assert "its slaves are simulated for this command only" in capsys.readouterr().err
    assert "mode: operate" in ctl(cli, "virtual", "status")
    second = start("run", str(mine))
    second.wait_for("operate")
    two = f"virtual:{second.process.pid}"
    said = f'dpstack: there are other runs on "virtual" ({one}): this one answers `dpstack ctl {two}`\n'
    eventually(lambda: second.err == said, lambda: second.err)  # beside the bus, which does not wait for it
    assert ctl(cli, one, "outputs", "9=01") == "ok\n"
    link = tmp_path / "link.toml"
    link.symlink_to(mine)
    for path in (mine, link):  # the file counts, not what it is called
        assert cli.json("drive", str(path), "fan", "status")["through"] == "run"
    cli("drive", str(mine), "fan", "speed", "0.25")
    setpoints = {
        name: json.loads(ctl(cli, name, "status", "--json"))["result"]["slaves"]["4"]["drive"]["setpoint"]
        for name in (one, two)
    }
    assert setpoints == {one: 0.0, two: 0.25}
    error = ctl(cli, "virtual", "clear", code=2)
    assert error.startswith('dpstack: there are 2 runs on "virtual": ')
    assert f"run on {one} ({theirs})" in error
    assert f"run on {two} ({mine})" in error
    third = start("run", str(mine), "--seconds", "60")
    third.wait_for("operate")
    several = cli.err("drive", str(mine), "fan", "stop")
    assert several.startswith(f'dpstack: 2 runs on "virtual" have the configuration {mine}: ')
    assert two in several
    assert f"virtual:{third.process.pid}" in several
    for program in (third, second):
        assert program.end(signal.SIGTERM) == 0
    assert "mode: operate" in ctl(cli, "virtual", "status")
    first.process.kill()
    first.process.wait()
    assert "nobody answers for virtual" in ctl(cli, "virtual", "status", code=1)
