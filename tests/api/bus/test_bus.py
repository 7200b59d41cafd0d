"""The public API in virtual time: bring-up, process data, drives, errors, and every kind of end."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import FAN, HOIST, RAW, begun, bus_of, operating, slave_in, stack_of
from slave_kit import make_slave

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.devices.finding import find
from dpstack.dp.master.events import DriveEvent, ModeChanged, SlaveFaulted, SlaveStateChanged
from dpstack.dp.plan.rotation_time import Case
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.events import RingJoined
from dpstack.fdl.interface import Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import Notice

pytestmark = pytest.mark.virtual_time

# --- bring-up and process data --------------------------------------------------------------------------------------


async def test_a_raw_slave_mirrors() -> None:
    async with bus_of(RAW) as bus:
        assert bus.mode is dpstack.Mode.CLEAR
        slave = bus.slave("raw")
        await slave.ready()
        assert slave.state is dpstack.SlaveState.DATA_EXCHANGE
        assert slave.inputs == b"\x00"
        slave.outputs = b"\x5a"
        await asyncio.sleep(0.02)
        assert slave.inputs == b"\x00"  # in Clear outputs are zero
        await bus.operate()
        await asyncio.sleep(0.02)
        assert slave.inputs == b"\x5a"
        assert slave.inputs_valid
        await bus.clear()
        await asyncio.sleep(0.02)
        assert slave.inputs == b"\x00"
        assert slave.diagnosis is not None
        assert slave.watchdog_ms == 200
        assert (slave.retries, slave.timeouts, slave.fault) == (0, 0, None)


async def test_stop_lets_the_watchdog_expire_and_operate_takes_up_again() -> None:
    async with operating(RAW) as bus:
        await bus.stop()
        before = bus.slave(9).exchanges
        await asyncio.sleep(1)
        assert bus.slave(9).exchanges <= before + 1
        await bus.operate()
        await bus.slave(9).wait_state(dpstack.SlaveState.OFFLINE, dpstack.SlaveState.DIAGNOSIS, timeout=2)
        await bus.ready(5)


def test_the_same_program_in_an_ordinary_loop() -> None:
    async def program() -> int:
        async with operating(RAW) as bus:
            await bus.rotated(20)
            return bus.stats.rotations

    assert asyncio.run(program()) >= 20


async def test_waiting_for_what_does_not_come() -> None:
    world = World()
    async with bus_of(RAW, world=world) as bus:  # an existing world: nobody is simulated
        with pytest.raises(dpstack.SlaveTimeout, match=r"slave 9 \(raw\): not in data exchange after 1 s: no answer"):
            await bus.slave("raw").ready(1)
        with pytest.raises(TimeoutError):
            await bus.slave("raw").wait_state(dpstack.SlaveState.DATA_EXCHANGE, timeout=0.1)


async def test_refusals_are_typed(w: World) -> None:
    slave_in(w, MirrorDevice(0x4321, bytes.fromhex("20 10")), 9)
    slave_in(w, MirrorDevice(0x1234, bytes.fromhex("21 11")), 10)
    slave_in(w, MirrorDevice(0x1234, bytes.fromhex("20 10")), 11)
    tables = [RAW, RAW | {"name": "other", "address": 10}, RAW | {"name": "good", "address": 11}]
    async with bus_of(*tables, world=w) as bus:
        with pytest.raises(dpstack.SlaveFault, match="another device: ident 0x4321 instead of 0x1234"):
            await bus.slave("raw").ready(2)
        with pytest.raises(dpstack.SlaveFault, match=r"refuses the configuration .* it has 21 11: octet 1 differs"):
            await bus.slave("other").ready(2)
        await bus.slave("good").ready(2)  # the others go on
        await bus.operate()
        with pytest.raises(dpstack.SlaveFault):
            await bus.ready(2)


async def test_a_slave_that_dies_in_the_middle(w: World) -> None:
    station, _ = slave_in(w, MirrorDevice(0x1234, bytes.fromhex("20 10")), 9)
    async with bus_of(RAW, world=w) as bus:
        await bus.ready()
        w.remove(station)
        await bus.slave(9).wait_state(dpstack.SlaveState.OFFLINE, timeout=1)
        fault = bus.slave(9).fault
        assert fault is not None
        assert "stopped answering during Data_Exchange" in fault.text
        assert not bus.slave(9).inputs_valid
        slave_in(w, MirrorDevice(0x1234, bytes.fromhex("20 10")), 9)
        await bus.ready(3)


class LyingApp(SlaveApp):
    """Accepts the configuration and answers Data_Exchange with one octet too many."""

    __slots__ = ()

    def serve(self, request: Telegram, now: int) -> Reply | None:
        reply = super().serve(request, now)
        if reply is not None and request.dsap is None and reply.data:
            return reply._replace(data=reply.data + b"\x00")
        return reply


async def test_wrong_length(w: World) -> None:
    app = LyingApp(MirrorDevice(0x1234, bytes.fromhex("20 10")))
    w.add(PassiveStation(9, app, BusParams.preset(500_000)))
    slave_in(w, MirrorDevice(0x1234, bytes.fromhex("20 10")), 11)
    async with bus_of(RAW, RAW | {"name": "good", "address": 11}, world=w) as bus:
        await bus.slave(9).wait_state(dpstack.SlaveState.FAULT, timeout=3)
        with pytest.raises(
            dpstack.SlaveFault,
            match="with 2 octets instead of 1: Chk_Cfg was 20 10; its real",
        ):
            await bus.slave(9).ready(0.1)
        await bus.slave("good").ready(1)


async def test_owned_by_another_master(w: World) -> None:
    _, app = slave_in(w, MirrorDevice(0x1234, bytes.fromhex("20 10")), 9)
    first = bus_of(RAW, address=1, world=w)
    async with first:
        await first.ready()
        async with bus_of(RAW, world=w) as second:
            joined = next(e for e in core_of(second)._events._history if isinstance(e, RingJoined))
            assert 1 in joined.masters
            with pytest.raises(dpstack.SlaveFault, match="is owned by master 1; it is never taken away"):
                await second.slave(9).ready(5)
            assert app.master == 1
            await first.ready(1)


# --- drives ---------------------------------------------------------------------------------------------------------


async def test_both_drives_through_their_runs() -> None:
    async with bus_of(HOIST, FAN) as bus:
        await bus.operate()
        hoist, fan = bus.drive("hoist"), bus.drive(4)
        assert await hoist.read(412) == 44
        await hoist.write(412, 1)
        await hoist.write(434, 2)
        hoist.speed = 0.5
        fan.frequency = -30
        assert fan.speed == -0.5
        assert fan.frequency == -30
        await asyncio.gather(hoist.start(), fan.start())
        await asyncio.gather(hoist.reached(), fan.reached(tolerance=0.01))
        assert hoist.status.running
        assert hoist.status.speed == pytest.approx(0.5, abs=0.01)
        assert fan.status.speed == pytest.approx(-0.5, abs=0.01)
        await hoist.quick_stop()
        await fan.coast()
        assert not hoist.status.running


async def test_drive_errors_are_typed() -> None:
    async with bus_of(HOIST, FAN) as bus:
        hoist, fan = bus.drive("hoist"), bus.drive("fan")
        await bus.ready()
        with pytest.raises(dpstack.DriveTimeout, match=r"drive hoist: start: the bus is in Clear.*operate\(\)"):
            await hoist.start(0.5)
        await bus.operate()
        with pytest.raises(dpstack.DpError, match="412"):
            await hoist.start(2)
        with pytest.raises(dpstack.UsageError, match="drive fan: PPO3 of fuji-frenic has no parameter channel"):
            await fan.read(1)
        with pytest.raises(dpstack.ParameterError, match="drive hoist") as caught:
            await hoist.read(999)
        assert caught.value.number == 0
        with pytest.raises(dpstack.UsageError, match=r"drive fan: speed 3 is outside -1\.\."):
            fan.speed = 3
        with pytest.raises(dpstack.UsageError, match="timeout"):
            await fan.start(-1)
        with pytest.raises(dpstack.UsageError, match=r"no drive 'x' on this bus; there are: hoist, fan"):
            bus.drive("x")
        with pytest.raises(dpstack.UsageError, match="its drive plugin makes the outputs"):
            bus.slave("fan").outputs = bytes(4)


async def test_an_order_to_a_drive_that_is_not_there(w: World) -> None:
    async with bus_of(FAN, world=w) as bus:
        await bus.operate()
        with pytest.raises(dpstack.DriveTimeout, match=r"slave 4 is not in data exchange: no answer from address 4"):
            await bus.drive("fan").start(1)


async def test_a_drive_that_vanishes_fails_what_is_pending(w: World) -> None:
    fan = find("fuji-frenic").simulated("PPO3", {}, {})
    station = make_slave(4, fan, BusParams.preset(500_000))
    w.add(station)
    async with bus_of(FAN, world=w) as bus:
        await bus.operate()
        drive = bus.drive("fan")
        drive.speed = 1.0
        await drive.start()
        waiting = await begun(drive.reached(), 0.05)
        w.remove(station)
        with pytest.raises(dpstack.DriveError, match="left data exchange"):
            await waiting
        assert drive.status.state == "offline"


async def test_statuses_the_latest_wins() -> None:
    async with bus_of(FAN) as bus:
        await bus.operate()
        fan = bus.drive("fan")
        await fan.start()
        fan.speed = 1.0
        seen = []
        async for status in fan.statuses():
            seen.append(status.speed or 0.0)
            await asyncio.sleep(0.1)  # a slow reader
            if status.reached and status.speed is not None and status.speed > 0.99:
                break
        assert 5 < len(seen) < 30
        assert seen == sorted(seen)
        assert stack_of(bus).master.on_round is None or fan._readers


async def test_a_plugin_that_raises_stops_its_drive_only(monkeypatch: pytest.MonkeyPatch) -> None:
    async with bus_of(FAN, RAW) as bus:
        await bus.operate()
        fan = bus.drive("fan")
        await fan.start()

        def broken(inputs: bytes, now: int) -> bytes:
            raise ZeroDivisionError("a defect")

        fan.speed = 1.0
        monkeypatch.setattr(fan._core, "cyclic", broken)
        waiting = asyncio.ensure_future(fan.reached())
        with pytest.raises(dpstack.DriveError, match="plugin failed"):
            await waiting
        assert bus.slave("fan").outputs == bytes.fromhex("047E0000")
        before = bus.slave("raw").exchanges
        await asyncio.sleep(0.1)
        assert bus.slave("raw").exchanges > before


# --- slaves come and go ---------------------------------------------------------------------------------------------


async def test_findings_of_the_plan_about_an_added_slave_are_told() -> None:
    """As at the start: notes of its table, its watchdog, its place in the round. What was told then is not repeated."""
    told: list[str] = []

    def tell(event: dpstack.Event) -> None:
        if isinstance(event, Notice) and event.source == "plan":
            told.append(event.text)

    async with bus_of(RAW | {"watchdog_ms": 0}, on_event=tell) as bus:
        assert len(told) == 1
        await bus.add_slave({"name": "far", "address": 20, "ident": 0x4321, "config": "20", "watchdog_ms": 0})
        await bus.add_slave(FAN | {"watchdog_ms": 10})
    assert told[0].startswith("plan: slave 9 (raw): its watchdog is off")
    far, ident, config, short = told[1:]
    assert ident.startswith("plan: slave 4 (fan): the ident number ")
    assert config.startswith("plan: slave 4 (fan): the identifier octets ")
    assert short.startswith("plan: slave 4 (fan): its watchdog of 10 ms is shorter than the longest rotation can take")
    assert far.startswith("plan: slave 20 (far): its watchdog is off")


async def test_add_and_remove() -> None:
    async with bus_of(RAW) as bus:
        await bus.operate()
        added = await bus.add_slave(FAN)
        await added.ready()
        await bus.drive("fan").start()
        with pytest.raises(dpstack.ConfigError, match="both have address 9"):
            await bus.add_slave(RAW | {"name": "again"})
        with pytest.raises(dpstack.ConfigError, match="there is a slave called 'raw' already"):
            await bus.add_slave(RAW | {"address": 10})
        await bus.remove("raw")
        with pytest.raises(dpstack.UsageError, match=r"no slave 'raw' on this bus; there are: fan \(4\)"):
            bus.slave("raw")
        await bus.remove(added)
        assert bus.slaves == ()
        assert bus.drives == ()
        await asyncio.sleep(0.1)


# --- events ---------------------------------------------------------------------------------------------------------


async def test_events_from_the_start_on() -> None:
    seen: list[dpstack.Event] = []
    async with bus_of(RAW, on_event=seen.append) as bus:
        await bus.ready()
        stream = bus.events()
        await bus.operate()
    told = [event async for event in stream]
    assert told == seen
    assert stream.dropped == 0
    states = [e.state.value for e in told if isinstance(e, SlaveStateChanged)]
    assert states[:4] == ["set_prm", "chk_cfg", "wait_ready", "data_exchange"]
    assert any(isinstance(e, ModeChanged) for e in told)
    assert [e async for e in bus.events()] == told  # after the end there is the history


async def test_a_reader_that_does_not_read_loses_the_oldest() -> None:
    async with bus_of(RAW) as bus:
        stream = bus.events()
        for n in range(2000):
            core_of(bus)._events.publish(Notice(t_ns=n, source="test", message=str(n)))
        assert stream.dropped >= 1000
        stream.close()
        rest = [event async for event in stream]
        assert len(rest) == 1000
        assert rest[-1].text == "test: 1999"


# --- the plan is what happens ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("baud", [9600, 45_450, 500_000, 1_500_000, 12_000_000])
@pytest.mark.parametrize("count", [1, 3, 20])
async def test_the_shortest_rotation_is_the_plans(baud: int, count: int) -> None:
    """No more than one bit time a telegram between the plan and the wire."""
    kinds = ["20 10", "F3 71", "20", "10", "71"]
    tables: list[dict[str, object]] = [
        {"name": f"s{n}", "address": n, "ident": 1, "config": kinds[n % len(kinds)]} for n in range(3, 3 + count)
    ]

    async with dpstack.open_bus(port="virtual", baud=baud, slaves=tables, gap=0) as bus:
        await bus.operate()
        await bus.ready(60)
        master = stack_of(bus).master
        master.rotation = Histogram()  # without the rounds of the bring-up
        await bus.rotated(30)
        planned = bus.plan.rotation_ns(Case.SHORTEST)
        telegrams = 2 * count + 1
        assert abs(master.rotation.min_ns - planned) <= bus.params.ns(telegrams)
        assert master.rotation.quantile_ns(0.5) == pytest.approx(planned, rel=0.005)
        assert bus.stats.bad == {}


def test_types_of_the_event_module_are_told() -> None:
    assert issubclass(DriveEvent, dpstack.Event)
    assert issubclass(SlaveFaulted, dpstack.Event)
    assert SlaveAppState.DATA_EXCH
