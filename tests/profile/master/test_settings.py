"""The settings of a drive that its plugin relies on: read when data exchange begins; wrong ones refuse a start."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from demag_kit import ZERO, pkw, sim
from drive_bench import BUS, MS, NONE, PZD, DeviceBench, Named, PairBench, PluginBench, S, pair
from support import present

from dpstack.profile import CommandError, DriveProfile, ParameterChannel, ParamKey, SettingsState, Steps
from dpstack_drives.demag import DRIVE as DEMAG
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.fuji import table as fuji
from dpstack_drives.imo import DRIVE as IMO
from dpstack_drives.keb import DRIVE as KEB
from dpstack_drives.ls import DRIVE as LS


def set_by_hand(bench: PairBench, name: str, raw: int) -> None:
    """At the drive itself, beside the bus."""
    store = present(bench.device.store)
    spec = present(store.table.named(name))
    store.write(spec, raw)


# -- each drive against its simulated one, set otherwise ---------------------------------------------------------------

REFUSED = [
    (
        DEMAG,
        "PPO1",
        {**BUS, "390": 60},
        NONE,
        "390 is 60 Hz in data set 1, the option reference_hz is 50: set 390 = 50",
    ),
    (
        DEMAG,
        "PPO1",
        {**BUS, "375": 87},
        NONE,
        "375 is 87 Hz in data set 1, the option reference_hz is 50: set 390 = 50",
    ),
    (DEMAG, "PPO2", {**BUS, "434": 1}, NONE, "434 is 1: the drive follows its internal set point"),
    (FUJI, "PPO1", {"F03": 50}, NONE, "F03 is 50 Hz, not 60 Hz: set F03 = 60 or the option reference_hz = 50"),
    (FUJI, "PPO1", {"y98": 2}, NONE, "y98 is 2, not 3: set y98 = 3"),
    (
        FUJI,
        "PPO2",
        {"o40": 0x0407},
        NONE,
        "o40 to o43 are F07, the option map_outputs is empty: set map_outputs = 'F07'",
    ),
    (LS, "PPO1", {"COM-14": 1}, NONE, "COM-14 is 1, not 0: set COM-14 = 0 and COM-94 = 1, or the option speed_unit"),
    (LS, "PPO1", NONE, {"speed_unit": "rpm"}, "COM-14 is 0, not 1"),
    (LS, "PPO1", {"dr-20": 50}, NONE, "dr-20 is 50 Hz, not 60 Hz: set dr-20 = 60 or the option reference_hz = 50"),
    (
        LS,
        "PPO1",
        {"dr-07": 0},
        NONE,
        "dr-07 is 0, not 8: the frequency does not come from the field bus: set dr-07 = 8",
    ),
    (LS, "PPO2", {"para_control": "dr-04"}, NONE, "COM-51.. are 1104, the option para_control says 0005 0006"),
    (KEB, "PCH+4/4", {"oP.00": 0}, NONE, "oP.00 is 0, not 5: the set point is not sy.52: set oP.00 = 5"),
    (KEB, "PCH+4/4", NONE, {"direction": "sign"}, "oP.01 is 9: the direction comes from sy.50"),
    (
        KEB,
        "PCH+8/8",
        NONE,
        {"map_outputs": "cS.19:long=5 sy.50 sy.52", "map_inputs": "ru.12:long sy.51 sy.53"},
        "the active map has 2032 2034 (sy.24 to sy.31), the option map_outputs says 2F13 2032 2034",
    ),
    (IMO, None, {**PZD, "P00.06": 0}, NONE, "P00.06 is 0, not 9: the set frequency does not come from PROFIBUS"),
]


@pytest.mark.parametrize(("drive", "telegram", "simulated", "options", "says"), REFUSED)
def test_another_scale_or_source_refuses_the_start(
    drive: DriveProfile,
    telegram: str | None,
    simulated: Named,
    options: Named,
    says: str,
) -> None:
    bench = pair(drive, telegram, simulated, options)
    text = bench.refused_as("fault", "start")
    assert says in text
    status = bench.core.status()
    assert status.settings is SettingsState.DIFFERENT
    assert any(says in one for one in status.settings_texts)
    assert any(says in notice and "start is refused until then" in notice for notice in bench.notices())
    bench.pass_time(500)
    assert not bench.device.motor.on


NOTICED = [
    (DEMAG, "PPO1", {**BUS, "228": 5}, "434 is 3: the drive adds its internal set point (5 Hz by 228)"),
    (FUJI, "PPO2", {"o48": 0x041A}, "o48 to o51 are F26, the option map_inputs is empty"),
    (LS, "PPO1", {"profile": "ls", "dr-20": 50}, "dr-20 is 50 Hz, not 60 Hz"),
    (LS, "PPO2", {"para_status": "In-90"}, "COM-31.. are 155A, the option para_status says 000A 000E 000F"),
    (KEB, "PCH+4/4", {"oP.01": 8}, "oP.01 is 8, not 9: the direction may not come from sy.50"),
    (IMO, None, {**PZD, "P00.03": 40}, "P00.03 (maximum frequency) is 40 Hz, not 50 Hz: set points are limited there"),
]


@pytest.mark.parametrize(("drive", "telegram", "simulated", "says"), NOTICED)
def test_a_setting_that_changes_neither_scale_nor_source_is_a_notice(
    drive: DriveProfile, telegram: str | None, simulated: Named, says: str
) -> None:
    options = {"profile": "ls"} if "profile" in simulated else NONE
    bench = pair(drive, telegram, simulated, options)
    if drive is KEB:  # the simulated drive obeys with 9 only
        bench.pass_time(2000)
    else:
        bench.ok("start")
    assert bench.core.status().settings is SettingsState.DIFFERENT
    assert [notice for notice in bench.notices() if says in notice] != []
    assert not any("refused" in notice for notice in bench.notices())


@pytest.mark.parametrize(
    ("drive", "telegram", "simulated"),
    [
        (DEMAG, "PPO1", BUS),
        (DEMAG, "PPO2", {**BUS, "390": 50, "434": 2}),
        (FUJI, "PPO1", NONE),
        (FUJI, "PPO2", NONE),
        (LS, "PPO1", NONE),
        (LS, "PPO2", NONE),
        (KEB, "PCH+4/4", NONE),
        (KEB, "PCH+8/8", NONE),
        (IMO, None, PZD),
    ],
)
def test_settings_as_expected_give_no_notice(drive: DriveProfile, telegram: str | None, simulated: Named) -> None:
    bench = pair(drive, telegram, simulated)
    bench.ok("start")
    assert bench.core.status().settings is SettingsState.CHECKED
    assert bench.core.status().settings_texts == ()
    assert not any("settings" in notice for notice in bench.notices())


def test_a_keb_whose_map_is_the_manuals_example_is_verified_in_both_blocks() -> None:
    """The two examples of the manual: 12 octets of inputs, 10 of outputs
    (docs/reference/drives/keb-f5.md#second-block)."""
    maps = {"map_inputs": "202C:long 2033 2035 2200 2227", "map_outputs": "2F13:long=5 2032 2034 230A=5600"}
    device = KEB.simulated("PCH+8+2/8+4 own-gsd", {}, {})
    first = PairBench(KEB.core("it", "PCH+8+2/8+4 own-gsd", simulated=True), device)
    first.ok("write_map", inputs=maps["map_inputs"], outputs=maps["map_outputs"].replace("=5600", "").replace("=5", ""))
    after = KEB.simulated("PCH+8+2/8+4 own-gsd", {}, {})
    after.inherit(device)
    bench = PairBench(KEB.core("it", "PCH+8+2/8+4 own-gsd", maps, simulated=True), after)
    bench.ok("start")
    assert bench.core.status().settings is SettingsState.CHECKED
    # sy.16 to sy.23 and sy.58 to sy.65 as the manual prints them ("Saving of the F5 PB-Operator Configuration")
    shown = [bench.ok("read", number=f"sy.{number}") for number in (*range(16, 24), *range(58, 66))]
    assert shown == [0x2C, 1, 0x33, 1, 0x35, 1, -1, 1, 0x200, 1, 0x227, 1, -1, 1, -1, 1]
    shown = [bench.ok("read", number=f"sy.{number}") for number in (*range(24, 32), *range(66, 74))]
    assert shown == [0xF13, 1, 0x32, 1, 0x34, 1, -1, 255, 0x30A, 1, -1, 255, -1, 255, -1, 255]


# -- literal octets of the master --------------------------------------------------------------------------------------


def replied(bench: PluginBench, request: str, reply: str, process: str) -> None:
    """The plugin asks ``request`` and gets ``reply``, zeros follow (all octets of the parameter channel in hex)."""
    for _ in range(200):
        if bench.out().startswith(request):
            break
    assert bench.out().startswith(request)
    bench.see(f"{reply} {process}", 2)
    bench.see(ZERO + process, 2)


def test_demag_390_375_and_434_are_read_in_the_active_data_set() -> None:
    idle = "02 40 00 00"
    bench = PluginBench(DEMAG.core("hoist", "PPO1", {"reference_hz": 60}), ZERO + idle)
    replied(bench, "10 F9 00 00", "10 F9 00 00 00 00 00 02", idle)
    replied(bench, "61 9C 02 00", "41 9C 02 00 00 00 00 01", idle)
    replied(bench, "61 86 02 00", "51 86 02 00 00 00 17 70", idle)  # 390 = 60.00 Hz
    replied(bench, "61 77 02 00", "51 77 02 00 00 00 13 88", idle)  # 375 = 50.00 Hz
    assert bench.core.status().settings is SettingsState.CHECKING
    replied(bench, "61 B2 02 00", "41 B2 02 00 00 00 00 02", idle)
    replied(bench, "10 E4 00 00", "20 E4 00 00 00 00 00 00", idle)
    replied(bench, "13 70 00 00", "13 70 00 00 00 00 00 00", idle)
    assert bench.core.status().settings is SettingsState.CHECKED
    assert bench.out()[24:29] == "00 00"


def test_fuji_f03_and_y98_with_the_octets_of_the_manual() -> None:
    """y98 as in example 2 of 8.3; with 1 the run command does not come from the bus."""
    bench = PluginBench(FUJI.core("fan", "PPO1", {"reference_hz": 60}), ZERO + "02 31 00 00")
    for request, reply in (
        ("11 04 03 00 00 00 00 00", "11 04 03 00 00 00 02 58"),
        ("11 0F 62 00 00 00 00 00", "11 0F 62 00 00 00 00 01"),
    ):
        assert request in [bench.out()[:23] for _ in range(20)]
        bench.see(f"{reply} 02 31 00 00", 2)
    assert bench.notices() == [
        "y98 is 1, not 3: set y98 = 3 (run and frequency command from PROFIBUS); start is refused until then"
    ]


def test_ls_pnu_930_and_its_codes_over_pkw() -> None:
    """Addresses as in 4.2.5 and 6.2.1: dr-07 is 1107h, dr-20 1114h, COM-68 1744h, COM-14 170Eh; 60.00 Hz is 1770h."""
    idle = "02 35 00 00"
    bench = PluginBench(LS.core("pump", "PPO1"), ZERO + idle)
    for request, reply in (
        ("13 A2 00 00 00 00 00 00", "13 A2 00 00 00 00 00 01"),
        ("10 11 07 00 00 00 00 00", "10 11 07 00 00 00 00 08"),
        ("10 11 14 00 00 00 00 00", "10 11 14 00 00 00 17 70"),
        ("10 17 44 00 00 00 00 00", "10 17 44 00 00 00 00 00"),
        ("10 17 0E 00 00 00 00 00", "10 17 0E 00 00 00 00 01"),
    ):
        assert request in [bench.out()[:23] for _ in range(40)]
        bench.see(f"{reply} {idle}", 2)
    assert bench.core.status().settings is SettingsState.DIFFERENT
    assert bench.notices() == [
        "COM-14 is 1, not 0: set COM-14 = 0 and COM-94 = 1, or the option speed_unit (now 'percent'); "
        "start is refused until then"
    ]


def test_imo_asks_for_source_and_maximum_after_its_maps() -> None:
    """Requests of table 2-9: PKW1 = 1, PKW2 the address. P00.06 = 9, P00.03 = 4000 (40.00 Hz)."""
    values = {0x0006: 9, 0x0003: 4000, 0x0F02: 1}
    bench = PluginBench(IMO.core("pump"), ZERO + "41 03 " + "00 " * 22)
    asked: list[int] = []
    for _ in range(4000):
        out = bench.run()
        if out[1] == 1:
            address = int.from_bytes(out[2:4], "big")
            asked += [address] if asked[-1:] != [address] else []
            reply = f"0001 {address:04X} 0000 {values.get(address, 0):04X} "
            bench.inputs = bytes.fromhex(reply + "4103" + "00" * 22)
    assert asked == [*range(0x0F02, 0x0F18), 0x0006, 0x0003]
    assert bench.core.status().settings_texts == (
        "P00.03 (maximum frequency) is 40 Hz, not 50 Hz: set points are limited there; set P00.03 = 50 or the option "
        "max_hz = 40",
    )


@pytest.mark.parametrize(
    ("index", "value"),
    [("10", "00 00 00 33"), ("11", "00 00 00 01"), ("12", "00 00 00 35"), ("14", "FF FF FF FF"), ("1A", "00 00 00 34")],
)
def test_the_active_map_of_the_simulated_keb(index: str, value: str) -> None:
    """sy.16, sy.17, sy.18, sy.20 and sy.26 of the map as delivered: 0033h and 0035h in, 0032h and 0034h out, -1 off."""
    bench = DeviceBench(KEB.simulated("PCH+4/4", {}, {}), KEB.telegram("PCH+4/4").config.hex())
    request = f"71 01 20 {index} 00 00 00 00"
    assert bench.send(f"{request} 00 00 00 00", 20)[:23] == f"41 01 20 {index} {value}"


@pytest.mark.parametrize(
    ("order", "reply"),
    [
        ("61 86 01 00 00 00 00 00", "51 86 01 00 00 00 17 70"),  # 390 = 60.00 Hz
        ("61 77 01 00 00 00 00 00", "51 77 01 00 00 00 13 88"),  # 375 = 50.00 Hz
        ("61 B2 01 00 00 00 00 00", "41 B2 01 00 00 00 00 01"),  # 434 = 1
        ("10 E4 00 00 00 00 00 00", "20 E4 00 00 00 00 01 F4"),  # 228 = 5.00 Hz
    ],
)
def test_the_reference_of_the_simulated_demag(order: str, reply: str) -> None:
    assert pkw(sim("PPO1", {"390": 60, "434": 1, "228": 5}), order) == reply


def test_keb_reads_its_active_map_by_index() -> None:
    """sy.24, sy.26, sy.28 (definitions of the outputs), sy.25, sy.27 (their sets), the inputs', both enables, oP.00."""
    options = {"check_settings": True, "control_bits": "enable=0 run=2", "status_bits": "run=2", "rpm_per_count": 1.0}
    bench = PairBench(KEB.core("saw", "PCH+4/4", options), KEB.simulated("PCH+4/4", {}, {}))
    seen: list[str] = []
    for _ in range(2000):
        request = bench.run()[:4]
        if request[0] & 3 and (asked := request[1:].hex()) not in seen[-1:]:
            seen.append(asked)
    assert seen == [
        *("012018", "01201a", "01201c", "012019", "01201b"),
        *("012010", "012012", "012014", "012011", "012013"),
        *("006002", "005ff8"),
        *("012300", "012301"),
    ]


# -- time and results of the comparison --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("drive", "telegram", "simulated", "relies"),
    [
        (DEMAG, "PPO3", BUS, "390 (375 where 390 is 0) = 50 Hz, 434 = 2 or 3"),
        (FUJI, "PPO3", NONE, "F03 = 60 Hz, y98 = 3"),
        (FUJI, "PPO4", NONE, "o40 to o43 = empty"),
        (LS, "PPO6", NONE, "dr-07 = 8, dr-20 = 60 Hz, COM-68 = 0, COM-14 = 0"),
        (KEB, "4/4", NONE, "sy.24 to sy.31 = 2032 2034, sy.16 to sy.23 = 2033 2035"),
    ],
)
def test_without_a_channel_a_drive_starts_with_its_settings_not_checked(
    drive: DriveProfile, telegram: str, simulated: Named, relies: str
) -> None:
    bench = pair(drive, telegram, simulated)
    bench.ok("start")
    status = bench.core.status()
    assert status.settings is SettingsState.NOT_CHECKED
    (text,) = status.settings_texts
    assert text.startswith(f"settings not checked: {telegram} has no parameter channel; the plugin relies on ")
    assert relies in text
    assert bench.notices().count(text) == 1
    assert status.as_dict()["settings"] == "not_checked"
    assert status.as_dict()["settings_texts"] == [text]
    bench.ok("stop")
    bench.ok("start")
    assert bench.notices().count(text) == 1


