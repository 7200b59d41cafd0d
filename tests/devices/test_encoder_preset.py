"""Presets of encoders: octets of the manual, the handshake under lost exchanges, and what ends an order."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from api_kit import begun
from hypothesis import given, settings
from hypothesis import strategies as st

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.control.control_server import ControlServer
from dpstack.api.control.handlers import control_run
from dpstack.devices import finding
from dpstack.devices.encoder_core import EncoderCore
from dpstack.devices.examples import run_examples
from dpstack.devices.model import EncoderFile
from dpstack.errors import SlaveError, SlaveTimeout, UsageError
from dpstack.plant.quality import Quality, Reason

MS = 1_000_000
SENSOR: dict[str, Any] = {"name": "spindle", "address": 5, "device": "simodrive-sensor"}


class Bench:
    """The master's end alone: inputs are those of the test, every rotation takes 10 ms."""

    def __init__(self, telegram: str = "class2", **options: object) -> None:
        core = finding.find_device("simodrive-sensor").core("spindle", telegram, options)
        assert isinstance(core, EncoderCore)
        self.core, self.now = core, 0
        self.events: list[dict[str, object]] = []

    def see(self, inputs: str, rotations: int = 1) -> str:
        out = b""
        for _ in range(rotations):
            self.now += 10 * MS
            out = self.core.cyclic(bytes.fromhex(inputs), self.now)
            self.events += self.core.take_events()
        return out.hex(" ").upper()

    def order(self, **args: object) -> None:
        self.core.command("preset", args, 1, self.now)
        self.events += self.core.take_events()

    @property
    def result(self) -> object:
        (found,) = [one for one in self.events if one["type"] == "result"]
        return found["value"] if found["ok"] else (found["error"], found["text"])


def test_class_2_confirms_by_the_position_alone() -> None:
    """BEI 03/10, page 16: master 1 | value, encoder 0 | new = value, master 0. For the value 1000."""
    bench = Bench()
    assert bench.see("00 00 18 00", 5) == "00 00 00 00"
    bench.order(value=1000)
    assert bench.see("00 00 18 00", 4) == "80 00 03 E8"  # the strobe was seen at 0 before
    assert bench.see("00 00 03 E8", 3) == "80 00 03 E8"  # held for 50 ms
    assert not bench.events
    assert bench.see("00 00 03 E8", 2) == "00 00 03 E8"
    assert bench.result == 1000


def test_versions_2_confirm_by_bit_31() -> None:
    """BEI 03/10, page 26: master bit 31 and value; encoder bit 31, bit 25 and the value; master bit 31 = 0."""
    bench = Bench("2.1")
    bench.see("02 00 18 00", 5)
    bench.order(value=1000)
    assert bench.see("02 00 03 E8", 20) == "80 00 03 E8"  # the position alone does not confirm it
    assert bench.see("82 00 03 E8") == "00 00 03 E8"
    assert bench.result == 1000
    bench.events.clear()
    bench.order(value=2000)
    assert bench.see("82 00 03 E8", 20) == "00 00 03 E8"  # it still confirms the former one
    assert bench.see("02 00 03 E8") == "80 00 07 D0"


@pytest.mark.parametrize(
    ("args", "error"),
    [
        ({}, "preset takes the position"),
        ({"value": 1, "turns": 1}, "preset takes the position"),
        ({"value": 0.5}, "no whole number of counts"),
        ({"value": -1}, "-1 is outside 0..999"),
        ({"value": 1000}, "1000 is outside 0..999"),
        ({"value": "x"}, "value must be a number"),
        ({"value": 1, "speed": 1}, "unknown argument 'speed'"),
        ({"value": 1, "tolerance": "x"}, "tolerance must be a number"),
    ],
)
def test_wrong_values_send_nothing(args: dict[str, object], error: str) -> None:
    bench = Bench(counts_per_turn=100, range=1000)
    bench.see("00 00 00 00", 5)
    bench.order(**args)
    assert error in str(bench.result)
    assert bench.see("00 00 00 00", 5) == "00 00 00 00"


def test_turns_signs_and_the_other_direction() -> None:
    bench = Bench(counts_per_turn=100, range=1000, signed=True, backwards=True)
    bench.see("00 00 00 00", 5)
    bench.order(turns=2.5)
    assert bench.see("00 00 00 00", 4) == "80 00 02 EE"  # 1000 - 250
    assert bench.see("00 00 02 EE", 9) == "00 00 02 EE"
    assert bench.result == 250


