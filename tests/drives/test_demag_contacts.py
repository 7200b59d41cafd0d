"""Demag: control by remote contacts (412 = 2) at both ends, hardware contacts of the simulated drive, the keypad
(docs/reference/drives/demag.md#control-modes, docs/reference/drives/demag.md#set-point-and-actual-value)."""

from __future__ import annotations

import pytest
from demag_kit import ZERO, DemagBench, device, pkw, plugin, sim
from drive_bench import MS, DeviceBench, PairBench, PluginBench

from dpstack.profile import Leave, State
from dpstack_drives.demag import DRIVE

CONTACTS = "remote-contacts"
#: 412 is 2 in data set 1: requests of 249 and 412, and the answers
ANSWERS = (("10 F9 00 00", "10 F9 00 00 00 00 00 01"), ("61 9C 01 00", "41 9C 01 00 00 00 00 02"))


def contacts(telegram: str = "PPO3", process: str = "02 23 00 00") -> PluginBench:
    """PPO3: 0x23 and remote with the control word 0 are control by remote contacts."""
    head = ZERO if telegram == "PPO1" else ""
    return plugin(head + process, telegram, control=CONTACTS)


def run(bench: PluginBench, ms: int = 200) -> str:
    return bench.run(ms * MS // bench.rotation).hex(" ").upper()


def answered(bench: PluginBench, request: str, reply: str, process: str, control: str) -> None:
    """The plugin asks ``request``, with the control word ``control`` until the answer has come."""
    while not (out := bench.out()).startswith(request):
        assert out[24:29] == control
    assert out[24:29] == control
    bench.see(f"{reply} {process}", 2)
    bench.see(ZERO + process, 2)


# -- the plugin, against literal octets --------------------------------------------------------------------------------


def test_d7_start_and_stop_by_contacts() -> None:
    """S1 and S2 start clockwise, S1 and S3 anticlockwise with the amount of the set point; S1 alone stops."""
    bench = contacts()
    assert bench.out() == "00 00 00 00"
    bench.order("speed", value=0.5)
    start = bench.order("start")
    assert run(bench) == "00 03 20 00"
    assert bench.value(start, "02 27 00 00", 60) == "running"
    bench.see("06 27 20 00", 60)
    assert (bench.core.status().reached, bench.core.status().speed) == (True, 0.5)
    assert bench.out_after("speed", value=-0.25) == "00 05 10 00"
    assert bench.see("06 27 F0 00") == "00 05 10 00"
    assert bench.core.status().speed == -0.25
    stop = bench.order("stop")
    assert bench.out() == "00 01 10 00"
    assert bench.core.status().state is State.STOPPING
    assert bench.see("02 23 00 00", 60) == "00 00 10 00"
    assert bench.value(stop) == "ready"
    coast = bench.order("coast")
    assert run(bench, 120) == "00 00 10 00"
    assert bench.value(coast) == "ready"


def test_d7_the_mode_is_read_over_the_channel_before_the_first_contact() -> None:
    bench = contacts("PPO1")
    bench.order("start")
    for request, reply in ANSWERS:
        answered(bench, request, reply, "02 23 00 00", "00 00")
    assert run(bench)[24:] == "00 03 00 00"


@pytest.mark.parametrize(
    ("process", "says"),
    [
        ("02 40 00 00", "412 is 1: control by the state machine; write 412 = 2 in the active data set"),
        ("00 23 00 00", "set 412 = 2 at the keypad or over PPO1 or PPO2 (factory setting 44); if it is 2, no hardware"),
        ("02 27 00 00", "does not show whether 412 is 2"),
    ],
)
def test_d7_no_contact_is_closed_while_412_is_not_2(process: str, says: str) -> None:
    bench = contacts(process=process)
    token = bench.order("start")
    assert {bench.run()[:2].hex() for _ in range(600)} == {"0000"}
    assert says in bench.text(token, "fault")


def test_d7_412_that_changes_while_contacts_run_it_ends_that() -> None:
    bench = contacts("PPO1")
    bench.order("start")
    for request, reply in ANSWERS:
        answered(bench, request, reply, "02 23 00 00", "00 00")
    bench.see(ZERO + "02 27 00 00", 60)
    for request, reply in (("10 F9", "10 F9 00 00 00 00 00 02"), ("61 9C", "41 9C 02 00 00 00 00 00")):
        answered(bench, request, reply, "02 27 00 00", "00 03")
    assert bench.out()[24:] == "00 00 00 00"
    assert any("412 is 0: control not by the bus; write 412 = 2" in text for text in bench.notices())


def test_d10_the_toggle_bit_is_copied_beside_the_contacts() -> None:
    bench = contacts()
    bench.order("start")
    run(bench)
    assert bench.see("03 27 00 00", 2) == "01 03 00 00"
    assert bench.see("02 27 00 00", 2) == "00 03 00 00"


@pytest.mark.parametrize(
    ("op", "says"), [("quick_stop", "stop() takes the ramp"), ("acknowledge", "acknowledge at the drive")]
)
def test_d9_orders_that_contacts_have_no_word_for(op: str, says: str) -> None:
    assert says in contacts().misuse(op)


def test_a_listener_reads_the_direction_of_the_contacts() -> None:
    core = contacts().core
    assert core.decode(bytes.fromhex("00 03 20 00")) == (3, 0.5)
    assert core.decode(bytes.fromhex("00 05 20 00")) == (5, -0.5)


# -- the drive, against literal octets ---------------------------------------------------------------------------------


def local(**presets: object) -> DemagBench:
    """412 = 0 and 434 = 1; no contact is closed, so that each one counts."""
    found = DRIVE.device("PPO1", {"412": 0, "434": 1, **presets})
    bench = DeviceBench(found, "F3 71")
    bench.send(ZERO + "00 00 00 00")
    return bench  # type: ignore[return-value]


def words(bench: DemagBench, ms: float = 70) -> str:
    return bench.send(ZERO + "00 0F 40 00", ms)[24:]


def test_d7_d11_local_run_by_contacts_at_the_internal_set_point() -> None:
    """The control word and the line set point do nothing; bit 9 is always 0."""
    bench = local()
    bench.device.set_point(25.0)
    assert words(bench, 500) == "00 23 00 00"
    bench.device.contact("S2", True)
    assert words(bench, 500) == "00 23 00 00"  # no release
    bench.device.contact("S1", True)
    assert words(bench, 500) == "00 23 00 00"  # S2 starts by its edge
    bench.device.contact("s2", False)
    words(bench)
    bench.device.contact("s2", True)
    assert words(bench, 800) == "04 27 20 00"
    assert bench.device.injected == ("contact S1 on", "contact S2 on")
    bench.device.contact("S2", False)
    bench.device.contact("S3", True)
    assert words(bench, 1500) == "04 27 E0 00"
    assert pkw(bench, "10 FA 00 00 00 00 00 00") == "10 FA 00 00 00 00 00 05"  # 250: S1 and S3
    assert pkw(bench, "10 E4 00 00 00 00 00 00") == "20 E4 00 00 00 00 09 C4"  # 228: 25.00 Hz
    bench.device.contact("S3", False)
    assert words(bench, 100)[:5] == "00 27"  # its ramp
    assert words(bench, 1500) == "00 23 00 00"


def test_d7_emergency_operation_goes_on_without_the_master() -> None:
    """S4 takes data set 2, in which the contacts control it: bit 9 goes to 0, and there is no F2062."""
    found = device("PPO1", **{"414": 0})
    mode, ramp = found.store.table.get(412), found.store.table.get(434)
    assert mode is not None
    assert ramp is not None
    found.store.write(mode, 0, 2)
    found.store.write(ramp, 1, 2)
    found.set_point(10.0)
    bench = DeviceBench(found, "F3 71")
    assert bench.send(ZERO + "00 06 00 00")[24:] == "02 21 00 00"
    found.contact("S4", True)
    found.contact("S2", False)
    assert bench.send(ZERO + "00 06 00 00")[24:] == "00 23 00 00"
    bench.lose(1000, Leave.WATCHDOG)
    found.contact("S2", True)
    bench.pass_time(1000)
    assert (found.motor.on, round(found.motor.frequency, 3), found.fault) == (True, 0.2, 0)


@pytest.mark.parametrize(("closed", "active"), [("", 1), ("S4", 2), ("S5", 3), ("S4 S5", 4)])
def test_d18_the_data_set_by_contacts(closed: str, active: int) -> None:
    """414 = 0; a reading, binary from 1."""
    bench = local()
    for name in closed.split():
        bench.device.contact(name, True)
    assert pkw(bench, "10 F9 00 00 00 00 00 00") == f"10 F9 00 00 00 00 00 0{active}"
    assert pkw(bench, "21 9E 00 00 00 00 00 02") == "11 9E 00 00 00 00 00 02"  # 414 = 2 goes first
    assert pkw(bench, "10 F9 00 00 00 00 00 00") == "10 F9 00 00 00 00 00 02"


def test_d7_in_mode_2_the_control_word_has_the_contacts_of_the_data_set() -> None:
    bench = sim("PPO1", {"412": 2})
    assert pkw(bench, "10 F9 00 00 00 00 00 00") == "10 F9 00 00 00 00 00 01"
    bench.send(ZERO + "00 08 00 00")
    assert bench.send("10 F9 00 00 00 00 00 00 00 08 00 00")[:23] == "10 F9 00 00 00 00 00 02"


@pytest.mark.parametrize(("how", "shown"), [(1, "03 E8"), (2, "09 C4"), (3, "0D AC")])  # 10, 25 and 35 Hz in 283
def test_d11_434_and_the_internal_set_point(how: int, shown: str) -> None:
    bench = sim("PPO1", {"434": how, "228": 10})
    bench.send(ZERO + "00 00 20 00")
    assert bench.send("11 1B 00 00 00 00 00 00 00 00 20 00")[:23] == f"21 1B 00 00 00 00 {shown}"


def test_d7_the_release_of_the_state_machine_needs_s2_or_s3_and_that_of_contacts_s1_alone() -> None:
    bench = sim()
    assert bench.send("00 06 00 00") == "02 21 00 00"
    bench.device.contact("S2", False)
    assert bench.send("00 06 00 00") == "00 21 00 00"
    bench.device.contact("S3", True)
    assert bench.send("00 06 00 00") == "02 21 00 00"
    bench = sim(presets={"412": 2})
    bench.device.contact("S2", False)
    assert bench.send("00 03 00 00") == "06 27 00 00"


def test_a_contact_that_it_does_not_have_is_named() -> None:
    with pytest.raises(ValueError, match=r"'S9' is no contact of demag-dedrive; it has S1, S2, S3, S4, S5, S6"):
        device().contact("S9", True)
    with pytest.raises(ValueError, match=r"2000 Hz is outside -1000..1000 Hz"):
        device().set_point(2000)


def test_contacts_stay_over_power_off() -> None:
    before = device()
    before.contact("S4", True)
    after = device()
    after.inherit(before)
    assert after.injected == ("contact S4 on",)


def test_d9_the_keypad_acknowledges_in_every_mode_but_not_in_the_first_15_s() -> None:
    bench = sim(presets={"412": 2})
    with pytest.raises(ValueError, match="no fault stands"):
        bench.device.acknowledge()
    bench.device.trip("F2100")
    assert bench.send("00 00 00 00") == "02 08 00 00"
    with pytest.raises(ValueError, match=r"15 s after it came: 1[45].. s are left"):
        bench.device.acknowledge()
    bench.send("00 00 00 00", 15_000)
    bench.device.acknowledge()
    assert bench.send("00 00 00 00") == "02 23 00 00"


def test_d21_data_of_the_motor_are_locked_in_operation() -> None:
    """Error 106."""
    bench = sim("PPO1")
    for word in ("00 06", "00 07", "00 0F"):
        bench.send(f"{ZERO}{word} 20 00")
    order = "81 77 01 00 00 00 17 70"  # 375 = 60 Hz in data set 1
    bench.send(f"{ZERO}00 0F 20 00")
    assert bench.send(f"{order} 00 0F 20 00")[:23] == "71 77 01 00 00 00 00 6A"
    bench.send(f"{ZERO}00 00 20 00", 2000)
    assert bench.send(f"{order} 00 00 20 00")[:23] == "51 77 01 00 00 00 17 70"


# -- both --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("telegram", ["PPO1", "PPO3"])
def test_contacts_run_the_simulated_drive_both_ways(telegram: str) -> None:
    bench = PairBench(DRIVE.core("hoist", telegram, {"control": CONTACTS}), device(telegram, **{"412": 2}))
    bench.ok("speed", value=0.5)
    assert bench.ok("start") == "running"
    assert bench.ok("reached") == pytest.approx(0.5, abs=0.01)
    bench.ok("speed", value=-0.5)
    assert bench.ok("reached") == pytest.approx(-0.5, abs=0.01)
    assert bench.device.motor.frequency == pytest.approx(-0.5, abs=0.01)
    assert bench.ok("stop") == "ready"
    assert not bench.device.motor.on


def test_set_412_sets_what_the_option_needs() -> None:
    bench = PairBench(DRIVE.core("hoist", "PPO1", {"control": CONTACTS, "set_412": True}), device("PPO1"))
    assert bench.ok("start") == "running"
    assert any("412 was 1: set to 2 in data set 1 (RAM only)" in text for text in bench.notices())


# -- 880 = 1 -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reaction", "told"), [(0, False), (1, True), (2, False)])
def test_d10_a_clear_that_will_trip_is_told_when_data_exchange_begins(reaction: int, told: bool) -> None:
    """880 is read like the other settings; the drive can be started all the same."""
    bench = PairBench(DRIVE.core("hoist", "PPO1"), device("PPO1", **{"880": reaction}))
    bench.pass_time(2500)
    says = "880 is 1: every Clear longer than 881, also the one at the end of the program, trips F2100"
    assert any(text.startswith(says) for text in bench.notices()) == told
    bench.ok("start")


def test_d10_880_is_asked_with_literal_octets() -> None:
    bench = plugin(ZERO + "02 40 00 00", "PPO1", check_settings=True)
    known = {"10F9": 1, "619C": 1, "6186": 0, "6177": 5000, "61B2": 2, "10E4": 0, "1370": 1}
    replies = {"10F9": "10F9", "619C": "419C", "6186": "5186", "6177": "5177", "61B2": "41B2", "10E4": "20E4"}
    for _ in range(400):
        request = bench.run()[:8].hex().upper()
        answer = ""
        if (key := request[:4]) in known:
            answer = replies.get(key, key) + request[4:8] + f"{known[key]:08X}"
        bench.inputs = bytes.fromhex((answer or "00" * 8) + "02400000")
    (notice,) = bench.notices()
    assert notice == (
        "880 is 1: every Clear longer than 881, also the one at the end of the program, trips F2100, which is "
        "locked for 15 s; 880 = 2 switches off instead, without a fault"
    )


def test_d10_clear_trips_and_locks() -> None:
    bench = sim(presets={"880": 1})
    bench.send("01 00 00 00", 40)
    for _ in range(4):
        bench.send("00 00 00 00", 40)
        bench.send("01 00 00 00", 40)
    bench.device.clear(bench.now)
    bench.pass_time(450)
    assert not bench.device.faulted
    bench.pass_time(150)
    bench.device.operate(bench.now)
    assert bench.send("00 80 00 00", 500) == "02 08 00 00"  # locked
