"""Reasons for which `start()` will be refused: reported when data exchange begins, and as far as possible in Clear."""

from __future__ import annotations

import asyncio

import pytest
from api_kit import bench_of, in_virtual_time
from drive_bench import MS, NONE, PZD, Named, PairBench, PluginBench, S

import dpstack
from dpstack.profile import DriveCore, DriveDevice, DriveProfile, SettingsState
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS

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
