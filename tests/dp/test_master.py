"""The class 1 master against scripted answers: literal octets in, literal octets out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from scripted_link import DIAG_FREE, DIAG_READY, MS, ScriptedLink, ScriptedSlave, data

from dpstack.dp.bringup import TABLE
from dpstack.dp.commands import (
    ActivateSlave,
    AddSlave,
    DeactivateSlave,
    DriveCommand,
    Mode,
    RemoveSlave,
    SetMode,
    Shutdown,
)
from dpstack.dp.events import DriveEvent, MasterStopped, SlaveFaulted, SlaveState
from dpstack.dp.master import Master
from dpstack.dp.setup import SlaveSetup, watchdog_factors
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram
from dpstack.fdl.user import Failure, Request
from dpstack.machine import LineDown
from dpstack.params import BusParams

PPO3 = bytes([0x71])


def setup(address: int = 3, **changes: Any) -> SlaveSetup:
    values: dict[str, Any] = {"address": address, "name": f"s{address}", "ident": 0x0696, "config": PPO3}
    return SlaveSetup(**(values | changes))


def link(*setups: SlaveSetup, slaves: dict[int, ScriptedSlave] | None = None, **options: Any) -> ScriptedLink:
    master = Master(BusParams.preset(500_000, address=2), setups, **options)
    given = {s.address: ScriptedSlave() for s in setups} if slaves is None else slaves
    return ScriptedLink(master, given)


def exchanging(*setups: SlaveSetup, **options: Any) -> ScriptedLink:
    bus = link(*setups, **options)
    bus.run(5 * MS)
    assert all(h.state is SlaveState.DATA_EXCHANGE for h in bus.master.handlers.values())
    return bus


def test_bring_up_to_the_octet() -> None:
    bus = link(setup(groups=(1, 3), user_prm=bytes.fromhex("AA BB")))
    bus.run(2 * MS)
    made = [(r.dsap, r.data.hex(" ").upper()) for r in bus.requests if r.da == 3]
    # 200 ms watchdog = 1 x 20 x 10 ms; Lock_Req and WD_On = 88; min T_SDR 11; groups 1 and 3 = 05
    assert made[:4] == [
        (60, ""),
        (61, "88 01 14 0B 06 96 05 AA BB"),
        (62, "71"),
        (60, ""),
    ]
    assert made[4] == (None, "00 00 00 00")
    assert bus.states(3) == ["set_prm", "chk_cfg", "wait_ready", "data_exchange"]
    assert bus.requests[0].restart
    assert not bus.requests[0].patient


def test_global_control_is_really_sent_and_repeated() -> None:
    bus = exchanging(setup())
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    bus.requests.clear()
    bus.run(1000 * MS)
    controls = [r for r in bus.requests if r.dsap == 58]
    assert {(r.da, r.function, r.ssap, r.data) for r in controls} == {(127, Req.SDN_HIGH, 62, b"\x00\x00")}
    assert 5 <= len(controls) <= 8  # two at once, then every 200 ms
    bus.master.command(SetMode(Mode.CLEAR), bus.now)
    bus.requests.clear()
    bus.run(10 * MS)
    assert [r.data for r in bus.requests if r.dsap == 58] == [b"\x02\x00"] * 2


def test_outputs_are_zero_in_clear_and_the_image_in_operate() -> None:
    bus = exchanging(setup(initial=bytes([1, 2, 3, 4])))
    assert [r.data for r in bus.hold() if r.dsap is None] == [bytes(4)]
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    assert [r.data for r in bus.hold() if r.dsap is None] == [bytes([1, 2, 3, 4])]
    bus.master.images[3].outputs = b"\x09\x08\x07\x06"
    assert [r.data for r in bus.hold() if r.dsap is None] == [b"\x09\x08\x07\x06"]


def test_fail_safe_slave_gets_an_empty_frame_in_clear() -> None:
    bus = exchanging(setup(fail_safe=True))
    assert [r.data for r in bus.hold() if r.dsap is None] == [b""]


def test_exchange_runs_every_round_whether_the_application_calls_or_not() -> None:
    bus = exchanging(setup(3), setup(4))
    before = {a: h.exchanges for a, h in bus.master.handlers.items()}
    for _ in range(50):
        bus.hold()
    assert {a: h.exchanges - before[a] for a, h in bus.master.handlers.items()} == {3: 50, 4: 50}


def test_inputs_reach_the_image() -> None:
    bus = exchanging(setup())
    bus.slaves[3].inputs = b"\x11\x22\x33\x44"
    bus.hold()
    image = bus.master.images[3]
    assert (image.inputs, image.valid) == (b"\x11\x22\x33\x44", True)


def test_every_nth_round() -> None:
    bus = exchanging(setup(3), setup(4, every=3))
    before = bus.master.handlers[4].exchanges
    for _ in range(30):
        bus.hold()
    assert bus.master.handlers[4].exchanges - before == 10


def test_inputs_only_slave_is_asked_without_data_and_outputs_only_answers_sc() -> None:
    asked = ScriptedSlave(inputs=b"\x07")
    told = ScriptedSlave(answers={})
    bus = link(setup(3, config=b"\x10"), setup(4, config=b"\x20"), slaves={3: asked, 4: told})
    bus.run(2 * MS)
    told.answers[None] = lambda _r: SHORT_ACK
    made = [(r.da, r.data) for r in bus.hold() if r.dsap is None]
    assert made == [(3, b""), (4, b"\x00")]
    assert bus.master.images[3].inputs == b"\x07"
    before = bus.master.handlers[4].exchanges
    bus.hold()
    assert bus.master.handlers[4].exchanges == before + 1


def test_absent_slave_backs_off_is_told_once_and_the_other_goes_on() -> None:
    bus = link(setup(3), setup(4), slaves={4: ScriptedSlave()})
    bus.run(10_000 * MS)
    polls = [r for r in bus.requests if r.da == 3]
    # 0.1, 0.2, 0.4, 0.8, 1, 1 ... seconds
    assert 11 <= len(polls) <= 13
    assert bus.faults(3) == ["absent"]
    assert bus.master.handlers[4].state is SlaveState.DATA_EXCHANGE
    fault = next(e for e in bus.events if isinstance(e, SlaveFaulted))
    assert "no answer from address 3 at 500 kbit/s" in fault.text
    assert "check power" in fault.text


def test_absent_polls_keep_their_share_of_the_bus() -> None:
    bus = link(*(setup(a) for a in range(3, 20)), slaves={3: ScriptedSlave()}, absent_share=100)
    bus.run(20 * MS)
    bus.requests.clear()
    bus.run(2000 * MS)
    silent = sum(r.da != 3 and r.da != 127 for r in bus.requests)
    assert silent * bus.step <= 2000 * MS / 100 + 2 * bus.step


def test_wrong_ident_names_both() -> None:
    bus = link(setup(ident=0x1234))
    bus.run(5 * MS)
    fault = bus.master.handlers[3].fault
    assert fault is not None
    assert fault.kind.value == "wrong_ident"
    assert "0x0696 instead of 0x1234" in fault.message
    assert not any(r.dsap == 61 for r in bus.requests)


def test_ident_ask_takes_and_tells_what_is_found() -> None:
    bus = exchanging(setup(ident=None))
    assert bus.remarks(3) == ["its ident number is 0x0696 (taken from its diagnosis)"]
    assert next(r for r in bus.requests if r.dsap == 61).data[4:6] == b"\x06\x96"


def test_slave_of_another_master_is_never_parameterised() -> None:
    bus = link(setup(), slaves={3: ScriptedSlave(free=bytes.fromhex("00 0C 00 07 06 96"))})
    bus.run(30_000 * MS)
    assert bus.faults(3) == ["locked"]
    assert not any(r.dsap in (61, 62, None) for r in bus.requests if r.da == 3)
    fault = bus.master.handlers[3].fault
    assert fault is not None
    assert "owned by master 7" in fault.message


def test_own_address_plus_128_is_no_other_master() -> None:
    bus = exchanging(setup(), slaves={3: ScriptedSlave(ready=bytes.fromhex("00 0C 00 82 06 96"))})
    assert bus.remarks(3) == ["its diagnosis gives the master address as 130; tolerated"]


@pytest.mark.parametrize(
    ("status", "kind", "words"),
    [
        ("42 05 00 FF 06 96", "prm_fault", "Set_Prm was 88 01 14 0b 06 96 00"),
        ("06 05 00 FF 06 96", "cfg_fault", "Chk_Cfg was 71, it has f1: octet 1 differs"),
        ("12 05 00 FF 06 96", "not_supported", "Not_Supported"),
    ],
)
def test_refusals_name_the_reason_and_are_retried_with_back_off(status: str, kind: str, words: str) -> None:
    slave = ScriptedSlave(ready=bytes.fromhex(status))
    slave.answers[59] = lambda r: data(r, b"\xf1")
    bus = link(setup(), slaves={3: slave})
    bus.run(500 * MS)
    assert bus.faults(3) == [kind]
    fault = bus.master.handlers[3].fault
    assert fault is not None
    assert words in fault.message
    assert fault.remedy
    bus.run(40_000 * MS)
    attempts = sum(r.dsap == 61 for r in bus.requests)
    assert 5 <= attempts <= 8  # after 1, 2, 4, 8, 10, 10 s
    assert bus.faults(3) == [kind]  # told once
    slave.ready = DIAG_READY
    bus.run(11_000 * MS)
    assert bus.master.handlers[3].state is SlaveState.DATA_EXCHANGE


def test_fault_shown_in_one_diagnosis_only_is_kept() -> None:
    slave = ScriptedSlave(ready=bytes.fromhex("42 05 00 FF 06 96"))
    bus = link(setup(), slaves={3: slave})
    bus.run(2 * MS)
    slave.configured, slave.ready = False, DIAG_READY
    assert bus.master.handlers[3].fault is not None
    assert bus.master.handlers[3].findings.fault_at > 0


@pytest.mark.parametrize("sap", [61, 62])
def test_silence_to_set_prm_or_chk_cfg_asks_the_diagnosis_first(sap: int) -> None:
    slave = ScriptedSlave(answers={sap: lambda _r: Failure.NO_ANSWER})
    bus = link(setup(), slaves={3: slave})
    refused = bytes.fromhex("42 05 00 FF 06 96")
    slave.answers[60] = lambda r: data(r, refused if any(q.dsap == sap for q in bus.requests) else DIAG_FREE)
    bus.run(2 * MS)
    made = [r.dsap for r in bus.requests if r.da == 3]
    assert made[made.index(sap) + 1] == 60
    assert bus.faults(3) == ["prm_fault"]


def test_silence_that_is_never_explained() -> None:
    bus = link(setup(), slaves={3: ScriptedSlave(answers={61: lambda _r: Failure.NO_ANSWER})})
    bus.run(500 * MS)
    assert bus.faults(3) == ["refused"]
    fault = bus.master.handlers[3].fault
    assert fault is not None
    assert "does not acknowledge Set_Prm" in fault.message


def test_lost_acknowledgement_of_set_prm_goes_on_with_chk_cfg() -> None:
    slave = ScriptedSlave(answers={61: lambda _r: Failure.NO_ANSWER})
    bus = link(setup(), slaves={3: slave})
    slave.answers[60] = lambda r: data(
        r,
        DIAG_READY
        if slave.configured
        else bytes.fromhex("02 0C 00 02 06 96")
        if any(q.dsap == 61 for q in bus.requests)
        else DIAG_FREE,
    )
    bus.run(5 * MS)
    assert bus.states(3) == ["set_prm", "wait_ready", "chk_cfg", "wait_ready", "data_exchange"]


def test_never_ready() -> None:
    bus = link(setup(), slaves={3: ScriptedSlave(ready=bytes.fromhex("02 0C 00 02 06 96"))})
    bus.run(10_500 * MS)
    assert bus.faults(3) == ["not_ready"]


def test_slave_dies_and_comes_back_with_a_fresh_start() -> None:
    bus = exchanging(setup(3), setup(4))
    gone = bus.slaves.pop(3)
    bus.run(300 * MS)
    assert bus.faults(3) == ["lost"]
    assert bus.master.handlers[4].state is SlaveState.DATA_EXCHANGE
    assert not bus.master.images[3].valid
    gone.configured = False
    bus.slaves[3] = gone
    bus.requests.clear()
    bus.run(1500 * MS)
    first = next(r for r in bus.requests if r.da == 3)
    assert (first.dsap, first.restart) == (60, False) or first.restart
    assert bus.master.handlers[3].state is SlaveState.DATA_EXCHANGE


def test_slave_that_was_reset_is_taken_up_afresh() -> None:
    bus = exchanging(setup())
    bus.run(1500 * MS)
    bus.slaves[3].configured = False
    bus.requests.clear()
    bus.run(20 * MS)
    assert bus.faults(3) == ["left"]
    made = [r for r in bus.requests if r.da == 3]
    assert [r.dsap for r in made[:5]] == [None, 60, 61, 62, 60]
    assert made[1].restart
    assert bus.master.handlers[3].state is SlaveState.DATA_EXCHANGE


def test_slave_that_flaps_is_not_reinitialised_for_ever() -> None:
    slave = ScriptedSlave()

    def refuse(request: Request) -> Telegram | Failure:
        slave.configured = False
        return Telegram(Kind.SD1, 2, request.da, 0x03)

    slave.answers[None] = refuse
    bus = link(setup(), slaves={3: slave})
    bus.run(30_000 * MS)
    assert 4 <= sum(r.dsap == 61 for r in bus.requests) <= 7


def test_wrong_length_is_a_fault_with_both_lengths() -> None:
    bus = exchanging(setup())
    bus.slaves[3].inputs = b"\x01\x02"
    bus.run(5 * MS)
    fault = bus.master.handlers[3].fault
    assert fault is not None
    assert "2 octets instead of 4" in fault.message
    assert bus.master.images[3].inputs == bytes(4)


def test_high_priority_answer_fetches_the_diagnosis_in_the_same_round() -> None:
    bus = exchanging(setup())
    bus.slaves[3].answers[None] = lambda r: data(r, bytes(4), fc=0x0A)
    bus.slaves[3].ready = bytes.fromhex("08 0C 00 02 06 96 07 0A")
    bus.hold()
    bus.slaves[3].answers.clear()
    made = [r.dsap for r in bus.hold() if r.da == 3]
    assert made == [None, 60]
    assert bus.master.handlers[3].diagnosis is not None
    assert bus.master.handlers[3].diagnosis.ext == b"\x07\x0a"
    assert [r.dsap for r in bus.hold() if r.da == 3] == [None]


def test_static_diagnosis_makes_inputs_invalid_until_it_is_over() -> None:
    bus = exchanging(setup())
    bus.slaves[3].ready = bytes.fromhex("00 0E 00 02 06 96")
    bus.slaves[3].answers[None] = lambda r: data(r, bytes(4), fc=0x0A)
    bus.hold()
    bus.slaves[3].answers.clear()
    bus.run(20 * MS)
    assert not bus.master.images[3].valid
    bus.slaves[3].ready = DIAG_READY
    bus.run(200 * MS)
    assert bus.master.images[3].valid


def test_stop_sends_nothing_to_slaves() -> None:
    bus = exchanging(setup())
    bus.master.command(SetMode(Mode.STOP), bus.now)
    assert bus.hold() == []


def test_shutdown_safe_values_then_clear_twice() -> None:
    bus = exchanging(setup(safe=b"\x00\x01\x00\x02", initial=b"\x01\x01\x01\x01"))
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    bus.run(5 * MS)
    bus.requests.clear()
    bus.master.command(Shutdown(), bus.now)
    began = bus.now
    while not any(r.data == bytes(4) for r in bus.requests):
        bus.hold()
    assert bus.now - began >= 50 * MS  # a drive that looks every 32 ms has seen them
    bus.run(5 * MS)
    made = [(r.dsap, r.data) for r in bus.requests if r.data != b"\x00\x00"]
    safe = [m for m in made if m[1] == b"\x00\x01\x00\x02"]
    assert made == [*safe, (None, bytes(4)), (58, b"\x02\x00"), (58, b"\x02\x00")]
    assert isinstance(bus.events[-1], MasterStopped)
    assert bus.hold() == []


def test_shutdown_without_a_token_ends_too() -> None:
    bus = exchanging(setup())
    bus.master.command(Shutdown(), bus.now)
    bus.master.tick(bus.now + 1_000 * MS)
    assert any(isinstance(e, MasterStopped) for e in bus.master.take_events())


def test_line_down_tells_every_slave_lost() -> None:
    bus = exchanging(setup(3), setup(4))
    bus.master.command(LineDown("unplugged"), bus.now)
    bus.events += bus.master.take_events()
    assert bus.faults(3) == ["lost"]
    assert bus.faults(4) == ["lost"]
    assert not bus.master.images[3].valid


def test_rotation_is_from_first_exchange_to_first_exchange() -> None:
    bus = exchanging(setup(3), setup(4))
    bus.run(10 * MS)
    for _ in range(100):
        bus.hold()
    # two exchanges of 100 us and 100 us to the next hold
    assert bus.master.rotation.quantile_ns(0.5) == pytest.approx(300_000, rel=0.005)


def test_add_and_remove_while_running() -> None:
    bus = exchanging(setup(3))
    bus.slaves[4] = ScriptedSlave()
    bus.master.command(AddSlave(setup(4)), bus.now)
    bus.run(5 * MS)
    assert bus.master.handlers[4].state is SlaveState.DATA_EXCHANGE
    bus.requests.clear()
    bus.master.command(RemoveSlave(4), bus.now)
    bus.run(60 * MS)
    made = [(r.dsap, r.data) for r in bus.requests if r.da == 4]
    assert len(made) > 10
    assert set(made[:-1]) == {(None, bytes(4))}
    assert made[-1] == (61, bytes.fromhex("40 01 01 0B 06 96 00"))
    with pytest.raises(UsageError, match="no slave with address 4"):
        bus.master.command(RemoveSlave(4), bus.now)


def test_two_slaves_at_one_address_and_the_masters_own_are_refused() -> None:
    with pytest.raises(ConfigError, match="both have address 3"):
        link(setup(3), setup(3, name="other"))
    with pytest.raises(ConfigError, match="own address 2"):
        link(setup(2))


class Unit:
    """A cyclic unit under the test's control."""

    def __init__(self) -> None:
        self.outputs = b"\x05\x06\x07\x08"
        self.error: Exception | None = None
        self.losses = 0
        self.events: list[dict[str, object]] = []

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        if self.error is not None:
            raise self.error
        return self.outputs

    def lost(self, now: int) -> None:
        self.losses += 1

    def safe(self, configured: bytes) -> bytes:
        return configured

    def command(self, op: str, args: object, token: int, now: int) -> None:
        self.events.append({"type": "result", "token": token, "ok": True, "value": op})

    def take_events(self) -> list[dict[str, object]]:
        events, self.events = self.events, []
        return events


