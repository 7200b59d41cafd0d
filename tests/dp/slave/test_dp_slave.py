"""A slave from a description and a function: what the function is given and when, what the description refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from slave_kit import CFG, CLEAR, FREEZE, MS, OPERATE, PRM, PRM_NO_WD, SYNC, UNLOCK, UNSYNC, Bench

from dpstack.dp.pdu.diag_blocks import NO_DIAG
from dpstack.dp.slave.application import SlaveAppState
from dpstack.dp.slave.device import DpV0Device, Leave
from dpstack.dp.slave.events import DeviceFailed, Report
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule
from dpstack.dpv1.slave.user_slave import DpSlave, OnCycle
from dpstack.errors import ConfigError
from dpstack.fdl.interface import RS_REPLY

IDENT = 0x0A35


class Log:
    """The function of a slave: writes down outputs, gives them back."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.elapsed: list[int] = []

    def __call__(self, outputs: bytes, elapsed: int) -> bytes:
        self.calls.append(outputs.hex())
        self.elapsed.append(elapsed)
        return outputs


def describe(**more: Any) -> SlaveDescription:
    keys: dict[str, Any] = {"ident": IDENT, "configs": (CFG,), "name": "own"}
    return SlaveDescription(**(keys | more))


def served(function: OnCycle, **more: Any) -> Bench:
    slave_keys = {"safe", "config", "on_prm", "on_address", "on_leave"}
    description = describe(**{key: value for key, value in more.items() if key not in slave_keys})
    return Bench(DpSlave(description, function, **{key: more[key] for key in slave_keys & set(more)}))


def in_state(bench: Bench, state: SlaveAppState) -> None:
    assert bench.app.state is state


# --- the function -------------------------------------------------------------------------------------------------


def test_outputs_and_the_time_since_data_exchange_began() -> None:
    log = Log()
    bench = served(log)
    bench.now = 5 * MS
    bench.up(PRM_NO_WD)
    bench.now += 2 * MS
    assert bench.dx(b"\x11").data == b"\x11"
    bench.now += 3 * MS
    assert bench.dx(b"\x22").data == b"\x22"
    assert (log.calls, log.elapsed) == (["11", "22"], [2 * MS, 5 * MS])


@pytest.mark.parametrize("safe", [None, b"\x0f"])
def test_safe_outputs_come_at_once_on_every_way_out(safe: bytes | None) -> None:
    """Never later than the slave knows, and never the real ones again after that."""
    ways: dict[str, Callable[[Bench], object]] = {
        "clear": lambda bench: bench.control(CLEAR),
        "unlock": lambda bench: bench.prm(UNLOCK),
        "bad parameters": lambda bench: bench.prm(b""),
        "new parameters": lambda bench: bench.prm(PRM),
        "bad configuration": lambda bench: bench.cfg(b"\x11"),
        "wrong length": lambda bench: bench.dx(b"\1\2"),
        "watchdog": lambda bench: bench.pass_time(100 * MS),
        "restart": lambda bench: bench.app.restart(bench.now),
        "initial reset": lambda bench: bench.app.initial_reset(bench.now),
    }
    for way, go in ways.items():
        log = Log()
        bench = served(log, safe=safe).up()
        bench.dx(b"\x11")
        go(bench)
        assert log.calls == ["11", "00" if safe is None else "0f"], way


CONTROLS = {"CLEAR": CLEAR, "OPERATE": OPERATE, "SYNC": SYNC, "UNSYNC": UNSYNC, "FREEZE": FREEZE}


@pytest.mark.parametrize(
    ("steps", "outputs"),
    [
        pytest.param("11 empty 22", "11 0f 0f 22", id="an empty frame gives the safe outputs"),
        pytest.param("CLEAR 11 OPERATE 22", "0f 0f 22", id="Clear holds until Operate"),
        pytest.param("11 SYNC 22 SYNC 33 UNSYNC", "11 11 11 22 22 33", id="outputs of the last SYNC"),
        # a FREEZE before the first exchange has no real ones either; in Operate they wait for the next SYNC
        pytest.param("FREEZE SYNC 11 CLEAR OPERATE 22 SYNC", "0f 0f 0f 0f 0f 22", id="safe ones until the next SYNC"),
    ],
)
def test_the_outputs_that_the_function_gets(steps: str, outputs: str) -> None:
    log = Log()
    bench = served(log, fail_safe=True, safe=b"\x0f").up()
    for step in steps.split():
        if step in CONTROLS:
            bench.control(CONTROLS[step])
        else:
            assert bench.dx(bytes.fromhex(step.removeprefix("empty"))).data.hex() == log.calls[-1]
        assert bench.ask(57).data.hex() == log.calls[-1]
    assert " ".join(log.calls) == outputs