def test_a_preset_ends_with_its_time_and_with_data_exchange() -> None:
    bench = Bench()
    bench.see("00 00 18 00", 5)
    bench.order(value=1000, timeout_s=0.3)
    assert bench.see("00 00 18 00", 31) == "00 00 03 E8"
    assert bench.result == (
        "timeout",
        "its position is 6144, not 1000. It may have taken the preset and turned on: look at its position. Does its "
        "shaft stand still, and are its class 2 functions on? For a shaft that turns give tolerance=COUNTS",
    )
    bench.events.clear()
    bench.order(value=1000)
    assert bench.see("00 00 18 00", 9) == "80 00 03 E8"
    bench.core.lost(bench.now)
    bench.events += bench.core.take_events()
    assert bench.result == ("lost", "the device left data exchange")
    assert bench.see("00 00 18 00", 20) == "00 00 00 00"  # never later by itself


def test_counts_beyond_the_range_are_reported_once() -> None:
    bench = Bench(counts_per_turn=100, range=1000)
    for counts in ("00 00 03 E7", "00 00 03 E8", "00 00 03 E9"):
        bench.see(counts)
    (notice,) = bench.events
    assert str(notice["text"]).startswith("its position is 1000, and its range ends at 999: compare")


@given(
    value=st.integers(0, 999),
    before=st.integers(0, 999),
    lost=st.lists(st.sampled_from(["", "request", "answer"]), min_size=80, max_size=80),
    confirms=st.booleans(),
)
@settings(max_examples=60, deadline=None)
def test_lost_exchanges_never_confirm_a_preset_that_was_not_made(
    value: int, before: int, lost: list[str], confirms: bool
) -> None:
    """A model of the device, written from the manual: an exchange takes the outputs and returns the inputs that were
    there before. A lost request reaches nobody; a lost answer leaves the master its former inputs."""
    bench = Bench("2.1" if confirms else "class2", counts_per_turn=100, range=1000)
    position, strobe, presets = before, False, []
    seen = (0).to_bytes(4, "big") if confirms else before.to_bytes(4, "big")
    bench.see(seen.hex(), 5)
    bench.order(value=value, timeout_s=0.6)
    for trouble in lost:
        outputs = bytes.fromhex(bench.see(seen.hex()))
        answer = (position | (strobe << 31 if confirms else 0)).to_bytes(4, "big")
        if trouble != "request":
            wanted = int.from_bytes(outputs, "big")
            if wanted >> 31 and not strobe:
                position = wanted & 0x7FFF_FFFF
                presets.append(position)
            strobe = bool(wanted >> 31)
            if trouble != "answer":
                seen = answer
    assert presets in ([], [value])
    result = bench.result
    if result == value:
        assert presets == [value] or before == value
    else:
        assert isinstance(result, tuple)
        assert result[0] == "timeout"
    if "request" not in lost and "answer" not in lost:
        assert presets == [value]
        assert result == value
    assert bench.core.outputs[0] >> 7 == 0


@pytest.mark.parametrize("name", ["simodrive-sensor", "tr-58"])
def test_the_examples_of_the_library(name: str) -> None:
    path = finding.path_of(name)
    assert path is not None
    file = finding.file_at(path)
    assert isinstance(file, EncoderFile)
    assert file.examples
    assert file.source
    assert "not tried" in file.tried
    assert [one.errors for one in run_examples(file)] == [()] * len(file.examples)


