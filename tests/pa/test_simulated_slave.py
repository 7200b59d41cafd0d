"""Simulated PA devices on a bus in virtual time: MS1, MS2, cyclic data, diagnosis, faults, what others read."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

import pytest
from pa_rack import RACK, Rack, slave
from support import WorldFactory

import dpstack
from dpstack.dp.pdu.pa_diagnosis import diagnosis_words
from dpstack.errors import AcyclicError, ConfigError, RecordRefused, UsageError
from dpstack.testing import BusFactory, SimulatedBus

#: printed by programs of others that read the rack (docs/development/foreign.md#process-devices): program, address,
#: slot, index, what it printed, the octets of the answer
PRINTED = (
    ("hablix", 4, 1, 70, "Found TRANSDUCER block at Slot 1 Index 70", "fa0302020001000100004002030200003801 7e01"),
    ("browser", 4, 1, 70, "Class: Resistance Thermometer", "fa0302020001000100004002030200003801 7e01"),
    ("hablix", 4, 0, 26, "Man Name = SIEMENS AG", "002a"),
    ("browser", 4, 0, 27, "Device ID: PA-TEMPERATURE", "50412d54454d50455241545552452020"),
    ("hablix", 4, 1, 26, "Output value = 20.0, status = 128", "41a0000080"),
    ("jannusch", 4, 1, 78, "PRIMARY_VALUE Value: 20.0 | Status: GOOD_NON_CASCADE", "41a0000080"),
    ("jannusch", 4, 1, 79, "Unit: °C (degree Celsius", "03e9"),
    ("jannusch", 4, 1, 91, "UPPER_SENSOR_LIMIT Value: 850.0", "44548000"),
    ("hablix", 5, 1, 26, "Output value = 50.0", "4248000080"),
    ("hablix", 6, 2, 26, "Output value = 10000.0", "461c400080"),
    ("jannusch", 6, 1, 88, "VOLUME_FLOW_UNITS Unit: m3/h", "0545"),
    ("jannusch", 6, 1, 90, "VOLUME_FLOW_HI_LIMIT Value: 100.0", "42c80000"),
    ("jannusch", 6, 0, 16, "MULTI_VARIABLE PHYSICAL_BLOCK", "fa017ffa0001000100004002030200002100310 1"),
    ("jannusch", 8, 1, 70, "ACTUATOR ELECTRO_PNEUMATIC", "fa03050200010001000040020302000049018f01"),
    ("jannusch", 8, 1, 16, "OUTPUT ANALOG_OUTPUT", "fa0202010001000100004002030200002b013b01"),
    ("jannusch", 9, 1, 16, "OUTPUT DISCRETE_OUTPUT", "fa02020200010001000040020302000027013701"),
    ("jannusch", 9, 2, 16, "INPUT DISCRETE_INPUT", "fa0201020001000100004002030200001d022d01"),
    ("jannusch", 4, 0, 34, "WRITE_LOCKING Value: 2457", "0999"),
)


def test_programs_of_others_read_these_octets() -> None:
    rack = Rack(records="one")
    try:
        found = {row[:4]: rack.read(*row[1:4]).hex() for row in PRINTED}
        assert found == {row[:4]: row[5].replace(" ", "") for row in PRINTED}
    finally:
        rack.close()


@pytest.fixture
def plant(dpstack_bus: BusFactory) -> Callable[..., SimulatedBus]:
    def make(*devices: str, **simulated: object) -> SimulatedBus:
        return dpstack_bus(slaves=[slave(5 + n, one, **simulated) for n, one in enumerate(devices)], baud=93_750)

    return make


def inputs(bus: SimulatedBus, name: str) -> dict[str, Any]:
    bus.wait(0.3)
    return bus.slave(name).input_values


def test_values_and_their_quality_follow_the_faults(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-pressure")
    device = bus.device("pa-pressure").process
    device.set_process(2.5)
    assert inputs(bus, "pa-pressure") == {"pressure": 2.5}
    device.sensor_failure(True)
    bus.wait(0.5)
    assert bus.device("pa-pressure").inputs.hex() == "4020000047"  # the last usable value
    seen = bus.slave("pa-pressure").diagnosis
    assert seen is not None
    # 14 octets: status FE, slot 0, a message appears, measurement failed with more in the extension, bit 0 of that
    assert seen.ext.hex(" ") == "0e fe 00 01 20 00 00 80 01 00 00 00 00 00"
    assert diagnosis_words(seen.ext[4:8]) == ("measurement failed (failure)", "more in DIAGNOSIS_EXTENSION")
    device.sensor_failure(False)
    bus.wait(0.5)
    seen = bus.slave("pa-pressure").diagnosis
    assert seen is not None
    assert seen.ext.hex(" ") == "08 fe 00 02 00 00 00 00"
    assert inputs(bus, "pa-pressure") == {"pressure": 2.5}


@pytest.mark.parametrize(
    ("coding", "order", "octets"),
    [
        ("classic", "maintenance required", "3f800000a4"),
        ("condensed", "maintenance required", "3f800000a4"),
        ("condensed", "maintenance demanded", "3f800000a8"),
        ("condensed", "maintenance alarm", "3f8000004b"),
        ("classic", "function-check on", "3f80000064"),
        ("condensed", "function-check on", "3f8000004b"),
        ("classic", "fail-safe on", "3f80000047"),
        ("classic", "out-of-service on", "3f8000001f"),
        ("condensed", "out-of-service on", "3f80000023"),
        ("classic", "simulate 7.5", "40f0000060"),
        ("condensed", "simulate 7.5 80 ai1", "40f0000084"),
        ("classic", "sensor-failure on", "3f80000047"),
        ("classic", "local-operation on", "3f80000080"),
        ("classic", "write-protect on", "3f80000080"),
        ("classic", "slow 2", "3f80000080"),
        ("classic", "process 3", "4040000080"),
        ("classic", "process 12", "4140000052"),
    ],
)
def test_commands_of_ctl(plant: Callable[..., SimulatedBus], coding: str, order: str, octets: str) -> None:
    from dpstack.api.control.simulation_handlers import slave_handlers

    bus = plant("pa-pressure", coding=coding)
    word, *rest = order.split()
    slave_handlers(bus._bench)[word](["pa-pressure", *rest])
    bus.wait(0.1)
    assert bus.device("pa-pressure").inputs.hex() == octets
    injected = bus._bench.status_of(5).get("injected", [])
    assert word == "process" or any(word in str(one) for one in injected)  # type: ignore[attr-defined]


def test_a_jammed_valve(plant: Callable[..., SimulatedBus]) -> None:
    from dpstack.api.control.simulation_handlers import slave_handlers

    bus = plant("pa-positioner")
    slave_handlers(bus._bench)["jam"](["pa-positioner", "on"])
    bus.slave("pa-positioner")["valve"] = 40.0
    found = inputs(bus, "pa-positioner")
    assert (found["valve_readback"], found["valve_checkback_control_error"]) == (0.0, True)


def test_wrong_commands_say_what_is_possible(plant: Callable[..., SimulatedBus]) -> None:
    from dpstack.api.control.simulation_handlers import slave_handlers

    bus = plant("pa-pressure")
    handlers = slave_handlers(bus._bench)
    for command, args, said in (
        ("maintenance", ["much"], "maintenance is required, demanded, alarm or off, not 'much'"),
        ("process", ["1", "colour"], "'colour' is no process value of this device; it has pressure, temperature"),
        ("jam", ["on"], "it has no valve"),
        ("simulate", ["1", "80", "ai7"], "ai7 has no SIMULATE; there are: AI1"),
        ("slow", ["61"], "'61' is no number from 0 to 60"),
        ("fail-safe", ["yes"], "'yes' is neither on nor off"),
    ):
        with pytest.raises(UsageError, match=said):
            handlers[command](["pa-pressure", *args])


def test_a_set_point_moves_the_valve_and_clear_closes_it(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-positioner")
    name = "pa-positioner"
    assert bus.device(name).process.model.block("AO1").part("sp", "status") == 0  # no user's value stands
    bus.slave(name)["valve"] = 40.0
    bus.wait(3)
    found = inputs(bus, name)
    assert (found["valve_readback"], found["valve_pos_d"], found["valve_checkback_fail_safe"]) == (40.0, 3, False)
    bus.run(bus.master.clear())
    bus.wait(5)
    assert bus.device(name).process.model.process["position"] == 0
    assert bus.device(name).inputs.hex() == "0000000081" + "0180" + "010000"


def test_records_over_both_classes_with_refusals(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-pressure")
    pressure = bus.slave("pa-pressure")

    async def program() -> None:
        assert await pressure.read(1, 16 + 11) == bytes.fromhex("41200000 00000000")
        async with bus.master.class2.connect(5) as connection:
            assert await connection.read(1, 16 + 11) == bytes.fromhex("41200000 00000000")
            await connection.write(1, 16 + 2, b"PT 101".ljust(32))
            assert (await connection.read(1, 17)).hex() == "0001"
            assert len(await connection.read(1, 16 + 40)) == 2 + 3 + 8 + 5  # view 1
            for slot, index, octets, code in ((1, 19, b"\0", 0xB1), (0, 26, b"\0\0", 0xB6), (7, 16, b"\0", 0xB2)):
                with pytest.raises(AcyclicError) as caught:
                    await connection.write(slot, index, octets)
                assert f"{code:02X}" in str(caught.value)

    bus.run(program())


def test_a_slow_device_answers_later(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-pressure", answer_s=2.0)

    async def program() -> float:
        async with bus.master.class2.connect(5) as connection:
            begun = bus.now
            assert (await connection.read(0, 26)).hex() == "ffff"
            im = await connection.im()
            assert isinstance(im, dpstack.Im0)
            assert im.order_id == "PA-PRESSURE"
            return bus.now - begun

    assert 2.0 <= bus.run(program()) < 6.5


def test_prm_cond_switches_the_coding(dpstack_bus: BusFactory) -> None:
    """Set_Prm with a structure of type 65 (PA.h): length 5, slot 0, reserved, options with bit 0 PRM_COND."""
    table = slave(5, "pa-pressure") | {"user_prm": "80 00 08 05 41 00 00 01"}
    bus = dpstack_bus(slaves=[table], baud=93_750)
    model = bus.device(5).process.model
    assert (model.condensed, model.physical.octets_of("feature")[4] & 1) == (True, 1)
    bus.device(5).process.out_of_service(True)
    bus.wait(0.1)
    assert bus.device(5).inputs[4] == 0x23


def test_power_off_keeps_the_parameters(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-flow")
    device = bus.device("pa-flow").process
    bus.wait(36)
    device.model.block("AI1").put("tag_desc", "FT 7")
    with bus.faults.power_off("pa-flow"):
        bus.wait(5)
    bus.wait(3)
    after = bus.device("pa-flow").process
    assert after.model.block("AI1").get("tag_desc") == "FT 7"
    assert after.model.block("TOT1").part("total", "value") == pytest.approx(0.12, abs=0.01)
    seen = bus.slave("pa-flow").diagnosis
    assert seen is not None
    assert diagnosis_words(seen.ext[4:8]) == ("warm start",)


def test_held_values_and_their_end(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-level")
    bus.device("pa-level").set(level=77.0)
    assert inputs(bus, "pa-level")["level"] == 77.0
    assert bus.device("pa-level").process.model.block("AI1").part("out", "value") == 77.0
    bus.device("pa-level").mirror()
    assert inputs(bus, "pa-level")["level"] == 50.0


def test_the_address_of_a_reset_device(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-pressure")

    async def program() -> None:
        async with bus.master.class2.connect(5) as connection:
            await connection.write(0, 16 + 19, (2712).to_bytes(2, "big"))

    with contextlib.suppress(dpstack.DpError):  # it may be gone before it answers
        bus.run(program())
    bus.wait(1)
    assert bus._bench.units[5].address == 126


def test_ident_numbers(plant: Callable[..., SimulatedBus]) -> None:
    """IDENT_NUMBER_SELECTOR 127 adapts; the profile's number is that of the file here."""
    device = plant("pa-pressure").device(5).process
    device.model.physical.put("ident_number_selector", 0)
    device._judge_ident()
    assert device.ident == 0x9700


