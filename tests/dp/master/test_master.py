"""The class 1 master against scripted answers, in literal octets: bring-up, rounds, modes, slaves that come and go."""

from __future__ import annotations

import pytest
from scripted_link import MS, ScriptedPlugin, ScriptedSlave, exchanging, link, operating, setup

from dpstack.dp.master import fault_texts
from dpstack.dp.master.commands import AddSlave, DriveCommand, Mode, RemoveSlave, ReparameteriseSlave, SetMode, Shutdown
from dpstack.dp.master.events import DriveEvent, MasterStopped, SlaveState
from dpstack.dp.process_image import inputs_are_valid, inputs_limit_ns
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.telegram import SHORT_ACK, Req
from dpstack.machine import InDoubt, LineDown


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
    bus.send(SetMode(Mode.OPERATE))
    bus.run_anew(1000 * MS)
    controls = [r for r in bus.requests if r.dsap == 58]
    assert {(r.da, r.function, r.ssap, r.data) for r in controls} == {(127, Req.SDN_HIGH, 62, b"\x00\x00")}
    assert 5 <= len(controls) <= 8  # two at once, then every 200 ms
    bus.send(SetMode(Mode.CLEAR))
    bus.run_anew(10 * MS)
    assert [r.data for r in bus.requests if r.dsap == 58] == [b"\x02\x00"] * 2


def test_outputs_are_zero_in_clear_and_the_image_in_operate() -> None:
    bus = exchanging(setup(initial=bytes([1, 2, 3, 4])))
    assert [r.data for r in bus.hold() if r.dsap is None] == [bytes(4)]
    bus.send(SetMode(Mode.OPERATE))
    assert [r.data for r in bus.hold() if r.dsap is None] == [bytes([1, 2, 3, 4])]
    bus.image.outputs = b"\x09\x08\x07\x06"
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
    bus.slave.inputs = b"\x11\x22\x33\x44"
    bus.hold()
    image = bus.image
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
    assert bus.image.inputs == b"\x07"
    before = bus.master.handlers[4].exchanges
    bus.hold()
    assert bus.master.handlers[4].exchanges == before + 1


def test_stop_sends_nothing_to_slaves() -> None:
    bus = exchanging(setup())
    bus.send(SetMode(Mode.STOP))
    assert bus.hold() == []


def test_shutdown_safe_values_then_clear_twice() -> None:
    bus = exchanging(setup(safe=b"\x00\x01\x00\x02", initial=b"\x01\x01\x01\x01"))
    bus.send(SetMode(Mode.OPERATE), 5 * MS)
    bus.send_anew(Shutdown())
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
    bus.send(Shutdown())
    bus.master.tick(bus.now + 1_000 * MS)
    assert any(isinstance(e, MasterStopped) for e in bus.master.take_events())


def test_line_down_tells_every_slave_lost() -> None:
    bus = exchanging(setup(3), setup(4))
    bus.send(LineDown("unplugged"))
    bus.events += bus.master.take_events()
    assert bus.faults(3) == ["lost"]
    assert bus.faults(4) == ["lost"]
    assert not bus.image.valid


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
    bus.send(AddSlave(setup(4)), 5 * MS)
    assert bus.state(4) is SlaveState.DATA_EXCHANGE
    bus.send_anew(RemoveSlave(4), 60 * MS)
    made = [(r.dsap, r.data) for r in bus.requests if r.da == 4]
    assert len(made) > 10
    assert set(made[:-1]) == {(None, bytes(4))}
    assert made[-1] == (61, bytes.fromhex("40 01 01 0B 06 96 00"))
    with pytest.raises(UsageError, match="no slave with address 4"):
        bus.send(RemoveSlave(4))


def test_two_slaves_at_one_address_and_the_masters_own_are_refused() -> None:
    with pytest.raises(ConfigError, match="both have address 3"):
        link(setup(3), setup(3, name="other"))
    with pytest.raises(ConfigError, match="own address 2"):
        link(setup(2))


# --- The rule for valid inputs: in data exchange, and no older than the watchdog, 1 s without one, or two polls -----


@pytest.mark.parametrize(
    ("watchdog_ms", "poll_ms", "limit_ms"),
    [
        (200, 4, 200),  # its watchdog
        (0, 4, 1000),  # off: 1 s
        (60_000, 4, 60_000),
        (200, 150, 300),  # every n-th cycle, many slaves, a slow rate: two polls
        (200, 100, 200),
        (0, 700, 1400),
        (0, 500, 1000),
    ],
)
def test_the_greatest_age_of_valid_inputs(watchdog_ms: int, poll_ms: int, limit_ms: int) -> None:
    assert inputs_limit_ns(watchdog_ms * MS, poll_ms * MS) == limit_ms * MS