def test_examples_that_contradict_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "wheel.toml"
    head = 'format = 1\nname = "wheel"\nbase = "encoder"\n[telegrams]\n'
    head += 'one = { config = "F1", out = ["preset"], in = ["position"] }\n'
    rows = (
        ('inputs = "00 00 03 E8"\nvalues = { position = 999 }', "inputs 00 00 03 E8: position is 1000, not 999"),
        ('inputs = "00 00 03 E8"\nvalues = { turns = 1 }', "no value is called 'turns'; it has position"),
        ('inputs = "03 E8"', "inputs has 2 octets, telegram one has 4"),
        ('outputs = { "preset 1" = "80 00 00 02" }', "preset 1: it sends 00 00 00 00, 80 00 00 01, not 80 00 00 02"),
        ('outputs = { "preset" = "80 00 00 02" }', "preset: preset takes the position: value = 1000, or turns = 2.5"),
        ('outputs = { "start" = "80 00 00 02" }', "start: wheel has no order 'start'; it has preset"),
        ('outputs = { "preset x" = "80" }', "'preset x': write an order and a number, preset 1000 for instance"),
        ('inputs = "00 00 03 E8"\nstate = "running"', "an encoder has no state; leave it out"),
        ('telegram = "two"\ninputs = "00"', "wheel has no telegram 'two'; it has one"),
    )
    path.write_text(head + "".join(f"[[example]]\n{row}\n" for row, _ in rows))
    file = finding.file_at(path)
    assert isinstance(file, EncoderFile)
    found = [str(error) for one in run_examples(file) for error in one.errors]
    assert len(found) == len(rows)
    assert [error for error, (_, text) in zip(found, rows, strict=True) if f"[[example]]: {text}; " not in error] == []


# --- on a bus ----------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def bus_of(**more: object) -> AsyncIterator[dpstack.Bus]:
    slaves = [{**SENSOR, **more}]
    async with dpstack.open_bus(port="virtual", baud=1_500_000, slaves=slaves) as bus:
        await bus.operate()
        await bus.ready()
        await asyncio.sleep(0.05)
        yield bus


def octets_of(slave: dpstack.Slave) -> str:
    """Ext_Diag and the octets behind the six fixed ones."""
    diagnosis = slave.diagnosis
    assert diagnosis is not None
    return f"{'ext_diag' if diagnosis.ext_diag else ''} {b''.join(one.octets for one in diagnosis.blocks).hex()}"


@pytest.mark.virtual_time
async def test_an_encoder_turns_and_takes_a_preset() -> None:
    async with bus_of(telegram="2.2", simulated={"rpm": 600, "start": 16777216 - 4096}) as bus:
        spindle = bus.slave("spindle")
        assert spindle.orders == ("preset",)
        before = spindle["turns"]
        await asyncio.sleep(0.025)
        assert isinstance(before, float)
        assert before > 4095
        assert spindle["turns"] == pytest.approx(before + 0.25, abs=0.1)
        assert spindle["velocity"] == 32767  # 40960 counts/s are more than its word holds
        await asyncio.sleep(0.1)
        assert spindle["turns"] == pytest.approx((before + 1.25) % 4096, abs=0.1)
        assert await spindle.order("preset", value=1000) == 1000
        assert spindle["position"] == pytest.approx(1000, abs=6000)
        assert spindle.outputs.hex(" ") == "00 00 03 e8"
        unit = core_of(bus).bench.units[5]  # type: ignore[union-attr]
        assert unit.encoder is not None
        unit.encoder.turn(0)
        await asyncio.sleep(0.1)
        assert await spindle.order("preset", turns=2) == 8192
        assert spindle.value("turns").value == 2.0


@pytest.mark.virtual_time
async def test_alarms_and_warnings_of_the_diagnosis_are_doubts_of_the_values() -> None:
    async with bus_of() as bus:
        spindle = bus.slave("spindle")
        assert spindle.quality("position") is Quality.GOOD
        bench = core_of(bus).bench
        assert bench is not None
        encoder = bench.units[5].encoder
        assert encoder is not None
        encoder.trip("8.0")
        await asyncio.sleep(0.1)
        assert octets_of(spindle) == "ext_diag 3301" + "00" * 49  # octet 8, bit 0: page 27
        found = spindle.value("degrees")
        assert (found.quality, found.reason, found.text) == (Quality.BAD, Reason.DEVICE_FAULT, "position error")
        encoder.acknowledge()
        encoder.warn(0b010000)
        await asyncio.sleep(0.1)
        found = spindle.value("degrees")
        assert (found.quality, found.text) == (Quality.UNCERTAIN, "operating time exceeded")
        assert octets_of(spindle) == " 33" + "00" * 13 + "10" + "00" * 36  # octet 21, bit 4: page 28
        encoder.warn(0)
        await asyncio.sleep(0.1)
        assert spindle.quality("position") is Quality.GOOD


