"""Inputs of simulated slaves set by `dpstack ctl`, seen by a master in literal octets, and by a bus."""

from __future__ import annotations

import inspect

import pytest
from api_kit import FAN, in_virtual_time, operating
from simulated_kit import Asked

from dpstack.api.config.config import slave_config
from dpstack.api.control.handlers import control_run
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.errors import UsageError
from dpstack.params import BusParams
from dpstack.sim.world import World

IO: dict[str, object] = {
    "name": "io",
    "address": 7,
    "gsd": "io-station",
    "modules": ["8 DI", "8 DO", "8 DI"],
    "inputs": {"first": "u8@0", "second": "u8@1"},
}
RAW: dict[str, object] = {
    "name": "raw",
    "address": 9,
    "ident": 0x1234,
    "config": "11 20",
    "inputs": {"limit": "bool@0.3", "level": "u8@1"},
    "outputs": {"open": "bool@0.0"},
}


def test_inputs_replace_the_mirrored_outputs_until_they_are_mirrored_again() -> None:
    asked = Asked()
    orders = slave_handlers(asked.bench)
    assert asked.inputs("12 34") == "12 34"
    orders["set"](["valves.level=0x55"])
    assert asked.inputs("AA BB") == "12 55"  # the other bits stay as they were
    orders["set"](["8.limit=on", "8.level=7"])
    assert asked.inputs("AA BB") == "1A 07"
    assert asked.bench.status_of(8) == {"set_inputs": "1a07"}
    orders["input"](["valves", "BEEF"])
    assert asked.inputs("00 00") == "BE EF"
    asked.bench.power(8, False)
    asked.bench.power(8, True)
    asked.bring_up()
    assert asked.inputs("00 00") == "BE EF"
    orders["mirror"](["8"])
    assert asked.inputs("01 02") == "01 02"


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ("set valves.levle=1", "did you mean level"),
        ("set valves.level=300", "level = 300 is outside 0..255"),
        ("set valves.limit=maybe", "write on or off"),
        ("set fan.level=1", "there are: valves .8."),
        ("set level", "write it as 8.limit=on"),
        ("input valves 01", "2 octets of inputs, 1 octet given"),
        ("input valves 1 01", "no GSD file says what its slots are; write `input SLAVE HEX`"),
        ("input valves xy", "no hex digit"),
    ],
)
def test_wrong_inputs_change_nothing(order: str, says: str) -> None:
    asked = Asked()
    orders = slave_handlers(asked.bench)
    orders["set"](["valves.level=9"])
    name, *args = order.split()
    with pytest.raises(UsageError, match=says):
        orders[name]([*(["valves.level=1"] if name == "set" else []), *args])
    assert asked.inputs("00 00") == "00 09"


def test_inputs_of_one_module() -> None:
    bench = VirtualBench(World(), BusParams.preset(500_000))
    terminal = {"gsd": "examples/terminal.gsd", "modules": ["8 DI", "8 DO", "", "4 AI"]}
    bench.add(slave_config({"name": "io", "address": 8, **terminal}))
    orders = slave_handlers(bench)
    orders["input"](["io", "4", "00 01 00 02 00 03 00 04"])
    orders["input"](["io", "1", "7F"])
    assert bench.units[8].inputs.hex() == "7f0001000200030004"
    with pytest.raises(UsageError, match="no 1 octet of inputs; there are: slot 1: 1 octet, slot 4: 8 octets"):
        orders["input"](["io", "2", "01"])


@in_virtual_time
async def test_inputs_of_a_run_on_a_simulated_bus() -> None:
    events: list[str] = []
    async with operating(RAW, IO, FAN, on_event=lambda event: events.append(event.text)) as bus:
        handlers = control_run(bus, "virtual")._handlers

        async def order(text: str) -> None:
            name, *args = text.split()
            result = handlers[name](args)
            if inspect.isawaitable(result):
                await result

        await order("set raw.level=200 raw.open=on")
        await order("input io 0102")
        await order("set io.second=3")
        await bus.rotated(bus.stats.rotations + 3)
        assert (bus.slave("raw").inputs, bus.slave("raw").outputs) == (b"\x00\xc8", b"\x01")
        assert bus.slave("io").inputs == b"\x01\x03"
        for text, says in (
            ("input fan 00", "simulated drive makes its inputs"),
            ("mirror io", "mirrors nothing"),
            ("set fan.speed=1", "no output is called"),
        ):
            with pytest.raises(UsageError, match=says):
                await order(text)
    assert "slave 9 (raw): set level=200 (dpstack ctl)" in events
    assert "slave 7 (io): input 0102 (dpstack ctl)" in events