@pytest.mark.parametrize(
    ("simulated", "said"),
    [
        ({"lie": "big"}, "no lie 'big'"),
        ({"kind": "beer"}, "kind must be"),
        ({"profile": 5}, "profile"),
        ({"colour": 1}, "no option or value 'colour'"),
        ({"pressure": "x"}, "pressure = 'x' is no number"),
    ],
)
def test_options_that_cannot_be(simulated: dict[str, object], said: str) -> None:
    from dpstack.api.config.config import slave_config
    from dpstack.api.slave_side.virtual_bench import device_of

    with pytest.raises(ConfigError, match=said):
        device_of(slave_config(slave(5, "pa-pressure", **simulated)))


@pytest.mark.parametrize(
    "lie", ["outside", "lengths", "long views", "changing", "control characters", "short parameters"]
)
def test_lies_reach_the_master(plant: Callable[..., SimulatedBus], lie: str) -> None:
    bus = plant("pa-pressure", lie=lie)
    model = bus.device(5).process.model

    async def program() -> list[bytes]:
        async with bus.master.class2.connect(5) as connection:
            return [await connection.read(1, 1), await connection.read(0, 18), await connection.read(0, 49)]

    directory, tag, view = bus.run(program())
    assert (len(view) == 240) is (lie == "long views")
    assert (b"\x1b" in tag) is (lie == "control characters")
    assert (directory == model.layout.directory(model.blocks)[1]) is (lie not in ("outside", "circles"))


