"""Demag: Set_Prm, DC brake, toggle bit, address, limits, warnings and SYNC (docs/reference/drives/demag.md).

Both ends alone, against literal octets.
"""

from __future__ import annotations

import demag_kit
import pytest
from demag_kit import START, ZERO, DemagBench, enable, pkw, plugin, sim
from drive_bench import MS, S
from slave_kit import SLAVE, Bench

from dpstack.dp.slave.application import SlaveApp
from dpstack.errors import ConfigError
from dpstack_drives.demag import DRIVE

# -- docs/reference/drives/demag.md#gsd-facts --------------------------------------------------------------------------


def test_d1_what_set_prm_and_chk_cfg_bring() -> None:
    """The octets of the GSD file, at the simulated drive and as the plugin's telegrams."""
    device = DRIVE.device("PPO1")
    assert device.check_prm(bytes.fromhex("00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00")) is None
    assert device.check_prm(bytes.fromhex("00 00 00 00 00 00 00 00 00 00 00 00 00 00 00")) is not None
    for octets, name in (("F3 71", "PPO1"), ("F3 75", "PPO2"), ("71", "PPO3"), ("75", "PPO4")):
        assert device.check_cfg(bytes.fromhex(octets)) is None
        assert DRIVE.core("hoist", name).telegram.config == bytes.fromhex(octets)
    assert device.ident == 0x0696
    assert device.fail_safe


# -- docs/reference/drives/demag.md#stopping ---------------------------------------------------------------------------


def braking() -> DemagBench:
    """At full speed, with a DC brake of 2 s at the next stop (392 = 1)."""
    bench = sim("PPO3", {"392": 1, "632": 2.0})
    enable(bench, "40 00", words=START[:2])
    bench.until("00 0F 40 00", "06 27 40 00", 2000)
    return bench


def test_d8_the_dc_brake_holds_for_632_and_takes_no_control_word() -> None:
    bench = braking()
    began = bench.now
    assert bench.send("00 07 40 00", 40)[:5] == "0A 27"  # the torque limit holds it: bit 11
    assert bench.send("00 0F 40 00", 200) == "02 27 00 00"  # 0F does not bring it back
    assert bench.device.motor.braking
    assert bench.device.motor.speed == 0.0
    assert bench.send("00 00 40 00", 1000) == "02 27 00 00"
    seen = bench.until("00 07 40 00", "02 23 00 00", 1000)
    assert seen == ["02 27 00 00", "02 23 00 00"]
    assert 2 * S <= bench.now - began <= 2 * S + 64 * MS
    assert not bench.device.motor.on


def test_d8_the_dc_brake_ends_with_the_release_or_a_fault() -> None:
    for word, what in (("00 23 00 00", "release"), ("02 08 00 00", "fault")):
        bench = braking()
        bench.send("00 07 40 00", 40)
        if what == "release":
            bench.device.release(False)
        else:
            bench.device.trip("F2061")
        assert bench.send("00 07 40 00", 40) == word
        assert not bench.device.motor.on


def test_d8_392_by_the_kind_of_application() -> None:
    assert pkw(sim("PPO1"), "21 88 00 00 00 00 00 01") == "11 88 00 00 00 00 00 01"
    assert pkw(sim("PPO1", application="speed"), "21 88 00 00 00 00 00 01") == "71 88 00 00 00 00 00 02"
    assert pkw(sim("PPO1", application="speed"), "11 88 00 00 00 00 00 00") == "11 88 00 00 00 00 00 02"
    assert pkw(sim("PPO1", application="torque"), "11 88 00 00 00 00 00 00") == "11 88 00 00 00 00 00 00"
    with pytest.raises(ConfigError, match="392 = 1"):
        DRIVE.device("PPO3", {"392": 1, "application": "speed"})


# -- docs/reference/drives/demag.md#toggle-bit -------------------------------------------------------------------------


def test_d10_the_drive_waits_for_the_first_copy_and_then_limits_each_answer() -> None:
    bench = sim("PPO3", {"880": 1, "881": 100})
    assert bench.send("00 06 20 00", 5000) == "03 C0 00 00"  # bit 8, a warning, nothing obeyed
    assert bench.send("01 06 20 00", 32) == "02 21 00 00"  # the copy: obeyed, and the next bit is 0
    for control, status in (("00 07", "03 23"), ("01 0F", "06 27"), ("00 0F", "07 27")):
        assert bench.send(control + " 00 00", 32) == status + " 00 00"
    # no answer for 100 ms: F2100
    word = bench.send("00 0F 00 00", 50)
    assert word[3:5] == "27"
    assert bench.send("00 0F 00 00", 100)[:5] == "02 08"
    assert bench.send("60 00 00 00") == "62 08 21 00"
    assert bench.send("01 00 00 00", 14_000)[:5] == "02 08"  # not sent within 15 s of a fault
    assert bench.send("00 00 00 00", 1000)[:5] == "02 08"
    assert bench.send("00 80 00 00", 50) == "03 C0 00 00"  # acknowledged: it begins anew


