"""``slave.alarms()`` with both ends in one world: taken in order, acknowledged when taken, over with the bus."""

from __future__ import annotations

import asyncio
import dataclasses
import gc
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from api_kit import RAW, in_virtual_time, virtual
from support import WorldFactory

import dpstack
from dpstack import AlarmType, DpSlave, ModuleState, SlaveAlarm, SlaveDescription, Specifier, StatusType
from dpstack.api.bus.events_json import event_json, severity_of
from dpstack.api.server.server import ServedSlave
from dpstack.dpv1.master.orders import AlarmRaised, StatusTold
from dpstack.errors import AlarmError, SlaveFault, UsageError
from dpstack.sim.world import World
from dpstack.trace import Severity

ALL = ("pull_plug", "process", "diagnostic", "manufacturer", "status", "update")
TYPE_MODE = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=ALL)
RIG = dataclasses.replace(TYPE_MODE, alarm_sequence=8)
PROCESS = AlarmType.PROCESS
Program = Callable[[dpstack.Bus, ServedSlave], Coroutine[Any, Any, None]]


def rig(world: World, program: Program, description: SlaveDescription = RIG, **keys: object) -> list[dpstack.Event]:
    """``program`` with a bus and the slave at address 9; all events."""
    told: list[dpstack.Event] = []
    device = DpSlave(description, lambda outputs, elapsed: outputs)
    table = description.table(9)
    table["dpv1"] = {"alarms": list(ALL), "alarm_mode": 3 if description.alarm_sequence else 0, **keys}

    async def main() -> None:
        async with (
            dpstack.serve_slave(device, world=world, address=9) as server,
            dpstack.open_bus(world=world, baud=500_000, slaves=[table], on_event=told.append) as bus,
        ):
            await bus.ready()
            await program(bus, server.slave)

    virtual(main())
    return told


async def first_of(alarms: Any, count: int) -> list[SlaveAlarm]:
    return [await anext(alarms) for _ in range(count)]


@pytest.mark.parametrize("description", [RIG, TYPE_MODE])
def test_in_order_and_acknowledged_when_taken(world: WorldFactory, description: SlaveDescription) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        alarms = bus.slave("rig").alarms()
        raising = [asyncio.create_task(slave.alarm(PROCESS, slot, data=bytes((slot,)))) for slot in range(20)]
        await asyncio.sleep(2)
        assert not any(task.done() for task in raising)  # nobody has taken one
        found = []
        async for alarm in alarms:
            found.append(alarm)
            if len(found) == 20:
                break
        assert [(alarm.type, alarm.slot, alarm.data) for alarm in found] == [(2, n, bytes((n,))) for n in range(20)]
        await asyncio.gather(*raising)
        await asyncio.sleep(0.1)
        counts = bus.slave("rig").alarm_counts
        assert counts is not None
        assert (counts.raised, counts.acknowledged, counts.too_many, counts.repeated) == (20, 20, 0, 0)
        assert bus.stats.slaves[9].as_dict()["alarms"] == dataclasses.asdict(counts)

    told = rig(world(), program, description)
    assert len([event for event in told if isinstance(event, AlarmRaised)]) == 20


