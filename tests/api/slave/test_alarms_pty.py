"""Alarms over a pty, with the bus in this process's loop and with the bus in a process of its own: the same."""

from __future__ import annotations

import asyncio

import pytest
from far_ends import until
from process_kit import DRIVERS, UNHURRIED, Driver, unhurried

import dpstack
from dpstack import AlarmType, Specifier, StatusType
from dpstack.dpv1.master.orders import AlarmRaised, StatusTold
from dpstack.slave import DpSlave, SlaveDescription

RIG = SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig", dpv1=True, alarms=("process", "diagnostic"))


@pytest.mark.parametrize("driver", DRIVERS)
async def test_alarms_over_a_pty(driver: Driver) -> None:
    told: list[dpstack.Event] = []
    device = DpSlave(RIG, lambda outputs, elapsed: outputs)
    async with (
        dpstack.slave.serve_slave(device, port="pty", baud=500_000, address=9) as server,
        dpstack.open_bus(
            port=server.port_name,
            baud=500_000,
            driver=driver,
            slaves=[unhurried(RIG.table(9))],
            on_event=told.append,
            **UNHURRIED,
        ) as bus,
    ):
        await bus.ready(20)
        found, slave = bus.slave(9), server.slave
        await slave.alarm(AlarmType.PROCESS, 1, timeout=20)  # nobody listens
        statuses = found.status_messages()
        stream = found.alarms(acknowledge=False)
        raising = [asyncio.create_task(slave.alarm(AlarmType.PROCESS, slot, timeout=20)) for slot in (2, 3)]
        first = await anext(stream)
        assert (first.slot, raising[0].done()) == (2, False)
        await first.acknowledge()
        await raising[0]
        second = await anext(stream)
        assert second.slot == 3
        stream.close()  # nobody listens any more
        await raising[1]
        slave.status(StatusType.MESSAGE, 4, Specifier.APPEARS, b"\x55")
        assert (await anext(statuses)).data == b"\x55"
        await until(lambda: found.alarm_counts is not None and found.alarm_counts.acknowledged == 3, "the last answer")
        counts = bus.stats.slaves[9].alarms
        assert counts is not None
        assert (counts.raised, counts.statuses, counts.too_many) == (3, 1, 0)
        assert found.ready_now
    raised = [event for event in told if isinstance(event, AlarmRaised)]
    assert [(event.alarm.slot, event.held) for event in raised] == [(1, False), (2, True), (3, True)]
    assert [event.status.slot for event in told if isinstance(event, StatusTold)] == [4]