def test_unit_runs_in_operate_only_and_its_defect_stays_its_own() -> None:
    bus = exchanging(setup(3, safe=b"\x00\x00\x00\x01"), setup(4))
    unit = Unit()
    bus.master.images[3].unit = unit
    assert bus.hold()[0].data == bytes(4)
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    assert bus.hold()[0].data == unit.outputs
    bus.master.command(DriveCommand(3, "start", {}, 7), bus.now)
    bus.hold()
    results = [e.payload for e in bus.events if isinstance(e, DriveEvent)]
    assert results == [{"type": "result", "token": 7, "ok": True, "value": "start"}]
    unit.error = ZeroDivisionError("by the test")
    made = bus.hold()
    assert made[0].data == b"\x00\x00\x00\x01"
    assert made[1].da == 4
    assert bus.faults(3) == ["plugin"]
    assert bus.master.handlers[3].state is SlaveState.DATA_EXCHANGE
    bus.master.command(DriveCommand(3, "start", {}, 8), bus.now)
    last = [e for e in bus.master.take_events() if isinstance(e, DriveEvent)][-1]
    assert last.payload["ok"] is False


def test_unit_of_the_wrong_length_is_a_defect_of_the_unit() -> None:
    bus = exchanging(setup(3))
    unit = Unit()
    unit.outputs = b"\x01"
    bus.master.images[3].unit = unit
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    assert bus.hold()[0].data == bytes(4)
    assert bus.faults(3) == ["plugin"]


