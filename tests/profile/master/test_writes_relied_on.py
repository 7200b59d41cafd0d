"""Writes to parameters that a plugin relies on (scale, source, setting, map): refused while the motor may turn, read
again at standstill, and what does not act at once keeps its old value."""

from __future__ import annotations

import asyncio
import dataclasses
import functools
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import drive_bench
import pytest
from api_kit import bench_of, in_virtual_time
from demag_kit import ZERO
from drive_bench import ALONE, BUS, MS, NONE, PZD, Named, PairBench, PluginBench, S
from msgspec import structs
from support import present

import dpstack
from dpstack.devices.model import DeviceFile
from dpstack.dpv1.master.plugin_queue import RecordQueue
from dpstack.profile import (
    POWER_ON,
    DriveCore,
    DriveDevice,
    DriveProfile,
    ParamSpec,
    ParamTable,
    Setting,
    SettingsState,
    Use,
    equal,
)
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.fuji import table as fuji
from dpstack_drives.fuji.plugin import FujiCore
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS


class Case(NamedTuple):
    drive: DriveProfile
    telegram: str | None
    simulated: Named
    write: Named
    #: the drive's text for the parameter
    label: str


#: scale, source, or a setting of each drive
RELIED = [
    Case(DEMAG, "PPO1", BUS, {"number": 390, "value": 100}, "390 (Profibus Reference)"),
    Case(DEMAG, "PPO1", BUS, {"number": "profibus_reference", "value": 100, "data_set": 1}, "390 (Profibus Reference)"),
    Case(DEMAG, "PPO1", BUS, {"number": 375, "value": 87, "ram": True}, "375 (Rated frequency)"),
    Case(DEMAG, "PPO1", BUS, {"number": 412, "value": 44}, "412 (Local/Remote)"),
    Case(DEMAG, "PPO1", BUS, {"number": 414, "value": 2}, "414 (Data set selection)"),
    Case(DEMAG, "PPO1", BUS, {"number": 434, "value": 1}, "434 (Ramp set point)"),
    Case(FUJI, "PPO1", NONE, {"number": "F03", "value": 100}, "F03 (Maximum frequency)"),
    Case(FUJI, "PPO1", NONE, {"number": 0x104, "index": 3, "value": 1000}, "F03 (Maximum frequency)"),
    Case(FUJI, "PPO2", NONE, {"number": "y98", "value": 0}, "y98 (Run and frequency command source)"),
    Case(FUJI, "PPO1", NONE, {"number": "initialise", "value": 1}, "970 (Initialise the inverter, 1 to 0)"),
    Case(LS, "PPO1", NONE, {"number": "COM-14", "value": 1}, "COM-14 (PROFIdrive value: 0 standard, 1 rpm)"),
    Case(LS, "PPO1", NONE, {"number": "COM-94", "value": 1}, "COM-94 (Comm update)"),
    Case(LS, "PPO1", NONE, {"number": 0x1114, "value": 50}, "dr-20 (Maximum frequency)"),
    Case(LS, "PPO1", NONE, {"number": "dr-06", "value": 1}, "dr-06 (Command source, 4: field bus)"),
    Case(LS, "PPO1", NONE, {"number": "0x1107", "value": 0}, "dr-07 (Frequency source, 8: field bus)"),
    Case(KEB, "PCH+4/4", NONE, {"number": "oP.0", "value": 2}, "oP.00 (reference source)"),
    Case(KEB, "PCH+4/4", NONE, {"number": 0x2301, "value": 8, "index": 1}, "oP.01 (rotation source)"),
    Case(IMO, None, PZD, {"number": "P00.06", "value": 0}, "P00.06 (Source of the set frequency)"),
    Case(IMO, None, PZD, {"number": 1, "value": 0}, "P00.01 (Run command channel)"),
]

pair = functools.partial(drive_bench.pair, rotation=4 * MS)


def running(case: Case) -> PairBench:
    bench = pair(case.drive, case.telegram, case.simulated)
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("reached")
    return bench


