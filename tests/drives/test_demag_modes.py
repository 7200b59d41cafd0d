"""Demag: the bus controls it with 412 = 1 only (manual, 11.2.1); no word of the state machine goes to contacts."""

from __future__ import annotations

import pytest
from demag_kit import ZERO, device, plugin, ppo1, ppo3
from drive_bench import MS, PairBench, PluginBench, S

from dpstack.profile import State
from dpstack_drives.demag import DRIVE
from dpstack_drives.demag.simulator import DemagDevice

READY_2 = "02 23 00 00"
MOTIONS = ("start", "stop", "quick_stop", "coast", "acknowledge")


def answered(bench: PluginBench, *replies: str, process: str) -> None:
    """Each reply once, zeros between them (the handshake of 11.1)."""
    bench.run(2)
    for reply in replies:
        bench.see(f"{reply} {process}", 2)
        bench.see(ZERO + process, 3)


def started(speed: str = "20 00") -> PluginBench:
    """PPO3 after its start."""
    bench = ppo3()
    bench.order("start")
    for word in ("02 21 00 00", "02 23 00 00", f"02 27 {speed}"):
        bench.see(word, 2)
    return bench


def words(bench: PluginBench, ms: int, offset: int = 0) -> set[str]:
    """The different control words sent within some time, in hex."""
    return {bench.run()[offset : offset + 2].hex().upper() for _ in range(ms * MS // bench.rotation)}


def running(telegram: str = "PPO1") -> tuple[PairBench, DemagDevice]:
    simulated = device(telegram)
    bench = PairBench(DRIVE.core("hoist", telegram), simulated)
    bench.ok("speed", value=0.5)
    bench.ok("start")
    bench.ok("reached")
    return bench, simulated


def other_set(device: DemagDevice, mode: int) -> None:
    """A contact selects data set 2, in which 412 is another one."""
    local_remote, selection = device.store.table.get(412), device.store.table.get(414)
    assert local_remote is not None
    assert selection is not None
    device.store.write(local_remote, mode, 2)
    device.store.write(selection, 2)


def test_control_by_remote_contacts_is_read_before_the_first_word() -> None:
    bench = ppo1(ZERO + READY_2)
    token = bench.order("start")
    assert bench.out() == "10 F9 00 00 00 00 00 00 00 00 00 00"
    answered(bench, "10 F9 00 00 00 00 00 01", "41 9C 01 00 00 00 00 02", process=READY_2)
    assert bench.text(token).startswith("412 is 2: the control word drives contacts")
    assert "write 412 = 1 in the active data set (1)" in bench.text(token)
    assert words(bench, 1000, 8) == {"0000"}


@pytest.mark.parametrize("op", MOTIONS)
@pytest.mark.parametrize("process", [READY_2, "02 27 20 00", "02 08 00 00"])
def test_no_order_sends_a_word_of_the_state_machine_to_contacts(op: str, process: str) -> None:
    """412 = 2 is known (data exchange has begun): the control word stays 0, so S1IND to S8IND stay open."""
    bench = ppo1(ZERO + process, check_settings=True)
    answered(bench, "10 F9 00 00 00 00 00 01", "41 9C 01 00 00 00 00 02", process=process)
    bench.order(op, timeout_s=2)
    seen = set()
    for _ in range(400):
        answered(bench, process=process)
        seen.add(bench.run()[8:10].hex())
        request = bench.run()[:8].hex().upper()
        if request[:4] == "10F9":
            answered(bench, "10 F9 00 00 00 00 00 01", process=process)
        elif request[:4] == "619C":
            answered(bench, "41 9C 01 00 00 00 00 02", process=process)
    # selector bits 12 to 14 count in every mode (11.2.1.1)
    assert {word[1:] for word in seen} == {"000"}


@pytest.mark.parametrize("op", MOTIONS)
def test_nothing_is_sent_while_the_mode_is_unknown(op: str) -> None:
    """The drive does not answer in its parameter channel, and 0x23 is a state of every mode."""
    bench = ppo1(ZERO + READY_2)
    token = bench.order(op, timeout_s=2)
    assert words(bench, 3000, 8) == {"0000"}
    if op == "start":
        assert "nobody knows whether 412 is 1" in bench.text(token)


def test_without_an_answer_the_status_word_proves_the_state_machine() -> None:
    bench = ppo1(ZERO + "02 40 00 00")
    bench.order("start", timeout_s=4)
    assert words(bench, 2900, 8) == {"0000"}
    assert bench.run(100)[8:10].hex() == "0006"


def test_without_a_channel_0x23_at_control_word_0_is_not_the_state_machine() -> None:
    bench = ppo3(READY_2)
    token = bench.order("start")
    assert words(bench, 1000) == {"0000"}
    assert bench.text(token).startswith("412 is 2: the control word drives contacts")
    says = "PPO3 has no parameter channel to read or set 412: do it at the keypad or over PPO1 or PPO2"
    assert says in bench.text(token)
    # the data set is another one now, and 412 = 1 in it
    token = bench.order("start")
    assert bench.see("02 40 00 00") == "00 06 00 00"


@pytest.mark.parametrize("op", ["stop", "quick_stop", "coast"])
def test_without_a_channel_nothing_is_sent_before_the_mode_is_proven(op: str) -> None:
    bench = ppo3("02 27 20 00")
    bench.order(op, timeout_s=2)
    assert words(bench, 2500) == {"0000"}


def test_a_fault_can_be_acknowledged_before_the_mode_is_proven() -> None:
    """In control by contacts bit 7 alone is S8IND without S1IND, the release: nothing can start."""
    bench = ppo3("62 08 20 62")
    bench.order("acknowledge", timeout_s=1)
    assert words(bench, 1000) == {"0080", "0000"}


@pytest.mark.parametrize(("mode", "says"), [(2, "412 is 2: the control word drives contacts"), (0, "412 is 0")])
def test_412_that_changes_with_the_data_set_while_it_runs(mode: int, says: str) -> None:
    bench, device = running()
    other_set(device, mode)
    bench.pass_time(1500)
    assert bench.run()[8:10] == bytes(2)
    assert any(says in notice and "it stays off until the next start" in notice for notice in bench.notices())
    bench.pass_time(3000)
    assert not device.motor.on
    assert "data set (2)" in bench.refused("start")[1]
    assert bench.ok("stop") == "ready"
    assert bench.run()[8:10] == bytes(2)


def test_a_stop_after_412_has_changed_leaves_the_drive_off() -> None:
    bench, device = running()
    other_set(device, 2)
    bench.ok("stop")
    bench.pass_time(2000)
    assert not device.motor.on
    assert bench.run()[8:10] == bytes(2)


def test_412_that_is_set_back_is_seen_by_the_next_start() -> None:
    bench, device = running()
    other_set(device, 2)
    bench.pass_time(3000)
    bench.refused("start")
    bench.ok("write", number=412, value=1, data_set=2)
    assert bench.ok("start") == "running"


def test_remote_that_goes_to_0_while_it_runs_takes_the_command_back() -> None:
    """412 became 0 with the data set, and a contact keeps it running: the bus does not control it any more."""
    bench = started("00 00")
    assert bench.core.status().state is State.RUNNING
    assert bench.see("00 27 20 00", 60) == "00 00 00 00"
    assert any("remote (bit 9) went to 0" in notice for notice in bench.notices())


def test_remote_that_is_0_when_a_running_drive_is_stopped_takes_the_command_back() -> None:
    """The status word stays the same from the order on: the watch judges it at once, not when it reads 412 again."""
    bench = ppo1(ZERO + "00 27 20 00")
    bench.order("stop")
    words(bench, 400)
    assert any("remote (bit 9) went to 0" in notice for notice in bench.notices())


def test_without_a_channel_a_drive_that_runs_on_after_a_stop_gets_zeros() -> None:
    """412 became 2 with the data set: 0007 is S1IND to S3IND then, and only zeros open the release."""
    bench = started()
    token = bench.order("stop")
    assert bench.out() == "00 07 00 00"
    bench.run(2 * S // bench.rotation)
    assert bench.out() == "00 07 00 00"
    bench.run(2 * S // bench.rotation)
    assert bench.out() == "00 00 00 00"
    assert any("ordered to stop and has not slowed down for 3 s" in notice for notice in bench.notices())
    bench.see("02 23 00 00", 60)
    assert bench.done(token)["ok"] is True


def test_without_a_channel_a_slow_ramp_is_left_alone() -> None:
    bench = started()
    bench.order("stop")
    for speed in range(0x2000, 0x0100, -0x0100):  # 1.6 % of the reference in 2 s
        bench.see(f"02 27 {speed:04X}", 2 * S // bench.rotation)
        assert bench.out() == "00 07 00 00"


@pytest.mark.parametrize("op", ["stop", "quick_stop"])
@pytest.mark.parametrize(("telegram", "lead"), [("PPO3", ""), ("PPO1", ZERO)])
def test_412_that_changed_while_the_drive_stands_gets_no_word_of_a_stop(telegram: str, lead: str, op: str) -> None:
    """With 412 = 1 the drive showed 0x40; now another data set with 412 = 2 is active, and it shows 0x23."""
    bench = plugin(lead + "02 40 00 00", telegram)
    token = bench.order("start", timeout_s=4)
    if lead:
        answered(bench, "10 F9 00 00 00 00 00 01", "41 9C 01 00 00 00 00 01", process="02 40 00 00")
    for word in ("02 21 00 00", "02 23 00 00", "02 27 00 00"):
        bench.see(lead + word, 2)
    assert bench.done(token)["ok"] is True
    bench.order("coast")
    bench.see(lead + "02 40 00 00", 100)
    bench.see(lead + READY_2, 100)
    bench.order(op)
    assert words(bench, 500, 8 if lead else 0) == {"0000"}


def test_412_that_changes_on_the_way_to_running_ends_the_start() -> None:
    """The drive shows 0x23 and bit 9 all the time, so only the channel tells that its contacts are driven."""
    bench = ppo1(ZERO + "02 40 00 00")
    token = bench.order("start", timeout_s=5)
    answered(bench, "10 F9 00 00 00 00 00 01", "41 9C 01 00 00 00 00 01", process="02 40 00 00")
    assert bench.see(ZERO + READY_2, 20)[24:29] == "00 0F"
    bench.run(S // bench.rotation)
    answered(bench, "10 F9 00 00 00 00 00 02", "41 9C 02 00 00 00 00 02", process=READY_2)
    assert words(bench, 500, 8) == {"0000"}
    assert "412 is 2" in bench.text(token)


def test_after_a_stop_the_word_is_0_so_that_the_mode_shows() -> None:
    bench, _ = running("PPO3")
    bench.ok("stop")
    assert bench.run()[:2] == bytes(2)
    bench.pass_time(100)
    assert bench.core.status().state is State.SWITCH_ON_INHIBITED


def test_a_contact_that_keeps_it_running_is_seen_over_the_channel() -> None:
    """412 is 2 in the data set that is active now, and 000F keeps the drive running: literal octets."""
    bench = ppo1(ZERO + "02 40 00 00")
    bench.order("start")
    answered(bench, "10 F9 00 00 00 00 00 01", "41 9C 01 00 00 00 00 01", process="02 40 00 00")
    for word in ("02 21 00 00", "02 23 00 00", "02 27 20 00"):
        bench.see(ZERO + word, 2)
    bench.run(S // bench.rotation)
    assert bench.run()[:4].hex() == "10f90000"
    answered(bench, "10 F9 00 00 00 00 00 02", "41 9C 02 00 00 00 00 02", process="02 27 20 00")
    assert bench.run()[8:].hex() == "00000000"
    says = "write 412 = 1 in the active data set (2); its control word is 0 now"
    assert any("412 is 2" in notice and says in notice for notice in bench.notices())


def test_set_412_takes_it_from_the_contacts() -> None:
    device = DRIVE.simulated("PPO1", {}, {"412": 2})
    bench = PairBench(DRIVE.core("hoist", "PPO1", {"set_412": True}), device)
    assert bench.ok("start") == "running"
    assert any("412 was 2: set to 1 in data set 1 (RAM only)" in notice for notice in bench.notices())