def test_unit_is_told_when_the_slave_is_lost() -> None:
    bus = exchanging(setup(3))
    unit = Unit()
    bus.master.images[3].unit = unit
    bus.slaves.clear()
    bus.hold()
    assert unit.losses == 1


def test_garbage_in_answers_never_raises() -> None:
    def answering(junk: bytes) -> Callable[[Request], Telegram]:
        return lambda request: data(request, junk)

    for junk in (b"", b"\x00", bytes(5), bytes(244)):
        for sap in (60, 61, 62, None):
            bus = link(setup(), slaves={3: ScriptedSlave(answers={sap: answering(junk)})})
            bus.run(100 * MS)


def test_states_of_the_table_are_reachable_and_named() -> None:
    assert {state for state, _ in TABLE} == set(SlaveState)
    assert all(row.clause for row in TABLE.values())


@pytest.mark.parametrize("wanted", [1, 10, 11, 95, 200, 2550, 2551, 12_345, 99_999, 650_250])
def test_watchdog_factors_are_never_shorter_and_close(wanted: int) -> None:
    first, second = watchdog_factors(wanted)
    assert 1 <= first <= 255
    assert 1 <= second <= 255
    effective = first * second * 10
    assert wanted <= effective
    assert effective <= max(wanted * 1.02 + 10, 10)


