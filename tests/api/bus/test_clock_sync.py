"""The class 3 master on a simulated bus: its telegrams on the wire, and a slave of one's own that follows them."""

from __future__ import annotations

import asyncio
import itertools

import msgspec
import pytest
from api_kit import begun, bus_of, stack_of

import dpstack
from dpstack.api.bus.events_json import event_json
from dpstack.api.control.record_orders import carry_out, parse_order
from dpstack.dp.acyclic.clock_master import VIRTUAL_EPOCH_NS, resolution_for
from dpstack.dp.pdu.clock import ClockValue, StampedEvent, TimeStampedAlarm
from dpstack.errors import ConfigError, RecordRefused, UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.telegram import Telegram
from dpstack.phy.patience import Lateness
from dpstack.plant.items import ClockValues, Remark
from dpstack.plant.state import LiveState
from dpstack.screen.overview import head
from dpstack.screen.view import View
from dpstack.slave import ClockLost, ClockSet, DpSlave, PlantClock, SlaveDescription
from dpstack.trace import Event, WireEntry
from dpstack.units import NS_PER_MS, NS_PER_S

pytestmark = pytest.mark.virtual_time

TANK = SlaveDescription(ident=0x1234, configs=(b"\x31",), name="tank", dpv1=True)
BLOCK = {"type": "time_ar", "clock_sync_interval": 200}
TABLE = {
    "address": 9,
    "name": "tank",
    "ident": 0x1234,
    "config": "31",
    "user_prm": "00 00 00",
    "dpv1": {"blocks": [BLOCK]},
}


def times_on(world: dpstack.World) -> list[tuple[WireEntry, Telegram]]:
    """The Time_Events and Clock_Values on the wire."""
    telegrams = [(entry, decode(entry.octets)) for entry in world.log]
    return [(entry, found) for entry, found in telegrams if found and found.fc & 0x40 and not found.function]