def test_without_an_answer_a_drive_starts_in_time_with_its_settings_not_checked() -> None:
    bench = PluginBench(FUJI.core("fan", "PPO1"), ZERO + "02 31 00 00")
    token = bench.order_and_run(3 * S // bench.rotation, "start", timeout_s=5)
    assert bench.out().endswith("04 7E 00 00")
    bench.run(2 * S // bench.rotation - bench.rotation // MS * 100)
    assert bench.out().endswith("04 7F 00 00")
    assert bench.value(token, ZERO + "02 37 00 00", 20) == "running"
    assert "settings not checked: the drive has not yet answered; the plugin relies on F03 = 60 Hz, y98 = 3" in (
        bench.notices()
    )
    bench.run(3 * S // bench.rotation)
    assert bench.core.status().settings is SettingsState.NOT_CHECKED


@pytest.mark.parametrize(("drive", "telegram", "simulated"), [(DEMAG, "PPO1", BUS), (FUJI, "PPO1", NONE)])
def test_a_slow_bus_leaves_time_for_the_start_itself(drive: DriveProfile, telegram: str, simulated: Named) -> None:
    """Six drives at 9.6 kbit/s take 350 ms a rotation, a request of the Demag 1.9 s, its way to RUNNING 2 s."""
    bench = pair(drive, telegram, simulated, rotation=350 * MS)
    bench.ok("start")
    assert any("settings not checked: the drive has not yet answered" in notice for notice in bench.notices())
    bench.pass_time(20_000)
    assert bench.core.status().settings is SettingsState.CHECKED


def test_a_setting_that_the_drive_does_not_have_is_not_checked_the_others_are() -> None:
    """An inverter of another family: P00.06 does not exist there."""
    bench = pair(IMO, None, {**PZD, "P00.03": 40}, {"frequency_source": "P77.01=9"})
    bench.ok("start")
    status = bench.core.status()
    assert status.settings is SettingsState.DIFFERENT
    assert any("P77.01: error 2, invalid data address" in text for text in status.settings_texts)
    assert any("P00.03 (maximum frequency) is 40 Hz" in text for text in status.settings_texts)


def test_settings_are_compared_again_after_each_loss() -> None:
    bench = pair(FUJI, "PPO1")
    bench.ok("start")
    bench.core.lost(bench.now)
    assert bench.core.status().settings is SettingsState.NONE
    set_by_hand(bench, "F03", 500)
    bench.pass_time(500)
    assert bench.core.status().settings is SettingsState.DIFFERENT
    assert "F03 is 50 Hz" in bench.refused("start")[1]


def test_the_next_start_sees_a_corrected_setting() -> None:
    bench = pair(FUJI, "PPO1", {"F03": 50})
    bench.refused("start")
    bench.ok("write", number="F03", value=60)
    bench.ok("start")
    assert bench.core.status().settings is SettingsState.CHECKED


def test_the_next_start_sees_a_setting_that_was_changed_meanwhile() -> None:
    bench = pair(DEMAG, "PPO1", BUS)
    bench.ok("start")
    bench.ok("stop")
    bench.ok("write", number=390, value=100)
    assert "390 is 100 Hz" in bench.refused("start")[1]


def test_another_data_set_is_compared_before_the_next_start() -> None:
    """390 is another one in data set 2, which a contact selects while the drive stands."""
    bench = pair(DEMAG, "PPO1", BUS)
    bench.ok("start")
    bench.ok("stop")
    bench.ok("write", number=390, value=100, data_set=2)
    bench.ok("start")
    bench.ok("stop")
    set_by_hand(bench, "414", 2)
    bench.pass_time(1100)
    assert "390 is 100 Hz in data set 2" in bench.refused("start")[1]


def test_a_notice_is_not_repeated_by_a_drive_that_comes_and_goes() -> None:
    bench = pair(LS, "PPO1", {"dr-07": 0})
    for _ in range(5):
        bench.pass_time(300)
        bench.core.lost(bench.now)
    assert len([notice for notice in bench.notices() if "dr-07" in notice]) == 1


@pytest.mark.parametrize(("drive", "telegram"), [(DEMAG, "PPO1"), (FUJI, "PPO2"), (KEB, "PCH+8/8"), (LS, "PPO2")])
def test_an_order_of_the_application_waits_for_one_request_at_most(drive: DriveProfile, telegram: str | None) -> None:
    """A request takes two scans of the Demag, and as long until both ends are at 0 again."""
    number = {DEMAG.name: 400, FUJI.name: "F26", KEB.name: "oP.3", LS.name: "dr-03"}[drive.name]
    took = {}
    for check in (False, True):
        bench = pair(drive, telegram, options={"check_settings": check})
        bench.run(20)
        began = bench.now
        bench.ok("read", number=number)
        took[check] = bench.now - began
    assert took[True] <= took[False] + 4 * bench.device.scan_ns + 20 * MS


def test_the_option_switches_the_comparison_off() -> None:
    bench = pair(FUJI, "PPO1", {"F03": 50}, {"check_settings": False})
    bench.ok("start")
    (text,) = bench.core.status().settings_texts
    assert text.startswith("settings not checked: the option check_settings is false; the plugin relies on F03 = 60 Hz")


def test_a_start_order_that_is_cancelled_while_it_waits_sends_nothing() -> None:
    bench = PluginBench(FUJI.core("fan", "PPO1"), ZERO + "02 31 00 00")
    token = bench.order_and_run(100, "start")
    bench.order_and_run(2000, "cancel", order=token)
    assert bench.out().endswith("04 7E 00 00")


# -- reached() and the actual speed ------------------------------------------------------------------------------------


def test_reached_needs_more_than_the_bit() -> None:
    """Bit 10 is set and the motor turns at 37.5 % instead of 50 %: scale or source of the set point is another one."""
    bench = PluginBench(DEMAG.core("hoist", "PPO3"), "02 40 00 00")
    bench.order("speed", value=0.5)
    bench.order("start")
    for word in ("02 21", "02 23", "06 27"):
        bench.see(f"{word} 18 00", 2)
    token = bench.order_and_run(600, "reached", timeout_s=1)
    assert bench.text(token, "timeout").startswith(
        "50.0% not reached, at 37.5% (the drive itself reports its set point as reached; more than 2% of the reference "
    )
    token = bench.order("reached")
    bench.see("06 27 1E C0", 2)  # 48.0 %
    assert bench.done(token)["ok"] is True


def test_reached_counts_the_additional_reference() -> None:
    """PZD3 is added behind the ramp (11.2.2.2): 50 % and 10 Hz of 50 Hz are 70 %."""
    bench = pair(DEMAG, "PPO2", BUS, {"map_outputs": "reference"})
    bench.ok("speed", value=0.5)
    bench.ok("output", number="pzd3", value=10.0)
    bench.ok("start")
    assert bench.ok("reached") == pytest.approx(0.7, abs=0.01)


def test_a_refusal_of_the_channel_is_no_reason_to_fail() -> None:
    """The drive refuses 249, the active data set: it starts by its status word, and says what it did not check."""
    idle = "02 40 00 00"
    bench = PluginBench(DEMAG.core("hoist", "PPO1"), ZERO + idle)
    token = bench.order("start")
    for _ in range(3):
        if bench.run(20)[:2].hex() == "10f9":
            bench.see("70 F9 00 00 00 00 00 00 " + idle, 2)
            bench.see(ZERO + idle, 2)
    assert bench.out().endswith("00 06 00 00")
    for word in ("02 21 00 00", "02 23 00 00", "02 27 00 00"):
        bench.see(ZERO + word, 60)
    assert bench.value(token) == "running"
    assert any("error 0, inadmissible parameter number" in text for text in bench.core.status().settings_texts)


def test_a_command_error_of_a_plugin_ends_the_comparison_only() -> None:
    class Broken(type(FUJI.core("it", "PPO1"))):  # type: ignore[misc]
        def before_settings(self, deadline: int):  # type: ignore[no-untyped-def]
            yield
            raise CommandError("timeout", "no answer of this drive")

    options = {name: one.default for name, one in FUJI.core_options.items()}
    core = Broken(fuji.FILE, FUJI, "it", FUJI.telegram("PPO1"), options)
    bench = PluginBench(core, ZERO + "02 31 00 00")
    bench.run(5)
    assert core.status().settings is SettingsState.NOT_CHECKED
    assert "no answer of this drive" in core.status().settings_texts[0]


def test_all_settings_of_a_parameter_that_cannot_be_read_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """434 tells the source of the set point, and whether 228 is added."""
    read = ParameterChannel.read_many

    def without_434(
        access: ParameterChannel, keys: Sequence[ParamKey], deadline: int
    ) -> Steps[list[dict[str, object]]]:
        entries = yield from read(access, keys, deadline)
        return [{"text": "no 434"} if key.name == 434 else one for key, one in zip(keys, entries, strict=True)]

    monkeypatch.setattr(ParameterChannel, "read_many", without_434)
    bench = pair(DEMAG, "PPO1", BUS)
    bench.ok("start")
    assert bench.core.status().settings_texts == (
        "settings not checked: no 434; the plugin relies on 434 = 2 or 3, 228 = 0 Hz where 434 is 3",
    )
