"""``dpstack why``: beside the slave's own master, out of the ring, through a run; the lines of ``dpstack run``."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from api_kit import RAW, bench_of, in_virtual_time, operating
from bus_kit import add_station, setup
from cli_kit import Cli
from plant_files import plant_file
from slave_kit import make_slave

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.control.client import connect
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import WhyAnswer
from dpstack.cli.commands import on_bus
from dpstack.cli.terminal import causes
from dpstack.cli.terminal.causes import CauseLines, as_json
from dpstack.dp.master.events import SlaveFaulted, SlaveState
from dpstack.dp.master.fault_texts import absent
from dpstack.dp.master.master import Master
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import UsageError
from dpstack.params import BusParams

pytestmark = pytest.mark.usefixtures("alone")


class Field:
    """The slave at 8 in data exchange with another master, 2, whose gap factor is ``gap``."""

    def __init__(self, gap: int) -> None:
        self.world = dpstack.World(referee=False)
        params = BusParams.preset(500_000, address=2, gap=gap)
        self.slave = make_slave(8, MirrorDevice(0x1234, bytes.fromhex("20 10")), params)
        self.world.add(self.slave)
        self.owner = Master(params, [setup(8, name="rig", config=bytes.fromhex("20 10"))])
        self.station = add_station(self.world, params, self.owner)
        self.world.run_for(300_000_000)

    def bus(self, config: Any, *, on_event: Any = None, world: object = None) -> dpstack.Bus:
        assert world is None
        return dpstack.Bus(config, on_event=on_event, world=self.world, join_timeout=0.4)

    def is_undisturbed(self) -> bool:
        counted = self.station.stats.stations[8]
        return self.owner.handlers[8].state is SlaveState.DATA_EXCHANGE and counted.retries == counted.timeouts == 0


def field(monkeypatch: pytest.MonkeyPatch, gap: int = 1) -> Field:
    found = Field(gap)
    monkeypatch.setattr(on_bus, "Bus", found.bus)
    monkeypatch.setattr("asyncio.run", dpstack.run_virtual)
    return found


def plant(tmp_path: Path, master: int, *more: dict[str, object]) -> str:
    return str(plant_file(tmp_path, {**RAW, "name": "rig", "address": 8}, *more, port="/dev/ttyNone", address=master))


def test_beside_its_own_master(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    there = field(monkeypatch)
    story = cli.json("why", plant(tmp_path, 2), "rig", "--json")
    assert [*story] == ["slave", "address", "source", "state", "steps", "causes"]
    assert (story["slave"], story["address"], story["source"], story["state"]) == ("rig", 8, "class2", "data_exchange")
    assert [(step["asked"], step["answered"]) for step in story["steps"]] == [("Slave_Diag", "DL"), ("Get_Cfg", "DL")]
    assert story["steps"][0]["received"] == "000c00021234"
    assert story["steps"][1]["received"] == "2010"
    assert story["causes"][0]["cause"] == "healthy"
    assert {"cause", "confidence", "for", "against", "next"} <= story["causes"][0].keys()
    assert there.is_undisturbed()


def test_without_a_name_every_slave_is_asked(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    there = field(monkeypatch)
    first, *rest = cli.out("why", plant(tmp_path, 2, {**RAW, "name": "gone"}), code=1).splitlines()
    assert first == "slave 8 (rig): data_exchange, seen by a class 2 master beside it, healthy"
    assert rest[0] == "slave 9 (gone): offline, seen by a class 2 master beside it"
    assert "not_there" in " ".join(rest)
    assert there.is_undisturbed()
    assert cli.out("why", plant(tmp_path, 2)).count("\n") == 1


def test_beside_a_plc_that_is_the_master_of_a_read_only_configuration(
    tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No cause advises to stop the PLC."""
    there = field(monkeypatch)
    slave = {**RAW, "name": "rig", "address": 8}
    read_only = str(plant_file(tmp_path, slave, port="/dev/ttyNone", address=3, read_only=True))
    assert cli.out("why", read_only).splitlines()[0] == (
        "slave 8 (rig): data_exchange, seen by a class 2 master beside it, healthy"
    )
    assert there.is_undisturbed()


def test_a_slave_of_another_master_is_locked(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    there = field(monkeypatch)
    out = cli.out("why", plant(tmp_path, 1), "8", code=1)
    assert "1. locked (96 %)" in out
    assert "Master 2 is in the token ring." in out
    assert there.is_undisturbed()


def test_a_ring_that_lets_nobody_in_is_told(tmp_path: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    there = field(monkeypatch, gap=0)
    story = cli.json("why", plant(tmp_path, 1), "rig", "--json", code=1)
    assert story["causes"][0]["cause"] == "no_token"
    assert story["steps"] == []
    assert there.is_undisturbed()


@in_virtual_time
async def test_through_a_run() -> None:
    async with operating(RAW) as bus:
        bench_of(bus).power(9, False)
        await asyncio.sleep(0.4)
        with pytest.raises(UsageError, match="no slave 'x' here"):
            control_run(bus, "pty")._handlers["why"](["x"])
        items: list[object] = []

        async def send(item: object) -> None:
            items.append(item)

        command: Any = control_run(bus, "pty")._handlers["why"](["raw"])
        story = await command(send)
        assert story["source"] == "run"
        assert story["causes"][0]["cause"] == "not_there"
        assert {"state": "offline"} in items


@in_virtual_time
async def test_notices_of_a_run() -> None:
    told: list[str] = []
    async with operating(RAW, on_event=lambda event: told.append(event.text)) as bus:
        lines = CauseLines(bus)
        assert await lines.stories() == {}
        bench_of(bus).power(9, False)
        await asyncio.sleep(0.4)
        fault = SlaveFaulted(t_ns=core_of(bus).runtime.now(), address=9, name="raw", fault=absent(9, 500_000))
        told.clear()
        for _ in range(3):  # the same cause is told once
            lines.event(fault)
            await asyncio.sleep(0.1)
        (line,) = [text for text in told if text.startswith("why: ")]
        assert line.startswith("why: slave 9 (raw): likely not_there (")
        assert line.endswith("; dpstack why CONFIG raw")
        stories = await lines.stories()
        assert [*as_json(stories)["why"]] == ["9"]


def test_a_real_client_of_a_run() -> None:
    async def program() -> None:
        async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[RAW]) as bus:
            await bus.ready()
            async with control_run(bus, "COM3"):
                client = await asyncio.to_thread(connect, "COM3")
                with client:
                    story = await asyncio.to_thread(client.call, "why", "9", kind=WhyAnswer)
                assert story["causes"][0]["cause"] == "healthy"

    asyncio.run(program())


def test_the_command_in_a_line_names_the_file_as_one_types_it_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    here = Path.cwd()
    assert causes._typed(here / "line 3" / "plant.toml") == "line 3/plant.toml"
    assert causes._typed(here.parent / "plant.toml") == str(here.parent / "plant.toml")
