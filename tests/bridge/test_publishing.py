"""Connectors beside a simulated bus: whatever they do, the bus goes on and its outputs keep their safe end."""

from __future__ import annotations

import asyncio
import resource
import socket
from typing import Any, Literal

import probe_connector
import pytest
from api_kit import in_virtual_time, slave_in
from far_ends import free_port, until
from probe_connector import ProbeConnector
from process_kit import SPEC, Driver, bus_on, octet_slaves
from process_kit import VALVES as PTY_VALVES
from support import WorldFactory

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import parse_config
from dpstack.api.connectors.kinds import KINDS, ConnectorKind
from dpstack.api.connectors.publishing import Publishing
from dpstack.api.control.orders import carry_out
from dpstack.api.refused_orders import OrdersRefused
from dpstack.bridge.orders import Refusal
from dpstack.dp.master.commands import Mode
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import BusError, ConfigError, PortError, SlaveError, UsageError
from dpstack.plant.items import DrivePlant, FieldPlant, SlavePlant
from dpstack.plant.nodes import Kind, slave_of
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.plant.tree import Born, NodesChanged
from dpstack.sim.world import World
from dpstack.trace import Notice

VALVES: dict[str, object] = {
    "name": "valves",
    "address": 9,
    "ident": 0x1234,
    "config": "21 11",
    "safe": "11 00",
    "inputs": {"level": "i16@0"},
    "outputs": {"lamp": "bool@0.1", "target": {"at": "u8@1", "scale": 0.5, "unit": "bar"}},
}
PUMP: dict[str, object] = {"name": "pump", "address": 6, "drive": "ls-s100", "telegram": "PPO1"}


pytestmark = pytest.mark.usefixtures("probe")


async def begin(bus: dpstack.Bus, table: dict[str, Any]) -> None:
    """A bus with a connector that cannot begin."""
    async with dpstack.publish(bus, probe=table), bus:
        raise AssertionError("it must not begin")


def notices(bus: dpstack.Bus) -> list[str]:
    events = core_of(bus).past_events()
    return [one.message for one in events if isinstance(one, Notice) and one.source == "connectors"]


class Plant:
    """A bus with a slave that keeps the outputs that it gets."""

    def __init__(self, world: World, **more: Any) -> None:
        self.outputs: list[bytes] = []
        #: when the safe values came, by the clock of the loop
        self.safe_at = 0.0
        description = SlaveDescription(ident=0x1234, configs=(bytes.fromhex("21 11"),))
        self.station, self.app = slave_in(world, DpSlave(description, self._exchange), 9)
        self.bus = dpstack.open_bus(port="virtual", baud=500_000, slaves=[VALVES], world=world, **more)

    def _exchange(self, outputs: bytes, elapsed: int) -> bytes:
        self.outputs.append(outputs)
        if outputs == b"\x11\x00" and b"\x77\x77" in self.outputs and not self.safe_at:
            self.safe_at = asyncio.get_running_loop().time()
        return outputs

    async def operate(self) -> None:
        await self.bus.operate()
        await self.bus.ready()
        self.bus.slave(9).outputs = b"\x77\x77"
        await asyncio.sleep(0.5)

    def ended_safely(self) -> bool:
        assert b"\x77\x77" in self.outputs
        return b"\x11\x00" in self.outputs[-3:] and self.app.clear and not self.bus.is_open