@pytest.mark.parametrize("case", RELIED, ids=lambda case: f"{case.drive.name}-{case.write['number']}")
def test_while_the_motor_turns_it_is_refused_with_what_to_do(case: Case) -> None:
    bench = running(case)
    wrote = bench.device.store.changes
    text = bench.misuse("write", **case.write)
    assert text == (
        f"{case.label} is not written: a start was ordered, and the plugin relies on its value; stop() it first, then "
        "do it at standstill"
    )
    bench.pass_time(500)
    assert bench.device.motor.frequency == pytest.approx(0.5)
    assert bench.device.store.changes == wrote
    assert bench.core.status().settings is SettingsState.CHECKED
    bench.order_and_run(30, "stop")
    assert "is not written: the drive is stopping" in bench.misuse("write", **case.write)


AFTERWARDS = [
    (RELIED[0], "390 is 100 Hz in data set 1"),
    (RELIED[3], "412 is 44: control not by the bus"),
    (RELIED[5], "434 is 1"),
    (RELIED[6], "F03 is 100 Hz, not 60 Hz"),
    (RELIED[8], "y98 is 0, not 3"),
    (RELIED[12], "dr-20 is 50 Hz, not 60 Hz"),
    (RELIED[13], "dr-06 is 1, not 4"),
    (RELIED[15], "oP.00 is 2, not 5"),
    (RELIED[16], "oP.01 is 8, not 9"),
    (RELIED[17], "P00.06 is 0, not 9"),
    (RELIED[18], "SW bits 13-14 are 0: its keypad commands the drive"),
]


@pytest.mark.parametrize(("case", "says"), AFTERWARDS, ids=lambda one: one if isinstance(one, str) else one.drive.name)
def test_at_standstill_it_is_written_and_read_again_at_once(case: Case, says: str) -> None:
    """No start is needed to hear of it."""
    bench = pair(case.drive, case.telegram, case.simulated)
    bench.pass_time(3000)
    assert bench.core.status().settings is SettingsState.CHECKED
    bench.ok("write", **case.write)
    assert bench.core.status().settings in (SettingsState.CHECKING, SettingsState.DIFFERENT)
    bench.pass_time(2000)
    assert bench.core.status().settings is SettingsState.DIFFERENT
    assert any(says in text for text in bench.core.status().settings_texts)
    assert any(says in text for text in bench.notices())


def test_a_data_set_that_a_contact_selects_while_it_runs_takes_speed_and_frequency_off_the_status() -> None:
    """390 is another one in data set 2: 25.0 Hz of the old scale were 50 Hz of the motor."""
    bench = running(RELIED[0])
    for number, value in ((390, 100), (412, 1), (434, 3)):
        spec = present(bench.device.store.table.get(number))
        bench.device.store.write(spec, spec.to_raw(value), 2)
    selection = present(bench.device.store.table.get(414))
    assert bench.core.status().frequency_hz == pytest.approx(25)
    bench.device.store.write(selection, 2)
    bench.pass_time(4000)
    assert bench.device.motor.frequency * 50 == pytest.approx(50, abs=1)
    status = bench.core.status()
    assert (status.running, status.settings) == (True, SettingsState.DIFFERENT)
    assert (status.speed, status.frequency_hz) == (None, None)
    assert "390 is 100 Hz in data set 2" in status.settings_texts[0]
    kind, text = bench.refused("reached", timeout_s=5)
    assert (kind, text) == ("fault", f"nobody knows whether it is reached: {status.settings_texts[0]}")


@pytest.mark.parametrize(
    ("drive", "telegram", "simulated", "name", "raw", "says"),
    [
        (DEMAG, "PPO1", BUS, "390", 10_000, "390 is 100 Hz"),
        (FUJI, "PPO1", NONE, "F03", 1000, "F03 is 100 Hz"),
        (LS, "PPO1", NONE, "dr-20", 12_000, "dr-20 is 120 Hz"),
        (KEB, "PCH+4/4", NONE, "oP.00", 2, "oP.00 is 2"),
        (IMO, None, PZD, "P00.06", 0, "P00.06 is 0"),
    ],
)
def test_a_keypad_passes_no_plugin_so_each_start_reads_again(
    drive: DriveProfile, telegram: str | None, simulated: Named, name: str, raw: int, says: str
) -> None:
    bench = pair(drive, telegram, simulated)
    bench.ok("start")
    bench.ok("stop")
    store = bench.device.store
    spec = present(store.table.named(name))
    store.write(spec, raw)
    assert says in bench.refused("start")[1]
    assert not bench.device.motor.on


