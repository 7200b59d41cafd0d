"""The slave application: bring-up, diagnosis, watchdog, restart."""

from __future__ import annotations

import pytest
from slave_kit import (
    CFG,
    DATA_EXCH,
    KEEP,
    MASTER,
    MS,
    OTHER,
    PRM,
    PRM_NO_WD,
    SLAVE,
    WAIT_CFG,
    WAIT_PRM,
    Bench,
    Recorder,
    in_state,
)

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import RequestRefused, SlaveAppStateChanged, WatchdogExpired
from dpstack.dp.slave.state_table import AppTrigger
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import ConfigError
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply
from dpstack.fdl.telegram import Resp
from dpstack.units import NEVER


def test_the_bring_up_octet_by_octet() -> None:
    """Diagnoses as in the logs of pyprofibus#7 (waiting) and #19 (ready, watchdog on, master 2)."""
    bench = Bench()
    app = bench.app
    assert bench.ask(60) == Reply(Resp.DL, bytes.fromhex("02 05 00 FF 0A 35"))
    assert bench.ask(59) == Reply(Resp.DL, CFG)
    assert bench.prm() == SC_REPLY
    assert (app.state, app.master) == (WAIT_CFG, MASTER)
    assert bench.diag() == bytes.fromhex("02 0C 00 02 0A 35")
    assert bench.cfg() == SC_REPLY
    assert app.state is DATA_EXCH
    assert bench.diag() == bytes.fromhex("00 0C 00 02 0A 35")
    assert bench.dx(b"\x55") == Reply(Resp.DL, b"\x01")
    assert bench.dx(b"\x66") == Reply(Resp.DL, b"\x02")
    assert (app.outputs, app.inputs) == (b"\x66", b"\x02")
    assert bench.recorder.calls == ["check_prm", "check_cfg 1020", "enter", "operate", "exchange 55", "exchange 66"]
    assert bench.texts() == [
        "slave 8 (recorder): wait_cfg (Set_Prm with Lock_Req accepted, master 2)",
        "slave 8 (recorder): data_exchange (Chk_Cfg accepted, master 2)",
    ]
    assert app.stats.exchanges == 2


@pytest.mark.parametrize(
    ("prm", "reason"),
    [
        ("", "octet 1"),
        ("88 01 0A 0B 0A 35", "octet 7"),
        ("88 01 0A 0B 0C DA 00", "octets 5-6: ident number 0x0CDA, this device is 0x0A35"),
        ("88 00 0A 0B 0A 35 00", "octet 2: watchdog factor 0"),
        ("88 01 00 0B 0A 35 00", "octet 3: watchdog factor 0"),
        ("40 01 01 0B 0C DA 00", "octets 5-6"),
    ],
)
@pytest.mark.parametrize("start", [WAIT_PRM, WAIT_CFG, DATA_EXCH])
def test_bad_parameters(start: SlaveAppState, prm: str, reason: str) -> None:
    """docs/reference/protocol.md#refused-parameters-are-acknowledged: Prm_Fault in the diagnosis, back to Wait_Prm, the
    lock given up."""
    bench = in_state(start)
    assert bench.prm(bytes.fromhex(prm)) == SC_REPLY
    assert bench.app.state is WAIT_PRM
    assert bench.diag() == bytes.fromhex("42 05 00 FF 0A 35")
    refusals = [event for event in bench.app.take_events() if isinstance(event, RequestRefused)]
    assert [(event.service, event.master) for event in refusals] == [("Set_Prm", MASTER)]
    assert reason in refusals[0].text
    bench.prm()
    assert bench.diag()[0] == 0x02  # good ones clear the fault


def test_user_parameters_are_the_device_s_to_judge() -> None:
    bench = Bench()
    bench.recorder.prm_reason = "octet 9 must be 1..3"
    bench.prm(PRM + b"\x07\x08")
    assert bench.recorder.calls == ["check_prm 0708"]
    assert bench.app.state is WAIT_PRM
    assert "octet 8 on: octet 9 must be 1..3" in bench.texts()[0]