def test_safe_outputs_that_do_not_fit_are_the_device_s_failure() -> None:
    device = DpSlave(SlaveDescription(ident=IDENT, configs=(CFG,)), Log())
    device.safe = b"\0\0"
    bench = Bench(device).up()
    assert bench.app.failure == "ValueError: 2 safe octets, the configuration has 1 output octets"
    assert bench.dx() == RS_REPLY


def test_a_function_that_raises_gets_safe_outputs_and_the_slave_says_so() -> None:
    calls: list[str] = []

    def function(outputs: bytes, elapsed: int) -> bytes:
        calls.append(outputs.hex())
        raise ZeroDivisionError("no more")

    bench = served(function, safe=b"\x0f").up()
    assert bench.dx(b"\x11") == RS_REPLY
    assert calls == ["11", "0f"]
    failures = [event for event in bench.app.take_events() if isinstance(event, DeviceFailed)]
    assert [event.error for event in failures] == ["ZeroDivisionError: no more"]  # told once
    assert "function(), test_dp_slave.py line" in failures[0].text
    assert bench.diag() == bytes.fromhex("02 07 00 FF 0A 35")  # Stat_Diag


@pytest.mark.parametrize(
    ("returned", "failure"),
    [
        (None, "TypeError: it returned NoneType, inputs are bytes"),
        ("x", "TypeError: it returned str, inputs are bytes"),
        (1, "TypeError: it returned int, inputs are bytes"),
        ([1], "TypeError: it returned list, inputs are bytes"),
        (b"", "ValueError: it returned 0 input octets, its configuration has 1"),
        (bytearray(2), "ValueError: it returned 2 input octets, its configuration has 1"),
    ],
)
@pytest.mark.parametrize("frozen", [False, True])
def test_a_function_that_returns_something_else(returned: Any, failure: str, frozen: bool) -> None:
    answers: list[Any] = [b"\x01"]
    bench = served(lambda outputs, elapsed: answers[-1]).up()
    if frozen:
        bench.control(b"\x08\x00")
    answers.append(returned)
    assert bench.dx() == RS_REPLY
    assert bench.app.failure == failure


def test_a_bytearray_that_goes_on_being_written_to() -> None:
    image = bytearray(b"\x01")
    bench = served(lambda outputs, elapsed: image).up()
    assert bench.dx().data == b"\x01"
    image[0] = 2
    assert bench.app.inputs == b"\x01"


def test_the_device_gets_the_reason_why_data_exchange_ended() -> None:
    reasons: list[Leave] = []
    bench = served(Log(), on_leave=reasons.append).up()
    bench.pass_time(100 * MS)
    bench.up()
    bench.prm(UNLOCK)
    assert reasons == [Leave.WATCHDOG, Leave.UNLOCK]


def test_user_parameters() -> None:
    asked: list[bytes] = []

    def judge(user_prm: bytes) -> str | None:
        asked.append(user_prm)
        return "octet 9 is a mode 1..3" if user_prm[1] > 3 else None

    bench = served(Log(), user_prm_len=(2, 3), on_prm=judge)
    for user_prm, reason in [
        (b"\0", "1 octets of user parameters, 2..3 are expected"),
        (bytes(4), "4 octets of user parameters, 2..3 are expected"),
        (b"\0\7", "octet 9 is a mode 1..3"),
    ]:
        bench.prm(PRM + user_prm)
        assert bench.diag()[0] == 0x42
        assert reason in bench.texts()[0]
    bench.prm(PRM + b"\0\1\2")
    assert bench.app.state is SlaveAppState.WAIT_CFG
    assert asked == [b"\0\7", b"\0\1\2"]