def test_a_start_on_a_slow_bus_goes_by_what_was_read_before() -> None:
    """Six drives at 9.6 kbit/s take 350 ms a rotation: the KEB's twelve parameters take more than a start may wait."""
    bench = pair(FUJI, "PPO2", rotation=350 * MS)
    bench.pass_time(30_000)
    assert bench.core.status().settings is SettingsState.CHECKED
    bench.ok("start")
    (notice,) = [text for text in bench.notices() if "before this start" in text]
    assert notice.startswith("settings not read again before this start: the drive has not yet answered; as the drive ")


# -- parameters that do not act at once --------------------------------------------------------------------------------


def test_ls_com_14_counts_when_com_94_is_written() -> None:
    """COM-14 := 1 and COM-94 := 1 made 60 Hz of the motor 6.59 Hz of the status."""
    bench = pair(LS, "PPO1")
    bench.pass_time(1000)
    bench.ok("write", number="COM-14", value=1)
    bench.pass_time(500)
    status = bench.core.status()
    waits = (
        "COM-14 (PROFIdrive value: 0 standard, 1 rpm) was written and acts when COM-94 is written with 1; until then "
        "the old value counts"
    )
    assert (status.settings, status.settings_texts) == (SettingsState.CHECKED, (waits,))
    assert bench.notices().count(waits) == 1
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("reached")
    assert bench.core.status().frequency_hz == pytest.approx(30, abs=0.5)
    assert bench.device.motor.frequency * 60 == pytest.approx(30, abs=0.5)
    assert "COM-94 (Comm update) is not written: a start was ordered" in bench.misuse("write", number="COM-94", value=1)
    bench.ok("stop")
    bench.ok("write", number="COM-94", value=1)
    assert "COM-14 is 1, not 0" in bench.refused("start")[1]
    assert waits not in bench.core.status().settings_texts
    bench.ok("write", number="COM-14", value=0)
    bench.ok("write", number="COM-94", value=1)
    bench.ok("start")


def test_fuji_o30_acts_at_power_on_and_the_status_says_so() -> None:
    bench = pair(FUJI, "PPO1")
    bench.pass_time(300)
    bench.ok("write", number="o30", value=3)
    bench.run(2)
    assert bench.core.status().settings_texts == (
        "o30 (PPO type) was written and acts from the drive's next power-on; until then the old value counts",
    )
    bench.ok("start")


def fuji_with(change: Callable[[ParamSpec], ParamSpec]) -> DeviceFile:
    """Fuji's device file with another column in its table."""
    return structs.replace(fuji.FILE, parameters=ParamTable(map(change, fuji.PARAMETERS)))


@pytest.mark.parametrize("channel", ["first", "known"])
def test_a_scale_that_acts_at_power_on_keeps_its_old_value_until_then(channel: str) -> None:
    """A drive whose scale acts from power-on: one column of its table is another one."""
    file = fuji_with(lambda spec: dataclasses.replace(spec, acts=POWER_ON) if spec.name == "F03" else spec)
    drive = dataclasses.replace(FUJI, core_factory=partial(FujiCore, file))
    device = drive.simulated("PPO1", {}, {})
    bench = PairBench(drive.core("it", "PPO1"), device)
    if channel == "known":
        bench.pass_time(500)
    bench.ok("write", number="F03", value=100)
    bench.pass_time(500)
    status = bench.core.status()
    assert status.settings is SettingsState.CHECKED
    assert "F03 (Maximum frequency) was written and acts from the drive's next power-on" in status.settings_texts[0]
    bench.ok("start")
    bench.ok("stop")
    bench.core.lost(bench.now)
    bench.pass_time(500)
    assert "F03 is 100 Hz, not 60 Hz" in bench.refused("start")[1]