@pytest.mark.parametrize("fails", ["no", "take", "serve", "end", "close"])
@pytest.mark.parametrize("how", ["end", "exception", "cancelled", "outside"])
@in_virtual_time
async def test_outputs_keep_their_safe_end_whatever_a_connector_does(world: WorldFactory, fails: str, how: str) -> None:
    plant, loop, left_at = Plant(world()), asyncio.get_running_loop(), 0.0

    async def inside() -> None:
        async with plant.bus, dpstack.publish(plant.bus, probe={"fails": fails}):
            await use()

    async def around() -> None:
        """As `dpstack run` does: the connectors begin before the bus, and end after it."""
        async with dpstack.publish(plant.bus, probe={"fails": fails}), plant.bus:
            await use()

    async def use() -> None:
        nonlocal left_at
        await plant.operate()
        left_at = loop.time()
        if how == "exception":
            raise ZeroDivisionError("of the program")
        if how == "cancelled":
            await asyncio.sleep(1000)

    task = asyncio.ensure_future(around() if how == "outside" else inside())
    if how == "cancelled":
        await asyncio.sleep(1)
        left_at = loop.time()
        task.cancel()
    await asyncio.wait((task,))
    kinds = {"exception": ZeroDivisionError, "cancelled": asyncio.CancelledError}
    if how == "cancelled":
        assert task.cancelled()
    else:
        assert type(task.exception()) is kinds.get(how, type(None))
    assert plant.ended_safely()
    assert plant.safe_at - left_at < (0.1 if how == "outside" or fails != "end" else 1.2)
    [connector] = ProbeConnector.made
    assert connector.course[:2] == ["open", "serve"]
    assert connector.course[-1] == "close"
    told = [text for text in notices(plant.bus) if "fault" in text]
    if fails in ("take", "serve"):
        assert told == [
            f"probe: it has ended by a fault of its program (ZeroDivisionError: {fails}); the bus goes on without it"
        ]
    else:
        assert told == []
        # the end of the bus reaches a connector that ends after it
        assert connector.course[2] == ("last: Died 9, Died None" if how == "outside" else "last: Born None, Born 9")


@in_virtual_time
async def test_nothing_is_sent_before_the_connectors_have_made_their_nodes(world: WorldFactory) -> None:
    """A connector that makes many nodes holds up the event loop, and so the safe end of a bus that runs."""
    w = world()
    plant = Plant(w)
    async with dpstack.publish(plant.bus, probe={"fails": "build"}):
        opening = asyncio.ensure_future(plant.bus.open())
        await asyncio.sleep(2)
        [connector] = ProbeConnector.made
        assert [node.id for node in connector.tree.nodes if node.slave == 9 and node.kind is Kind.VALUE] == [
            "slave/9/input/level", "slave/9/output/lamp", "slave/9/output/target"
        ]  # fmt: skip
        assert (opening.done(), list(w.log)) == (False, [])
        connector.is_built = True
        await opening
        await plant.operate()
        # the nodes are those of before
        assert sum(isinstance(one, NodesChanged) for one in connector.changes) == 1
        await plant.bus.close()
    assert plant.ended_safely()


@in_virtual_time
async def test_nodes_are_made_behind_the_search_for_the_baud_rate(world: WorldFactory) -> None:
    w = world()
    plant = Plant(w)
    async with plant.bus:
        await plant.operate()
        other = {"name": "tank", "address": 7, "ident": 0x1234, "config": "11", "inputs": {"full": "bool@0.0"}}
        second = dpstack.open_bus(world=w, baud="auto", address=5, slaves=[other], t_tr=plant.bus.params.t_tr)
        async with dpstack.publish(second, probe={"fails": "build"}):
            opening = asyncio.ensure_future(second.open())
            await asyncio.sleep(2)
            assert (second.searching, opening.done(), plant.bus.snapshot.las) == (False, False, frozenset({2}))
            [connector] = ProbeConnector.made
            assert "slave/7/input/full" in [node.id for node in connector.tree.nodes]
            connector.is_built = True
            await opening
            await second.close()


@in_virtual_time
async def test_a_connector_that_fails_as_it_makes_its_nodes_does_not_hold_up_the_bus(world: WorldFactory) -> None:
    plant, loop = Plant(world()), asyncio.get_running_loop()

    def fail() -> None:
        connector.breaks = True
        connector.spread([])

    async with dpstack.publish(plant.bus, probe={"fails": "build"}):
        [connector] = ProbeConnector.made
        loop.call_later(0.5, fail)
        begun = loop.time()
        async with plant.bus:
            assert 0.5 <= loop.time() - begun < 1
            await plant.operate()
    assert plant.ended_safely()


@in_virtual_time
async def test_a_bus_that_is_closed_while_nodes_are_made_is_never_opened(world: WorldFactory) -> None:
    w = world()
    plant = Plant(w)
    async with dpstack.publish(plant.bus, probe={"fails": "build"}):
        opening = asyncio.ensure_future(plant.bus.open())
        await asyncio.sleep(1)
        await plant.bus.close()
        ProbeConnector.made[0].is_built = True
        with pytest.raises(UsageError, match="the bus was closed before its port was opened"):
            await opening
    assert list(w.log) == []


