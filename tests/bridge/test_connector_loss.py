"""``on_connector_loss``: what connectors have ordered becomes safe, or stays, when they end by a fault or hang; none of
their orders acts afterwards."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from typing import Any, Literal

import probe_connector
import pytest
from api_kit import in_virtual_time, slave_in
from far_ends import eventually, until
from probe_connector import ProbeConnector
from process_kit import SPEC, VALVES, bus_on, octet_slaves
from support import WorldFactory

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import parse_config
from dpstack.api.connectors import publishing
from dpstack.api.connectors.outside import OutsideOrders
from dpstack.api.refused_orders import OrdersRefused
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import ApplicationSilent
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import BusError
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.plant.tree import Born
from dpstack.sim.world import World
from dpstack.trace import Notice

Rule = Literal["safe", "keep"]
#: safe values: lamp on, target 0 (raw), gain NaN, which no order can set
TANK: dict[str, object] = {
    "name": "tank",
    "address": 9,
    "ident": 0x1234,
    "config": "25 15",
    "safe": "02 00 7F C0 00 00",
    "outputs": {
        "pump": "bool@0.0",
        "lamp": "bool@0.1",
        "valve": "bool@0.2",
        "target": {"at": "u8@1", "scale": 0.5},
        "gain": "f32@2",
    },
}
PUMP: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO1"}
ALLOWED = {"allow_commands": ["tank.*"]}


@pytest.fixture(autouse=True)
def probe() -> Iterator[None]:
    probe_connector.register()
    yield
    probe_connector.forget()


def told(bus: dpstack.Bus) -> list[str]:
    events = core_of(bus).past_events()
    return [one.message for one in events if isinstance(one, Notice) and one.source == "connectors"]


class Tank:
    """A bus with a slave that keeps the outputs that it gets."""

    def __init__(self, world: World, rule: Rule = "safe", **more: Any) -> None:
        self.outputs = b""
        description = SlaveDescription(ident=0x1234, configs=(bytes.fromhex("25 15"),))
        slave_in(world, DpSlave(description, self._exchange), 9)
        self.bus = dpstack.open_bus(
            port="virtual", baud=500_000, slaves=[TANK], world=world, on_connector_loss=rule, **more
        )

    def _exchange(self, outputs: bytes, elapsed: int) -> bytes:
        self.outputs = outputs
        return outputs

    async def operate(self) -> None:
        await self.bus.operate()
        await self.bus.ready()
        self.bus.slave(9).outputs = bytes.fromhex("04 00 00 00 00 00")  # the valve, by the program
        await asyncio.sleep(0.5)


async def given(connector: ProbeConnector, name: str, value: object = None) -> str:
    return (await connector.orders.give(name, value, made_at=None)).reason


@pytest.mark.parametrize("rule", ["safe", "keep"])
@in_virtual_time
async def test_what_a_connector_ordered_becomes_safe_when_it_ends_by_a_fault(world: WorldFactory, rule: Rule) -> None:
    """Its outputs get the safe values of the slave, to the bit, and outputs of the program stay as they are."""
    tank = Tank(world(), rule)
    async with tank.bus as bus, dpstack.publish(bus, probe=ALLOWED):
        [connector] = ProbeConnector.made
        await tank.operate()
        for name, value in (("tank.pump", True), ("tank.target", 7.4), ("tank.gain", 1.5)):
            assert await given(connector, name, value) == ""
        await asyncio.sleep(0.1)
        ordered = bytes.fromhex("05 0F 3F C0 00 00")
        assert tank.outputs == ordered
        connector.breaks = True
        connector.spread([])
        assert await given(connector, "tank.pump", True) == "its connector has ended, or hung, since the order came"
        await asyncio.sleep(0.1)
        assert tank.outputs == (ordered if rule == "keep" else bytes.fromhex("04 00 7F C0 00 00"))
        assert bus.mode is Mode.OPERATE
    becomes = "becomes safe: outputs get their safe values, drives stop"
    becomes = "stays as it is" if rule == "keep" else becomes
    begin, *_, fault, loss = [text for text in told(bus) if not text.startswith("probe: born")]
    assert begin == (
        f"probe: when a connector ends by a fault or hangs, all that it has ordered {becomes} "
        f'(on_connector_loss = "{rule}")'
    )
    assert fault.startswith("probe: it has ended by a fault of its program (ZeroDivisionError: take)")
    assert [event.text for event in core_of(bus).past_events() if isinstance(event, OrdersRefused)] == [
        "orders: probe: order tank.pump refused: its connector has ended, or hung, since the order came"
    ]
    names = "tank.pump, tank.target, tank.gain"
    assert loss == {
        "safe": f"{names}: safe values are set and drives stop, as probe had ordered them "
        '(on_connector_loss = "safe")',
        "keep": f'{names}: stay as probe ordered them (on_connector_loss = "keep")',
    }[rule]  # fmt: skip


@in_virtual_time
async def test_only_what_is_still_as_the_lost_connector_ordered_it_becomes_safe(world: WorldFactory) -> None:
    tank, remarks = Tank(world()), list[str]()
    async with tank.bus as bus:
        await tank.operate()
        outside = OutsideOrders(bus, lambda text, _: remarks.append(text))
        await outside.carry_out("mqtt", SetOutputs(9, {"pump": True, "lamp": False, "target": 4.0}))
        await outside.carry_out("opcua", SetOutputs(9, {"target": 5.0}))
        with pytest.raises(dpstack.UsageError, match=r"target = 999.0 is outside"):
            await outside.carry_out("mqtt", SetOutputs(9, {"target": 999.0}))
        bus.slave(9)["pump"] = False  # by the program itself
        await outside.lose(["mqtt"])
        await asyncio.sleep(0.1)
        assert tank.outputs.hex(" ") == "06 0a 00 00 00 00"  # the lamp is on by its safe value
        assert remarks == [
            'tank.lamp: safe values are set and drives stop, as mqtt had ordered them (on_connector_loss = "safe")'
        ]
        await outside.lose(["mqtt"])
        assert outside.in_effect
        await outside.lose(["opcua", "mqtt"])
        await asyncio.sleep(0.1)
        assert tank.outputs.hex(" ") == "06 00 00 00 00 00"
        assert not outside.in_effect


@in_virtual_time
async def test_a_loss_in_clear_acts_before_the_next_operate(world: WorldFactory) -> None:
    tank = Tank(world())
    async with tank.bus as bus:
        await tank.operate()
        outside = OutsideOrders(bus, lambda *_: None)
        await outside.carry_out("mqtt", SetOutputs(9, {"pump": True}))
        await bus.clear()
        await bus.wait_state(Mode.CLEAR)
        with pytest.raises(BusError, match="the bus is in Clear"):
            await outside.carry_out("mqtt", SetOutputs(9, {"pump": False}))
        await outside.lose(["mqtt"])
        await bus.operate()
        await asyncio.sleep(0.1)
        assert tank.outputs.hex(" ") == "04 00 00 00 00 00"


@in_virtual_time
async def test_drives_that_were_moved_from_outside_stop() -> None:
    fan = {"name": "fan", "address": 7, "drive": "ls-s100", "telegram": "PPO1"}
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[PUMP, fan]) as bus:
        await bus.operate()
        await bus.ready()
        outside = OutsideOrders(bus, lambda *_: None)
        for drive in bus.drives:
            await drive.start()
            drive.speed = 0.2
        await outside.carry_out("mqtt", DriveOrder(6, "speed", 0.25))
        await outside.carry_out("mqtt", DriveOrder(7, "start"))
        await outside.carry_out("mqtt", DriveOrder(7, "stop"))
        await bus.drive("fan").start()  # by the program: its connector has stopped it
        await bus.drive("pump").reached()
        await outside.lose(["mqtt"])
        await asyncio.sleep(1)
        assert [bus.drive(name).status.running for name in ("pump", "fan")] == [False, True]


@in_virtual_time
async def test_the_connectors_hang(world: WorldFactory) -> None:
    """An order that came before, and has waited meanwhile, is refused whatever age it may have."""
    tank = Tank(world())
    async with tank.bus as bus, dpstack.publish(bus, probe=ALLOWED) as connectors:
        [connector] = ProbeConnector.made
        await tank.operate()
        assert await given(connector, "tank.pump", True) == ""
        gateway: Any = connectors._gateway
        step = gateway._step
        go_on = asyncio.Event()

        async def hang(items: object) -> None:
            await go_on.wait()
            await step(items)

        gateway._step = hang
        early = connector.orders.batch()
        await asyncio.sleep(publishing.HANG_S - 0.5)
        assert tank.outputs[0] == 5
        await asyncio.sleep(3)
        assert tank.outputs[0] == 4
        reason = "its connector has ended, or hung, since the order came"
        late = await connector.orders.give("tank.pump", True, made_at=None, batch=early)
        assert (late.result, late.reason) == ("refused", reason)
        go_on.set()
        await asyncio.sleep(1)
        assert await given(connector, "tank.pump", True) == ""  # it serves again
    [hung] = [text for text in told(bus) if "sign of life" in text]
    assert hung.startswith("the connectors gave no sign of life for ")
    assert "blocked" not in hung


@in_virtual_time
async def test_all_connectors_end_by_a_fault_of_the_gateway(world: WorldFactory) -> None:
    tank = Tank(world())
    async with tank.bus as bus, dpstack.publish(bus, probe=ALLOWED) as connectors:
        [connector] = ProbeConnector.made
        await tank.operate()
        assert await given(connector, "tank.pump", True) == ""
        gateway: Any = connectors._gateway
        gateway._give_out = None  # a defect
        await asyncio.sleep(2)
        assert tank.outputs[0] == 4
        assert "its connector has ended" in await given(connector, "tank.pump", True)
    assert any(text.startswith("all connectors have ended by a fault (TypeError") for text in told(bus))


async def test_a_bus_process_goes_to_clear_while_the_program_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody could stop anything from outside any more. Without an order in effect the bus goes on; with "keep" it does
    all the same (a row of ends.md)."""
    monkeypatch.setattr(publishing, "HANG_S", 0.4)
    monkeypatch.setattr(publishing, "_BEAT_S", 0.05)
    with octet_slaves(SPEC) as (path, there):
        bus = bus_on(path, "process", VALVES)
        slave = there.slaves[4]
        async with dpstack.publish(bus, probe={"allow_commands": ["valves.target"]}), bus:
            [connector] = ProbeConnector.made
            await bus.operate()
            await bus.ready(30)
            await until(lambda: Born(4) in connector.lives, "the birth of the slave")
            bus.slave(4).outputs = b"\x11\x22"
            await until(lambda: slave.outputs == b"\x11\x22", "outputs of the program")
            time.sleep(0.6)  # noqa: ASYNC251  the event loop is blocked
            assert slave.outputs == b"\x11\x22"
            await asyncio.sleep(0.1)
            assert await given(connector, "valves.target", 0x3344) == ""
            eventually(lambda: slave.outputs == bytes(2), "Clear while the program hangs")
            await until(lambda: bus.mode is Mode.CLEAR, "the program learns of it")
            assert isinstance(bus.forced_clear, ApplicationSilent)
            await until(lambda: bus.slave(4).outputs == b"\xa5\x5a", "the safe value is prepared")
            await bus.operate()
            await until(lambda: slave.outputs == b"\xa5\x5a", "and goes out")
    assert any("(this program was stopped, or its event loop was blocked)" in text for text in told(bus))


def test_another_rule_is_refused() -> None:
    with pytest.raises(dpstack.ConfigError, match="on_connector_loss"):
        parse_config('[bus]\nport = "virtual"\nbaud = 500000\non_connector_loss = "stop"\n')