def test_any_setting_of_any_plugin_is_relied_on_without_a_column() -> None:
    """A plugin with settings and no column ``use`` at all, as those of other people are."""

    class Plain(FujiCore):
        def settings(self) -> tuple[Setting, ...]:
            return (equal("F26", 2, "set F26 = 2"), equal("F07", 1, "set F07 = 1", refuse=False))

    file = fuji_with(lambda spec: dataclasses.replace(spec, use=Use.NONE))
    drive = dataclasses.replace(FUJI, core_factory=partial(Plain, file))
    bench = PairBench(drive.core("it", "PPO1"), drive.simulated("PPO1", {}, {}))
    bench.ok("start")
    assert "F26 (Motor sound) is not written" in bench.misuse("write", number="F26", value=3)
    assert bench.ok("write", number="F07", value=2) == 2
    assert bench.ok("write", number="E31", value=100) == 100


# -- who may write when ------------------------------------------------------------------------------------------------


def test_a_start_waits_for_a_write_under_way_and_a_write_is_refused_beside_a_start() -> None:
    bench = pair(FUJI, "PPO1")
    bench.pass_time(500)
    write = bench.order("write", number="F03", value=100)
    start = bench.order("start")
    refused = bench.order("write", number="F03", value=60)
    while bench.result(start) is None:
        bench.run()
    assert bench.done(write)["ok"]
    assert "is not written: a start was ordered" in bench.text(refused, "usage")
    assert "F03 is 100 Hz" in bench.text(start, "fault")
    assert not bench.device.motor.on


def test_a_write_is_judged_when_the_drive_is_there() -> None:
    """Before data exchange nobody knows whether the motor turns."""
    bench = PluginBench(FUJI.core("fan", "PPO1", ALONE), "00" * 12)
    bench.core.lost(bench.now)
    token = bench.order("write", number="F03", value=100)
    assert bench.core.cyclic(b"", bench.now)[:8] == bytes(8)
    bench.see(ZERO + "0A 37 20 00", 50)  # it runs by its terminals
    assert "is not written: the drive is " in bench.text(token, "usage")


def test_a_value_in_the_process_data_is_written_too() -> None:
    """F03 among the PCD words: ``output`` obeys the same rule."""
    bench = pair(FUJI, "PPO2", {"o40": 0x0403}, {"map_outputs": "F03=60"})
    bench.ok("start")
    assert "output: F03 is not written: a start was ordered" in bench.misuse("output", number="F03", value=100)
    bench.pass_time(100)
    assert bench.device.store.value("F03") == 60
    bench.ok("stop")
    bench.ok("output", number="F03", value=100)
    bench.pass_time(500)
    assert "F03 is 100 Hz, not 60 Hz" in bench.core.status().settings_texts[0]


def test_the_columns_are_strings_of_a_table() -> None:
    """As a device file will have them."""
    spec = ParamSpec(1, "p1", "Scale", use=Use("scale"), acts="p2")
    table = ParamTable((spec, ParamSpec(2, "p2", "Apply"), ParamSpec(3, "p3", "Later", acts="power-on")))
    assert table.applies == frozenset({"p2"})
    assert [str(use) for use in Use] == ["", "scale", "source", "setting", "map"]


def test_over_record_47_the_rule_is_the_same() -> None:
    """Nothing is asked of the drive for a code of the map."""
    queue = RecordQueue()
    core = LS.core("pump", "PPO3", records=queue)
    bench = PluginBench(core, "02 35 00 00")
    while queue.take() is not None:
        pass
    assert "COM-51 (Para Control-1) is a code of the process data map" in bench.misuse(
        "write", number="COM-51", value=0x1104
    )
    assert queue.take() is None


# --- Reasons for which `start()` will be refused: reported when data exchange begins, and as far as possible in Clear


