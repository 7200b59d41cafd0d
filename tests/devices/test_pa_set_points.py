"""Set points of PROFIBUS PA: value and status are one output, good only while a value stands and the bus operates."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from api_kit import in_virtual_time, slave_in
from far_ends import eventually
from process_kit import octet_slaves
from support import WorldFactory

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.connectors.outside import OutsideOrders
from dpstack.devices.finding import find_device
from dpstack.devices.pa.core import PaCore
from dpstack.devices.pa.device import PaDevice
from dpstack.dp.master.commands import Mode
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import UsageError
from dpstack.plant.orders import SetOutputs
from dpstack.plant.quality import Quality
from dpstack.sim.world import World

#: KH 8384-4 EN, page 12: version 5
CONFIG = "C7 84 89 08 05 08 05 05 05 0A"
VALVE: dict[str, Any] = {"name": "pos", "address": 6, "device": "samson-3730-4", "watchdog_ms": 200}
FLOW: dict[str, Any] = {"name": "flow", "address": 7, "device": "promag-55-pa"}
#: 50 % by IEEE 754, with the status good
HALF = "42 48 00 00 80"
ZEROS = "00 00 00 00 00"


def core(device: str, telegram: str | None = None) -> PaCore:
    made = find_device(device).core("pos", telegram)
    assert isinstance(made, PaCore)
    return made


def ordered(of: PaCore, values: dict[str, float | None]) -> str:
    """The octets of the next exchange, or the text of the refusal."""
    words = [{"name": name, "value": value} for name, value in values.items()]
    of.command("set", {"values": words}, 1, 0)
    (event,) = of.take_events()
    return of.cyclic(b"", 10).hex(" ").upper() if event["ok"] else str(event["text"])


def test_octets_of_set_points() -> None:
    pos = core("samson-3730-4", "SP+RCAS_IN+READBACK+RCAS_OUT+POS_D+CHECKBACK")
    assert pos.cyclic(b"", 1).hex(" ") == f"{ZEROS} {ZEROS}"
    assert ordered(pos, {"valve": 50}) == f"{HALF} {ZEROS}"
    assert ordered(pos, {"valve_rcas_in": 20}) == f"{HALF} 41 A0 00 00 80"
    assert ordered(pos, {"valve": None}) == f"{ZEROS} 41 A0 00 00 80"
    assert ordered(pos, {"valve": 0}) == "00 00 00 00 80 41 A0 00 00 80"
    pos.lost(20)
    assert pos.cyclic(b"", 30).hex(" ") == f"{ZEROS} {ZEROS}"


def test_totaliser_control_has_no_status() -> None:
    """Promag 55, page 111: byte 1 SETTOT, byte 2 MODETOT; CONTROL_BLOCK of one octet, page 103."""
    flow = core("promag-55-pa", "AI, SETTOT_MODETOT_TOTAL, free, free, free, free, CONTROL_BLOCK")
    assert ordered(flow, {"total1_mode": 3, "total1_set": 1}) == "01 03 00"
    assert ordered(flow, {"control": 60}) == "01 03 3C"
    assert ordered(flow, {"total1_set": 0}) == "00 03 3C"


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"valv": 1}, "'valv' is no output of samson-3730-4; it has valve"),
        ({"valve": 1e39}, "set: values 1: value must be a number up to 1e+15"),
        ({"valve": 20, "readback": 1}, "'readback' is no output of samson-3730-4; it has valve"),
    ],
)
def test_a_set_point_that_cannot_be_changes_none(values: dict[str, float | None], said: str) -> None:
    pos = core("samson-3730-4")
    assert ordered(pos, values) == said
    assert pos.cyclic(b"", 20).hex(" ") == ZEROS


def test_whole_numbers_only() -> None:
    flow = core("promag-55-pa")
    assert ordered(flow, {"total1_set": 1.5}) == "total1_set = 1.5 is no whole number"
    assert ordered(flow, {"total1_set": 256}) == "total1_set = 256 does not fit into 1 octets"


class Actuator:
    """A bus with a positioner that keeps the outputs that it gets, and the referee beside it."""

    def __init__(self, world: World) -> None:
        self.heard: list[str] = []
        description = SlaveDescription(ident=0x071D, configs=(bytes.fromhex(CONFIG),))
        self.station, self.app = slave_in(world, DpSlave(description, self._exchange), 6)
        self.bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=[VALVE], world=world)

    def _exchange(self, outputs: bytes, elapsed: int) -> bytes:
        if not self.heard or self.heard[-1] != outputs.hex(" "):
            self.heard.append(outputs.hex(" "))
        return bytes(10)

    async def half_open(self) -> dpstack.Slave:
        await self.bus.operate()
        await self.bus.ready()
        slave = self.bus.slave("pos")
        await asyncio.sleep(0.1)
        slave["valve"] = 50
        await asyncio.sleep(0.1)
        assert self.heard == [ZEROS, HALF]
        return slave


async def to_clear(bus: dpstack.Bus, slave: dpstack.Slave) -> None:
    await bus.clear()
    await bus.wait_state(Mode.CLEAR)
    assert slave.outputs_sent.hex(" ") == ZEROS
    await bus.operate()


async def away_and_back(bus: dpstack.Bus, slave: dpstack.Slave) -> None:
    await slave.deactivate()
    await asyncio.sleep(0.1)
    await slave.activate()
    await slave.ready()


async def released(bus: dpstack.Bus, slave: dpstack.Slave) -> None:
    assert await slave.order("release", name="valve") == ["valve"]


async def taken_back(bus: dpstack.Bus, slave: dpstack.Slave) -> None:
    slave["valve"] = None


async def connector_lost(bus: dpstack.Bus, slave: dpstack.Slave) -> None:
    """What a connector has ordered ends with the connector."""
    outside = OutsideOrders(bus, lambda *_: None)
    await outside.carry_out("mqtt", SetOutputs(6, {"valve": 50.0}))
    await outside.lose(["mqtt"])


async def plugin_fails(bus: dpstack.Bus, slave: dpstack.Slave) -> None:
    plugin = core_of(bus).parts.plugins[6][0]

    def fails(inputs: bytes, now: int) -> bytes:
        raise ZeroDivisionError

    plugin.cyclic = fails  # type: ignore[union-attr,method-assign]


WAYS: tuple[Callable[[dpstack.Bus, dpstack.Slave], Awaitable[None]], ...] = (
    to_clear, away_and_back, released, taken_back, connector_lost, plugin_fails
)  # fmt: skip


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.__name__)
@in_virtual_time
async def test_bad_status_on_every_way_out(
    way: Callable[[dpstack.Bus, dpstack.Slave], Awaitable[None]], world: WorldFactory
) -> None:
    actuator = Actuator(world())
    async with actuator.bus as bus:
        slave = await actuator.half_open()
        await way(bus, slave)
        await asyncio.sleep(0.3)
        assert actuator.heard == [ZEROS, HALF, ZEROS]
        assert slave.outputs.hex(" ") == ZEROS
        if way is not plugin_fails:
            slave["valve"] = 50
            await asyncio.sleep(0.1)
            assert actuator.heard[-1] == HALF


@in_virtual_time
async def test_bad_status_when_the_bus_is_closed_and_by_an_exception(world: WorldFactory) -> None:
    actuator = Actuator(world())

    async def program() -> None:
        async with actuator.bus:
            await actuator.half_open()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await program()
    assert actuator.heard == [ZEROS, HALF, ZEROS]
    assert actuator.app.outputs.hex(" ") == ZEROS


APPLICATION = """
import asyncio, sys
sys.path.insert(0, {kits!r})
from process_kit import bus_on
async def main():
    valve = {{"name": "pos", "address": 6, "device": "samson-3730-4", "options": {{"units": False}}}}
    async with bus_on({path!r}, "process", valve) as bus:
        await bus.ready(60)
        await bus.operate()
        while True:  # a busy machine may lose the slave, which takes the value back
            bus.slave("pos")["valve"] = 50
            await asyncio.sleep(0.2)
