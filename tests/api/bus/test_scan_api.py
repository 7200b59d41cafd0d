"""The live list through the API: beside data exchange, beside other masters, on a read-only bus, as a configuration."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import FAN, HOIST, RAW, bus_of, operating, slave_in
from support import present

import dpstack
from dpstack.api.bus.bus import Bus
from dpstack.api.bus.events_json import event_json
from dpstack.api.commissioning.live_list import LiveListResult, config_skeleton, scan_port
from dpstack.api.config.config import make_config, parse_config
from dpstack.dp.master.scanner import Found, StationSeen
from dpstack.dp.pdu.diagnosis import SlaveView
from dpstack.dp.slave.application import SlaveAppState
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.telegram import StationType
from dpstack.sim.world import World
from dpstack.trace import Notice

pytestmark = pytest.mark.virtual_time


def brief(stations: tuple[Found, ...]) -> list[tuple[object, ...]]:
    return [(f.address, f.kind.name.lower(), f.ident, f.state and f.state.value, f.master) for f in stations]


async def scan(world: World, **how: Any) -> LiveListResult:
    def make_bus(address: int) -> Bus:
        config = make_config("virtual", 500_000, address, bus={"read_only": True})
        return Bus(config, world=world, watched=False)

    return await scan_port(make_bus, **how)


# --- a scan of its own ----------------------------------------------------------------------------------------------


async def test_a_silent_bus_is_asked_from_0() -> None:
    world = World()
    for address in (3, 125, 126):
        slave_in(world, MirrorDevice(0x1234, b"\x21"), address)
    result = await scan(world, configs=True)
    assert result.address == 0
    assert brief(result.stations) == [(a, "slave", 0x1234, "wait_prm", None) for a in (3, 125, 126)]
    assert {f.config for f in result.stations} == {b"\x21"}
    assert result.notes == ()
    present(world.referee).check()


async def test_a_slave_at_the_scanners_own_address_is_found_too() -> None:
    world = World()
    for address in (0, 1):
        slave_in(world, MirrorDevice(0x1234, b"\x21"), address)
    result = await scan(world)
    assert brief(result.stations) == [(a, "slave", 0x1234, "wait_prm", None) for a in (0, 1)]


async def test_beside_masters_one_of_them_at_0() -> None:
    async with operating(HOIST, RAW, address=0, gap=1) as bus:
        result = await scan(present(bus.world))
        assert result.address == 1
        assert brief(result.stations) == [
            (0, "master_in_ring", None, None, None),
            (3, "slave", 0x0696, "data_exchange", 0),
            (9, "slave", 0x1234, "data_exchange", 0),
        ]
        await asyncio.sleep(1)
        assert all(slave.ready_now and slave.timeouts == slave.retries == 0 for slave in bus.slaves)


async def test_an_address_given_and_in_use_is_refused() -> None:
    async with bus_of(RAW, gap=1) as bus:
        await bus.ready()
        assert bus.world is not None
        with pytest.raises(dpstack.BusError, match="another station on the bus sends as address 2"):
            await scan(bus.world, address=2)
        with pytest.raises(dpstack.BusError, match="another station on the bus sends as address 9"):
            await scan(bus.world, address=9)


# --- beside data exchange -------------------------------------------------------------------------------------------


async def test_an_address_that_no_station_can_have_is_refused_and_the_bus_goes_on() -> None:
    async with operating(RAW) as bus:
        for address in (127, 200, -1, 9_999_999_999_999):
            with pytest.raises(dpstack.UsageError, match=f"no station has the address {address}: the live list asks 0"):
                await bus.scan(addresses=[9, address])
        await bus.rotated(5)
        assert brief(await bus.scan(addresses=[9, 126])) == [(9, "slave", 0x1234, "data_exchange", 2)]


async def test_the_live_list_of_a_running_bus() -> None:
    async with operating(HOIST, RAW) as bus:
        _, app = slave_in(present(bus.world), MirrorDevice(0x4321, b"\x21"), 20)
        found = await bus.scan(configs=True)
        assert brief(found) == [
            (3, "slave", 0x0696, "data_exchange", 2),
            (9, "slave", 0x1234, "data_exchange", 2),
            (20, "slave", 0x4321, "wait_prm", None),
        ]
        assert [f.config for f in found] == [bytes.fromhex("f371"), bytes.fromhex("2010"), b"\x21"]
        assert app.state is SlaveAppState.WAIT_PRM
        assert all(slave.ready_now for slave in bus.slaves)
        assert brief(await bus.scan(addresses=[20, 21])) == [(20, "slave", 0x4321, "wait_prm", None)]
        stats = bus.stats
        assert (stats.timeouts, stats.retries, stats.late) == (0, 0, 0)
        assert set(stats.stations) >= {3, 9, 20}
        assert 21 not in stats.stations


# --- read-only ------------------------------------------------------------------------------------------------------


async def test_a_read_only_bus_shows_and_changes_nothing() -> None:
    async with operating(RAW, gap=1) as owner:
        world = present(owner.world)
        tables = [RAW, {**HOIST, "address": 30}, {**FAN, "ident": 0x1111}]
        slave_in(world, MirrorDevice(0x2222, b"\x21"), 4)
        told: list[dpstack.Event] = []
        config = make_config("virtual", 500_000, 5, tables, bus={"read_only": True})
        async with dpstack.open_bus(config, world=world, on_event=told.append) as bus:
            await asyncio.sleep(1)
            raw, hoist, fan = bus.slave("raw"), bus.slave("hoist"), bus.slave("fan")
            assert raw.state is dpstack.SlaveState.DATA_EXCHANGE
            assert raw.ready_now
            assert present(raw.found).master == 2
            assert present(raw.diagnosis).wd_on
            assert hoist.state is dpstack.SlaveState.OFFLINE
            assert fan.state is dpstack.SlaveState.FAULT  # another device: 0x2222
            assert raw.fault is None
            assert present(hoist.fault).text.startswith("no answer from address 30")
            assert "0x2222" in present(fan.fault).text
            assert bus.mode is dpstack.Mode.STOP
            for refused in (bus.operate, bus.clear, bus.drive("hoist").start):
                with pytest.raises(dpstack.UsageError, match="read-only"):
                    await refused()
            with pytest.raises(dpstack.UsageError, match="read-only"):
                raw.outputs = b"\x01"
            summary: Any = bus.stats.summary()
            assert summary["slaves"]["9"]["master"] == 2
            assert bus.stats.link.refused == 0
        heard = next(e for e in told if isinstance(e, Notice) and e.source == "bus")
        assert heard.message.startswith("listened first: ")
        assert heard.message.endswith(" telegrams, master 2; nobody has address 5")
        seen = [e for e in told if isinstance(e, StationSeen)]
        line = event_json(next(e for e in seen if e.found.address == 9), 0.5)
        assert line == {
            "event": "station",
            "t": 0.5,
            "address": 9,
            "type": "slave",
            "ident": "0x1234",
            "state": "data_exchange",
            "master": 2,
            "present": True,
            "text": "station 9: slave, ident 0x1234, data_exchange, master 2",
        }
        assert owner.slave("raw").ready_now
        assert owner.slave("raw").timeouts == 0


async def test_a_silent_bus_is_reported_as_silent() -> None:
    told: list[dpstack.Event] = []
    async with bus_of(RAW, on_event=told.append):
        pass
    texts = [e.text for e in told if isinstance(e, Notice) and e.source == "bus"]
    assert texts == ["bus: listened first: silence; nobody has address 2"]


# --- the configuration skeleton -------------------------------------------------------------------------------------


def found(address: int, ident: int | None, config: str | None, **more: Any) -> Found:
    octets = None if config is None else bytes.fromhex(config)
    state = more.pop("state", SlaveView.WAIT_PRM)
    return Found(address=address, kind=StationType.SLAVE, ident=ident, state=state, config=octets, **more)


def test_the_skeleton_is_a_configuration() -> None:
    master = Found(address=2, kind=StationType.MASTER_IN_RING)
    stations = (
        master,
        found(3, 0x0696, "f3 71", state=SlaveView.DATA_EXCHANGE, master=2),
        found(5, 0x0696, "20 10"),
        found(6, 0x1234, "20 10"),
        found(7, 0x1234, None),
        found(8, None, "20"),
        found(9, 0x1234, "C3 01"),
        found(10, 0x1234, ""),
        found(126, 0x1234, "20"),
    )
    text = config_skeleton(LiveListResult(baud=187_500, address=0, stations=stations), '/dev/"odd"\\name')
    config = parse_config(text, "skeleton")
    assert (config.port, config.baud, config.bus.address) == ('/dev/"odd"\\name', 187_500, 4)
    assert [(s.address, s.params.ident, s.params.config.hex(), s.telegram) for s in config.slaves] == [
        (3, 0x0696, "f371", "PPO1"),
        (5, 0x0696, "2010", None),
        (6, 0x1234, "2010", None),
    ]
    for line in (
        "# other masters on this bus: 2",
        "# in data exchange with master 2, which keeps it until it is stopped or gives it free",
        "# by its ident number Demag Dedrive Compact, CM-PDP-24, but with none of its telegrams",
        "# slave 7 did not give its configuration",
        "# slave 8 did not give its ident number",
        "# slave 9: its configuration cannot be read",
        "# slave 10: its configuration cannot be (0 input, 0 output octets)",
        "# station 126 is a slave as delivered: give it an address of its own first",
    ):
        assert line in text


def test_a_skeleton_of_nobody() -> None:
    config = parse_config(config_skeleton(LiveListResult(baud=500_000, address=0, stations=()), "/dev/ttyUSB0"))
    assert config.slaves == ()
    assert config.bus.address == 2


@pytest.mark.parametrize(
    ("ident", "octets", "drive", "telegram"),
    [(0x05EB, "B7 A1 97", "keb-f5", "PCH+2/8"), (0x0A6C, "62 51", "ls-s100", "VENDOR 3/2")],
)
def test_the_skeleton_names_drive_and_telegram(ident: int, octets: str, drive: str, telegram: str) -> None:
    result = LiveListResult(baud=500_000, address=2, stations=(found(5, ident, octets),))
    text = config_skeleton(result, "virtual")
    assert f'drive = "{drive}"' in text
    assert f'telegram = "{telegram}"' in text


async def test_a_scan_ends_with_an_answer_to_its_caller_and_not_with_an_event() -> None:
    told: list[str] = []
    async with operating(RAW, on_event=lambda event: told.append(event.text)) as bus:
        told.clear()
        assert brief(await bus.scan(addresses=(9,))) == [(9, "slave", 0x1234, "data_exchange", 2)]
    assert not [text for text in told if "live list" in text]