async def test_a_slave_follows_the_clock_of_its_master() -> None:
    events: list[Event] = []
    world = dpstack.World(keep=4_000)
    slave = DpSlave(TANK, lambda outputs, _elapsed: bytes(2))
    served = dpstack.slave.serve_slave(slave, world=world, address=9, baud=19_200, on_event=events.append)
    async with served as server:
        async with bus_of(TABLE, world=world, baud=19_200, clock_sync_s=1) as bus:
            await bus.operate()
            for _ in range(3):
                await asyncio.sleep(1)
                clock = server.slave.clock
                assert clock == PlantClock(VIRTUAL_EPOCH_NS + world.now, True, 2, 1, False, 0)
        await asyncio.sleep(4)
        assert not server.slave.clock.synchronised
    told = [type(event).__name__ for event in events if isinstance(event, ClockSet | ClockLost)]
    assert told == ["ClockSet", "ClockLost"]
    assert world.referee is not None
    world.referee.check()
    times = times_on(world)
    assert [telegram.is_clock_value for _, telegram in times] == [False, True] * (len(times) // 2)
    values = [ClockValue.parse(telegram.data) for _, telegram in times[1::2]]
    ends = [entry.end_ns for entry, _ in times[::2]]
    assert [value.time_ns - VIRTUAL_EPOCH_NS for value in values] == pytest.approx(ends, abs=1)
    assert [value.previous_ns for value in values[1:]] == [value.time_ns for value in values[:-1]]
    gaps = [after - before for before, after in itertools.pairwise(ends)]
    assert len(gaps) >= 2
    assert all(abs(gap - NS_PER_S) < 50 * NS_PER_MS for gap in gaps)


async def test_no_time_is_sent_without_the_key() -> None:
    world = dpstack.World(keep=4_000)
    slave = DpSlave(TANK, lambda outputs, _elapsed: bytes(2))
    async with dpstack.slave.serve_slave(slave, world=world, address=9), bus_of(TABLE, world=world) as bus:
        await bus.operate()
        await asyncio.sleep(0.1)
    assert not times_on(world)


@pytest.mark.parametrize(
    ("late_ns", "resolution"),
    [(0, 1), (NS_PER_MS, 1), (NS_PER_MS + 1, 10), (21 * NS_PER_MS, 100), (NS_PER_S, 1000), (5 * NS_PER_S, 1000)],
)
def test_the_resolution_holds_the_lateness_of_the_port(late_ns: int, resolution: int) -> None:
    assert resolution_for(Lateness(late_ns)) == resolution


@pytest.mark.parametrize("seconds", [0, 0.5, 3601, "1"])
def test_intervals_that_cannot_be(seconds: object) -> None:
    with pytest.raises(ConfigError, match="clock_sync_s"):
        bus_of(TABLE, clock_sync_s=seconds)


async def test_time_stamped_events_are_read_behind_their_alarm() -> None:
    # AUMA, table 39: end position OPEN became active at 13:02:56.5
    record = bytes.fromhex("01 00 02 01 00 00 E81B2C80 80000000")

    async def read(slot: int, index: int) -> bytes:
        if (slot, index) != (0, 100):
            raise RecordRefused(0xB0)
        return record

    description = SlaveDescription(
        ident=0x1234, configs=(b"\x31",), name="tank", dpv1=True, alarms=("process",), max_diag_len=40
    )
    slave = DpSlave(description, lambda outputs, _elapsed: bytes(2), on_read=read)
    table = TABLE | {"dpv1": {"alarms": ["process"]}}
    world = dpstack.World()
    stamps: list[StampedEvent] = []
    async with dpstack.slave.serve_slave(slave, world=world, address=9) as server, bus_of(table, world=world) as bus:
        await bus.operate()
        await bus.ready()
        alarm = TimeStampedAlarm(False, True, 100, 1)
        async with asyncio.timeout(5), asyncio.TaskGroup() as tasks:
            tasks.create_task(server.slave.alarm(2, 0, data=alarm.octets))
            async for event in bus.events():
                if isinstance(event, dpstack.events.AlarmRaised):
                    assert event.alarm.time_stamps == alarm
                    line = event_json(event, 0.0)
                    assert line is not None
                    assert line["time_stamps"] == {
                        "buffer_overrun": False,
                        "restarted": True,
                        "index": 100,
                        "events": 1,
                    }
                    break
        stamps += await bus.slave(9).read_time_stamps(100)
        answer = await carry_out(bus.slave(9), parse_order("stamps", ["100"]))
        assert [(one["time"], one["kind_text"]) for one in answer["events"]] == [("2023-05-26T13:02:56.500Z", "change")]
        with pytest.raises(UsageError, match="100 to 115"):
            await bus.slave(9).read_time_stamps(99)
    assert stamps == [StampedEvent(1, 0, 2, 1, 1_685_106_176_500_000_000)]


async def followed(bus: dpstack.Bus, seconds: float) -> LiveState:
    """The live stream of ``seconds``."""
    state = LiveState()

    async def read() -> None:
        async for item in bus.live(0.2):
            state.apply(item)

    task = await begun(read(), seconds)
    task.cancel()
    await asyncio.wait([task])
    return state


def clock_line(state: LiveState) -> str:
    """The line of the live screen about the time on the bus."""
    view = View()
    view.state = state
    lines = ["".join(text for text, _ in line).strip() for line in head(view, 160)]
    return next((line for line in lines if line.startswith("clock:")), "")


async def test_the_stream_has_the_time_on_the_bus_and_the_clocks_of_simulated_slaves() -> None:
    own = TABLE | {"dpv1": True}
    async with bus_of(own, clock_sync_s=1) as bus:
        await bus.operate()
        await bus.ready()
        await asyncio.sleep(1)
        state = await followed(bus, 1.5)
        clock = state.bus.clock
        assert isinstance(clock, ClockValues)
        assert (clock.interval_s, clock.late_ms, clock.late_measured, clock.masters) == (1, 0, False, [])
        assert clock.sent is not None
        assert (clock.sent.address, clock.sent.resolution_ms, clock.sent.synchronised) == (2, 1, True)
        assert clock.sent.time.startswith("2026-01-01T00:00:0")
        assert clock.remark == Remark("this master sends the time every 1 s, resolution 1 ms, synchronised", "info")
        slave = state.slaves["9"].clock
        assert slave is not None
        assert (slave.master, slave.synchronised, slave.text) == (2, True, "follows master 2, synchronised")
        assert clock_line(state) == f"clock: {clock.remark.text}"


async def test_two_clock_masters_are_shown_and_reported_by_both() -> None:
    world = dpstack.World(keep=100)
    told: list[str] = []
    first = bus_of(TABLE, world=world, clock_sync_s=1, t_tr=50_000, on_event=lambda event: told.append(event.text))
    async with first as bus:
        second = dpstack.open_bus(world=world, baud=500_000, address=5, clock_sync_s=2, t_tr=50_000)
        async with second as other:
            await asyncio.sleep(3)
            state = await followed(bus, 1)
            clock = state.bus.clock
            assert clock is not None
            assert [one.address for one in clock.masters or []] == [5]
            assert clock.remark is not None
            assert clock.remark.severity == "warning"
            assert "this master and master 5 send the time" in clock.remark.text
            assert clock_line(state).startswith("clock: this master and master 5")
            heard = stack_of(other).bus().clock
            assert heard is not None
            assert [one.master for one in heard.others] == [2]
            whole = stack_of(other).bus()  # as a bus process sends it
            assert msgspec.msgpack.decode(msgspec.msgpack.encode(whole), type=type(whole)) == whole
    assert len([text for text in told if text.startswith("clock: master 5 and this master send the time")]) == 1


async def test_a_bus_without_a_clock_says_nothing_about_it() -> None:
    async with bus_of(TABLE) as bus:
        state = await followed(bus, 0.5)
        assert state.bus.clock is None
        assert clock_line(state) == ""