asyncio.run(main())
"""


def test_the_bus_process_makes_the_status_bad_when_its_program_is_killed() -> None:
    with octet_slaves(f"6:071d:{CONFIG.replace(' ', '').lower()}:10:5") as (path, there):
        kits = str(Path(__file__).parents[1] / "kits")
        with subprocess.Popen([sys.executable, "-c", APPLICATION.format(kits=kits, path=path)]) as program:
            eventually(lambda: there.slaves[6].outputs.hex(" ") == HALF, "the set point")
            os.kill(program.pid, signal.SIGKILL)
            program.wait()
            eventually(lambda: there.slaves[6].outputs.hex(" ") == ZEROS, "zeros")
            eventually(lambda: there.slaves[6].control == b"\x02\x00", "Clear")


# --- the simulated device ----------------------------------------------------------------------------------------


def process_device(bus: dpstack.Bus, address: int) -> PaDevice:
    bench = core_of(bus).bench
    assert bench is not None
    found = bench.units[address].process_device
    assert found is not None
    return found


@in_virtual_time
async def test_the_simulated_positioner_follows_and_shows_why_it_does_not() -> None:
    slaves = [{**VALVE, "simulated": {"stroke_s": 0}}]
    async with dpstack.open_bus(port="virtual", baud=93_750, slaves=slaves) as bus:
        await bus.operate()
        await bus.ready()
        pos = bus.slave("pos")
        await asyncio.sleep(0.3)
        assert pos["valve_checkback_fail_safe"] is True
        assert pos.value("valve_pos_d").text == "closed"
        pos["valve"] = 100
        await asyncio.sleep(0.3)
        assert (pos["valve_readback"], pos["valve_checkback_fail_safe"]) == (100.0, False)
        assert pos.value("valve_pos_d").text == "open"
        device = process_device(bus, 6)
        assert device.model.block("AO1").get("sp") == {"value": 100.0, "status": 0x80}
        device.local_operation(True)
        device.put("valve_readback", 100.0, 0xA4)
        await asyncio.sleep(0.3)
        assert pos["valve_checkback_local"] is True
        found = pos.value("valve_readback")
        assert (found.quality, found.text) == (Quality.GOOD, "maintenance required (status A4)")
        device.put("valve_readback", 0.0, 0x1C)
        await asyncio.sleep(0.3)
        assert pos.quality("valve_readback") is Quality.BAD
        with pytest.raises(ValueError, match="'x' is no value of this device"):
            device.put("x", 1)


@in_virtual_time
async def test_values_are_set_by_name_as_ctl_does() -> None:
    async with dpstack.open_bus(port="virtual", baud=93_750, slaves=[FLOW]) as bus:
        await bus.operate()
        await bus.ready()
        bench = core_of(bus).bench
        assert bench is not None
        bench.set("flow", flow="12.5", total1=3)
        await asyncio.sleep(0.3)
        assert [bus.slave("flow").value(name).text for name in ("flow", "total1")] == ["", ""]
        assert (bus.slave("flow")["flow"], bus.slave("flow")["total1"]) == (12.5, 3.0)
        bench.power(7, on=False)
        await asyncio.sleep(0.3)
        bench.power(7, on=True)
        await bus.slave("flow").ready()
        await asyncio.sleep(0.3)
        assert bus.slave("flow")["flow"] == 12.5


@in_virtual_time
async def test_totalisers_count_and_are_reset_by_words() -> None:
    slaves = [{**FLOW, "simulated": {"flow": 7.5, "total1": 100}}]
    async with dpstack.open_bus(port="virtual", baud=93_750, slaves=slaves) as bus:
        await bus.operate()
        await bus.ready()
        flow, device = bus.slave("flow"), process_device(bus, 7)
        await asyncio.sleep(0.3)
        assert flow["flow"] == 7.5
        assert flow["total1"] == pytest.approx(100, abs=0.01)
        device.set_process(36_000)
        await asyncio.sleep(1)
        assert flow["total1"] == pytest.approx(110, abs=1)
        flow.update({"total1_set": "reset", "total1_mode": "hold"})
        await asyncio.sleep(0.3)
        assert (flow["total1"], flow["total1_set"], flow.outputs.hex()) == (0.0, 1, "0103")
        with pytest.raises(UsageError, match=r"total1_set is never 'rset': it is totalise \(0\), reset \(1\), preset"):
            flow["total1_set"] = "rset"
        await bus.clear()
        await asyncio.sleep(0.3)
        assert flow.outputs_sent.hex() == "0000"