@in_virtual_time
async def test_somebody_in_a_hurry_does_not_wait_for_connectors(world: WorldFactory) -> None:
    plant, loop = Plant(world()), asyncio.get_running_loop()
    hurried: list[float] = []
    table = probe_connector.ProbeConfig(fails="end")
    async with Publishing(plant.bus, {"probe": table}, hurried=lambda: bool(hurried)), plant.bus:
        await plant.operate()
        loop.call_later(1.0, lambda: hurried.append(loop.time()))
    assert hurried
    assert loop.time() - hurried[0] < 0.7
    assert plant.ended_safely()


@in_virtual_time
async def test_values_go_out_and_orders_come_back(world: WorldFactory) -> None:
    allowed = {"allow_commands": ["valves.*"]}
    plant = Plant(world())
    async with plant.bus as bus, dpstack.publish(bus, probe=allowed) as connectors:
        await plant.operate()
        [connector] = ProbeConnector.made
        assert connectors.connectors == ("probe",)
        assert connector.lives == [Born(None), Born(9)]
        outside = "slave 9 (valves): target = 999.0 is outside 0.0..127.5 bar (u8, scale 0.5, offset 0)"
        orders = (("valves.lamp", True), ("valves.target", 7.5), ("valves.target", 999.0), ("pump.stop", 1))
        given = [await connector.orders.give(name, value, made_at=None) for name, value in orders]
        assert [(one.result, one.reason) for one in given] == [
            ("done", ""),
            ("done", ""),
            ("refused", outside),
            ("refused", "it is not in allow_commands"),
        ]
        await asyncio.sleep(0.5)
        assert plant.outputs[-1] == bytes([0x77 | 2, 15])
        # the value comes back from the bus, and is no echo of the order
        assert connector.values("slave/9/output/target")[-1] == 7.5
    assert [text for text in notices(bus) if text.startswith("probe: order ")] == [
        "probe: order valves.lamp: done",
        "probe: order valves.target: done",
    ]
    assert [event.text for event in core_of(bus).past_events() if isinstance(event, OrdersRefused)] == [
        f"orders: probe: order valves.target refused: {outside}",
        "orders: probe: order pump.stop refused: it is not in allow_commands",
    ]
    assert connector.lives == [Born(None), Born(9)]


@in_virtual_time
async def test_an_output_that_cannot_reach_its_slave_now_is_refused_and_never_acts_later(world: WorldFactory) -> None:
    """In Clear, in a Clear that the master went to by itself, and where the slave is gone before the tree knows it."""
    w = world()
    plant = Plant(w, application_watchdog_ms=100)
    async with plant.bus as bus, dpstack.publish(bus, probe={"allow_commands": ["valves.*"]}):
        [connector] = ProbeConnector.made

        async def refused() -> tuple[str, Refusal]:
            one = await connector.orders.give("valves.target", 7.5, made_at=None)
            both = await connector.orders.give_outputs([("valves.target", 7.5), ("valves.lamp", True)], made_at=None)
            assert {(two.result, two.reason, two.kind) for two in both} == {one[1:]}
            assert one.result == "refused"
            return one.reason, one.kind

        await bus.ready()
        await asyncio.sleep(1)
        operate = "(of a run: dpstack ctl virtual operate)"
        clear = f"the bus is in Clear, nothing reaches valves: call operate() first {operate}"
        assert (bus.mode, await refused()) == (Mode.CLEAR, (clear, Refusal.STATE))
        await bus.operate()
        bus.alive()
        await asyncio.sleep(0.05)
        assert (await connector.orders.give("valves.target", 8.0, made_at=None)).reason == ""
        await asyncio.sleep(0.5)
        assert bus.forced_clear is not None
        reason, kind = await refused()
        assert reason.startswith("the bus went to Clear by itself (")
        assert reason.endswith(f"): look at the plant, then operate() {operate}")
        assert kind is Refusal.STATE
        await bus.operate()
        await asyncio.sleep(0.05)
        assert {octets[1] for octets in plant.outputs} == {0, 16}  # 7.5 bar would be 15
        w.remove(plant.station)
        await bus.until(lambda: not bus.slave(9).ready_now)
        with pytest.raises(SlaveError, match=r"^slave 9 is not in data exchange: "):
            await carry_out(bus, SetOutputs(9, {"target": 7.5}), now=True)
        assert bus.slave(9)["target"] == 8.0