@pytest.mark.parametrize(
    ("mode", "reaction", "start", "words"),
    [
        (1, 2, ("00 06", "00 07", "00 0F"), ["03 C0"]),
        (1, 3, ("00 06", "00 07", "00 0F"), ["03 87", "03 C0"]),
        (2, 2, ("00 03",), ["03 A3"]),
        (2, 3, ("00 03",), ["03 A3"]),
    ],
)
def test_d10_switch_off_and_quick_stop(mode: int, reaction: int, start: tuple[str, ...], words: list[str]) -> None:
    """Quick stop only with 412 = 1; with 412 = 2 it switches off."""
    bench = sim("PPO3", {"412": mode, "880": reaction, "881": 500})
    copy, controls = "01", [*start]
    while controls or copy == "00":
        control = controls.pop(0) if controls else start[-1]
        copy = f"{int(bench.send(copy + control[2:] + ' 20 00', 16)[:2], 16) & 1:02}"
    assert bench.device.motor.on
    seen: list[str] = []
    for _ in range(100):
        word = bench.send(start[-1] + " 20 00", 16)[:5]
        if not seen or seen[-1] != word:
            seen.append(word)
        if word == words[-1]:
            break
    assert seen[-len(words) :] == words
    assert not bench.device.motor.on


def test_d10_880_is_0_as_delivered_and_bit_8_stays_0() -> None:
    bench = sim()
    assert bench.send("01 06 00 00") == "02 21 00 00"
    assert bench.send("00 06 00 00") == "02 21 00 00"


def test_d10_the_master_copies_the_bit_and_never_inverts_it() -> None:
    bench = plugin("03 C0 00 00")
    assert bench.out() == "51 00 00 00"  # with bits 12-14: which warning is it?
    assert bench.see("52 40 00 00") == "00 00 00 00"
    bench.order("start")
    assert bench.see("03 40 00 00") == "01 06 00 00"
    assert bench.see("02 21 00 00") == "00 07 00 00"
    assert bench.see("03 23 00 00") == "01 0F 00 00"
    bench.core.lost(bench.now)
    assert bench.core.cyclic(b"", bench.now).hex(" ") == "00 00 00 00"


@pytest.mark.parametrize(("limit", "told"), [("00 32", True), ("01 F4", False)])
def test_d10_the_plugin_warns_when_881_is_too_short(limit: str, told: bool) -> None:
    """50 ms are less than two scans of 32 ms."""
    bench = plugin(ZERO + "03 40 00 00", "PPO1")
    assert bench.out(7) == "13 71 00 00 00 00 00 00 01 00 00 00"
    bench.see(f"13 71 00 00 00 00 {limit} 03 40 00 00", 3)
    notices = [text for text in bench.notices() if "881" in text]
    assert len(notices) == told
    assert all("50 ms, two scans of the drive and two rotations take 68 ms" in text for text in notices)


# -- docs/reference/drives/demag.md#address ----------------------------------------------------------------------------


def test_d19_a_write_of_391_resets_the_drive() -> None:
    bench = sim("PPO1")
    enable(bench, head=ZERO, words=START[:2])
    assert bench.send(ZERO + "00 0F 20 00", 1500) == ZERO + "06 27 20 00"
    assert bench.send("81 E0 06 00 00 00 03 E8 00 0F 20 00")[:23] == "51 E0 06 00 00 00 03 E8"  # 480 in RAM only
    bench.send(ZERO + "00 0F 20 00")
    bench.send("21 87 00 00 00 00 00 07 00 00 20 00")
    assert bench.send(ZERO + "00 00 20 00") == ZERO + "02 40 " + "00 00"
    assert not bench.device.motor.on
    assert pkw(bench, "61 E0 01 00 00 00 00 00") == "51 E0 01 00 00 00 01 F4"  # RAM is what the EEPROM holds
    bench = sim("PPO1", {"391": 9})
    assert pkw(bench, "11 87 00 00 00 00 00 00") == "11 87 00 00 00 00 00 09"
    assert pkw(bench, "21 87 00 00 00 00 00 7F") == "71 87 00 00 00 00 00 02"