@pytest.mark.parametrize(
    ("exchanging", "age_ms", "valid"),
    [(True, 0, True), (True, 200, True), (True, 201, False), (False, 0, False), (True, None, False)],
)
def test_inputs_are_valid_up_to_that_age(exchanging: bool, age_ms: int | None, valid: bool) -> None:
    age_ns = None if age_ms is None else age_ms * MS
    assert inputs_are_valid(exchanging=exchanging, age_ns=age_ns, limit_ns=200 * MS) is valid


def test_inputs_in_doubt_are_not_valid_until_the_next_exchange() -> None:
    """The adapter's driver counted damaged octets after the answer was delivered."""
    bus = exchanging(setup())
    image = bus.image
    bus.send(InDoubt(0))  # nothing arrived after now
    valid = [image.valid]
    bus.send(InDoubt(bus.now - image.input_time + 1))
    assert [*valid, image.valid] == [True, False]
    exchanges = bus.master.handlers[3].exchanges
    bus.hold()
    assert (bus.master.handlers[3].exchanges, image.valid) == (exchanges + 1, True)
    bus.send(InDoubt(bus.now))
    bus.hold()
    assert bus.remarks(3) == [fault_texts.IN_DOUBT]  # once


# --- The share of the bus time that polls of absent slaves may take -------------------------------------------------


@pytest.mark.parametrize(("divisor", "polls"), [(8, 12), (0, 30)])
def test_short_polls_take_their_share_and_no_more(divisor: int, polls: int) -> None:
    """A poll takes 1 ms. With a share of an eighth of the time the next one comes 8 ms later: five rounds of 1.6 ms."""
    bus = exchanging(setup(3), absent_divisor=divisor)
    for address in range(20, 50):
        bus.send(AddSlave(setup(address)))
    bus.step, bus.period = 1 * MS, 600_000
    bus.run_anew(100 * MS)
    assert len([r for r in bus.requests if r.da >= 20]) == polls


# --- Drive plugins at the master: called in Operate, their defects their own, told of losses and new parameters -----


def test_unit_runs_in_operate_only_and_its_defect_stays_its_own() -> None:
    bus = exchanging(setup(3, safe=b"\x00\x00\x00\x01"), setup(4))
    unit = ScriptedPlugin()
    bus.image.plugin = unit
    assert bus.hold()[0].data == bytes(4)
    bus.send(SetMode(Mode.OPERATE))
    assert bus.hold()[0].data == unit.outputs
    bus.send(DriveCommand(3, "start", {}, 7))
    bus.hold()
    results = [e.payload for e in bus.events_of(DriveEvent)]
    assert results == [{"type": "result", "token": 7, "ok": True, "value": "start"}]
    unit.error = ZeroDivisionError("by the test")
    made = bus.hold()
    assert made[0].data == b"\x00\x00\x00\x01"
    assert made[1].da == 4
    assert bus.faults(3) == ["plugin"]
    assert bus.state(3) is SlaveState.DATA_EXCHANGE
    bus.send(DriveCommand(3, "start", {}, 8))
    last = [e for e in bus.master.take_events() if isinstance(e, DriveEvent)][-1]
    assert last.payload["ok"] is False


@pytest.mark.parametrize(
    ("outputs", "events"),
    [
        pytest.param(b"\x01", [], id="outputs of the wrong length"),
        pytest.param(bytes(4), [{"type": "status", "speed": object()}], id="an event that is no plain data"),
    ],
)
def test_a_defect_of_the_plugin(outputs: bytes, events: list[dict[str, object]]) -> None:
    bus = exchanging(setup(3))
    unit = ScriptedPlugin()
    unit.outputs, unit.events = outputs, events
    bus.image.plugin = unit
    bus.send(SetMode(Mode.OPERATE))
    assert bus.hold()[0].data == bytes(4)
    assert bus.faults(3) == ["plugin"]


def test_unit_is_told_when_the_slave_is_lost() -> None:
    bus = exchanging(setup(3))
    unit = ScriptedPlugin()
    bus.image.plugin = unit
    bus.slaves.clear()
    bus.hold()
    assert unit.losses == 1


def test_a_plugin_is_told_and_nothing_is_half_applied() -> None:
    bus = operating(setup(3))
    unit = bus.image.plugin = ScriptedPlugin()
    before = bus.master.handlers[3]
    with pytest.raises(UsageError, match="its drive plugin is made for 4 octets of inputs"):
        bus.send(ReparameteriseSlave(setup(3, config=b"\x10")))
    with pytest.raises(UsageError, match="no slave with address 9"):
        bus.send(ReparameteriseSlave(setup(9)))
    bus.run(10 * MS)
    assert bus.master.handlers[3] is before
    assert before.state is SlaveState.DATA_EXCHANGE
    assert unit.losses == 0
    bus.send(ReparameteriseSlave(setup(3, groups=(1,))))
    assert unit.losses == 1
    assert bus.image.plugin is unit
