"""The device files that come with dpstack: conformance of each, and the octets that its manual prints.

The octets here are those of the manuals again, not read from the files: a wrong example in a file is found too.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from drive_bench import PluginBench, pair
from profidrive_kit import RecordBench

from dpstack.devices import finding
from dpstack.devices.finding import find
from dpstack.errors import ConfigError
from dpstack.profile import DriveProfile, DriveStatus, Leave, State
from dpstack.profile.record47 import RecordQueue
from dpstack.testing import DriveConformance

CHANNEL = "00 " * 8
ALONE = {"check_settings": False}


def meaning(profile: DriveProfile, telegram: str, inputs: str, sent: str) -> DriveStatus:
    """The status that process data received mean, of a drive whose master last sent the control word ``sent``."""
    core = profile.core("drive", telegram, ALONE, simulated=True)
    return core.read_inputs(bytes(core.offset) + bytes.fromhex(inputs), int(sent, 16))


def bench(profile: DriveProfile, telegram: str, inputs: str) -> PluginBench:
    """The plugin, with inputs behind its parameter channel that stand still."""
    core = profile.core("drive", telegram, ALONE, simulated=True)
    return PluginBench(core, "00" * core.offset + inputs)


def asked(plugin: PluginBench, request: str, answer: str, op: str, **args: object) -> dict[str, object]:
    """The result of an order over the parameter channel that sends ``request`` and is answered ``answer``."""
    rest = plugin.inputs[8:].hex(" ")
    token = plugin.order(op, **args)
    assert plugin.out(3)[:23] == request
    plugin.see(f"{answer} {rest}")
    return plugin.done(token, CHANNEL + rest, 3)


# -- ABB ACS355 with FPBA-01 -------------------------------------------------------------------------------------------

PROFIDRIVE = find("abb-acs355-profidrive")
ABB_DRIVES = find("abb-acs355")
REST = " 0000 0000 0000 0000"


class TestAcs355Profidrive(DriveConformance):
    profile = PROFIDRIVE
    telegrams = ("PPO1",)
    stops_when_lost = False


class TestAcs355ProfidriveWithoutChannel(DriveConformance):
    profile = PROFIDRIVE
    telegrams = ("PPO8",)
    stops_when_lost = False
    names_faults = False


class TestAcs355(DriveConformance):
    profile = ABB_DRIVES
    telegrams = ("PPO5",)
    stops_when_lost = False


def test_acs355_the_worked_answer_means_running_at_the_actual_value() -> None:
    """FPBA-01 manual p121: CW 047F REF 3415, SW 0337 ACT 3415."""
    for profile, speed in ((PROFIDRIVE, 0x3415 / 0x4000), (ABB_DRIVES, 0x3415 / 20000)):
        if profile is ABB_DRIVES:  # p96: operation is enabled only with bit 12
            assert "run enable" in str(_obstacle(profile, "0337 3415" + REST))
            assert _obstacle(profile, "1337 3415" + REST) is None
        status = meaning(profile, "PPO2", "0337 3415" + REST, "047F")
        assert (status.state, status.speed, status.remote) == (State.RUNNING, speed, True)
        assert status.bits == _SHOWN


_SHOWN = ("ready_to_switch_on", "ready", "operation_enabled", "no_coast", "no_quick_stop", "reached", "remote")


def _obstacle(profile: DriveProfile, inputs: str) -> str | None:
    core = profile.core("drive", "PPO2", ALONE, simulated=True)
    core.read_inputs(bytes(8) + bytes.fromhex(inputs), 0x047F)
    return core.obstacle()


def test_acs355_start_sequence_and_torque_mode() -> None:
    """p51: 047E ready to switch on, 047F operating; p53: 0C7F torque mode; p97: REF1 MAX is 20000, REF2 MAX 10000."""
    plugin = bench(ABB_DRIVES, "PPO2", "1230 0000" + REST)
    assert plugin.out() == CHANNEL + "04 7E 00 00 00 00 00 00 00 00 00 00"
    plugin.ok("speed", value=1.0)
    plugin.order("start")
    assert plugin.out() == CHANNEL + "04 7E 4E 20 00 00 00 00 00 00 00 00"  # not ready to switch on
    assert plugin.see(CHANNEL + "1231 0000" + REST) == CHANNEL + "04 7F 4E 20 00 00 00 00 00 00 00 00"
    plugin.see(CHANNEL + "1237 0000" + REST)
    plugin.order("ext2")
    plugin.order("set", values=[{"name": "ref2", "value": 100}])
    assert plugin.out(2) == CHANNEL + "0C 7F 4E 20 27 10 00 00 00 00 00 00"
    plugin.order("ext1")
    assert plugin.out(2) == CHANNEL + "04 7F 4E 20 27 10 00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("request_", "answer", "order", "value"),
    [
        ("70 0C 02 00 00 00 00 64", "40 0C 02 00 00 00 00 64", ("write", "12.02", 100), 100),  # p123
        ("13 96 00 00 00 00 00 00", "13 96 00 00 00 00 00 02", ("read", 918), 2),  # p125
        ("23 CB 00 00 00 00 00 01", "13 CB 00 00 00 00 00 01", ("write", 971, 1), 1),  # p126
        ("63 B1 01 00 00 00 00 00", "43 B1 01 00 00 00 23 00", ("read", "945.1"), 0x2300),  # p127
        ("73 93 03 00 00 00 0C 02", "43 93 03 00 00 00 0C 02", ("write", "915.3", 0x0C02), 0x0C02),  # p128
        ("73 94 03 00 00 00 01 04", "43 94 03 00 00 00 01 04", ("write", "916.3", 0x0104), 0x0104),  # p129
    ],
)
def test_acs355_parameters(request_: str, answer: str, order: tuple[str, str | int, int], value: int) -> None:
    op, number, *given = order
    plugin = bench(PROFIDRIVE, "PPO1", "0331 0000")
    result = asked(plugin, request_, answer, op, number=number, **({"value": given[0]} if given else {}))
    assert (result["ok"], result["value"]) == (True, value)


def test_acs355_any_parameter_by_group_and_index() -> None:
    """p121, p122: 84.11 is read as 100, or refused with error 3."""
    plugin = bench(PROFIDRIVE, "PPO1", "0331 0000")
    asks = "60 54 0B 00 00 00 00 00"
    assert asked(plugin, asks, "40 54 0B 00 00 00 00 64", "read", number=84, index=11)["value"] == 100
    refused = asked(plugin, asks, "70 54 0B 00 00 00 00 03", "read", number=84, index=11)
    assert "error 3, invalid subindex" in str(refused["text"])


def test_acs355_simulated_goes_on_without_its_master_and_stops_when_it_is_back() -> None:
    """p50: 3018 COMM FAULT FUNC = LAST SPEED."""
    both = pair(ABB_DRIVES, "PPO2", options=ALONE)
    both.ok("speed", value=0.5)
    both.ok("start")
    both.pass_time(2000)
    both.device.leave(Leave.WATCHDOG, both.now)
    both.core.lost(both.now)
    both.now += 20_000_000_000
    both.device.advance(both.now)
    assert both.device.motor.frequency == pytest.approx(0.5, abs=0.01)
    both.device.enter(both.core.telegram.config, both.now)
    both.inputs = b""
    both.pass_time(3000)
    assert (both.device.motor.frequency, both.core.state) == (0, State.READY_TO_SWITCH_ON)


def test_acs355_record_47() -> None:
    """p140: 12.04 is read in slot 1; the request there has the reference 05 and one element, the answer is 0564h."""
    records = RecordQueue()
    plugin = RecordBench(PROFIDRIVE.core("drive", "PPO3", ALONE, records=records), records, "0331 0000")
    token = plugin.order("read", number=12, index=4)
    plugin.answer("01 01 01 01 42 01 05 64")
    assert plugin.requests == ["01 01 01 01 10 01 00 0C 00 04"]
    assert plugin.value(token) == 0x0564


def test_acs355_the_fault_that_stands_is_read() -> None:
    """p127: 945 with subindex 1; ACS550-02 manual p259: the text of 2310h."""
    plugin = bench(PROFIDRIVE, "PPO1", "0338 0000")
    for request, answer in (
        ("13 B8 00 00 00 00 00 00", "13 B8 00 00 00 00 00 01"),  # 952 counts
        ("63 B1 01 00 00 00 00 00", "43 B1 01 00 00 00 23 10"),
        ("13 B8 00 00 00 00 00 00", "13 B8 00 00 00 00 00 01"),
    ):
        assert plugin.out(2)[:23] == request
        plugin.see(f"{answer} 03 38 00 00")
        plugin.see(CHANNEL + "03 38 00 00", 3)
    assert plugin.core.faults() == ("2310h overcurrent",)


# -- SINAMICS G120 -----------------------------------------------------------------------------------------------------

G120 = find("sinamics-g120")


QUICK = {"p1120": 0.2, "p1121": 0.2, "p1135": 0.1}


class TestG120(DriveConformance):
    profile = G120
    telegrams = ("354",)
    simulated = QUICK
    fault = "F07011"


class TestG120WithoutFaultWord(DriveConformance):
    profile = G120
    telegrams = ("350",)
    simulated = QUICK
    names_faults = False


def test_g120_words_of_telegram_352() -> None:
    """Operating instructions p112; fault and alarm are numbers without their letters (LH9 p654: F01003 is 1003)."""
    status = meaning(G120, "352", "02B8 0000 0000 0000 03F8 03EB", "047E")
    assert (status.state, status.faults, status.warnings) == (State.FAULT, ("F01003",), ("A01016 firmware changed",))
    status = meaning(G120, "352", "0337 2000 1000 F000 0000 0000", "047F")
    assert (status.state, status.speed, status.current, status.torque) == (State.RUNNING, 0.5, 0.25, -0.25)


def test_g120_the_torque_limit_stays_open_in_the_safe_outputs() -> None:
    core = G120.core("drive", "350", ALONE, simulated=True)
    assert core.safe_outputs.hex(" ", 2) == "047e 0000 4000 0000"
    plugin = PluginBench(core, "0231 0000 0000 0000")
    plugin.order("set", values=[{"name": "torque_limit", "value": 50}])
    assert plugin.out(2) == "04 7E 00 00 20 00 00 00"


def test_g120_parameters() -> None:
    """p122, table 6-17: r7841[2]; and the write of 26 to p1210."""
    plugin = bench(G120, "353", "0231 0000")
    read = asked(plugin, "67 31 02 90 00 00 00 00", "47 31 02 90 00 00 00 07", "read", number="r7841[2]")
    assert read["value"] == 7
    wrote = asked(
        plugin, "74 BA 00 00 00 00 00 1A", "44 BA 00 00 00 00 00 1A", "write", number="p1210", index=0, value=26
    )
    assert wrote["ok"]


# -- Danfoss FC 302 ----------------------------------------------------------------------------------------------------

FC302 = find("danfoss-fc-302")


class TestFc302(DriveConformance):
    profile = FC302
    telegrams = ("PPO1",)
    simulated = {"3-41": 0.2}


class TestFc302WithoutChannel(DriveConformance):
    profile = FC302
    telegrams = ("PPO8",)
    simulated = {"3-41": 0.2}
    names_faults = False


def test_fc302_start_and_status() -> None:
    """MG.33.C4.02 p85: 04 7C 20 00 starts at 50 %; p86: 0F 07 20 00 is running at 50 %."""
    plugin = bench(FC302, "PPO1", "1603 0000")
    assert plugin.out() == CHANNEL + "04 3C 00 00"
    plugin.ok("speed", value=0.5)
    plugin.order("start")
    assert plugin.out() == CHANNEL + "04 7C 20 00"
    status = meaning(FC302, "PPO1", "0F07 2000", "047C")
    assert (status.state, status.speed, status.remote, status.reached) == (State.RUNNING, 0.5, True, True)
    assert status.bits == ("control_ready", "drive_ready", "enabled", "reached", "remote", "in_range", "in_operation")


def test_fc302_words_of_the_other_orders_follow_from_the_bits() -> None:
    """MG.33.C2.02 p35: bit 6 start, 4 quick stop, 3 coasting, 7 reset by its edge; bit 10 always 1."""
    plugin = bench(FC302, "1", "0F07 2000")
    for order, word in (("stop", "04 3C"), ("quick_stop", "04 2C"), ("coast", "04 34")):
        plugin.order(order)
        assert plugin.out()[:5] == word
    assert meaning(FC302, "1", "0F07 2000", "043C").state is State.STOPPING


def test_fc302_parameters() -> None:
    """p61: par. 3-41 is 10.00 s; and a refusal, which has neither number nor index: error 2."""
    plugin = bench(FC302, "PPO1", "0603 0000")
    asks = "31 55 00 00 00 00 03 E8"
    assert asked(plugin, asks, "21 55 00 00 00 00 03 E8", "write", number="3-41", value=10)["value"] == 10
    refused = asked(plugin, asks, "70 00 00 00 00 00 00 02", "write", number="3-41", value=10)
    assert (refused["error"], "error 2, low or high limit" in str(refused["text"])) == ("parameter", True)


def test_fc302_simulated_a_refusal_has_neither_number_nor_index() -> None:
    both = pair(FC302, "PPO1", options=ALONE)
    both.pass_time(50)
    token = both.order("read", number=999)
    while both.result(token) is None:
        both.run()
        if both.inputs[0] >> 4 == 7:
            assert both.inputs[:8].hex() == "7000000000000000"
    assert both.text(token, "parameter") == "parameter 999: error 0, illegal parameter number"


# -- SEW ---------------------------------------------------------------------------------------------------------------

MOVITRAC = find("sew-movitrac-b")
MOVIDRIVE = find("sew-movidrive")


class TestMovitrac(DriveConformance):
    profile = MOVITRAC
    telegrams = ("PARAM+3PD",)


class TestMovidrive(DriveConformance):
    profile = MOVIDRIVE
    telegrams = ("6PD",)


def test_movitrac_control_words() -> None:
    """0006h enable, 0002h stop (MOVIMOT MM..C p120); 0000h rapid stop, 0001h inhibit; a digit is 0.2 rpm."""
    plugin = bench(MOVITRAC, "2PD", "0006 0000")  # ready, PO data enabled
    assert plugin.out() == "00 02 00 00"
    plugin.ok("speed", value=-0.5)
    plugin.order("start")
    assert plugin.out() == "00 06 F1 5A"  # -750 rpm
    plugin.see("0007 F15A")
    assert plugin.core.state is State.RUNNING
    for order, word in (("stop", "00 02"), ("quick_stop", "00 00"), ("coast", "00 01")):
        plugin.order(order)
        assert plugin.out()[:5] == word
    assert meaning(MOVITRAC, "2PD", "0007 F15A", "0006").speed == -0.5


def test_movitrac_the_high_octet_is_a_fault_or_a_warning_while_bit_5_is_set() -> None:
    """Online manual 5947088779: 01 is overcurrent; bit 1 is 0 while a fault stands, MDX60B unit profile p93."""
    status = meaning(MOVITRAC, "2PD", "0124 0000", "0002")
    assert (status.state, status.faults, status.warnings) == (State.FAULT, ("F01 overcurrent",), ())
    status = meaning(MOVITRAC, "2PD", "1A27 0000", "0006")
    assert (status.state, status.faults, status.warnings) == (State.RUNNING, (), ("F26",))
    status = meaning(MOVITRAC, "2PD", "0407 0000", "0006")  # the unit status is no fault
    assert (status.state, status.faults, status.warnings) == (State.RUNNING, (), ())


def test_movitrac_does_not_start_by_the_reset_of_a_fault() -> None:
    """It starts by level: 0006h must not stand when the fault ends."""
    plugin = bench(MOVITRAC, "2PD", "0006 0000")
    plugin.order("start")
    plugin.out()
    plugin.see("0007 0000")
    assert plugin.see("0124 0000") == "00 02 00 00"
    plugin.order("acknowledge")
    assert plugin.out(2) == "00 42 00 00"
    assert plugin.see("0006 0000", 60) == "00 02 00 00"


def test_movitrac_simulated_warning_runs_on() -> None:
    both = pair(MOVITRAC, "2PD", options=ALONE)
    both.pass_time(50)
    both.ok("start")
    both.device.warn(26)
    both.pass_time(50)
    assert (both.inputs[:2].hex(), both.core.warnings(), both.core.faults()) == ("1a27", ("F26",), ())


def test_movitrac_parameters() -> None:
    """MOVIPRO manual p112: 32 00 21 9E 00 00 01 F4 writes 500 ms; MOVIMOT p195: 31 00 20 87 00 00 00 14 is 20 degC."""
    plugin = bench(MOVITRAC, "PARAM+2PD", "0006 0000")
    plugin.see("40 00 00 00 00 00 00 00 0006 0000", 30)  # the drive's handshake bit stands at 1
    token = plugin.order("write", number=8606, value=500)
    assert plugin.out(30)[:23] == "32 00 21 9E 00 00 01 F4"
    assert plugin.value(token, "32 00 21 9E 00 00 01 F4 0006 0000") == 500
    token = plugin.order("read", number=8327)
    assert plugin.out(2)[:23] == "71 00 20 87 00 00 00 00"
    assert plugin.value(token, "71 00 20 87 00 00 00 14 0006 0000") == 20
    token = plugin.order("read", number=8327)
    assert plugin.out(2)[:23] == "31 00 20 87 00 00 00 00"
    assert plugin.value(token, "31 00 20 87 00 00 00 14 0006 0000") == 20


def test_movitrac_the_reference_cannot_be_another_one() -> None:
    with pytest.raises(ConfigError, match="reference_rpm"):
        MOVITRAC.core("drive", "2PD", {"reference_rpm": 3000.0})


# -- all of them -------------------------------------------------------------------------------------------------------

LIBRARY = sorted(path.stem for path in (Path(finding.__file__).parent / "library").glob("*.toml"))


@pytest.mark.parametrize("name", LIBRARY)
def test_each_says_where_its_facts_are_from_and_that_nobody_has_tried_it(name: str) -> None:
    file = finding.file_at(Path(finding.__file__).parent / "library" / f"{name}.toml")
    assert file.source
    assert file.tried == "from the manual, not tried at the device"
    assert all(one.source for one in file.examples)
    assert file.examples or file.base not in ("profidrive", "bits")