BEGINS = [
    (DEMAG, "PPO1", NONE, "412 is 44: control not by the bus; write 412 = 1 in the active data set (1), or set the "),
    (DEMAG, "PPO2", {"412": 0}, "412 is 0: control not by the bus"),
    (IMO, None, NONE, "no received PZD carries the set frequency: of P15.02 to P15.12 none is 1; set P15.02 to 1, by "),
    (IMO, None, {**PZD, "P00.01": 0}, "SW bits 13-14 are 0: its keypad commands the drive, not the bus; set the run "),
    (IMO, None, {**PZD, "P00.01": 1}, "SW bits 13-14 are 1: its terminals commands the drive"),
    (
        LS,
        "PPO1",
        {"dr-06": 1},
        "dr-06 is 1, not 4: set dr-06 (command source) to 4, field bus, and see that the keypad ",
    ),
    (FUJI, "PPO1", {"y98": 0}, "y98 is 0, not 3: set y98 = 3 (run and frequency command from PROFIBUS)"),
    (KEB, "PCH+4/4", {"oP.00": 0}, "oP.00 is 0, not 5: the set point is not sy.52: set oP.00 = 5"),
]


@pytest.mark.parametrize(("drive", "telegram", "simulated", "says"), BEGINS)
def test_what_a_start_refuses_is_reported_when_data_exchange_begins(
    drive: DriveProfile, telegram: str | None, simulated: Named, says: str
) -> None:
    """Nobody has ordered anything; a start then says the same."""
    bench = PairBench(drive.core("it", telegram, simulated=True), drive.simulated(telegram, {}, simulated), 4 * MS)
    bench.pass_time(2000)
    (notice,) = [text for text in bench.notices() if says in text]
    assert notice.endswith("; start is refused until then")
    assert bench.core.status().settings is SettingsState.DIFFERENT
    text = bench.refused_as("fault", "start")
    assert says[:8] in text


@pytest.mark.parametrize(
    ("drive", "options", "says"), [(DEMAG, {"set_412": True}, "412 is"), (IMO, {"set_map": True}, "no received PZD")]
)
def test_what_a_start_sets_itself_is_not_reported(drive: DriveProfile, options: Named, says: str) -> None:
    bench = PairBench(drive.core("it", None, options, simulated=True), drive.simulated(None, {}, {}))
    bench.pass_time(2000)
    assert not [text for text in bench.notices() if says in text]
    bench.ok("start")


def test_imo_a_key_at_the_keypad_is_seen_in_the_status_word() -> None:
    """Before the next start, and when it is right again."""
    bench = PairBench(IMO.core("it"), IMO.simulated(None, {}, PZD))
    bench.pass_time(1000)
    assert bench.core.status().settings is SettingsState.CHECKED
    source = bench.device.store.table.named("P00.01")
    assert source is not None
    bench.device.store.write(source, 0)
    bench.pass_time(500)
    assert bench.core.status().settings is SettingsState.DIFFERENT
    bench.device.store.write(source, 2)
    bench.pass_time(500)
    assert bench.core.status().settings is SettingsState.CHECKED


# -- Clear -------------------------------------------------------------------------------------------------------------

SLAVES: list[dict[str, object]] = [
    {"name": "hoist", "address": 3, "drive": "demag-dedrive"},
    {"name": "fan", "address": 4, "drive": "fuji-frenic", "simulated": {"y98": 0}},
    {"name": "mixer", "address": 5, "drive": "imo-hd2", "simulated": {"P00.01": 0}, "options": {"baud_index": 4}},
    {"name": "saw", "address": 6, "drive": "keb-f5"},
    {"name": "pump", "address": 7, "drive": "ls-s100", "telegram": "PPO3", "simulated": {"dr-06": 1}},
]
TOLD = {
    "hoist": "remote (bit 9) is 0: 412 is not 1 in the active data set, or no hardware release: switch on S1 ",
    "fan": "STW bit 9 is 0: neither run nor frequency command comes from the bus; set y98 to 3",
    "mixer": "SW bits 13-14 are 0: its keypad commands the drive, not the bus; ",
    "pump": "dr-06 is 1, not 4: set dr-06 (command source) to 4, field bus, and see that the keypad is not in local ",
}
SILENT = {
    "hoist": "the parameter channel of PPO1 is silent in Clear, they are compared in Operate; the plugin relies on 412",
    "fan": "the parameter channel of PPO1 is silent in Clear, they are compared in Operate; the plugin relies on F03",
    "mixer": "the parameter channel of PKW+12 is silent in Clear, they are compared in Operate; the plugin relies on ",
    "saw": "the parameter channel of PCH+4/4 is silent in Clear, they are compared in Operate; the plugin relies on ",
}