@in_virtual_time
async def test_orders_to_a_drive() -> None:
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=[PUMP]) as bus:
        await bus.operate()
        await bus.ready()
        async with dpstack.publish(bus, probe={"allow_commands": ["pump.*"]}):
            await asyncio.sleep(0.5)
            [connector] = ProbeConnector.made
            for name, value in (("pump.start", None), ("pump.speed", 0.25)):
                assert (await connector.orders.give(name, value, made_at=None)).reason == ""
            await bus.drive("pump").reached()
            assert bus.drive("pump").status.running
            assert (await connector.orders.give("pump.speed", 77.0, made_at=None)).result == "refused"
            assert (await connector.orders.give("pump.stop", True, made_at=None)).reason == ""
            await asyncio.sleep(0.5)
            assert not bus.drive("pump").status.running
            assert connector.values("slave/6/drive/running")[-1] is False
            await bus.clear()
            await bus.wait_state(Mode.CLEAR)
            reason = (await connector.orders.give("pump.speed", 0.5, made_at=None)).reason
            assert "the bus is in Clear, nothing reaches pump: call operate() first" in reason
            await bus.operate()
            await asyncio.sleep(1)
            assert bus.drive("pump").status.setpoint == 0.25


@pytest.mark.parametrize("baud", [500_000, "auto"])
async def test_a_bus_that_cannot_be_opened_ends_its_connectors(baud: int | Literal["auto"]) -> None:
    bus = dpstack.open_bus(port="/dev/there-is-none", baud=baud, slaves=[VALVES], driver="asyncio")
    with pytest.raises(PortError):
        await _open_beside_connectors(bus)
    [connector] = ProbeConnector.made
    assert connector.lives == []
    assert connector.course == ["open", "serve", "last: ", "close"]


async def _open_beside_connectors(bus: dpstack.Bus) -> None:
    async with dpstack.publish(bus, probe={}):
        await asyncio.sleep(0.05)
        await bus.open()


@in_virtual_time
async def test_what_cannot_begin_is_an_error_before_anything_is_sent(world: WorldFactory) -> None:
    w = world()
    plant = Plant(w)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortError, match=rf"^\[probe\] port {port}: Address already in use; give another one$"):
            await begin(plant.bus, {"port": port})
    assert ProbeConnector.made[-1].course == ["open", "close"]
    with pytest.raises(ConfigError, match=r"'valves\.lmap' fits no order of this plant; did you mean 'valves\.lamp'\?"):
        await begin(plant.bus, {"allow_commands": ["valves.lmap"]})
    KINDS["probe"] = ConnectorKind("probe_connector", ("no_such_package",), ProbeConnector)
    with pytest.raises(UsageError, match=r"^\[probe\] needs no_such_package: pip install 'dpstack\[probe\]'$"):
        await begin(plant.bus, {})
    KINDS["probe"] = ConnectorKind("no_such_module", (), ProbeConnector)
    with pytest.raises(
        UsageError, match=r"^a connector cannot be loaded \(No module named 'no_such_module'\): pip install"
    ):
        await begin(plant.bus, {})
    with pytest.raises(UsageError, match="no connector is given"):
        dpstack.publish(plant.bus)
    with pytest.raises(ConfigError, match=r"publish: unknown table or key 'prob'; did you mean 'probe'\?"):
        dpstack.publish(plant.bus, prob={})
    assert list(w.log) == []