@pytest.mark.virtual_time
async def test_orders_that_cannot_be() -> None:
    async with bus_of() as bus:
        spindle = bus.slave("spindle")
        with pytest.raises(UsageError, match=r"slave 5 \(spindle\) has no order 'presett'; did you mean preset\?"):
            await spindle.order("presett", value=1)
        with pytest.raises(UsageError, match=r"16777216 is outside 0\.\.16777215"):
            await spindle.order("preset", value=1 << 24)
        with pytest.raises(
            UsageError, match=r"its plugin makes the outputs; give it an order, slave.order\(\) \(preset\)"
        ):
            spindle.outputs = bytes(4)
        with pytest.raises(UsageError, match="its user parameters decide how its plugin reads the position"):
            await spindle.reparameterise(user_prm=bytes(18))
        await bus.clear()
        with pytest.raises(SlaveTimeout, match="the bus is in Clear"):
            await spindle.order("preset", value=1, timeout=0.02)
        await bus.operate()
        waiting = await begun(spindle.order("preset", value=1, timeout=5), 0.03)
        await bus.clear()
        with pytest.raises(SlaveError, match="the device left data exchange: the bus is in Clear"):
            await waiting
        await bus.operate()
        await asyncio.sleep(0.1)
        assert spindle.outputs == bytes(4)
        pending = await begun(spindle.order("preset", value=1, timeout=5), 0.03)
        await bus.remove(spindle)
        with pytest.raises(SlaveError, match="the device left data exchange"):
            await pending
    async with dpstack.open_bus(
        port="virtual", baud=500_000, slaves=[{"name": "raw", "address": 9, "ident": 1, "config": "20"}]
    ) as bus:
        assert bus.slave(9).orders == ()
        with pytest.raises(UsageError, match="takes no orders"):
            await bus.slave(9).order("preset", value=1)


async def ordered(server: ControlServer, text: str) -> object:
    """The answer to a command of `dpstack ctl`."""
    name, *args = text.split()
    found = server._handlers[name](args)
    found = await found if inspect.isawaitable(found) else found
    if not callable(found):
        return found

    async def send(_item: object) -> None:
        pass

    return await found(send)


@pytest.mark.virtual_time
async def test_commands_of_ctl() -> None:
    async with bus_of(telegram="2.2") as bus:
        server, spindle = control_run(bus, "virtual"), bus.slave("spindle")
        answer = {"order": "preset", "slave": "spindle", "address": 5, "value": 1000}
        assert await ordered(server, "order spindle preset value=1000") == answer
        assert spindle["position"] == 1000
        await ordered(server, "turn 5 -60")
        await ordered(server, "trip spindle 8.4")
        await ordered(server, "warn spindle 1")
        await asyncio.sleep(0.1)
        assert spindle["velocity"] == -4096
        assert spindle.value("position").text == "memory error, speed too high"
        bench = core_of(bus).bench
        assert bench is not None
        assert bench.injected(5) == ["trip memory error", "warn 0001"]
        await ordered(server, "acknowledge spindle")
        for command, text in (
            ("order spindle preset 1000", "write NAME=VALUE"),
            ("order spindle preset value=x", "is no number"),
            ("order spindle start", "has no order 'start'; it has preset"),
            ("trip spindle 9.9", "no alarm of this device; known: 8.0 (position error)"),
            ("acknowledge spindle", "no alarm stands"),
            ("load spindle 1", "is no simulated drive: an encoder"),
            ("turn spindle x", "60"),
            ("set spindle.position=1", "the simulated encoder makes its inputs"),
        ):
            with pytest.raises((UsageError, ValueError)) as caught:
                await ordered(server, command)
            assert text in str(caught.value)


@pytest.mark.virtual_time
async def test_power_off_keeps_the_position() -> None:
    """An absolute encoder has its position and its zero point after power-on."""
    async with bus_of(simulated={"start": 77}) as bus:
        spindle, bench = bus.slave("spindle"), core_of(bus).bench
        await spindle.order("preset", value=1000)
        assert bench is not None
        bench.power("spindle", False)
        await spindle.wait_state(dpstack.SlaveState.OFFLINE, timeout=5)
        assert spindle.quality("position") is Quality.STALE
        bench.power("spindle", True)
        await spindle.ready()
        await asyncio.sleep(0.01)
        assert spindle["position"] == 1000
