"""Clear and Operate, SYNC and FREEZE with their double buffers, groups (docs/reference/protocol.md#global_control)."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from slave_kit import CFG, CLEAR, FREEZE, OPERATE, OTHER, PRM, SYNC, UNFREEZE, UNSYNC, Bench, Recorder

from dpstack.dp.pdu.diag_blocks import UserDiag
from dpstack.dp.slave.application import SlaveAppState
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import RS_REPLY
from dpstack.fdl.telegram import Kind, Resp, Telegram

#: a step in each line: outputs of a Data_Exchange, or a Global_Control | the calls of the device | its outputs after
#: that | the modes after that
STEPS = {
    "Clear and Operate": """
        11      | operate, exchange 11 | 11 |
        CLEAR   | clear                | 00 | clear
        22      | exchange 00          | 00 | clear
        CLEAR   |                      | 00 | clear
        OPERATE | operate              | 00 |
        33      | exchange 33          | 33 |
        OPERATE |                      | 33 |
    """,
    "Operate is called once after entry, also by Global_Control": """
        OPERATE | operate              | 00 |
        55      | exchange 55          | 55 |
        55      | exchange 55          | 55 |
    """,
    "Clear before the first exchange": """
        CLEAR   | clear                | 00 | clear
        11      | exchange 00          | 00 | clear
        OPERATE | operate              | 00 |
        11      | exchange 11          | 11 |
    """,
    # docs/reference/protocol.md#clear: a full frame ends it unless Global_Control said Clear
    "an empty frame is Clear for a Fail_Safe slave": """
        11      | operate, exchange 11 | 11 |
        empty   | clear, exchange 00   | 00 | clear
        empty   | exchange 00          | 00 | clear
        22      | operate, exchange 22 | 22 |
        CLEAR   | clear                | 00 | clear
        empty   | exchange 00          | 00 | clear
        33      | exchange 00          | 00 | clear
        OPERATE | operate              | 00 |
        44      | exchange 44          | 44 |
    """,
    "SYNC holds the outputs, and every further one passes on those received last": """
        11      | operate, exchange 11 | 11 |
        SYNC    | exchange 11          | 11 | sync
        22      | exchange 11          | 11 | sync
        33      | exchange 11          | 11 | sync
        SYNC    | exchange 33          | 33 | sync
        44      | exchange 33          | 33 | sync
        UNSYNC  | exchange 44          | 44 |
        55      | exchange 55          | 55 |
        UNSYNC  |                      | 55 |
    """,
    "SYNC after many exchanges, and Operate after UNSYNC": """
        11      | operate, exchange 11 | 11 |
        22      | exchange 22          | 22 |
        33      | exchange 33          | 33 |
        SYNC    | exchange 33          | 33 | sync
        UNSYNC  | exchange 33          | 33 |
        44      | exchange 44          | 44 |
        OPERATE |                      | 44 |
    """,
    # docs/reference/protocol.md#slave-states: Clear empties the outputs, held or not; after it they wait for the next
    # SYNC
    "Clear goes through SYNC": """
        11      | operate, exchange 11 | 11 |
        SYNC    | exchange 11          | 11 | sync
        CLEAR   | clear                | 00 | clear sync
        22      | exchange 00          | 00 | clear sync
        OPERATE | operate              | 00 | sync
        33      | exchange 00          | 00 | sync
        SYNC    | exchange 33          | 33 | sync
    """,
    "the un ones win": """
        11      | operate, exchange 11 | 11 |
        ALL     |                      | 11 |
        SYNC    | exchange 11          | 11 | sync
        FREEZE  | exchange 11          | 11 | sync freeze
        ALL     | exchange 11          | 11 |
    """,
}
CONTROLS = {
    "CLEAR": CLEAR,
    "OPERATE": OPERATE,
    "SYNC": SYNC,
    "UNSYNC": UNSYNC,
    "FREEZE": FREEZE,
    "ALL": b"\x3c\x00",  # sync, unsync, freeze, unfreeze
}


@pytest.mark.parametrize("name", STEPS)
def test_the_calls_of_the_device_step_by_step(name: str) -> None:
    device = Recorder()
    device.fail_safe = True
    bench = Bench(device).up()
    for line in STEPS[name].strip().splitlines():
        step, calls, outputs, modes = map(str.strip, line.split("|"))
        if step in CONTROLS:
            bench.control(CONTROLS[step])
        else:
            assert bench.dx(bytes.fromhex(step.removeprefix("empty"))).data == bytes((device.count,))
        status2 = bench.diag()[1]
        found = {"clear": bench.app.clear, "sync": status2 & 0x20, "freeze": status2 & 0x10}
        assert ", ".join(bench.recorder.take()) == calls, line
        assert (bench.app.outputs.hex(), " ".join(mode for mode in found if found[mode])) == (outputs, modes), line


def test_leaving_forgets_clear(bench: Bench) -> None:
    bench.control(CLEAR)
    bench.up()
    assert not bench.app.clear
    bench.dx(b"\x11")
    assert bench.app.outputs == b"\x11"


def test_inputs_go_on_during_sync(bench: Bench) -> None:
    bench.dx()
    bench.control(SYNC)
    assert [bench.dx().data for _ in range(3)] == [b"\x03", b"\x04", b"\x05"]


def test_freeze_holds_inputs_and_every_further_one_samples(bench: Bench) -> None:
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


def test_sync_and_freeze_at_once_take_one_sample(bench: Bench) -> None:
    bench.dx(b"\x11")
    bench.control(b"\x28\x00")
    assert bench.recorder.take() == ["operate", "exchange 11", "exchange 11"]
    assert bench.dx(b"\x22").data == b"\x02"
    assert bench.app.outputs == b"\x11"


@pytest.mark.parametrize("mode", [SYNC, FREEZE])
def test_a_device_without_sync_or_freeze_ignores_it(mode: bytes) -> None:
    bench = Bench()
    bench.device.sync_supported = bench.device.freeze_supported = False
    bench.up()
    bench.dx()
    bench.control(mode)
    assert bench.diag() == bytes.fromhex("00 0C 00 02 0A 35")
    bench.dx(b"\x77")
    assert bench.app.outputs == b"\x77"


def test_group_ident_only_with_lock_req(bench: Bench) -> None:
    """docs/reference/protocol.md#set_prm: Group_Ident is taken only when Lock_Req is set."""
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


