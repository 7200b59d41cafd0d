"""Simulated slaves whose address changes: by a parameter, at power-on, by Set_Slave_Add; behind a port and on a
simulated line, for commands, for the master, and for a slave that is added at the new address."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from functools import wraps

import pytest
from api_kit import bench_of, operating
from octet_wire import Wire, framed
from support import present

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.simulation import Simulation
from dpstack.profile import DriveDevice

pytestmark = pytest.mark.virtual_time

ALONE = {"check_settings": False}
DRIVES: dict[str, dict[str, object]] = {
    "demag": {"drive": "demag-dedrive", "telegram": "PPO1"},
    "keb": {"drive": "keb-f5", "telegram": "PCH+4/4"},
    "imo": {"drive": "imo-hd2"},
    "ls": {"drive": "ls-s100", "telegram": "PPO1"},
    "fuji": {"drive": "fuji-frenic", "telegram": "PPO1", "simulated": {"switches": 0}},
}
PARAMETERS = {"demag": "node_id", "keb": "sy.06", "imo": "P15.01", "ls": "COM-07", "fuji": "o31"}
RAW: dict[str, object] = {"name": "raw", "address": 8, "ident": 0x1234, "config": "11 21"}
BAUD = 1_500_000
#: FDL_Status of master 2 to stations 4, 8 and 9, and the answers of slaves
STATUS = {4: "10 04 02 49 4F 16", 8: "10 08 02 49 53 16", 9: "10 09 02 49 54 16"}
ANSWER = {4: "10 02 04 00 06 16", 8: "10 02 08 00 0A 16", 9: "10 02 09 00 0B 16"}
SC = "E5"


class Port:
    """The machine of a port with simulated slaves, asked by a master in literal octets."""

    def __init__(self, *slaves: Mapping[str, object]) -> None:
        self.simulation = Simulation(make_config("pty", BAUD, 2, slaves, where="test", bus={}), "pty", BAUD)
        self.wire = Wire(self.simulation._line)  # type: ignore[arg-type]
        self.wire.now = self.simulation.now
        self._handlers = slave_handlers(self.simulation, self.simulation)

    def order(self, text: str) -> None:
        command, *args = text.split()
        self._handlers[command](args)

    def answering(self, order: str = "") -> list[int]:
        """The addresses that answer, after an ``order`` if there is one."""
        if order:
            self.order(order)
        return [address for address, octets in STATUS.items() if self.wire.ask(octets) == ANSWER[address]]

    def set_parameter(self, name: str, value: int) -> DriveDevice:
        device = present(self.simulation.units[4].drive)
        spec = present(device.store.table.named(name))
        device.store.write(spec, value)
        return device

    def states(self) -> dict[str, tuple[object, object]]:
        slaves = self.simulation.status()["slaves"]
        assert isinstance(slaves, dict)
        return {place: (entry["name"], entry["state"]) for place, entry in slaves.items()}


def in_a_loop(test: Callable[..., None]) -> Callable[..., None]:
    """A test that makes a port and does not open it."""

    @wraps(test)
    def run(*args: object, **kwargs: object) -> None:
        async def program() -> None:
            test(*args, **kwargs)

        asyncio.run(program())

    return run


def drive_table(drive: str) -> dict[str, object]:
    return {"name": "it", "address": 4, "options": ALONE, **DRIVES[drive]}


@pytest.mark.parametrize("drive", ["demag", "ls"])
@in_a_loop
def test_a_drive_behind_a_port_that_restarts_is_found_at_its_new_address(drive: str) -> None:
    port = Port(drive_table(drive), RAW)
    assert port.answering() == [4, 8]
    port.set_parameter(PARAMETERS[drive], 9).restart_soon()
    port.simulation._line.poke()
    port.wire.pass_time(200_000_000)
    assert port.answering() == [8, 9]
    assert port.states() == {"9": ("it", "wait_prm"), "8": ("raw", "wait_prm")}
    assert port.answering("silence 9") == [8]
    port.order("resume it")
    assert port.answering("power-off 4") == [8]  # the address of its configuration means it, too, as nobody else has it
    assert port.answering("power-on 9") == [8, 9]


@pytest.mark.parametrize("drive", list(DRIVES))
@in_a_loop
def test_a_drive_behind_a_port_is_found_at_its_new_address_after_power_on(drive: str) -> None:
    port = Port(drive_table(drive), RAW)
    port.set_parameter(PARAMETERS[drive], 9)
    assert port.answering() == [4, 8]
    assert port.answering("power-off 4") == [8]
    assert port.states()["4"] == ("it", "off")
    assert port.answering("power-on 4") == [8, 9]
    assert port.states() == {"9": ("it", "wait_prm"), "8": ("raw", "wait_prm")}
    port.order("power-off it")
    assert port.answering("power-on it") == [8, 9]


@in_a_loop
def test_two_slaves_that_come_to_have_one_address_are_both_reached_by_name() -> None:
    port = Port(drive_table("keb"), RAW)
    port.set_parameter("sy.06", 8)
    port.order("power-off it")
    assert port.answering("power-on it") == [8]
    assert port.states() == {"8": ("it", "wait_prm"), "8 (raw)": ("raw", "wait_prm")}
    assert port.answering("power-off raw") == [8]
    assert port.answering("silence it") == []
    assert port.answering("power-on raw") == []  # the one that is cut off was there first
    assert port.answering("power-off it") == [8]


@in_a_loop
def test_a_slave_at_the_former_address_of_another_one() -> None:
    second = {**drive_table("keb"), "name": "second", "address": 8}
    port = Port(drive_table("keb"), second)
    port.set_parameter("sy.06", 9)
    other = present(port.simulation.units[8].drive)
    other.store.install("sy.06", 4)
    for name in ("it", "second"):
        port.order(f"power-off {name}")
        port.order(f"power-on {name}")
    assert port.answering() == [4, 9]
    assert port.answering("power-off it") == [4]
    port.order("power-on it")
    assert port.answering("silence 4") == [9]
    assert port.states() == {"9": ("it", "wait_prm"), "4": ("second", "wait_prm")}
    assert port.answering("resume second") == [4, 9]


@pytest.mark.parametrize(
    ("table", "ident", "kept"), [(drive_table("demag"), "06 96", 9), ({**RAW, "address": 4}, "12 34", 4)]
)
@in_a_loop
def test_set_slave_add_behind_a_port(table: dict[str, object], ident: str, kept: int) -> None:
    """A drive stores the address, a mirror forgets it when it is switched off."""
    for which in ("4", "9", str(table["name"])):
        port = Port(table)
        assert port.wire.ask(framed(0x84, 0x82, 0x5D, f"37 3E 09 {ident} 00")) == SC
        assert port.answering() == [9]
        assert port.answering(f"silence {which}") == []
        assert port.answering(f"resume {which}") == [9]
        assert port.answering(f"power-off {which}") == []
        assert port.answering(f"power-on {table['name']}") == [kept]


#: a write of a program to a drive, and the remedy in its error when the drive no longer answers
MOVES: list[tuple[str, list[tuple[str | int, int]], str]] = [
    (
        "demag",
        [(391, 9)],
        "it is at address 9 now, because 391 (Profibus Node-ID) was set to 9 here: give it address = 9 in the "
        "configuration; it is taken up again as soon as it answers",
    ),
    (
        "ls",
        [("COM-07", 9), ("COM-94", 1)],
        "it is at address 9 now, because COM-07 (FBus ID) was set to 9 here: give it address = 9 in the "
        "configuration; it is taken up again as soon as it answers",
    ),
    (
        "keb",
        [("sy.06", 9)],
        "sy.06 (2006h) was set to 9 here, which takes effect when it is switched off and on: if that has happened "
        "it is at address 9 now, give it address = 9 in the configuration; otherwise check its power and the "
        "cable; it is taken up again as soon as it answers",
    ),
    ("imo", [("P15.01", 9)], "if that has happened it is at address 9 now, give it address = 9"),
    ("fuji", [("o31", 9)], "takes effect when it is switched off and on with its address switches at 00: if"),
]


@pytest.mark.parametrize(("drive", "writes", "says"), MOVES)
async def test_the_plugin_that_moved_a_drive_says_where_it_is(
    drive: str, writes: list[tuple[str | int, int]], says: str
) -> None:
    async with operating(drive_table(drive), baud=BAUD) as bus:
        for parameter, value in writes:
            await bus.drive("it").write(parameter, value)
        bench = bench_of(bus)
        if drive not in ("demag", "ls"):
            bench.power("it", False)
            await asyncio.sleep(0.05)
            bench.power("it", True)
        await bus.slave("it").wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
        fault = present(bus.slave("it").fault)
        assert says in fault.remedy
        await bus.remove("it")
        moved = await bus.add_slave({**drive_table(drive), "address": 9, "name": "moved"})
        await moved.ready(20)
        assert await bus.drive("moved").read(PARAMETERS[drive]) == 9  # it is the same drive, with its memory
        bench.silence("moved")
        await moved.wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
        assert bench.injected(9) == ["silence until resume"]
        bench.resume(9)
        await moved.ready(20)
        await bus.add_slave({**drive_table(drive), "name": "new"})  # beside the one that has moved
        await bus.slave("new").ready(20)
        assert moved.state is dpstack.SlaveState.DATA_EXCHANGE


@pytest.mark.strangers
@pytest.mark.parametrize(("drive", "writes", "says"), MOVES)
def test_a_master_finds_it_behind_a_pty(drive: str, writes: list[tuple[str | int, int]], says: str) -> None:
    async def program() -> None:
        table = drive_table(drive)
        simulation = Simulation(make_config("pty", BAUD, 2, [table], where="test", bus={}), "pty", BAUD)
        handlers = slave_handlers(simulation, simulation)
        async with simulation, dpstack.open_bus(port=simulation.port_name, baud=BAUD, address=2, slaves=[table]) as bus:
            await bus.operate()
            await bus.ready(20)
            for parameter, value in writes:
                await bus.drive("it").write(parameter, value, timeout=20)
            if drive not in ("demag", "ls"):
                handlers["power-off"](["it"])
                await bus.slave("it").wait_state(dpstack.SlaveState.OFFLINE, timeout=20)
                handlers["power-on"](["it"])
            await bus.slave("it").wait_state(dpstack.SlaveState.OFFLINE, timeout=20)
            fault = present(bus.slave("it").fault)
            assert says in fault.remedy
            found = await bus.scan()
            assert {station.address for station in found if station.ident is not None} == {9}

    asyncio.run(program())


async def test_a_drive_that_kept_its_address_is_looked_for_as_before() -> None:
    async with operating(drive_table("demag")) as bus:
        await bus.drive("it").write(391, 4)
        bench_of(bus).power("it", False)
        await bus.slave("it").wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
        fault = present(bus.slave("it").fault)
        assert fault.remedy.startswith("check its power and the cable; it is taken up")
