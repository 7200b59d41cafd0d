"""The ways out of Operate and out of a slave's configuration: safe values first, nothing after (design, "the end")."""

from __future__ import annotations

import pytest
from scripted_link import (
    DIAG_LOCKED,
    MS,
    RUN,
    SAFE,
    ScriptedLink,
    ScriptedPlugin,
    ScriptedSlave,
    data,
    high,
    operating,
    outputs,
    refuses,
    setup,
)

from dpstack.dp.master.commands import AddSlave, Mode, RemoveSlave, SetMode, Shutdown
from dpstack.dp.master.events import DriveEvent, MasterStopped, ModeChanged, SlaveState, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.fdl.interface import Failure
from dpstack.machine import LineDown
from dpstack.params import BusParams

CLEAR_GC = b"\x02\x00"


def controls(bus: ScriptedLink) -> list[bytes]:
    return [r.data for r in bus.requests if r.dsap == 58]


@pytest.mark.parametrize("mode", [Mode.CLEAR, Mode.STOP])
def test_out_of_operate_safe_values_come_before_clear(mode: Mode) -> None:
    """Zeros mean nothing to a drive that wants bit 10 of STW1: only its safe word stops it."""
    bus = operating(setup(safe=SAFE, initial=RUN))
    bus.hold()
    bus.send(SetMode(mode))
    began = bus.now
    while bus.master.mode is Mode.OPERATE:
        bus.hold()
    assert bus.now - began >= 50 * MS  # a drive that looks every 32 ms has seen them
    bus.run(5 * MS)
    assert outputs(bus) == [RUN, SAFE, bytes(4)]
    assert controls(bus)[-2:] == [CLEAR_GC] * 2
    assert bus.master.mode is mode
    modes = [e.mode for e in bus.events_of(ModeChanged)]
    assert modes == ([Mode.CLEAR] if mode is Mode.CLEAR else [Mode.CLEAR, Mode.STOP])


def test_stop_from_operate_clears_first_even_where_zeros_are_safe() -> None:
    bus = operating(setup(initial=RUN))
    bus.send(SetMode(Mode.STOP), 5 * MS)
    assert outputs(bus) == [bytes(4)]
    assert controls(bus) == [CLEAR_GC] * 2
    assert bus.hold() == []


def test_back_to_operate_on_the_way_down() -> None:
    bus = operating(setup(safe=SAFE, initial=RUN))
    bus.send(SetMode(Mode.CLEAR), 5 * MS)
    bus.send(SetMode(Mode.OPERATE), 100 * MS)
    assert outputs(bus) == [SAFE, RUN]
    assert CLEAR_GC not in controls(bus)


def test_safe_values_reach_a_slave_that_is_served_every_nth_round_only() -> None:
    bus = operating(setup(every=10_000, safe=SAFE, initial=RUN), setup(4))
    bus.send(Shutdown(), 100 * MS)
    assert outputs(bus) == [SAFE, bytes(4)]


def test_line_down_on_the_way_down_ends_it_at_once() -> None:
    bus = operating(setup(safe=SAFE, initial=RUN))
    bus.send(SetMode(Mode.STOP))
    bus.hold()
    bus.send(LineDown("unplugged"))
    assert bus.master.mode is Mode.STOP
    assert bus.hold() == []


def test_stop_makes_inputs_invalid_and_is_no_rotation() -> None:
    bus = operating(setup())
    bus.send(SetMode(Mode.STOP), 1_000 * MS)
    stopped = bus.image.valid
    bus.send(SetMode(Mode.CLEAR), 5 * MS)
    assert (stopped, bus.image.valid) == (False, True)
    assert bus.master.rotation.max_ns < 100 * MS


def test_nothing_goes_to_a_slave_removed_in_the_middle_of_a_round() -> None:
    bus = operating(setup(3), setup(4, safe=SAFE, initial=RUN), setup(5))
    bus.slaves.pop(5)  # is looked for by service requests
    bus.run(300 * MS)
    master = bus.master
    first = bus.next_request()
    bus.send(RemoveSlave(4))
    bus.send(RemoveSlave(5))
    master.result(first, data(first, bytes(4)), bus.now)
    bus.now += 2_000 * MS
    while (request := master.next_request(bus.now, False)) is not None:
        assert request.da not in (4, 5)
        master.result(request, Failure.NO_ANSWER, bus.now)


