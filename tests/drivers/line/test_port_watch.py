"""Lost slaves make the driver look at its port, in a thread, and report what another program did; doubts of a port."""

from __future__ import annotations

import threading
from typing import Any

import pytest
from far_ends import until

from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.drivers.runtime import PortDisturbed
from dpstack.machine import InDoubt
from dpstack.units import NEVER
from tests.drivers.driver_rig import Rig, driver_on

pytestmark = pytest.mark.usefixtures("each_driver")


def lost(state: SlaveState = SlaveState.OFFLINE) -> SlaveStateChanged:
    return SlaveStateChanged(t_ns=1, address=3, name="hoist", state=state)


async def happens(rig: Any, event: SlaveStateChanged) -> None:
    rig.machine.events.append(event)
    rig.driver.command(NEVER)
    await rig.settle()


async def test_a_lost_slave_makes_the_driver_look_at_its_port_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    async with Rig() as rig:
        looked: list[threading.Thread] = []

        def inspect() -> list[str]:
            looked.append(threading.current_thread())
            return ["gpsd (pid 41) has it open, too"]

        monkeypatch.setattr(rig.port, "inspection", lambda: inspect)
        await happens(rig, lost(SlaveState.DATA_EXCHANGE))
        assert looked == []
        await happens(rig, lost())
        await until(lambda: bool(rig.events_of(PortDisturbed)), "the report")
        (event,) = rig.events_of(PortDisturbed)
        assert event.text == f"{rig.port.name}: gpsd (pid 41) has it open, too"
        assert looked[0] is not threading.main_thread()
        await happens(rig, lost())
        await until(lambda: len(looked) == 2, "the second look")
        await rig.settle()
        assert len(rig.events_of(PortDisturbed)) == 1  # the same, within a minute


async def test_slaves_lost_during_a_look_are_looked_at_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async with Rig() as rig:
        go_on = threading.Event()
        looks: list[None] = []

        def inspect() -> list[str]:
            looks.append(None)
            go_on.wait(10)
            return []

        monkeypatch.setattr(rig.port, "inspection", lambda: inspect)
        await happens(rig, lost())
        await until(lambda: len(looks) == 1, "the first look")
        await happens(rig, lost())
        await happens(rig, lost())
        assert len(looks) == 1
        go_on.set()
        await until(lambda: len(looks) == 2, "the second look")
        await rig.settle()
        assert len(looks) == 2
        assert rig.events_of(PortDisturbed) == []


async def test_doubts_of_a_port_reach_a_master() -> None:
    rig = Rig()
    rig.machine.held_up = lambda _gap, _now: False
    rig.driver = driver_on(rig.port, rig.machine, rig.on_events)
    async with rig:
        assert rig.port.on_doubt is not None
        rig.port.on_doubt(5)
        await until(lambda: InDoubt(5) in rig.machine.commands, "the command")
    other = Rig()
    assert other.port.on_doubt is None  # no master: its machine knows no such command
