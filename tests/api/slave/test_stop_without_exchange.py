"""Orders that stop a drive whose slave is not in data exchange: refused at once, and carried out on its return.

The octets are those of the simulated line: 04 7E is OFF1 (stop, and no order), 04 7A quick stop, 04 7C coast.
"""

from __future__ import annotations

import asyncio

import pytest
from api_kit import FAN, RAW, begun

import dpstack
from dpstack.testing import BusFactory, SimulatedBus

_AT_ONCE_S = 0.01


async def running(bus: SimulatedBus) -> dpstack.Drive:
    fan = bus.master.drive("fan")
    fan.speed = 0.5
    await fan.start()
    await fan.reached()
    return fan


async def lost(bus: SimulatedBus) -> dpstack.Drive:
    """The drive runs, then its slave no longer answers."""
    fan = await running(bus)
    bus.faults.silence("fan")
    await fan.slave.wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
    return fan


async def refused(fan: dpstack.Drive, order: str) -> str:
    """The message of an order that is refused at once."""
    begin = asyncio.get_running_loop().time()
    with pytest.raises(dpstack.DriveError) as caught:
        await getattr(fan, order)()
    assert asyncio.get_running_loop().time() - begin < _AT_ONCE_S
    return str(caught.value)


async def first_word_after_return(bus: SimulatedBus) -> str:
    """The control word of the first outputs that the slave gets again."""
    since = bus.now
    bus.faults.clear()
    await bus.master.ready(3)
    await asyncio.sleep(0.05)
    return bus.wire.exchanges("fan", since)[0].outputs[:2].hex()


@pytest.fixture
def bus(dpstack_bus: BusFactory) -> SimulatedBus:
    return dpstack_bus(slaves=[{**FAN, "watchdog_ms": 500}])


@pytest.mark.parametrize(("order", "word"), [("stop", "047e"), ("quick_stop", "047a"), ("coast", "047c")])
def test_a_dead_slave_is_told_at_once_and_gets_the_order_when_it_is_back(
    bus: SimulatedBus, order: str, word: str
) -> None:
    async def program() -> None:
        fan = await lost(bus)
        text = await refused(fan, order)
        assert text.startswith(f"drive fan: {order}: slave 4 is not in data exchange: stopped answering during Data_E")
        assert "its watchdog makes its outputs safe 500 ms after the last telegram" in text
        assert text.endswith(f"When it is back, the first outputs order {order} again")
        assert await first_word_after_return(bus) == word
        await asyncio.sleep(2)
        assert bus.wire.exchanges("fan")[-1].outputs[:2].hex() == word
        assert fan.status.running is False
        assert fan.status.speed == 0

    bus.run(program())


def test_without_a_watchdog_the_message_says_that_the_motor_may_turn(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[{**FAN, "watchdog_ms": 0}])

    async def program() -> None:
        fan = await lost(bus)
        assert "its watchdog is off: it keeps its last outputs and may go on turning" in await refused(fan, "stop")
        assert bus.device("fan").drive.motor.speed > 0.4  # so it does
        assert await first_word_after_return(bus) == "047e"
        await fan.stop()
        assert bus.device("fan").drive.motor.speed < 0.01

    bus.run(program())


def test_a_stop_that_was_pending_ends_with_the_loss_and_stays(bus: SimulatedBus) -> None:
    async def program() -> None:
        fan = await running(bus)
        stopping = await begun(fan.quick_stop(), 0.01)
        assert fan.status.state == "stopping"
        bus.faults.silence("fan")
        with pytest.raises(dpstack.DriveError, match=r"left data exchange|not in data exchange"):
            await stopping
        assert await first_word_after_return(bus) == "047a"

    bus.run(program())


def test_a_stop_outlasts_clear(bus: SimulatedBus) -> None:
    async def program() -> None:
        fan = await lost(bus)
        await refused(fan, "quick_stop")
        await bus.master.clear()
        await bus.master.operate()
        assert await first_word_after_return(bus) == "047a"

    bus.run(program())


def test_a_stop_that_the_drive_had_confirmed_is_over(bus: SimulatedBus) -> None:
    async def program() -> None:
        fan = await running(bus)
        await fan.quick_stop()
        bus.faults.silence("fan")
        await fan.slave.wait_state(dpstack.SlaveState.OFFLINE, timeout=2)
        assert await first_word_after_return(bus) == "047e"

    bus.run(program())


def test_during_the_first_bring_up_a_stop_waits(dpstack_bus: BusFactory) -> None:
    """The slave has no fault then: it gets the order, and confirms it."""
    bus = dpstack_bus(slaves=[FAN], master="clear")

    async def program() -> None:
        await bus.master.operate()
        await bus.master.drive("fan").stop()
        assert bus.master.slave("fan").ready_now

    bus.run(program())


def test_a_slave_out_of_service_and_one_that_was_never_there(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[FAN])

    async def program() -> None:
        fan = await running(bus)
        await fan.slave.deactivate()
        assert "slave 4 is not in data exchange: it is in deactivated" in await refused(fan, "stop")
        bus.faults.silence("fan")
        await fan.slave.activate()
        with pytest.raises(dpstack.DriveError, match=r"no answer from address 4.*\. Now"):
            await fan.stop()
        assert bus.now < 10

    bus.run(program())


def test_a_master_that_went_to_clear_by_itself_says_so(dpstack_bus: BusFactory) -> None:
    bus = dpstack_bus(slaves=[FAN, RAW], auto_clear=True)

    async def program() -> None:
        fan = await running(bus)
        bus.faults.silence("raw")
        await bus.master.wait_state(dpstack.Mode.CLEAR, timeout=5)
        text = await refused(fan, "stop")
        assert "the bus went to Clear by itself" in text
        assert "Now the master sends it safe outputs" in text

    bus.run(program())