def test_a_refusal_is_no_failure_of_the_device(plant: Callable[..., SimulatedBus]) -> None:
    bus = plant("pa-pressure")
    with pytest.raises(RecordRefused):
        bus.device(5).process.model.read(9, 9)
    assert bus.device_failures == []


def test_a_whole_segment_under_the_eyes_of_the_referee(world: WorldFactory) -> None:
    """Six devices, records of both classes beside data exchange, faults and their ends, a device switched off."""
    line = world()
    slaves = [slave(3 + n, name) for n, name in enumerate(RACK.values())]
    bench = dpstack.simulate(line, slaves, baud=93_750)

    async def program() -> None:
        async with dpstack.open_bus(world=line, baud=93_750, slaves=slaves) as bus:
            await bus.ready()
            await bus.operate()
            async with bus.class2.connect(7) as valve:
                for at in range(0, 30, 5):
                    await bus.slave(3).read(1, 16 + 11)
                    await valve.read(1, 16 + 9)
                    bench.process_device(3).sensor_failure(at % 10 == 0)
                await valve.write(0, 16 + 27, b"\1")
            bench.power(4, False)
            await asyncio.sleep(1)
            bench.power(4, True)
            await asyncio.sleep(1)
            assert [one.state.value for one in bus.slaves] == ["data_exchange"] * len(slaves)

    dpstack.run_virtual(program())
    assert bench.process_device(7).model.condensed
