"""Wrong arguments of a Python program: each call raises at once, and its message says what to give instead."""

from __future__ import annotations

import asyncio
import operator
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from api_kit import FAN, bus_of, operating
from ms2_kit import ms2_in

import dpstack
from dpstack import Int, at
from dpstack.api.config.config import make_config
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

TANK: dict[str, object] = {
    "name": "tank", "address": 8, "ident": 0x1234, "config": "10 20",
    "inputs": {"level": "u8@0"}, "outputs": {"order": "u8@0"},
}  # fmt: skip
WAITED = 'condition = False is no function: give one, until(lambda v: v["limit"]) for instance'


class Order(dpstack.Outputs):
    order: Int = at()


class Plain:
    level: int


class Bits(dpstack.Inputs):
    level: dpstack.Bool = at(0, "u8")


#: a whole configuration, which a message must not print before its remedy
WHOLE = {"bus": {"port": "virtual"}, "slave": [{"name": f"s{n}", "address": n} for n in range(3, 99)]}
OPENED: list[tuple[Any, dict[str, Any], str]] = [
    (WHOLE, {}, "... is no configuration: give the path of a file, or port=, baud= and slaves="),
    (None, {"baud": WHOLE}, "... is a table; it must be an integer"),
    (None, {"baud": 500_000, "slaves": WHOLE}, "... is no list: write slaves=[{'name': 'fan', ...}]"),
    (None, {"baud": 500_000, "world": WHOLE}, "... is no World: give one, world = dpstack.World() for instance"),
    ({"bus": {}}, {}, "open_bus: {'bus': {}} is no configuration: give the path of a file, or port=, baud= and slaves"),
    (None, {"baudrate": 500_000}, "open_bus: unknown argument 'baudrate'; did you mean 'baud'?"),
    (None, {"baud": 500_000, "slave": [TANK]}, "open_bus: unknown argument 'slave'; did you mean 'slaves'?"),
    (None, {"baud": 500_000, "slaves": "plant.toml"}, "open_bus: slaves = 'plant.toml' is no list: write slaves=[{'na"),
    (None, {"baud": 500_000, "slaves": {"a": 1}}, "open_bus: slaves = {'a': 1} is no list: write slaves=[{'name'"),
    (None, {"baud": 500_000, "slaves": ["a"]}, "open_bus: slave 1 must be a table; give a mapping of its keys, {'name"),
    (None, {"baud": 500_000, "on_event": "print"}, "open_bus: on_event = 'print' is no function: give one, on_event=p"),
    (None, {"baud": 500_000, "on_event": asyncio.sleep}, "open_bus: on_event is an async function, whose result nobod"),
    (None, {"baud": 500_000, "world": dpstack.World}, "is no World: give one, world = dpstack.World() for instance"),
]  # fmt: skip