def test_an_address_is_kept_where_the_application_says() -> None:
    kept: list[tuple[int, bool, bytes]] = []
    bench = served(Log(), set_slave_add=True, on_address=lambda *args: kept.append(args))
    bench.ask(55, bytes.fromhex("09 0A 35 FF 01 02"))
    bench.app.restart(1)
    assert kept == [(9, True, b"\1\2")]
    assert (bench.app.address, bench.app.address_fixed) == (9, True)
    forgetful = served(Log(), set_slave_add=True)
    forgetful.ask(55, bytes.fromhex("09 0A 35 00"))
    forgetful.app.restart(1)
    assert forgetful.app.address == 8


# --- watchdog and Fail_Safe in DPV1_Status_1 ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("supported", "user_prm", "ms"),
    [(True, "04", 7), (True, "44 00 00", 7), (True, "00", 70), (True, "", 70), (False, "04", 70)],
)
def test_the_watchdog_has_a_1_ms_base_where_it_is_set_and_known(supported: bool, user_prm: str, ms: int) -> None:
    """docs/reference/protocol.md#watchdog: WD_Base_1ms; exactly f1 x f2 ms after the last request of the owner, octets
    2 and 3 are 1 and 7."""
    bench = served(Log(), wd_base_1ms=supported)
    bench.prm_and_cfg(bytes.fromhex("88 01 07 0B 0A 35 00" + user_prm))
    bench.now = 1_234_567
    bench.dx()
    assert bench.app.wake_at() <= 1_234_567 + ms * MS
    bench.pass_time(ms * MS - 1)
    in_state(bench, SlaveAppState.DATA_EXCH)
    bench.pass_time(1)
    in_state(bench, SlaveAppState.WAIT_PRM)


@pytest.mark.parametrize(("user_prm", "status1"), [("", 0x42), ("00", 0x42), ("BF", 0x42), ("40", 0x02)])
def test_fail_safe_required(user_prm: str, status1: int) -> None:
    """docs/reference/protocol.md#clear: Prm_Fault for a master that does not announce empty frames."""
    bench = served(Log(), fail_safe_required=True)
    bench.prm(PRM + bytes.fromhex(user_prm))
    assert bench.diag()[0] == status1
    assert any("octet 8 bit 6: Fail_Safe is not set" in text for text in bench.texts()) is (status1 == 0x42)


# --- configurations -----------------------------------------------------------------------------------------------


def test_manufacturer_octets_that_the_master_does_not_compare() -> None:
    """docs/reference/protocol.md#special-identifiers: low nibble 15; the slave works, and tells, with its own octets.
    The same Chk_Cfg again changes nothing."""
    real = bytes.fromhex("42 C1 AA BB 20")  # 2 words of inputs, 2 octets of the maker's; 1 output octet
    left: list[Leave] = []
    bench = served(lambda outputs, elapsed: bytes(4), configs=(real,), on_leave=left.append)
    bench.up(PRM, bytes.fromhex("4F C1 20"))
    in_state(bench, SlaveAppState.DATA_EXCH)
    assert bench.ask(59).data == real
    bench.cfg(bytes.fromhex("4F C1 20"))
    bench.cfg(real)
    assert left == []
    for asked in ("42 C1 AA BC 20", "4F C0 20", "40 C1 20", "4F C1 AA BB 20", "4F C1", "4F"):
        bench.up(PRM, bytes.fromhex(asked))
        assert bench.diag()[0] == 0x06, asked


MODULES = (SlaveModule("8 DI", b"\x10"), SlaveModule("8 DO", b"\x20"), SlaveModule("both", b"\x10\x21"))


