"""Misuse by a program raises at once: attributes that do not exist, a bus that is not open, names that are numbers."""

from __future__ import annotations

import operator
from collections.abc import Callable

import pytest
from api_kit import FAN, bus_of
from ms2_kit import ms2_in

import dpstack
from dpstack.api.config.config import make_config
from dpstack.sim.world import World

pytestmark = pytest.mark.virtual_time

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
