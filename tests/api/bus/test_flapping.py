"""A slave whose state flaps fills neither a terminal nor a log: a limited number of events a second reports it."""

from __future__ import annotations

import asyncio
from collections import Counter

import pytest
from api_kit import FAN, RAW, bus_of, off_and_on

import dpstack
from dpstack.api.bus.events_json import event_json
from dpstack.api.streams import SlaveFlapping
from dpstack.dp.master.events import DriveEvent, SlaveEvent, SlaveStateChanged
from dpstack.trace import Event
from dpstack.units import NS_PER_S

pytestmark = pytest.mark.virtual_time

FLAPS = 60


async def flap(bus: dpstack.Bus) -> None:
    """Slave 9 loses its power :data:`FLAPS` times, and comes back each time."""
    await bus.ready()
    for _ in range(FLAPS):
        await off_and_on(bus, 9)


def states_of(events: list[Event], address: int) -> list[dpstack.SlaveState]:
    return [event.state for event in events if isinstance(event, SlaveStateChanged) and event.address == address]


async def test_a_flapping_slave_has_at_most_ten_events_a_second_and_the_last_one_is_its_last_state() -> None:
    events: list[Event] = []
    async with bus_of(RAW, FAN, on_event=events.append, baud=93_750) as bus:
        begin = bus.seconds
        await flap(bus)
        seconds = bus.seconds - begin
        await asyncio.sleep(2)
        assert bus.slave(9).state is dpstack.SlaveState.DATA_EXCHANGE
    assert bus.slave(9).exchanges > 0
    of_slave = [event for event in events if isinstance(event, SlaveEvent) and event.address == 9]
    flapping = [event for event in of_slave if isinstance(event, SlaveFlapping)]
    assert flapping
    # without a bound: 4 to 8 changes for each time it comes back
    assert len(of_slave) + sum(event.count for event in flapping) - len(flapping) > 4 * FLAPS
    assert len(of_slave) <= 40 + 10 * (seconds + 2)
    by_second = Counter(event.t_ns // NS_PER_S for event in of_slave)
    assert sorted(by_second.values())[-3] <= 15  # the burst at the beginning aside
    assert states_of(events, 9)[-1] is dpstack.SlaveState.DATA_EXCHANGE
    line = event_json(flapping[0], 1.0)
    assert line is not None
    assert (line["event"], line["address"], line["name"]) == ("flapping", 9, "raw")


async def test_no_change_is_held_back_at_the_end_of_the_bus() -> None:
    events: list[Event] = []
    async with bus_of(RAW, on_event=events.append, baud=93_750) as bus:
        await flap(bus)
        last = bus.slave(9).state
    assert states_of(events, 9)[-1] is last


async def test_events_of_other_slaves_and_of_drives_are_not_limited() -> None:
    events: list[Event] = []
    async with bus_of(RAW, FAN, on_event=events.append, baud=93_750) as bus:
        await flap(bus)
        await off_and_on(bus, 4)
    assert states_of(events, 4).count(dpstack.SlaveState.DATA_EXCHANGE) == 2
    assert any(isinstance(event, DriveEvent) and event.address == 4 for event in events)