def test_the_same_refusal_is_reported_once() -> None:
    bench = Bench()
    for _ in range(5):
        bench.prm(b"\x88")
    assert len(bench.app.take_events()) == 1
    bench.prm(b"\x88\x01")
    assert len(bench.app.take_events()) == 1
    assert bench.app.stats.refused == 6
    bench.up()
    bench.prm(b"\x88")
    assert [type(event) for event in bench.app.take_events()] == [RequestRefused, SlaveAppStateChanged]
    for n in range(60):  # another reason each time: fifty are told, then it is enough
        bench.prm(PRM[:4] + bytes([n + 100]) + PRM[5:])
    texts = bench.texts()
    assert len(texts) == 49
    assert texts[-1].endswith("this device is 0x0A35; further refusals to it are counted only")
    bench.prm(b"\x88", sa=OTHER)
    assert len(bench.texts()) == 1
    assert bench.app.stats.refused == 68
    bench.up()  # a good beginning: they are news again
    bench.prm(b"\x88")
    assert len(bench.app.take_events()) == 2


@pytest.mark.parametrize("prm", ["A0 01 01 0B 0A 35 00", "90 01 01 0B 0A 35 00"])
def test_sync_or_freeze_that_the_device_does_not_have(prm: str) -> None:
    bench = Bench()
    bench.device.sync_supported = bench.device.freeze_supported = False
    bench.prm(bytes.fromhex(prm))
    assert bench.app.state is WAIT_PRM
    assert bench.diag() == bytes.fromhex("12 05 00 FF 0A 35")  # Not_Supported
    bench.prm()
    assert bench.diag()[0] == 0x02


@pytest.mark.parametrize("config", [b"", b"\x11", b"\xc3\xc1", CFG + b"\x00"])
@pytest.mark.parametrize("start", [WAIT_CFG, DATA_EXCH])
def test_bad_configuration(start: SlaveAppState, config: bytes) -> None:
    """docs/reference/protocol.md#refused-parameters-are-acknowledged: Cfg_Fault in the diagnosis, back to Wait_Prm."""
    bench = in_state(start)
    assert bench.cfg(config) == SC_REPLY
    assert (bench.app.state, bench.app.master, bench.app.outputs) == (WAIT_PRM, None, b"")
    assert bench.diag() == bytes.fromhex("06 05 00 FF 0A 35")
    assert any(text.startswith("slave 8 (recorder): Chk_Cfg of master 2 refused") for text in bench.texts())
    bench.up()
    assert bench.diag() == bytes.fromhex("00 0C 00 02 0A 35")


def test_a_configuration_longer_than_a_telegram() -> None:
    config = bytes([0x7F] * 8)  # 8 x 16 words each way
    bench = Bench(Recorder(config))
    bench.prm_and_cfg(cfg=config)
    assert bench.app.state is WAIT_PRM
    assert "256 input and 256 output octets, 244 each are possible" in bench.texts()[-2]


def test_another_configuration_while_exchanging_is_taken_up_afresh() -> None:
    bench = Bench(Recorder(CFG, b"\x10")).up()
    bench.dx()
    bench.cfg(CFG)  # the same: nothing happens
    assert bench.recorder.take() == ["operate", "exchange 55"]
    bench.cfg(b"\x10")
    assert bench.app.state is DATA_EXCH
    assert bench.recorder.take() == ["check_cfg 10", "leave new configuration", "enter"]
    assert bench.dx(b"") == Reply(Resp.DL, b"\x02")
    assert bench.ask(59).data == b"\x10"


