"""``after_return`` for applications: programs, the configuration, orders from outside, and what every door shows."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import FAN, bench_of, bus_of, off_and_on

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.bus.events_json import event_json
from dpstack.api.bus.picture import picture_of
from dpstack.api.config.config import make_config, parse_config
from dpstack.api.control.handlers import run_status
from dpstack.api.control.orders import carry_out
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import OutputsWithheld
from dpstack.errors import ConfigError, SlaveError, UsageError
from dpstack.plant.orders import SetOctets, SetOutputs
from dpstack.trace import Event

pytestmark = pytest.mark.virtual_time

#: a drive that starts by level: a control word and a set point
TURNS: dict[str, object] = {
    "name": "turns",
    "address": 9,
    "ident": 0x1234,
    "config": "21 11",
    "safe": "01 00",
    "after_return": "safe",
    "outputs": {"control": "u8@0", "speed": "u8@1"},
}
#: Data_Exchange of master 2 with slave 9 and two octets of outputs (SD2, LE = 5, FC without the frame count bit)
DATA = bytes.fromhex("68 05 05 68 09 02")


class Wire:
    """The outputs to slave 9 by the log of the wire, without repetitions; and the referee of the wire."""

    def __init__(self, table: dict[str, object], **more: Any) -> None:
        self.sent: list[str] = []
        self.world = world = dpstack.World(seed=1)
        world.log.listener = self._add
        self.bench = dpstack.simulate(world, [table], baud=500_000)
        self.bus = bus_of(table, world=world, **more)

    async def off_and_on(self) -> None:
        self.bench.power(9, False)
        await self.bus.until(lambda: not self.bus.slave(9).ready_now, 5)
        self.bench.power(9, True)
        await self.bus.slave(9).ready()
        await asyncio.sleep(0.5)

    def judge(self) -> None:
        assert self.world.referee is not None
        self.world.referee.check()

    def _add(self, entry: Any) -> None:
        octets = entry.octets
        if octets[:6] == DATA and len(octets) == 11 and octets[7:9].hex() not in self.sent[-1:]:
            self.sent.append(octets[7:9].hex())


async def test_a_slave_that_goes_away_and_returns_on_the_wire() -> None:
    """The referee has no complaint, and the wire log has the safe octets from the return to the next set."""
    told: list[Event] = []
    wire = Wire(TURNS, on_event=told.append)
    async with wire.bus as bus:
        turns = bus.slave("turns")
        await turns.ready()
        await bus.operate()
        turns.update({"control": 0x7F, "speed": 50})
        await bus.rotated(bus.stats.rotations + 5)
        await wire.off_and_on()
        assert wire.sent == ["7f32", "0100"]
        assert turns.outputs == turns.outputs_sent == b"\x01\x00"
        assert turns.outputs_withheld == b"\x7f\x32"
        (event,) = [one for one in told if isinstance(one, OutputsWithheld)]
        assert event_json(event, 1.5) == {
            "event": "outputs_withheld",
            "t": 1.5,
            "address": 9,
            "name": "turns",
            "outputs": "7f32",
            "text": event.text,
        }
        turns["speed"] = 20  # the other value stays safe: nobody has ordered it
        await bus.rotated(bus.stats.rotations + 5)
        assert picture_of(core_of(bus), turns).withheld is None
        turns["control"] = 0x7F
        await bus.rotated(bus.stats.rotations + 5)
    assert wire.sent == ["7f32", "0100", "0114", "7f14", "0100", "0000"]
    wire.judge()


async def test_a_slave_that_resumes_has_its_outputs_at_once() -> None:
    wire = Wire(TURNS | {"after_return": "resume"})
    async with wire.bus as bus:
        turns = bus.slave("turns")
        turns.outputs = b"\x7f\x32"
        await bus.operate()
        await turns.ready()
        await wire.off_and_on()
        assert wire.sent == ["7f32"]
        assert turns.outputs_withheld is None
    wire.judge()


async def test_what_every_door_shows_meanwhile() -> None:
    async with bus_of(TURNS) as bus:
        turns = bus.slave("turns")
        await turns.ready()
        await bus.operate()
        turns.update({"control": 0x7F, "speed": 50})
        await off_and_on(bus, 9)
        await bus.rotated(bus.stats.rotations + 5)
        values = picture_of(core_of(bus), turns)
        assert (values.outputs, values.held, values.withheld) == ("0100", "7f32", True)
        assert values.fields == {"control": 1, "speed": 0}
        assert values.held_fields == {"control": 0x7F, "speed": 50}
        assert values.level == "warning"
        assert values.remark is not None
        assert values.remark.text == "it was away: its outputs stay at their safe values until they are set anew"
        status: Any = run_status(bus)
        found = status["slaves"]["9"]
        assert (found["outputs"], found["held"], found["withheld"]) == ("0100", "7f32", True)
        stats = bus.stats.slaves[9]
        assert (stats.outputs, stats.held, stats.withheld) == (b"\x01\x00", b"\x7f\x32", True)
        assert stats.as_dict()["withheld"] is True
        turns["speed"] = 0
        values = picture_of(core_of(bus), turns)
        assert (values.outputs, values.held, values.withheld, values.remark) == ("0100", None, None, None)
        assert values.level == "good"
        assert "withheld" not in bus.stats.slaves[9].as_dict()


async def test_orders_that_would_be_withheld_are_refused() -> None:
    """Also those of ``dpstack ctl``, which may prepare outputs of other slaves."""
    async with bus_of(TURNS) as bus:
        turns = bus.slave("turns")
        await turns.ready()
        await bus.operate()
        bench_of(bus).power(9, False)
        await bus.until(lambda: not turns.ready_now, 5)
        for order in (SetOutputs(9, {"speed": 20}), SetOctets(9, b"\x7f\x00")):
            with pytest.raises(SlaveError, match=r'after_return = "safe": set its outputs when it is back$'):
                await carry_out(bus, order)
        assert turns.outputs == b"\x01\x00"
        await carry_out(bus, SetOctets(9, b"\x01\x00"))  # that is safe
        bench_of(bus).power(9, True)
        await turns.ready()
        assert await carry_out(bus, SetOutputs(9, {"speed": 20}), now=True) is None
        assert turns.outputs == b"\x01\x14"
        await bus.clear()
        await bus.until(lambda: bus.mode is Mode.CLEAR, 1)
        assert await carry_out(bus, SetOutputs(9, {"speed": 30})) is not None  # held until operate
        await bus.operate()
        assert turns.outputs_sent == b"\x01\x1e"


async def test_it_can_be_chosen_while_the_bus_runs() -> None:
    async with bus_of(TURNS | {"after_return": "resume"}) as bus:
        turns = bus.slave("turns")
        await turns.ready()
        await bus.operate()
        turns.outputs = b"\x7f\x32"
        await turns.reparameterise(after_return="safe")
        assert turns.outputs == b"\x01\x00"  # other parameters are a way of being away
        turns.outputs = b"\x7f\x32"
        await turns.reparameterise(after_return=None)
        assert turns.outputs == b"\x01\x00"  # by the rule that held as it went away
        turns.outputs = b"\x7f\x32"
        await off_and_on(bus, 9)
        assert turns.outputs == b"\x7f\x32"


CONFIG = """
[bus]
port = "virtual"
baud = 500000