def test_what_it_says(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        alarms = bus.slave("rig").alarms()
        raising = asyncio.create_task(slave.alarm(AlarmType.DIAGNOSIS, 3, Specifier.APPEARS, b"\x11", add_ack=True))
        alarm = await anext(alarms)
        assert (alarm.appears, alarm.disappears, alarm.slot_good, alarm.user_ack) == (True, False, False, True)
        assert (alarm.title, alarm.address, alarm.name, alarm.sequence) == ("diagnosis alarm", 9, "rig", 0)
        assert alarm.text.startswith("slave 9 (rig): diagnosis alarm, slot 3, appears, slot disturbed, data 11, wants")
        assert alarm.diagnosis.ext.startswith(b"\x05\x01\x03\x05\x11")
        assert repr(alarm) == f"<SlaveAlarm {alarm.text}>"
        await raising
        others = {2: (False, True, True), 3: (False, True, False), 0: (False, False, None)}
        for specifier, expected in others.items():
            raising = asyncio.create_task(slave.alarm(AlarmType.DIAGNOSIS, 3, Specifier(specifier)))
            alarm = await anext(alarms)
            assert (alarm.appears, alarm.disappears, alarm.slot_good) == expected
            await raising

    told = rig(world(), program)
    raised = [event for event in told if isinstance(event, AlarmRaised)]
    assert [severity_of(event) for event in raised[:2]] == [Severity.WARNING, Severity.INFO]
    line = event_json(raised[0], 1.0)
    assert line is not None
    assert line | {"text": ""} == {
        "event": "alarm", "t": 1.0, "address": 9, "name": "rig", "type": 1, "title": "diagnosis alarm", "slot": 3,
        "specifier": "appears", "data": "11", "sequence": 0, "user_ack": True, "texts": [], "text": "",
    }  # fmt: skip


def test_nobody_listens_and_no_slave_waits(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        await asyncio.gather(*(slave.alarm(PROCESS, slot) for slot in range(10)))

    told = rig(world(), program)
    raised = [event for event in told if isinstance(event, AlarmRaised)]
    assert [event.alarm.slot for event in raised] == [*range(10)]
    assert not any(event.held for event in raised)


@pytest.mark.parametrize("how", ["break", "close", "cancel"])
def test_who_leaves_holds_nobody_up(world: WorldFactory, how: str) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        raising = [asyncio.create_task(slave.alarm(PROCESS, slot)) for slot in range(5)]
        if how == "break":
            async for alarm in bus.slave(9).alarms():
                assert alarm.slot == 0
                break
        elif how == "close":
            stream = bus.slave(9).alarms()
            assert (await anext(stream)).slot == 0
            stream.close()
            stream.close()
            with pytest.raises(StopAsyncIteration):
                await first_of(stream, 9)
        else:

            async def reads() -> None:
                async for _ in bus.slave(9).alarms():
                    await asyncio.sleep(60)

            task = asyncio.create_task(reads())
            await asyncio.sleep(0.1)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            del task
        gc.collect()
        await asyncio.gather(*raising)

    rig(world(), program)


def test_the_program_acknowledges(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        alarms = bus.slave(9).alarms(acknowledge=False)
        raising = [asyncio.create_task(slave.alarm(PROCESS, slot)) for slot in range(3)]
        first, second, third = await first_of(alarms, 3)
        await asyncio.sleep(1)
        assert not any(task.done() for task in raising)
        await third.acknowledge()
        await third.acknowledge()
        await raising[2]
        assert not raising[0].done()
        await asyncio.gather(first.acknowledge(), second.acknowledge(), *raising)

    rig(world(), program)


def test_two_listeners_and_both_have_it(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        one, other = bus.slave(9).alarms(), bus.slave(9).alarms()
        raising = asyncio.create_task(slave.alarm(PROCESS, 7))
        assert (await anext(one)).slot == 7
        await asyncio.sleep(1)
        assert not raising.done()
        assert (await anext(other)).slot == 7
        await raising
        del one  # the other one goes on
        gc.collect()
        raising = asyncio.create_task(slave.alarm(PROCESS, 8))
        await asyncio.sleep(1)
        assert not raising.done()
        await anext(other)
        await raising

    rig(world(), program)


def test_a_slave_that_goes_and_comes_back(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        found = bus.slave(9)
        alarms = found.alarms(acknowledge=False)
        raising = asyncio.create_task(slave.alarm(PROCESS, 1))
        lost = await anext(alarms)
        waiting = asyncio.create_task(slave.alarm(PROCESS, 2))
        await asyncio.sleep(0.1)
        await found.deactivate()
        with pytest.raises(AlarmError):
            await raising
        with pytest.raises(AlarmError):
            await waiting
        await found.activate()
        await found.ready()
        with pytest.raises(SlaveFault, match=r"slave 9 \(rig\) left data exchange: its alarms are void"):
            await lost.acknowledge()
        assert (await anext(alarms)).slot == 2  # what was delivered stays delivered
        raising = asyncio.create_task(slave.alarm(PROCESS, 3))
        alarm = await anext(alarms)
        assert alarm.slot == 3
        await alarm.acknowledge()
        await raising
        await found.reparameterise(watchdog_ms=500)
        raising = asyncio.create_task(slave.alarm(PROCESS, 4))
        await (await anext(alarms)).acknowledge()
        await raising

    rig(world(), program)


def test_it_ends_with_the_bus_and_with_the_slave(world: WorldFactory) -> None:
    kept: list[Any] = []

    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        found = bus.slave(9)
        alarms, statuses = found.alarms(), found.status_messages()
        raising = asyncio.create_task(slave.alarm(PROCESS, 1))
        await asyncio.sleep(0.2)
        await bus.remove(found)
        assert [alarm.slot async for alarm in alarms] == [1]  # what came can still be taken
        assert [status async for status in statuses] == []
        with pytest.raises(AlarmError):
            await raising
        added = await bus.add_slave(RIG.table(9))
        await added.ready()
        kept.extend((added.alarms(acknowledge=False), added.status_messages()))
        raising = asyncio.create_task(slave.alarm(PROCESS, 2))
        kept.append(await anext(kept[0]))
        kept.append(asyncio.create_task(kept[2].acknowledge()))
        raising.cancel()
        await asyncio.sleep(0)

    rig(world(), program)

    async def after() -> None:
        assert [alarm async for alarm in kept[0]] == []
        assert [status async for status in kept[1]] == []

    virtual(after())


def test_an_alarm_of_a_slave_that_was_removed_is_not_one_of_the_slave_added_after_it(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        old_stream = bus.slave(9).alarms(acknowledge=False)
        raising = asyncio.create_task(slave.alarm(PROCESS, 1))
        old = await anext(old_stream)
        await bus.remove(bus.slave(9))
        with pytest.raises(AlarmError):
            await raising
        added = await bus.add_slave(RIG.table(9))
        await added.ready()
        alarms = added.alarms(acknowledge=False)
        raising = asyncio.create_task(slave.alarm(PROCESS, 2))
        new = await anext(alarms)
        for _ in range(2):
            with pytest.raises(SlaveFault, match="left data exchange: its alarms are void"):
                await old.acknowledge()
        await asyncio.sleep(1)
        assert not raising.done()
        await new.acknowledge()
        await raising

    rig(world(), program)


@pytest.mark.parametrize("listens", [True, False])
def test_dpv1_off_and_on_again(world: WorldFactory, listens: bool) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        found = bus.slave(9)
        alarms = found.alarms()
        await asyncio.gather(slave.alarm(PROCESS, 1), anext(alarms))
        await found.reparameterise(dpv1=False)
        await found.ready()
        if not listens:
            alarms.close()
        await found.reparameterise(dpv1={"alarms": list(ALL)})
        await found.ready()
        raising = asyncio.create_task(slave.alarm(PROCESS, 2))
        if listens:
            assert (await anext(alarms)).slot == 2
        await raising
        await asyncio.sleep(0.1)
        assert found.alarm_counts is not None
        assert found.alarm_counts.raised == 2

    rig(world(), program)


def test_statuses(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        statuses = bus.slave(9).status_messages()
        slave.status(StatusType.MESSAGE, 3, Specifier.APPEARS, b"\x01")
        status = await anext(statuses)
        assert (status.type, status.slot, status.data) == (1, 3, b"\x01")
        slave.module_status([ModuleState.OK, ModuleState.MISSING])
        assert (await anext(statuses)).modules[:2] == (ModuleState.OK, ModuleState.MISSING)
        for number in range(70):
            slave.status(40, 1, data=bytes((number,)))
            await asyncio.sleep(0.02)
        assert (await anext(statuses)).data == b"\x06"
        assert statuses.dropped == 6
        assert bus.slave(9).diagnosis_texts[-1].startswith("vendor status 40, slot 1")

    told = rig(world(), program)
    line = event_json(next(event for event in told if isinstance(event, StatusTold)), 0)
    assert line is not None
    assert (line["event"], line["title"], line["data"]) == ("status_message", "status message", "01")


@in_virtual_time
async def test_misuse(world: WorldFactory) -> None:
    bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=[RAW])
    with pytest.raises(UsageError, match="the bus is not open"):
        bus.slave(9).alarms()
    async with bus:
        with pytest.raises(UsageError, match=r"slave 9 \(raw\) is not parameterised for DP-V1"):
            bus.slave(9).alarms()
        with pytest.raises(UsageError, match=r"slave 9 \(raw\) is not parameterised for DP-V1: no status messages"):
            bus.slave(9).status_messages()
        assert bus.slave(9).alarm_counts is None


def test_misuse_beside_one_who_listens(world: WorldFactory) -> None:
    async def program(bus: dpstack.Bus, slave: ServedSlave) -> None:
        found = bus.slave("rig")
        listening = found.alarms()
        await found.reparameterise(dpv1=False)
        with pytest.raises(UsageError, match="not parameterised for DP-V1"):
            found.alarms()
        await bus.close()
        with pytest.raises(UsageError, match="the bus is not open"):
            found.alarms()
        listening.close()

    rig(world(), program)