class _Recorder(dict[Any, Any]):
    """The table, remembering which rows were used."""

    def __init__(self) -> None:
        super().__init__(TABLE)
        self.used: set[Any] = set()

    def get(self, key: Any, default: Any = None) -> Any:
        self.used.add(key)
        return super().get(key, default)


def _diag(text: str) -> Callable[[Request], Telegram]:
    return lambda request: data(request, bytes.fromhex(text))


def _rs(request: Request) -> Telegram:
    return Telegram(Kind.SD1, 2, request.da, 0x03)


#: answers in the state reached (by SAP), to reach each row of the table from a slave that behaves up to there
_OTHER, _LOCKED = "02 05 00 FF 12 34", "00 0C 00 07 06 96"
_WANTS, _BAD_PRM, _STATIC, _WAITS = "02 05 00 FF 06 96", "42 05 00 02 06 96", "00 0E 00 02 06 96", "02 0C 00 02 06 96"


def test_every_row_of_the_table_is_exercised(monkeypatch: pytest.MonkeyPatch) -> None:
    from dpstack.dp import slave_handler

    table = _Recorder()
    monkeypatch.setattr(slave_handler, "TABLE", table)
    before: list[dict[int | None, Callable[[Request], Telegram | Failure]]] = [
        {},
        {60: _rs},
        {60: _diag(_OTHER)},
        {60: _diag(_LOCKED)},
        {61: lambda _r: Failure.NO_ANSWER},
        {61: _rs},
        {62: lambda _r: Failure.NO_ANSWER},
        {62: _rs},
    ]
    for answers in before:
        link(setup(), slaves={3: ScriptedSlave(answers=dict(answers))}).run(3_000 * MS)
    link(setup(), slaves={}).run(500 * MS)
    for ready in (_WANTS, _BAD_PRM, _WAITS, _LOCKED, _OTHER):
        long = 12_000 if ready == _WAITS else 3_000  # it is waited for the longest
        link(setup(), slaves={3: ScriptedSlave(ready=bytes.fromhex(ready))}).run(long * MS)
    half = link(setup(), slaves={3: ScriptedSlave(answers={61: lambda _r: Failure.NO_ANSWER}, free=DIAG_FREE)})
    half.hold()
    half.hold()
    half.slaves[3].free = bytes.fromhex(_WAITS)
    half.run(5 * MS)
    # in WAIT_READY: silence and refusals of Slave_Diag
    for answer in (lambda _r: Failure.NO_ANSWER, _rs):
        bus = link(setup())
        while bus.master.handlers[3].state is not SlaveState.WAIT_READY:
            bus.hold()
        bus.slaves[3].answers[60] = answer
        bus.run(500 * MS)
    # in data exchange: every kind of trouble, then trouble with the diagnosis that follows
    for trouble in (_rs, lambda r: Telegram(Kind.SD1, 2, r.da, 0x02), lambda r: data(r, b"\x01")):
        for later in ({}, {60: _rs}, {60: _diag(_LOCKED)}, {60: _diag(_OTHER)}, {60: lambda _r: Failure.NO_ANSWER}):
            bus = exchanging(setup())
            bus.run(1_100 * MS)
            bus.slaves[3].configured = False
            bus.slaves[3].answers |= {None: trouble} | later
            bus.run(2_500 * MS)
    for diagnosis in (_STATIC, _WANTS, _BAD_PRM, _LOCKED, _OTHER, DIAG_READY.hex()):
        bus = exchanging(setup())
        bus.slaves[3].answers = {None: lambda r: data(r, bytes(4), fc=0x0A), 60: _diag(diagnosis)}
        bus.run(1_500 * MS)
    gone = exchanging(setup())
    gone.slaves.clear()
    gone.run(500 * MS)
    # out of service from every state, and back
    refusing = ScriptedSlave(ready=bytes.fromhex(_BAD_PRM))
    leaving = ScriptedSlave(answers={None: _rs})
    for slave in (ScriptedSlave(), refusing, leaving):
        for state in {state for state, _ in TABLE} - {SlaveState.DEACTIVATED}:
            bus = link(setup(), slaves={3: slave})
            handler = bus.master.handlers[3]
            for _ in range(20):
                if handler.state is state:
                    break
                bus.hold()
            bus.master.command(DeactivateSlave(3), bus.now)
            bus.hold()
            bus.master.command(ActivateSlave(3), bus.now)
            slave.configured = False
    assert set(TABLE) - table.used == set()