[[slave]]
name = "it"
address = 9
{keys}
"""


@pytest.mark.parametrize(
    ("keys", "chosen"),
    [
        ('ident = 0x1234\nconfig = "21 11"', "resume"),
        ('ident = 0x1234\nconfig = "21 11"\nafter_return = "resume"', "resume"),
        ('ident = 0x1234\nconfig = "21 11"\nafter_return = "safe"', "safe"),
        ('gsd = "io-station"\nmodules = ["8 DO"]\nafter_return = "safe"', "safe"),
    ],
)
async def test_the_key(keys: str, chosen: str) -> None:
    assert parse_config(CONFIG.format(keys=keys)).slaves[0].params.after_return == chosen


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        (
            'ident = 0x1234\nconfig = "21 11"\nafter_return = "save"',
            '11: [[slave]] it: unknown after_return \'save\'; it must be "resume" or "safe"',
        ),
        (
            'drive = "fuji-frenic"\nident = "ask"\nafter_return = "safe"',
            "11: [[slave]] it: after_return beside drive; leave it out: a drive never starts by itself after it was "
            "away, start() starts it again",
        ),
    ],
)
async def test_a_wrong_key(keys: str, text: str) -> None:
    with pytest.raises(ConfigError) as wrong:
        parse_config(CONFIG.format(keys=keys))
    assert str(wrong.value).endswith(text)


async def test_a_drive_cannot_get_it_while_it_runs() -> None:
    async with bus_of(FAN) as bus:
        with pytest.raises((ConfigError, UsageError), match="after_return beside drive; leave it out"):
            await bus.slave(4).reparameterise(after_return="safe")


async def test_a_drive_by_octets_does_not_start_by_itself_either() -> None:
    """``run --outputs``: the octets of a running drive come without its plugin, and go out once."""
    config = make_config("virtual", 500_000, slaves=[FAN]).with_outputs({4: bytes.fromhex("047F 1000")})
    async with dpstack.open_bus(config) as bus:
        fan = bus.slave(4)
        await bus.operate()
        await fan.ready()
        assert fan.outputs_sent == bytes.fromhex("047F 1000")
        await off_and_on(bus, 4)
        assert fan.outputs_sent == fan.setup.safe_outputs
        assert fan.outputs_withheld == bytes.fromhex("047F 1000")
