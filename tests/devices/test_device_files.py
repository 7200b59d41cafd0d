"""Drives as device files: octets on the line, free words, orders, faults; the conformance checks over both bases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from api_kit import bus_of

import dpstack
from dpstack.devices.finding import find
from dpstack.profile import State
from dpstack.testing import DriveConformance

HERE = Path(__file__).parent
SAMPLE = {"name": "fan", "address": 4, "drive": str(HERE / "sample.toml"), "ident": 0x80E5}
pytestmark = pytest.mark.virtual_time


def core_of(name: str, telegram: str | None = None) -> Any:
    return find(str(HERE / name)).core("fan", telegram, {"check_settings": False})


def told(core: Any, octets: str, now: int) -> str:
    """The outputs in hex after these inputs."""
    return str(core.cyclic(bytes.fromhex(octets), now).hex(" ", 2).upper())


class TestSample(DriveConformance):
    profile = find(str(HERE / "sample.toml"))
    keys = {"ident": 0x80E5, "dpv1": True, "user_prm": "C0 00 00"}
    telegrams = ("352", "2")


class TestBits(DriveConformance):
    profile = find(str(HERE / "by_bits.toml"))
    keys = {"ident": 0x6002}


async def test_words_and_constants_stand_in_their_places() -> None:
    core = core_of("sample.toml")
    assert core.safe_outputs.hex(" ", 2) == "047e 0000 4000 0000 0000 1234"
    assert told(core, "0240 0000 0000 0000 0000 0000", 10_000_000) == "047E 0000 4000 0000 0000 1234"
    core.set_speed(-0.5)
    assert told(core, "0240 0000 0000 0000 0000 0000", 11_000_000) == "047E E000 4000 0000 0000 1234"
    core.command("set", {"values": [{"name": "torque_limit", "value": 80}]}, 1, 12_000_000)
    core.command("jog_on", {}, 2, 12_000_000)
    assert told(core, "0240 0000 0000 0000 0000 0000", 13_000_000) == "247E E000 3333 0000 0000 1234"
    core.lost(14_000_000)  # nothing that a program has set outlives the absence of the drive
    assert told(core, "0240 0000 0000 0000 0000 0000", 15_000_000) == "047E E000 4000 0000 0000 1234"


async def test_a_fault_and_a_warning_by_number() -> None:
    core = core_of("sample.toml")
    status = core.read_inputs(bytes.fromhex("0288 0000 0000 0000 1E7E 7531"), 0x047E)
    assert (status.state, status.faults, status.warnings) == (State.FAULT, ("F30001 overcurrent",), ("A07806",))
    status = core.read_inputs(bytes.fromhex("0288 0000 0000 0000 0000 0001"), 0x047E)
    assert (status.faults, status.warnings) == (("F00001",), ())


async def test_a_fault_number_in_the_high_octet_while_its_bit_is_set() -> None:
    core = core_of("by_bits.toml")
    status = core.read_inputs(bytes.fromhex("0B20 0000 0000"), 0x0002)
    assert (status.state, status.faults) == (State.FAULT, ("overtemperature",))
    assert core.read_inputs(bytes.fromhex("0B03 1388 01F4"), 0x0006).faults == ()  # another meaning without the bit
    status = core.read_inputs(bytes.fromhex("0403 1388 01F4"), 0x0006)
    assert (status.state, status.speed, status.current) == (State.RUNNING, 0.5, 0.5)


async def test_the_other_direction_is_a_bit() -> None:
    core = core_of("by_bits.toml")
    core.set_speed(-0.25)
    assert told(core, "0002 0000 0000", 10_000_000) == "0102 09C4 07D0"
    assert core.decode(bytes.fromhex("0102 09C4 07D0")) == (0x0102, -0.25)


async def test_telegram_2_has_32_bits() -> None:
    core = core_of("sample.toml", "2")
    core.set_speed(0.5)
    assert told(core, "0240 0000 0000 0000", 10_000_000) == "047E 2000 0000 0000"
    assert core.read_inputs(bytes.fromhex("0307 E000 0000 0000"), 0x047F).speed == -0.5


async def test_the_basic_positioner_is_switched_on_without_a_traversing_task() -> None:
    core = core_of("sample.toml", "111")
    at_rest = "0240 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000"
    assert core.safe_outputs.hex(" ", 2) == "043e 0000 0000 0000 0000 0000 0000 0000 0000 4000 4000 0000"
    core.command("start", {}, 1, 9_000_000)
    now, status = 10_000_000, ("0240", "0231", "0233", "0237")
    sent = []
    for word in (one for one in status for _ in range(20)):
        now += 5_000_000
        sent.append(told(core, at_rest.replace("0240", word, 1), now)[:4])
    assert set(sent) == {"043E", "043F"}  # bit 6, activate traversing task, stays 0
    core.command("set", {"values": [{"name": "target_position", "value": -10_000}]}, 2, now)
    assert told(core, at_rest.replace("0240", "0237", 1), now + 1)[25:34] == "FFFF D8F0"
    with pytest.raises(ValueError, match="telegram 111 has no speed set point"):
        core.setpoint_word(0.5)


async def test_free_words_are_set_and_named_values_are_read_by_name() -> None:
    async with bus_of(SAMPLE) as bus:
        await bus.ready()
        await bus.operate()
        fan, drive = bus.slave("fan"), bus.drive("fan")
        drive.speed = 0.5
        await drive.start()
        await drive.reached()
        assert fan["speed"] == pytest.approx(50, abs=0.6)
        fan["torque_limit"] = 25
        await bus.rotated(bus.stats.rotations + 2, 10)
        assert (fan["torque_limit"], fan.outputs.hex(" ", 2)) == (25, "047f 2000 1000 0000 0000 1234")
        for value, text in (
            (101, "torque_limit 101 % is outside 0..100 %"),
            ("much", "torque_limit is i16: 'much' is not a number"),
        ):
            with pytest.raises(dpstack.UsageError, match=text):
                fan["torque_limit"] = value
        with pytest.raises(dpstack.UsageError, match="or set torque_limit by name"):
            fan.outputs = bytes(12)
        await bus.clear()
        await bus.operate()
        await bus.rotated(bus.stats.rotations + 2, 10)
        assert fan.outputs.hex(" ", 2) == "047e 2000 4000 0000 0000 1234"  # back at its neutral value, and not running


BY_DRIVE = """
format = 1
name = "asked"
base = "profidrive"