def test_d19_the_plugin_reads_and_writes_391() -> None:
    bench = plugin(ZERO + "02 40 00 00", "PPO1")
    token = bench.order_and_run(2, "write", number="node_id", value=7)
    assert bench.out() == "21 87 00 00 00 00 00 07 00 00 00 00"
    assert bench.value(token, "11 87 00 00 00 00 00 07 02 40 00 00", 2) == 7
    assert "0..126" in bench.misuse("write", number=391, value=127)


def test_d20_limits_and_factory_values_over_the_channel() -> None:
    bench = sim("PPO1")
    for order, reply in (
        ("61 77 01 00 00 00 00 00", "51 77 01 00 00 00 13 88"),  # 375: 50.00 Hz
        ("81 77 01 00 00 00 03 E7", "71 77 01 00 00 00 00 02"),  # 9.99 Hz
        ("21 B2 00 00 00 00 00 04", "71 B2 00 00 00 00 00 02"),  # 434 1..3
        ("13 71 00 00 00 00 00 00", "13 71 00 00 00 00 01 F4"),  # 881: 500 ms
        ("13 70 00 00 00 00 00 00", "13 70 00 00 00 00 00 00"),  # 880: 0
        ("20 E4 00 00 00 00 00 01", "70 E4 00 00 00 00 00 01"),  # 228 is read only
        ("10 FA 00 00 00 00 00 00", "10 FA 00 00 00 00 00 03"),  # 250: S1 and S2
    ):
        assert pkw(bench, order) == reply


@pytest.mark.parametrize(
    ("mask", "status"), [(0x0080, "82 C0"), (0x0800, "02 C0"), (0x0100, "82 C0"), (0x0000, "02 40")]
)
def test_d15_d21_warning_bits_of_the_drive(mask: int, status: str) -> None:
    """ZSW 7 for any, ZSW 15 for one that leads to a trip; the word itself through bits 12 to 14."""
    bench = sim()
    bench.device.warn(mask)
    assert bench.send("00 00 00 00") == status + " 00 00"
    high = f"{int(status[:2], 16) | 0x50:02X}"
    assert bench.send("50 00 00 00") == f"{high} {status[3:]} {mask >> 8:02X} {mask & 0xFF:02X}"


def test_d15_lost_master_is_f2062() -> None:
    bench = sim()
    enable(bench)
    bench.away()
    bench.send("60 00 00 00")
    assert bench.send("60 00 00 00") == "62 08 20 62"


def test_d19_set_slave_add_is_kept_as_391() -> None:
    device = DRIVE.device("PPO1")
    app = SlaveApp(device, address=SLAVE)
    bench = Bench(device, app)
    bench.ask(55, bytes.fromhex("07 06 96 00"))
    again = DRIVE.device("PPO1")
    again.inherit(device)
    assert again.own_address == 7


def test_d22_each_further_sync_passes_the_outputs_on() -> None:
    """By the standard; the manual has only UNSYNC do that."""
    device = demag_kit.device("PPO3")
    app = SlaveApp(device, address=SLAVE)
    bench = Bench(device, app)
    bench.prm_and_cfg(bytes.fromhex("B0 01 01 0B 06 96 01") + bytes(16), bytes.fromhex("71"))  # lock, sync, freeze

    def after(outputs: str) -> str:
        bench.dx(bytes.fromhex(outputs))
        bench.now += 100 * MS
        return bench.dx(bytes.fromhex(outputs)).data.hex(" ")

    assert after("00 06 00 00") == "02 21 00 00"
    bench.control(bytes.fromhex("20 00"))  # SYNC
    assert after("00 07 00 00") == "02 21 00 00"
    bench.control(bytes.fromhex("20 00"))  # a further one
    assert after("00 00 00 00") == "02 23 00 00"
    bench.control(bytes.fromhex("10 00"))  # UNSYNC ends the mode
    assert after("00 00 00 00") == "02 40 00 00"


def test_d17_the_plugin_waits_for_two_scans_before_it_believes() -> None:
    """16 ms with PPO3, 32 ms with the others: an old 0627 is no answer to a stop."""
    for telegram, lead, early in (("PPO3", "", 60), ("PPO1", ZERO, 100)):
        bench = plugin(lead + "02 40 00 00", telegram)
        token = bench.order_and_run(early // 2, "coast")
        assert bench.result(token) is None
        bench.run(10)
        assert bench.done(token)["ok"]