@pytest.mark.parametrize(
    ("fails", "why"),
    [
        (None, r"\d+ MB of addresses are left, they take some 1000000000"),
        (MemoryError(), "MemoryError"),
        (RuntimeError("can't start new thread"), "can't start new thread"),
        (ImportError("_rust.abi3.so: failed to map segment from shared object"), "_rust.abi3.so: failed to map .*"),
    ],
)
@in_virtual_time
async def test_too_little_memory_for_the_connectors_is_one_clear_line(
    fails: Exception | None, why: str, world: WorldFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As under `ulimit -v`; a package that is written in Rust ends the program there, so it is not loaded."""

    async def load(*modules: str) -> None:
        assert fails is not None, "nothing is loaded"
        raise fails

    w = world()
    plant = Plant(w)
    KINDS["probe"] = KINDS["probe"]._replace(room_mb=1_000_000_000 if fails is None else 0)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (1 << 44, 1 << 44))
    monkeypatch.setattr("dpstack.api.connectors.publishing.load_beside", load)
    todo = r"raise that limit \(ulimit -v, LimitAS= of systemd\), or take one of these tables out"
    with pytest.raises(BusError, match=rf"^probe: there is too little memory for them \({why}\): {todo}$"):
        await begin(plant.bus, {})
    assert list(w.log) == []


@pytest.mark.parametrize("driver", ["asyncio", "process"])
async def test_connectors_of_a_bus_on_a_port(driver: Driver) -> None:
    """Both drivers at the octet slaves of a pty; where the loop is shared, a remark says so once."""
    with octet_slaves(SPEC) as (path, there):
        bus = bus_on(path, driver, PTY_VALVES | {"outputs": {"speed": "u8@0"}})
        async with dpstack.publish(bus, probe={"allow_commands": ["valves.speed"]}), bus:
            [connector] = ProbeConnector.made
            await bus.operate()
            await bus.ready(30)
            await until(lambda: Born(4) in connector.lives, "the birth of the slave")
            assert (await connector.orders.give("valves.speed", 0x5A, made_at=None)).reason == ""
            await until(lambda: there.slaves[4].outputs[:1] == b"\x5a", "the output at the slave")
            await until(lambda: connector.values("slave/4/output/speed")[-1] == 0x5A, "the output in the tree")
        assert connector.course[2] == "last: Died 4, Died None"
        # safe values, then Clear
        assert (there.slaves[4].outputs, there.slaves[4].control) == (bytes(2), b"\x02\x00")
        where = 'probe: in the event loop of the bus; with driver = "process" in [bus] they cannot delay it'
        assert notices(bus).count(where) == (driver == "asyncio")


@in_virtual_time
async def test_remarks_wait_for_the_bus(world: WorldFactory) -> None:
    plant = Plant(world())
    port = free_port()
    async with dpstack.publish(plant.bus, probe={"port": port}):
        await asyncio.sleep(0.3)
        assert notices(plant.bus) == []
        async with plant.bus:
            await plant.operate()
            assert notices(plant.bus) == [f"probe: on port {port}", "probe: born None", "probe: born 9"]


def test_tables_of_connectors_are_read_with_the_configuration() -> None:
    plant = '[bus]\nport = "virtual"\nbaud = 500000\n'
    config = parse_config(plant + "[probe]\nport = 1234\n")
    assert config.connectors == {"probe": probe_connector.ProbeConfig(port=1234)}
    assert config.with_bus(address=7).connectors == config.connectors
    assert parse_config(plant).connectors == {}
    for text, error in {
        "[probe]\nprot = 1": "config:5: [probe]: unknown key 'prot'; did you mean 'port'?",
        "[probe]\nport = 99999": "config:5: [probe]: port = 99999 is outside 0..65535; correct it or leave it out",
        "probe = 7": "config:1: [probe] must be a table; write [probe] on a line of its own",
        "[prob]": "config:4: unknown table or key 'prob'; did you mean 'probe'?",
        "[xyz]": "config:4: unknown table or key 'xyz'; a configuration has [bus], [[slave]], [mqtt], [metrics], "
        "[opcua], [epics], [probe]",
    }.items():
        with pytest.raises(ConfigError) as caught:
            parse_config(plant + text if text[0] == "[" else text + "\n" + plant)
        assert str(caught.value) == error


def test_drives_and_their_outputs() -> None:
    """The outputs of a drive are made by its plugin: its orders stand for them."""
    speed = FieldPlant(name="speed", type="i16", at="i16@0")
    hoist = SlavePlant(name="hoist", outputs=[speed], drive=DrivePlant())
    found = slave_of(3, hoist, writable=True)
    assert [one.typed(0.5) for one in found.orders if one.name == "hoist.speed"] == [DriveOrder(3, "speed", 0.5)]