[telegrams]
1 = { out = ["control", "setpoint"], in = ["status", "speed"] }

[reference]
rpm = "p2000"

[channel]
dialect = "paged"

[parameters]
p2000 = { number = 2000, type = "f32", unit = "rpm", low = 6, high = 210000, factory = 3000 }
"""


async def test_the_reference_is_read_from_the_drive_and_again_when_it_changes(tmp_path: Path) -> None:
    (tmp_path / "asked.toml").write_text(BY_DRIVE)
    asked = SAMPLE | {"drive": str(tmp_path / "asked.toml"), "telegram": "PPO1", "simulated": {"p2000": 1500}}
    async with bus_of(asked) as bus:
        drive = bus.drive("fan")
        with pytest.raises(dpstack.UsageError, match="nobody knows how many rpm 100 % is"):
            drive.rpm = 750
        await bus.ready()
        await bus.operate()
        await bus.until(lambda: drive.status.reference_rpm is not None, 5)
        drive.rpm = 750
        await drive.start()
        await drive.reached()
        assert drive.status.speed_rpm == pytest.approx(750, abs=10)
        assert drive.slave.outputs[-4:].hex(" ", 2) == "047f 2000"
        with pytest.raises(dpstack.UsageError, match="nobody knows how many Hz 100 % is"):
            drive.frequency = 25
        await drive.stop()
        assert (await drive.write("p2000", 3000)).value == 3000
        await bus.until(lambda: drive.status.reference_rpm == 3000, 5)
        drive.rpm = 750
        await bus.rotated(bus.stats.rotations + 2, 10)
        assert drive.slave.outputs[-4:].hex(" ", 2) == "047e 1000"


async def test_a_given_reference_is_compared_with_that_of_the_drive(tmp_path: Path) -> None:
    (tmp_path / "asked.toml").write_text(BY_DRIVE)
    asked = SAMPLE | {"drive": str(tmp_path / "asked.toml"), "telegram": "PPO1", "reference_rpm": 1500}
    async with bus_of(asked) as bus:
        await bus.ready()
        await bus.operate()
        with pytest.raises(
            dpstack.DriveFault, match="p2000 is 3000 rpm, not 1500 rpm: set p2000 = 1500, or the option ref"
        ):
            await bus.drive("fan").start()


async def test_the_bus_process_gets_the_file_that_was_read(tmp_path: Path) -> None:
    from dpstack.devices.finding import profile_at

    path = tmp_path / "sample.toml"
    path.write_text((HERE / "sample.toml").read_text())
    profile = find(str(path))
    assert profile_at(f"{profile.digest} {path}").telegrams == profile.telegrams
    path.write_text((HERE / "sample.toml").read_text() + "# changed\n")
    with pytest.raises(dpstack.ConfigError, match="has changed while the bus was opened; open it again"):
        profile_at(f"{profile.digest} {path}")


@pytest.mark.parametrize(
    ("change", "line", "text"),
    [
        (("torque_limit = { type", "torque_limit = { typ"), 13, "unknown key 'typ'; did you mean 'type'?"),
        (('"torque_limit", 0, 0, ', '"torque_limit", "torque_limit", 0, '), 10, "out names 'torque_limit' twice"),
        (('in = ["status", "speed"', 'in = ["status", "sped"'), 10, "in: 'sped' is no word of this file; did you mean"),
        (("C3 C5 C5 FD", "C3 C5 C4 FD"), 10, "telegram 352 has 12 octets of inputs and 12 of outputs, its identifiers"),
        (('base = "profidrive"', 'base = "profibus"'), 5, "base = 'profibus': there is no such file"),
        (("format = 1", "format = 2"), 2, "this dpstack reads format = 1"),
        (("low = 0, high = 100", "low = 0, high = 100, of = 0"), 13, "a scale of zero"),
        (('jog_on = { set = ["mop_up"] }', 'jog_on = { set = ["mop"] }'), 23, "'mop' is no bit of the control word"),
        (('p0922 = { equals = "{telegram}" }', "p0923 = { equals = 1 }"), 44, "'p0923' is no parameter of this file"),
        (('unknown = "F{:05d}"', 'unknown = "F{:05s}"'), 28, "has another place than {}"),
        (("mop_up = 13", "mop_up = 11"), 20, "reverse and mop_up are both bit 11"),
    ],
)
async def test_a_mistake_is_reported_by_line(tmp_path: Path, change: tuple[str, str], line: int, text: str) -> None:
    written = (HERE / "sample.toml").read_text()
    assert change[0] in written
    path = tmp_path / "sample.toml"
    path.write_text(written.replace(*change))
    with pytest.raises(dpstack.ConfigError) as raised:
        find(str(path))
    assert text in str(raised.value)
    assert f"sample.toml:{line}: " in str(raised.value) or "base =" in text


async def test_all_mistakes_of_a_file_are_found(tmp_path: Path) -> None:
    from dpstack.devices.finding import base_of
    from dpstack.devices.reader import DeviceFileError, Reader

    path = tmp_path / "sample.toml"
    text = (HERE / "sample.toml").read_text()
    path.write_text(
        text.replace("mop_up = 13", "mop_up = 16")
        .replace('{telegram}"', '{nothing}"')
        .replace("rpm = 1500", "rpm = -1")
    )
    with pytest.raises(DeviceFileError, match="more: `dpstack device check` shows them") as raised:
        Reader(path, base_of).read()
    assert [error.line for error in raised.value.errors] == [16, 20, 23, 24, 44]