@pytest.mark.parametrize(("config", "arguments", "says"), OPENED, ids=range(len(OPENED)))
def test_open_bus_refuses(config: Any, arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(dpstack.ConfigError) as raised:
        dpstack.open_bus(config, port="virtual", **arguments)
    assert says in str(raised.value)
    assert len(str(raised.value)) < 200


Call = Callable[[Any, Any, Any], Any]
CALLED: list[tuple[Call, str]] = [
    (lambda bus, tank, fan: tank.until(tank["level"] == 5), WAITED),
    (lambda bus, tank, fan: tank.until(asyncio.sleep), "condition is an async function, whose result nobody awaits"),
    (lambda bus, tank, fan: tank.until(lambda v: True, "1"), "timeout = '1' is no time: give a number of seconds"),
    (lambda bus, tank, fan: bus.until(True), "condition = True is no function: give one, until(lambda: bus"),
    (lambda bus, tank, fan: bus.ready("5"), "timeout = '5' is no time: give a number of seconds, 2.5 for instance"),
    (lambda bus, tank, fan: bus.wait_state("operate"), "mode = 'operate' is no Mode: give one, wait_state(Mode.OPERAT"),
    (lambda bus, tank, fan: tank.wait_state("offline"), "state = 'offline' is no SlaveState: give one, wait_state(Sl"),
    (
        lambda bus, tank, fan: tank.wait_state(dpstack.SlaveState.OFFLINE, 1),
        "state = 1 is no SlaveState: give one, wait_state(SlaveState.DATA_EXCHANGE, timeout=5) for instance",
    ),
    (lambda bus, tank, fan: tank.wait_state(), "state = None is no SlaveState"),
    (lambda bus, tank, fan: setattr(tank, "outputs", 1), "slave 8 (tank): outputs = 1 is no octets: give bytes"),
    (lambda bus, tank, fan: setattr(tank, "outputs", [300]), "slave 8 (tank): outputs = [300] is no octets: give byte"),
    (lambda bus, tank, fan: tank.inputs_as(Plain), "is no class of inputs: write class Tank(dpstack.Inputs): level: I"),
    (lambda bus, tank, fan: tank.inputs_as(Order), "is no class of inputs: write class Tank(dpstack.Inputs): level: I"),
    (lambda bus, tank, fan: tank.outputs_as(3), "3 is no class of outputs: write class Tank(dpstack.Outputs): level"),
    (lambda bus, tank, fan: tank.inputs_as(Bits), "Bits: level: at(0, 'u8') is no place of a Bool; give its bit: at(0"),
    (lambda bus, tank, fan: tank.send({"order": 1}), "send({'order': 1}) takes an object of a class of dpstack.Output"),
    (lambda bus, tank, fan: tank.send(Order), "takes an object of a class of dpstack.Outputs; update() takes names"),
    (lambda bus, tank, fan: anext(tank.changes("order")), "slave 8 (tank): order is an output: give the name of an in"),
    (lambda bus, tank, fan: setattr(fan, "speed", "fast"), "drive fan: speed = 'fast' is no number: give one, 0.5"),
    (lambda bus, tank, fan: setattr(fan, "speed", True), "drive fan: speed = True is no number: give one, 0.5"),
    (lambda bus, tank, fan: fan.start(timeout="1"), "drive fan: start: timeout must be a number of seconds, not '1'"),
]  # fmt: skip


async def test_calls_of_a_running_bus_refuse() -> None:
    said: list[str] = []
    async with operating(TANK, FAN) as bus:
        tank, fan = bus.slave("tank"), bus.drive("fan")
        for call, says in CALLED:
            began = bus.seconds
            with pytest.raises(dpstack.UsageError) as raised:
                await _outcome(call(bus, tank, fan))
            if says not in str(raised.value) or bus.seconds > began + 0.1:
                said.append(f"{raised.value} ({bus.seconds - began:.1f} s)\n    wanted: {says}")
        assert said == []
        fan.speed = 0.25  # the wrong set points above left nothing behind
        assert fan.status.setpoint == 0.25


async def _outcome(found: object) -> None:
    if isinstance(found, Awaitable):
        await found


WAITING: list[Callable[[dpstack.Bus], Awaitable[object]]] = [
    lambda bus: bus.ready(timeout=60),
    lambda bus: bus.wait_state(dpstack.Mode.OPERATE),
    lambda bus: bus.until(lambda: False),
    lambda bus: bus.slave("tank").ready(timeout=60),
    lambda bus: bus.slave("tank").until(lambda _: False),
    lambda bus: bus.slave("tank").wait_state(dpstack.SlaveState.DATA_EXCHANGE),
]


@pytest.mark.parametrize("wait", WAITING, ids=range(len(WAITING)))
async def test_waiting_on_a_bus_that_is_not_open_raises_at_once(
    wait: Callable[[dpstack.Bus], Awaitable[object]],
) -> None:
    bus, began = bus_of(TANK), time.monotonic()
    with pytest.raises(dpstack.UsageError, match=r"the bus is not open: use it inside .* \(dpstack.blocking: `with`\)"):
        await wait(bus)
    async with bus:
        pass
    with pytest.raises(dpstack.UsageError, match=r"the bus is not open any more: make a new one with open_bus\(\)"):
        await wait(bus)
    assert time.monotonic() - began < 60


async def test_a_wait_in_vain_says_what_it_waited_for() -> None:
    async with bus_of(TANK, FAN) as bus:
        with pytest.raises(TimeoutError, match=r"the master is not in operate after 0.1 s, it is in clear$"):
            await bus.wait_state(dpstack.Mode.OPERATE, 0.1)
        with pytest.raises(TimeoutError, match=r"the condition is not true after 0.1 s"):
            await bus.until(lambda: False, 0.1)
        with pytest.raises(
            dpstack.SlaveTimeout, match=r"slave 8 \(tank\): not in offline after 0.1 s: its state is data_ex"
        ):
            await bus.slave("tank").wait_state(dpstack.SlaveState.OFFLINE, timeout=0.1)


def test_run_virtual_takes_a_coroutine() -> None:
    main: Any = _outcome
    with pytest.raises(dpstack.UsageError, match=r"takes a coroutine: write run_virtual\(main\(\)\)"):
        dpstack.run_virtual(main)


# --- Misuse by a program raises at once: attributes that do not exist, a bus that is not open, names that are numbers


VALVES: dict[str, object] = {
    "name": "valves", "address": 5, "ident": 0x1234, "config": "21 11",
    "inputs": {"limit": "bool@0.0"}, "outputs": {"flap": "bool@0.3"},
}  # fmt: skip

Misuse = Callable[[dpstack.Bus], object]
ASSIGNED: list[tuple[Misuse, str, object, str]] = [
    (lambda bus: bus.drive("fan"), "sped", 0.3, "drive fan has no attribute 'sped'; did you mean speed?"),
    (lambda bus: bus.drive("fan"), "start", True, "drive fan: start is a method: call it instead of assigning to it"),
    (lambda bus: bus.drive("fan"), "status", 1, "drive fan: status can only be read"),
    (
        lambda bus: bus.slave("valves"), "flap", True,
        "slave 5 (valves) has no attribute 'flap': write slave['flap'] = ...",
    ),
    (
        lambda bus: bus.slave("valves"), "output", b"",
        "slave 5 (valves) has no attribute 'output'; did you mean outputs?",
    ),
    (lambda bus: bus.slave("valves"), "state", 1, "slave 5 (valves): state can only be read"),
    (lambda bus: bus, "operating", True, "bus has no attribute 'operating'; these can be assigned: none"),
    (lambda bus: bus.group(), "outputs", b"", "group has no attribute 'outputs'; these can be assigned: none"),
    (lambda bus: bus.class2, "timeout", 1, "class2 has no attribute 'timeout'; these can be assigned: none"),
]  # fmt: skip


@pytest.mark.parametrize(("thing", "name", "value", "text"), ASSIGNED)
async def test_an_attribute_that_does_not_exist(thing: Misuse, name: str, value: object, text: str) -> None:
    async with bus_of(VALVES, FAN) as bus:
        with pytest.raises(dpstack.UnknownAttribute) as raised:
            setattr(thing(bus), name, value)
        assert str(raised.value) == text
        assert isinstance(raised.value, (dpstack.UsageError, AttributeError))


RIG = dpstack.slave.SlaveDescription.simple(0x1234, inputs=1, outputs=1, name="rig")
SERVED: list[tuple[str, str, str]] = [
    ("device", "diagnosis", "slave rig has no attribute 'diagnosis'; did you mean diag?"),
    ("device", "exchange", "slave rig: exchange is a method: call it instead of assigning to it"),
    ("device", "im", "slave rig: im can only be read"),
    ("slave", "outputs", "served slave rig: outputs can only be read"),
    ("slave", "diag", "served slave rig has no attribute 'diag': its device has: assign to device.diag"),
    ("slave", "speed", "served slave rig has no attribute 'speed'; these can be assigned: none"),
    ("server", "slave", "slave server: slave can only be read"),
    ("server", "outputs", "slave server has no attribute 'outputs'; these can be assigned: none"),
]


@pytest.mark.parametrize(("which", "name", "text"), SERVED)
def test_an_attribute_that_a_slave_of_ones_own_does_not_have(which: str, name: str, text: str) -> None:
    device = dpstack.slave.DpSlave(RIG, lambda outputs, elapsed: outputs)
    server = dpstack.slave.serve_slave(device, world=World(), address=9)
    with pytest.raises(dpstack.UnknownAttribute) as raised:
        setattr({"device": device, "slave": server.slave, "server": server}[which], name, b"")
    assert str(raised.value) == text


async def test_an_attribute_that_a_connection_does_not_have() -> None:
    world = World()
    ms2_in(world)
    async with dpstack.open_bus(make_config("virtual", 500_000, 5), world=world) as bus:
        connection = await bus.class2.connect(9)
        with pytest.raises(dpstack.UnknownAttribute) as raised:
            connection.timeout = 3
        assert str(raised.value) == "connection to slave 9 has no attribute 'timeout'; these can be assigned: none"


def test_a_slave_of_ones_own_may_have_more_attributes_in_a_class_of_its_own() -> None:
    class Pump(dpstack.slave.DpSlave):
        def __init__(self) -> None:
            super().__init__(RIG, self.cycle)
            self.pressure = 3

        def cycle(self, outputs: bytes, elapsed: int) -> bytes:
            return bytes([self.pressure])

    pump = Pump()
    pump.temperature = 20
    assert pump.pressure == 3


async def test_attributes_that_may_be_assigned_still_may() -> None:
    class Named(dpstack.Bus):
        """A class of a user's own has attributes of its own."""

        title = ""

    async with bus_of(VALVES, FAN) as bus:
        bus.drive("fan").speed = 0.3
        bus.slave("valves").outputs = b"\x00\x08"
        bus.slave("valves")["flap"] = False
        own = Named(bus.config)
        own.title = "mine"
        assert own.title == "mine"


@pytest.mark.parametrize(
    "misuse",
    [
        lambda bus: bus.slave("valves")["flap"],
        lambda bus: operator.setitem(bus.slave("valves"), "flap", True),
        lambda bus: bus.slave("valves").outputs,
        lambda bus: setattr(bus.slave("valves"), "outputs", b"\x00\x08"),
    ],
    ids=["read a field", "write a field", "read the outputs", "write the outputs"],
)
async def test_data_of_a_bus_that_is_not_open(misuse: Misuse) -> None:
    bus = bus_of(VALVES)
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        misuse(bus)
    async with bus:
        misuse(bus)
    with pytest.raises(dpstack.UsageError, match="the bus is not open"):
        misuse(bus)
    slave = bus.slave("valves")  # what was, for a report
    assert (slave.inputs, slave.outputs_held, slave.inputs_valid) == (bytes(2), slave.outputs_held, False)
    assert bus.stats.slaves[5].outputs == b""  # nobody sends any
    assert bus.stats.slaves[5].held == slave.outputs_held


@pytest.mark.parametrize("name", ["4", "0x04", " 12 ", "-3", "007"])
def test_a_name_that_is_a_number(name: str) -> None:
    with pytest.raises(dpstack.ConfigError, match=r"looks like an address; write a word: name = \"slave5\""):
        bus_of({**VALVES, "name": name})


def test_a_name_that_only_begins_with_a_number() -> None:
    assert bus_of({**VALVES, "name": "4th valve"}).slaves[0].name == "4th valve"


async def test_a_name_that_is_a_number_is_refused_on_a_running_bus() -> None:
    async with bus_of(FAN) as bus:
        with pytest.raises(dpstack.ConfigError, match="looks like an address"):
            await bus.add_slave({**VALVES, "name": "4"})