@in_virtual_time
async def test_clear_is_a_commissioning_check() -> None:
    """The status word tells it, and record 47 of the LS; what needs the outputs is named. Nothing moves."""
    async with dpstack.open_bus(port="virtual", baud=187_500, slaves=SLAVES) as bus:
        await bus.ready()
        await asyncio.sleep(1.6)
        for name in (str(slave["name"]) for slave in SLAVES):
            texts = [notice.text for notice in bus.drive(name).notices]
            assert [text for text in texts if TOLD.get(name, "?") in text] or name not in TOLD
            assert [text for text in texts if SILENT.get(name, "?") in text] or name not in SILENT
            assert len(texts) == (name in TOLD) + (name in SILENT)
        devices = [bench_of(bus).device(address) for address in range(3, 8)]
        assert [device.motor.on for device in devices if isinstance(device, DriveDevice)] == [False] * 5
        assert not bus.drive("pump").status.running
        await bus.operate()
        await asyncio.sleep(0.8)
        assert any("412 is 44" in notice.text for notice in bus.drive("hoist").notices)


def watched(core: DriveCore, inputs: str, seconds: float) -> list[str]:
    """Notices in Clear with these inputs."""
    found = []
    for number in range(round(seconds * 500)):
        core.watch(bytes.fromhex(inputs), number * 2 * MS)
        found += [str(event["text"]) for event in core.take_events() if event["type"] == "notice"]
    return found


def test_in_clear_a_drive_is_judged_once_and_only_with_inputs() -> None:
    core = IMO.core("it")
    assert watched(core, "", 3) == []
    assert len(watched(core, "00 " * 8 + "01 03" + " 00" * 22, 3)) == 2
    assert watched(core, "00 " * 8 + "01 03" + " 00" * 22, 3) == []
    core.lost(6 * S)
    assert len(watched(core, "00 " * 8 + "01 03" + " 00" * 22, 3)) == 1, "what holds is said once"


@pytest.mark.parametrize(("drive", "inputs"), [(FUJI, "02 40 00 00"), (LS, "00 40 00 00")])
def test_s1_says_nothing_while_the_control_word_is_0(drive: DriveProfile, inputs: str) -> None:
    telegram = "PPO3"
    (notice,) = watched(drive.core("it", telegram), inputs, 3)
    assert notice.startswith("settings not checked: PPO3 has no parameter channel; the plugin relies on ")


# -- who has the control -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drive", "telegram", "options", "inputs", "remote"),
    [
        (LS, "PPO3", NONE, "02 35 00 00", None),  # ZSW1 bit 9 repeats STW1 bit 10
        (LS, "PPO3", NONE, "00 35 00 00", None),
        (LS, "PPO3", {"profile": "ls"}, "60 01 00 00", True),
        (LS, "PPO3", {"profile": "ls"}, "80 01 00 00", False),
        (KEB, "4/4", {"status_bits": "run=2"}, "00 04 00 00", None),
        (FUJI, "PPO3", NONE, "02 31 00 00", True),
        (FUJI, "PPO3", NONE, "00 31 00 00", False),
        (DEMAG, "PPO3", NONE, "02 40 00 00", True),
        (DEMAG, "PPO3", NONE, "00 40 00 00", False),
    ],
)
def test_remote_is_none_where_no_bit_tells_it(
    drive: DriveProfile, telegram: str, options: Named, inputs: str, remote: bool | None
) -> None:
    bench = PluginBench(drive.core("it", telegram, options), inputs)
    assert bench.core.status().remote is remote
    assert bench.core.status().as_dict()["remote"] is remote