@pytest.fixture
def bus() -> ScriptedLink:
    return operating(setup(3))


def test_the_answer_to_a_removed_slave_is_nobodys(bus: ScriptedLink) -> None:
    request = bus.next_request()
    bus.send(RemoveSlave(3))
    bus.send(AddSlave(setup(3)))
    bus.master.take_events()
    bus.master.result(request, Failure.NO_ANSWER, bus.now)
    assert bus.master.take_events() == []


def test_a_slave_added_where_one_was_just_removed_waits_for_its_farewell() -> None:
    bus = operating(setup(3), setup(4, safe=SAFE, initial=RUN))
    bus.send(RemoveSlave(4))
    bus.send(AddSlave(setup(4, initial=RUN)), 200 * MS)
    made = [(r.dsap, r.data) for r in bus.requests if r.da == 4]
    unlocked = next(at for at, (dsap, _) in enumerate(made) if dsap == 61)
    assert made[unlocked][1][0] == 0x40
    assert set(made[:unlocked]) == {(None, SAFE)}
    assert [dsap for dsap, _ in made[unlocked + 1 : unlocked + 6]] == [60, 61, 62, 60, None]
    assert bus.faults(4) == []


@pytest.mark.parametrize(("state", "unlocks"), [("set_prm", 0), ("chk_cfg", 1), ("wait_ready", 1)])
def test_a_slave_removed_during_its_bring_up_is_unlocked_when_it_was_parameterised(state: str, unlocks: int) -> None:
    bus = operating(setup(3))
    bus.slaves[4] = ScriptedSlave()
    bus.send(AddSlave(setup(4)))
    while bus.state(4).value != state:
        bus.hold()
    bus.send_anew(RemoveSlave(4), 200 * MS)
    assert [(r.dsap, r.data[0]) for r in bus.requests if r.da == 4] == [(61, 0x40)] * unlocks


def test_a_removed_slave_gets_its_farewell_before_the_end() -> None:
    bus = operating(setup(3), setup(4, safe=SAFE, initial=RUN))
    bus.send(RemoveSlave(4))
    bus.send(Shutdown(), 100 * MS)
    assert [r.data[0] for r in bus.requests if r.da == 4 and r.dsap == 61] == [0x40]
    assert isinstance(bus.events[-1], MasterStopped)


@pytest.mark.parametrize("how", ["line down", "stop"])
def test_no_farewell_after_the_line_was_down_or_in_stop(how: str) -> None:
    """Meanwhile the slave may be another master's."""
    bus = operating(setup(3), setup(4))
    if how == "stop":
        bus.send(SetMode(Mode.STOP), 10 * MS)
        bus.requests.clear()
    bus.send(RemoveSlave(4))
    if how == "line down":
        bus.send(LineDown("unplugged"))
    bus.run(10 * MS)
    bus.send(SetMode(Mode.CLEAR), 200 * MS)
    assert not any(r.da == 4 for r in bus.requests)


def test_shutdown_during_bring_up_parameterises_nobody_any_more(bus: ScriptedLink) -> None:
    bus.slaves[4] = ScriptedSlave()
    bus.send(AddSlave(setup(4)))
    bus.hold()
    bus.send_anew(Shutdown(), 100 * MS)
    assert not any(r.da == 4 for r in bus.requests)
    assert bus.master.mode is Mode.OFFLINE


# --- re-entry, back-off, what is told ---------------------------------------------------------------------------


def test_parameters_follow_a_fresh_diagnosis_after_a_pause(bus: ScriptedLink) -> None:
    """A slave that left after a short stay is parameterised later: by then another master may have taken it."""
    slave = bus.slave
    slave.answers[None] = refuses(0x03)
    slave.configured = False
    bus.run(500 * MS)
    slave.free = DIAG_LOCKED  # master 7
    bus.requests.clear()
    bus.run_long(30_000 * MS)
    assert not any(r.dsap in (61, 62) for r in bus.requests)
    assert bus.faults(3)[-1] == "locked"


def test_wrong_length_after_a_short_stay_is_retried_after_one_second(bus: ScriptedLink) -> None:
    bus.slave.inputs = b"\x01"
    bus.run(10 * MS)
    assert bus.state(3) is SlaveState.FAULT
    faulted = bus.events_of(SlaveStateChanged)[-1].t_ns
    bus.events.clear()
    bus.run(1_500 * MS)
    again = next(e.t_ns for e in bus.events_of(SlaveStateChanged) if e.state is SlaveState.SET_PRM)
    assert 1_000 * MS <= again - faulted < 1_010 * MS


