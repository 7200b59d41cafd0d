"""A slave whose state flaps fills neither a terminal nor a log: its changes are told in a bounded number a second."""

from __future__ import annotations

import asyncio
from collections import Counter

from api_kit import FAN, RAW, bus_of, off_and_on, virtual

import dpstack
from dpstack.api.bus.events_json import event_json
from dpstack.api.streams import SlaveFlapping
from dpstack.dp.master.events import DriveEvent, SlaveEvent, SlaveStateChanged
from dpstack.trace import Event
from dpstack.units import NS_PER_S

FLAPS = 60


def test_a_flapping_slave_is_told_of_ten_times_a_second_at_most_and_with_its_last_state() -> None:
    async def program() -> tuple[list[Event], int, float]:
        told: list[Event] = []
        async with bus_of(RAW, FAN, on_event=told.append) as bus:
            await bus.ready()
            begin = bus.seconds
            for _ in range(FLAPS):
                await off_and_on(bus, 9)
            seconds = bus.seconds - begin
            await asyncio.sleep(2)
            exchanging = bus.slave(9).state
            assert exchanging is dpstack.SlaveState.DATA_EXCHANGE
        return told, bus.slave(9).exchanges, seconds

    told, exchanges, seconds = virtual(program())
    assert exchanges > 0
    of_slave = [event for event in told if isinstance(event, SlaveEvent) and event.address == 9]
    flapping = [event for event in of_slave if isinstance(event, SlaveFlapping)]
    assert flapping
    # without a bound: 4 to 8 changes for each time it comes back
    assert len(of_slave) + sum(event.count for event in flapping) - len(flapping) > 4 * FLAPS
    assert len(of_slave) <= 40 + 10 * (seconds + 2)
    by_second = Counter(event.t_ns // NS_PER_S for event in of_slave)
    assert sorted(by_second.values())[-3] <= 15  # the burst at the beginning aside
    states = [event.state for event in of_slave if isinstance(event, SlaveStateChanged)]
    assert states[-1] is dpstack.SlaveState.DATA_EXCHANGE
    line = event_json(flapping[0], 1.0)
    assert line is not None
    assert (line["event"], line["address"], line["name"]) == ("flapping", 9, "raw")


def test_no_change_is_held_back_at_the_end_of_the_bus() -> None:
    async def program() -> tuple[list[Event], dpstack.SlaveState]:
        told: list[Event] = []
        async with bus_of(RAW, on_event=told.append) as bus:
            await bus.ready()
            for _ in range(FLAPS):
                await off_and_on(bus, 9)
            last = bus.slave(9).state
        return told, last

    told, last = virtual(program())
    assert [event.state for event in told if isinstance(event, SlaveStateChanged)][-1] is last


def test_other_slaves_and_events_of_drives_are_told_as_ever() -> None:
    async def program() -> list[Event]:
        told: list[Event] = []
        async with bus_of(RAW, FAN, on_event=told.append) as bus:
            await bus.ready()
            for _ in range(FLAPS):
                await off_and_on(bus, 9)
            await off_and_on(bus, 4)
        return told

    told = virtual(program())
    states = [event.state.value for event in told if isinstance(event, SlaveStateChanged) and event.address == 4]
    assert states.count("data_exchange") == 2
    assert any(isinstance(event, DriveEvent) and event.address == 4 for event in told)