def modular(**more: Any) -> Bench:
    return served(lambda outputs, elapsed: b"\1", configs=(), modules=MODULES, max_modules=3, **more)


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        ("10", None),
        ("10 20", None),
        ("20 10 21", None),
        ("10 21 10 21", None),  # two modules "both"
        ("10 20 20 20", "4 modules, 3 are possible"),
        ("10 22", "octet 2 (22) of the configuration begins no module of this slave"),
        ("21", "octet 1 (21)"),
        ("", "a configuration without any module"),
    ],
)
def test_modules_in_any_order(config: str, reason: str | None) -> None:
    bench = modular()
    bench.prm_and_cfg(cfg=bytes.fromhex(config))
    told = " ".join(bench.texts())
    if reason is None:
        assert bench.app.state is SlaveAppState.DATA_EXCH
        assert bench.ask(59).data == bytes.fromhex(config)
    else:
        assert bench.diag()[0] == 0x06
        assert reason in told


def test_get_cfg_tells_the_modules_that_are_plugged_in() -> None:
    assert modular().ask(59).data == b"\x10"
    assert modular(config=b"\x20\x10\x21").ask(59).data == b"\x20\x10\x21"
    with pytest.raises(ConfigError, match="begins no module"):
        modular(config=b"\x11")


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"max_input_len": 1}, "2 octets of inputs, 1 are possible"),
        ({"max_output_len": 1}, "2 octets of outputs, 1 are possible"),
        ({"max_data_len": 3}, "2 input and 2 output octets, 3 together are possible"),
        ({}, None),
    ],
)
def test_lengths(limits: dict[str, int], reason: str | None) -> None:
    modules = (SlaveModule("both", b"\x10\x20"),)
    assert describe(configs=(), modules=modules, max_modules=2, **limits).check_cfg(b"\x10\x20\x10\x20") == reason


# --- what cannot be -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"ident": 0x10000}, "ident 0x10000 does not fit"),
        ({"configs": ()}, "give configs .* or modules"),
        ({"modules": MODULES}, "give configs .* or modules"),
        ({"configs": (b"\x80",)}, "announces a length octet"),
        ({"max_output_len": 0}, "1 octet of outputs, 0 are possible"),
        ({"user_prm_len": (3, 2)}, r"user_prm_len \(3, 2\)"),
        ({"user_prm_len": (0, 238)}, "within 0..237"),
        ({"max_diag_len": 5}, "max_diag_len 5 is outside 6..244"),
        ({"configs": (), "modules": MODULES, "max_modules": 0}, "max_modules 0"),
    ],
)
def test_impossible_descriptions(wrong: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        describe(**wrong)


def test_impossible_modules_and_slaves() -> None:
    with pytest.raises(ConfigError, match="module x: no identifier octets"):
        SlaveModule("x", b"")
    with pytest.raises(ConfigError, match="2 safe octets are not the outputs"):
        DpSlave(describe(), Log(), safe=b"\0\0")
    with pytest.raises(ConfigError, match="a modular slave has zeros as safe outputs"):
        DpSlave(describe(configs=(), modules=MODULES), Log(), safe=b"")
    with pytest.raises(ConfigError, match="without octets is not 10 20"):
        DpSlave(describe(), Log(), config=b"")


def test_a_simple_one() -> None:
    description = SlaveDescription.simple(0x1234, inputs=2, outputs=18, name="rig")
    assert description.configs == (bytes.fromhex("11 2F 21"),)
    assert SlaveDescription.simple(0x1234, inputs=0, outputs=0).configs == (b"\0",)
    with pytest.raises(ConfigError, match="245 input"):
        SlaveDescription.simple(0x1234, inputs=245, outputs=0)
    assert description.table(7) == {
        "name": "rig",
        "address": 7,
        "ident": 0x1234,
        "config": "11 2f 21",
        "user_prm": "",
        "fail_safe": False,
        "min_slave_interval": 0,
    }
    with pytest.raises(ConfigError, match="say which configuration"):
        describe(configs=(), modules=MODULES).table(7)
    assert describe(configs=(), modules=MODULES, min_slave_interval_ns=150_000).table(7, b"\x10")["config"] == "10"


def test_a_device_that_overrides_nothing_reports_nothing() -> None:
    device = DpV0Device()
    assert (device.ext_diag(), device.user_diag()) == (b"", NO_DIAG)
    assert (device.check_prm(b"\1"), device.exchange(b"", 0)) == (None, b"")
    assert (device.address_set(3, False, b""), device.services(Report("a", None))) == (False, ())
