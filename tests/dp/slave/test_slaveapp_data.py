"""Clear and Operate, SYNC and FREEZE with their double buffers, groups (docs/protocol.md#global_control)."""

from __future__ import annotations

import pytest
from slave_kit import CFG, CLEAR, FREEZE, OPERATE, OTHER, PRM, SYNC, UNFREEZE, UNSYNC, Bench, Recorder

from dpstack.dp.slave.application import SlaveAppState
from dpstack.fdl.interface import RS_REPLY
from dpstack.fdl.telegram import Kind, Telegram


def test_clear_and_operate() -> None:
    bench = Bench().up()
    bench.dx(b"\x11")
    bench.control(CLEAR)
    assert (bench.app.outputs, bench.app.clear) == (b"\x00", True)
    bench.dx(b"\x22")  # whatever the master sends is void
    bench.control(CLEAR)  # repeated cyclically: told once
    bench.control(OPERATE)
    assert not bench.app.clear
    bench.dx(b"\x33")
    bench.control(OPERATE)
    assert bench.recorder.take() == ["operate", "exchange 11", "clear", "exchange 00", "operate", "exchange 33"]


def test_operate_is_called_once_after_entry_also_by_global_control() -> None:
    bench = Bench().up()
    bench.control(OPERATE)
    bench.dx()
    bench.dx()
    assert bench.recorder.take() == ["operate", "exchange 55", "exchange 55"]


def test_clear_before_the_first_exchange() -> None:
    bench = Bench().up()
    bench.control(CLEAR)
    bench.dx(b"\x11")
    bench.control(OPERATE)
    bench.dx(b"\x11")
    assert bench.recorder.take() == ["clear", "exchange 00", "operate", "exchange 11"]


def test_leaving_forgets_clear() -> None:
    bench = Bench().up()
    bench.control(CLEAR)
    bench.up()
    assert not bench.app.clear
    bench.dx(b"\x11")
    assert bench.app.outputs == b"\x11"


def test_an_empty_frame_is_clear_for_a_fail_safe_slave() -> None:
    """docs/protocol.md#clear: a Fail_Safe slave is sent empty frames in Clear; a full one ends it unless Global_Control
    said Clear."""
    device = Recorder()
    device.fail_safe = True
    bench = Bench(device).up()
    bench.dx(b"\x11")
    assert bench.dx(b"").data == b"\x02"
    assert bench.app.clear
    bench.dx(b"")
    bench.dx(b"\x22")
    assert bench.recorder.take() == [
        "operate", "exchange 11", "clear", "exchange 00", "exchange 00", "operate", "exchange 22",
    ]  # fmt: skip
    bench.control(CLEAR)
    bench.dx(b"")
    bench.dx(b"\x33")
    bench.control(OPERATE)
    bench.dx(b"\x44")
    assert bench.recorder.take() == ["clear", "exchange 00", "exchange 00", "operate", "exchange 44"]


def test_sync_holds_outputs_and_every_further_one_passes_on() -> None:
    bench = Bench().up()
    bench.dx(b"\x11")
    bench.control(SYNC)  # passes on what came last
    assert bench.recorder.take() == ["operate", "exchange 11", "exchange 11"]
    bench.dx(b"\x22")
    bench.dx(b"\x33")
    assert bench.app.outputs == b"\x11"
    assert bench.diag()[1] == 0x2C  # Sync_Mode
    bench.control(SYNC)
    assert bench.app.outputs == b"\x33"
    assert bench.recorder.take() == ["exchange 11", "exchange 11", "exchange 33"]
    bench.dx(b"\x44")
    bench.control(UNSYNC)
    assert bench.app.outputs == b"\x44"
    assert bench.diag()[1] == 0x0C
    bench.dx(b"\x55")
    assert bench.app.outputs == b"\x55"
    bench.control(UNSYNC)  # nothing to end
    assert bench.recorder.take() == ["exchange 33", "exchange 44", "exchange 55"]


def test_sync_holds_what_came_last_also_after_many_exchanges() -> None:
    bench = Bench().up()
    for octets in (b"\x11", b"\x22", b"\x33"):
        bench.dx(octets)
    bench.control(SYNC)
    assert bench.app.outputs == b"\x33"
    bench.control(UNSYNC)
    bench.dx(b"\x44")
    bench.control(OPERATE)
    assert bench.app.outputs == b"\x44"
    assert bench.recorder.take()[-1] == "exchange 44"


def test_inputs_go_on_during_sync() -> None:
    bench = Bench().up()
    bench.dx()
    bench.control(SYNC)
    assert [bench.dx().data for _ in range(3)] == [b"\x03", b"\x04", b"\x05"]