def test_a_device_put_in_place_of_one_whose_ident_was_asked_is_named() -> None:
    bus = operating(setup(3, ident=None))
    bus.slave.free = bytes.fromhex("02 05 00 FF 12 34")
    bus.slave.configured = False
    bus.run(3_000 * MS)
    assert "0x1234 instead of 0x0696" in bus.fault(3).message


def test_a_failed_plugin_stays_the_fault_of_its_slave_after_a_re_entry() -> None:
    bus = operating(setup(3, safe=SAFE, initial=RUN))
    bus.image.plugin = plugin = ScriptedPlugin()
    plugin.error = ZeroDivisionError("by the test")
    bus.run(1_500 * MS)
    bus.slave.configured = False
    bus.run_anew(50 * MS)
    assert bus.state(3) is SlaveState.DATA_EXCHANGE
    assert bus.fault(3).kind.value == "plugin"
    assert outputs(bus) == [SAFE]
    failed = [event.payload for event in bus.events_of(DriveEvent)]
    (one,) = failed
    assert str(one.pop("where")).startswith("cyclic(), scripted_link.py line ")
    assert one == {"type": "failed", "text": "ZeroDivisionError: by the test"}


def test_the_first_inputs_after_a_re_entry_are_never_the_old_ones() -> None:
    """The plugin sees inputs of this stay in data exchange only, also when the first answers carry none."""

    class Seen(ScriptedPlugin):
        def __init__(self) -> None:
            super().__init__()
            self.inputs: list[bytes] = []

        def cyclic(self, inputs: bytes, now: int) -> bytes:
            self.inputs.append(inputs)
            return bytes(4)

        def lost(self, now: int) -> None:
            self.inputs.clear()

    bus = operating(setup(3))
    bus.slave.inputs = b"\x11\x22\x33\x44"
    seen = Seen()
    bus.image.plugin = seen
    bus.run(1_500 * MS)
    bus.slave.configured = False
    while seen.inputs:
        bus.hold()
    bus.slave.answers[None] = refuses(0x02)  # RR: no resources yet
    while len(seen.inputs) < 3:
        bus.hold()
    bus.slave.answers.clear()
    bus.slave.inputs = b"\x55\x66\x77\x88"
    bus.run(5 * MS)
    assert set(seen.inputs) == {b"", b"\x55\x66\x77\x88"}


def test_global_control_is_not_repeated_after_every_diagnosis(bus: ScriptedLink) -> None:
    bus.slave.answers[None] = high  # always DH
    bus.run(1_000 * MS)
    assert sum(r.dsap == 60 for r in bus.requests) > 100
    assert len(controls(bus)) <= 7


def test_a_bring_up_that_has_begun_is_not_held_up_by_many_others() -> None:
    """From Set_Prm on the slave's watchdog runs: it must not wait in turn with 60 others."""
    addresses = range(3, 64)
    master = Master(BusParams.preset(500_000, address=2), [setup(a) for a in addresses])
    bus = ScriptedLink(master, {3: ScriptedSlave()}, period=4 * MS)
    bus.run(500 * MS)
    for address in addresses[1:]:
        bus.slaves[address] = ScriptedSlave()
    armed: dict[int, int] = {}
    worst = 0
    while any(h.state is not SlaveState.DATA_EXCHANGE for h in master.handlers.values()):
        before = bus.now
        for request in bus.hold():
            if request.dsap == 61:
                armed[request.da] = before
            elif request.da in armed:
                worst = max(worst, bus.now - armed[request.da])
                armed[request.da] = bus.now
        assert bus.now < 60_000 * MS
    assert worst < 200 * MS


def test_a_slave_that_wants_parameters_again_and_again_never_left_data_exchange(bus: ScriptedLink) -> None:
    bus.slaves[4] = ScriptedSlave(ready=bytes.fromhex("02 05 00 FF 06 96"))
    bus.send(AddSlave(setup(4)), 500 * MS)
    assert bus.faults(4) == ["not_ready"]
    assert "wants parameters again" in bus.fault(4).message