def test_global_control_of_the_wrong_length_is_reported_and_dropped(bench: Bench) -> None:
    bench.control(b"\x02")
    bench.control(b"\x02\x00\x00")
    assert not bench.app.clear
    assert ["octet 2" in text for text in bench.texts()] == [True, True]


def test_other_broadcasts_are_dropped(bench: Bench) -> None:
    bench.app.indicate(Telegram(Kind.SD2, 127, 2, 0x46, 55, 62, CLEAR), 0)
    bench.app.indicate(Telegram(Kind.SD2, 127, 2, 0x46, None, None, CLEAR), 0)
    assert not bench.app.clear


def test_global_control_as_srd_is_no_service() -> None:
    assert Bench().up().ask(58, CLEAR) == RS_REPLY


def test_inputs_before_the_first_exchange_are_zero() -> None:
    bench = Bench().up(PRM, CFG)
    assert (bench.ask(56).data, bench.ask(57).data) == (b"\0", b"\0")
    assert bench.app.state is SlaveAppState.DATA_EXCH


def behind(more: UserDiag) -> Callable[[UserDiag], UserDiag]:
    """As a fault of a test plant: ``more`` behind what the device reports."""
    return lambda own: UserDiag(own.ext + more.ext, own.fault or more.fault, own.stat or more.stat)


def test_a_diagnosis_behind_that_of_the_device(bench: Bench) -> None:
    """Octets and bits of both (octet 1 bit 3 Ext_Diag, octet 2 bit 1 Stat_Diag)."""
    bench.recorder.ext = b"\x02\x07"
    assert bench.diag().hex(" ") == "08 0c 00 02 0a 35 02 07"
    bench.app.diag.extend(behind(UserDiag(b"\x41\x01", stat=True)))
    assert bench.dx().status is Resp.DH
    assert bench.diag().hex(" ") == "08 0e 00 02 0a 35 02 07 41 01"
    bench.recorder.ext = b""
    assert bench.diag().hex(" ") == "00 0e 00 02 0a 35 41 01"
    bench.app.diag.extend(behind(UserDiag(b"\x41\x01", fault=True)))
    assert bench.diag().hex(" ") == "08 0c 00 02 0a 35 41 01"
    bench.app.diag.extend(lambda own: own)
    assert bench.diag().hex(" ") == "00 0c 00 02 0a 35"
    plain = Bench(MirrorDevice(0x0A35, CFG)).up()
    plain.app.diag.extend(behind(UserDiag(b"\x41\x01", fault=True)))
    assert plain.dx().status is Resp.DH
    assert plain.diag().hex(" ") == "08 0c 00 02 0a 35 41 01"