@pytest.mark.parametrize(
    ("config", "outputs", "expected"),
    [
        ("10 20", b"\x01", Reply(Resp.DL, b"\x01")),
        ("10", b"", Reply(Resp.DL, b"\x00")),  # inputs only: an empty request
        ("20", b"\x07", SC_REPLY),  # outputs only
        ("00", b"", SC_REPLY),  # neither
        ("11 20", b"\x09", Reply(Resp.DL, b"\x09\x00")),
        ("10 21", b"\x09\x0a", Reply(Resp.DL, b"\x09")),
        ("C3 C1 C1 FD 00 01", b"\x01\x02\x03\x04", Reply(Resp.DL, b"\x01\x02\x03\x04")),
    ],
)
def test_shapes_of_devices(config: str, outputs: bytes, expected: Reply) -> None:
    octets = bytes.fromhex(config)
    bench = Bench(MirrorDevice(0x0A35, octets)).up(PRM, octets)
    assert bench.dx(outputs) == expected
    assert bench.dx(outputs) == expected
    assert bench.ask(56) == (Reply(Resp.DL, expected.data) if expected.data else Reply(Resp.NR))
    assert bench.ask(57) == (Reply(Resp.DL, outputs) if outputs else Reply(Resp.NR))


@pytest.mark.parametrize("outputs", [b"", b"\x01\x02"])
def test_outputs_of_the_wrong_length(bench: Bench, outputs: bytes) -> None:
    """docs/reference/protocol.md#slave-states: back to Wait_Prm with Cfg_Fault."""
    bench.dx()
    assert bench.dx(outputs) == RS_REPLY
    assert bench.app.state is WAIT_PRM
    assert bench.diag() == bytes.fromhex("06 05 00 FF 0A 35")
    assert bench.recorder.take() == ["operate", "exchange 55", "leave wrong length"]
    assert f"{len(outputs)} output octets, the configuration has 1" in bench.texts()[0]


# --- diagnosis ----------------------------------------------------------------------------------------------------


def test_extended_diagnosis_asks_to_be_fetched(bench: Bench) -> None:
    """docs/reference/protocol.md#answers-to-data_exchange: DH from the change on until the owner has read it; Ext_Diag
    with it."""
    assert bench.dx().status is Resp.DL
    bench.recorder.ext = b"\x03\x01\x02"
    assert bench.dx() == Reply(Resp.DH, b"\x02")
    bench.diag(sa=OTHER)  # a class 2 master looks: the owner has still not read it
    assert bench.dx().status is Resp.DH
    assert bench.diag() == bytes.fromhex("08 0C 00 02 0A 35 03 01 02")
    assert bench.dx().status is Resp.DL
    bench.recorder.ext = b""
    assert bench.dx().status is Resp.DH
    assert bench.diag() == bytes.fromhex("00 0C 00 02 0A 35")
    assert bench.dx().status is Resp.DL


def test_extended_diagnosis_of_a_slave_without_inputs() -> None:
    bench = Bench(Recorder(b"\x20"))
    bench.recorder.input_len = 0
    bench.up(PRM, b"\x20")
    assert bench.dx() == SC_REPLY
    bench.recorder.ext = b"\x01"
    assert bench.dx() == Reply(Resp.DH, b"")


def test_a_new_owner_has_read_nothing(bench: Bench) -> None:
    bench.recorder.ext = b"\x02\x05"
    bench.diag()
    assert bench.dx().status is Resp.DL
    bench.up()
    assert bench.dx().status is Resp.DH


def test_too_much_extended_diagnosis_overflows() -> None:
    bench = Bench()
    bench.recorder.ext = bytes(239)
    octets = bench.diag()
    assert len(octets) == 244
    assert octets[:6] == bytes.fromhex("0A 05 80 FF 0A 35")
    bench.up()
    assert bench.dx().status is Resp.DH
    bench.diag()
    assert bench.dx().status is Resp.DL


# --- watchdog -----------------------------------------------------------------------------------------------------


def test_the_watchdog_clears_the_outputs(bench: Bench) -> None:
    bench.dx()
    bench.pass_time(99 * MS)
    assert bench.app.state is DATA_EXCH
    bench.pass_time(1 * MS)
    assert (bench.app.state, bench.app.master, bench.app.outputs) == (WAIT_PRM, None, b"")
    assert bench.recorder.take()[-1] == "leave watchdog"
    expired, changed = bench.app.take_events()
    assert isinstance(expired, WatchdogExpired)
    assert expired.text == "slave 8 (recorder): nothing from master 2 for 100 ms, outputs cleared"
    assert isinstance(changed, SlaveAppStateChanged)
    assert (changed.t_ns, changed.why) == (100 * MS, AppTrigger.WATCHDOG)
    assert bench.app.wake_at() == NEVER
    assert bench.diag() == bytes.fromhex("02 05 00 FF 0A 35")
    assert bench.app.stats.watchdogs == 1