def test_freeze_holds_inputs_and_every_further_one_samples() -> None:
    bench = Bench().up()
    assert bench.dx(b"\x11").data == b"\x01"
    bench.control(FREEZE)  # samples at that moment: the second call
    assert [bench.dx(b"\x22").data for _ in range(3)] == [b"\x02"] * 3
    assert bench.app.outputs == b"\x22"  # outputs go on
    assert bench.diag()[1] == 0x1C  # Freeze_Mode
    assert bench.ask(56).data == b"\x02"
    bench.control(FREEZE)
    assert bench.dx().data == b"\x06"
    bench.control(UNFREEZE)
    assert bench.diag()[1] == 0x0C
    assert bench.dx().data == b"\x08"


def test_sync_and_freeze_at_once_take_one_sample() -> None:
    bench = Bench().up()
    bench.dx(b"\x11")
    bench.control(b"\x28\x00")
    assert bench.recorder.take() == ["operate", "exchange 11", "exchange 11"]
    assert bench.dx(b"\x22").data == b"\x02"
    assert bench.app.outputs == b"\x11"


def test_the_un_ones_win() -> None:
    bench = Bench().up()
    bench.dx()
    bench.control(b"\x3c\x00")  # sync, unsync, freeze, unfreeze
    assert bench.diag()[1] == 0x0C
    bench.control(SYNC)
    bench.control(FREEZE)
    bench.control(b"\x3c\x00")
    assert bench.diag()[1] == 0x0C


def test_clear_goes_through_sync() -> None:
    """docs/protocol.md#slave-states: Clear empties the outputs, held or not; back in Operate they wait for the next
    SYNC."""
    bench = Bench().up()
    bench.dx(b"\x11")
    bench.control(SYNC)
    bench.control(b"\x02\x00")
    assert bench.app.outputs == b"\x00"
    bench.dx(b"\x22")
    bench.control(OPERATE)
    bench.dx(b"\x33")
    assert bench.app.outputs == b"\x00"
    bench.control(SYNC)
    assert bench.app.outputs == b"\x33"


@pytest.mark.parametrize("mode", [SYNC, FREEZE])
def test_a_device_without_sync_or_freeze_ignores_it(mode: bytes) -> None:
    bench = Bench()
    bench.device.sync_supported = bench.device.freeze_supported = False
    bench.up()
    bench.dx()
    bench.control(mode)
    assert bench.diag()[1] == 0x0C
    bench.dx(b"\x77")
    assert bench.app.outputs == b"\x77"


@pytest.mark.parametrize(("mask", "meant"), [(0, True), (2, True), (3, True), (0xFF, True), (1, False), (0xFD, False)])
def test_groups(mask: int, meant: bool) -> None:
    """The slave is in group 2 (mask 02)."""
    bench = Bench().up()
    bench.dx()
    bench.control(bytes((0x02, mask)))
    assert bench.app.clear is meant


def test_group_ident_only_with_lock_req() -> None:
    """docs/protocol.md#set_prm: Group_Ident is taken only when Lock_Req is set."""
    bench = Bench().up()
    bench.dx()
    bench.prm(bytes.fromhex("00 01 01 0B 0A 35 01"))
    bench.control(b"\x02\x01")
    assert not bench.app.clear


def test_global_control_is_for_the_owner_in_data_exchange_only() -> None:
    bench = Bench()
    bench.control(CLEAR)
    bench.prm()
    bench.control(CLEAR)
    bench.cfg()
    assert not bench.app.clear
    bench.dx()
    bench.control(CLEAR, sa=OTHER)
    assert not bench.app.clear
    assert bench.app.stats.foreign == 1


def test_global_control_of_the_wrong_length_is_reported_and_dropped() -> None:
    bench = Bench().up()
    bench.control(b"\x02")
    bench.control(b"\x02\x00\x00")
    assert not bench.app.clear
    assert ["octet 2" in text for text in bench.texts()] == [True, True]


def test_other_broadcasts_are_dropped() -> None:
    bench = Bench().up()
    bench.app.indicate(Telegram(Kind.SD2, 127, 2, 0x46, 55, 62, CLEAR), 0)
    bench.app.indicate(Telegram(Kind.SD2, 127, 2, 0x46, None, None, CLEAR), 0)
    assert not bench.app.clear


def test_global_control_as_srd_is_no_service() -> None:
    assert Bench().up().ask(58, CLEAR) == RS_REPLY


def test_inputs_before_the_first_exchange_are_zero() -> None:
    bench = Bench().up(PRM, CFG)
    assert (bench.ask(56).data, bench.ask(57).data) == (b"\0", b"\0")
    assert bench.app.state is SlaveAppState.DATA_EXCH