@pytest.mark.parametrize(("dsap", "data"), [(None, b"\x55"), (60, b""), (62, CFG), (59, b""), (56, b""), (61, KEEP)])
def test_requests_that_re_arm_the_watchdog(bench: Bench, dsap: int | None, data: bytes) -> None:
    for _ in range(10):
        bench.pass_time(90 * MS)
        bench.ask(dsap, data)
    assert bench.app.state is DATA_EXCH
    bench.pass_time(100 * MS)
    assert bench.app.state is WAIT_PRM


def test_requests_that_do_not_re_arm_the_watchdog(bench: Bench) -> None:
    bench.pass_time(90 * MS)
    bench.control(b"\x00\x00")
    bench.diag(sa=OTHER)
    bench.prm(sa=OTHER)
    bench.dx(sa=OTHER)
    bench.pass_time(10 * MS)
    assert bench.app.state is WAIT_PRM


def test_the_watchdog_runs_from_set_prm_on() -> None:
    bench = Bench()
    bench.prm()
    bench.pass_time(100 * MS)
    assert bench.app.state is WAIT_PRM


def test_without_watchdog_the_slave_stays_in_data_exchange() -> None:
    bench = Bench().up(PRM_NO_WD)
    assert bench.diag() == bytes.fromhex("00 04 00 02 0A 35")
    assert bench.app.wake_at() == NEVER
    bench.pass_time(3_600_000 * MS)
    assert bench.app.state is DATA_EXCH


def test_the_deadline_does_not_move_with_every_exchange(bench: Bench) -> None:
    """A driver re-arms a timer only when it moves."""
    bench.now = 50 * MS
    bench.dx()
    assert bench.app.wake_at() == 100 * MS
    bench.pass_time(50 * MS)
    assert bench.app.wake_at() == 150 * MS


# --- restart and construction -------------------------------------------------------------------------------------


def test_restart(bench: Bench) -> None:
    bench.dx()
    bench.app.restart(5)
    assert bench.app.state is WAIT_PRM
    assert bench.recorder.take()[-1] == "leave power off"
    assert bench.diag() == bytes.fromhex("02 05 00 FF 0A 35")
    assert [event.t_ns for event in bench.app.take_events()] == [5]


def test_impossible_devices_are_refused() -> None:
    device = Recorder()
    device.configs = ()
    with pytest.raises(ConfigError, match="configs"):
        SlaveApp(device)
    device.configs = (bytes(245),)
    with pytest.raises(ConfigError, match="configs"):
        SlaveApp(device)
    device.configs = (CFG,)
    device.ident = 0x10000
    with pytest.raises(ConfigError, match="0x10000"):
        SlaveApp(device, address=SLAVE)


def test_a_device_that_adapts_its_ident_number() -> None:
    """Its own 0A35 until Set_Prm; then the one in Set_Prm, if it is 9700; its own again when it is released."""
    device = MirrorDevice(0x0A35, CFG)
    device.other_idents = frozenset((0x9700,))
    bench = Bench(device)
    assert bench.diag() == bytes.fromhex("02 05 00 FF 0A 35")
    assert bench.prm(bytes.fromhex("88 01 0A 0B 97 01 00")) == SC_REPLY  # a profile that it does not know
    assert bench.diag() == bytes.fromhex("42 05 00 FF 0A 35")
    assert bench.prm(bytes.fromhex("88 01 0A 0B 97 00 00")) == SC_REPLY
    assert bench.diag() == bytes.fromhex("02 0C 00 02 97 00")
    assert bench.cfg() == SC_REPLY
    assert bench.diag() == bytes.fromhex("00 0C 00 02 97 00")
    bench.pass_time(200 * MS)  # the watchdog of 100 ms runs out
    assert bench.diag()[4:6] == b"\x0a\x35"
