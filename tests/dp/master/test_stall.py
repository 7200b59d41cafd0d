"""A stall: a slave was not asked for longer than its watchdog, so the old outputs do not go out again unasked."""

from __future__ import annotations

from typing import Any

import pytest
from scripted_link import (
    DIAG_FREE,
    DIAG_NOT_READY,
    DIAG_READY,
    MS,
    RUN,
    SAFE,
    ScriptedLink,
    link,
    mode_of,
    operating,
    outputs,
    refuses,
    setup,
)
from support import present

from dpstack.dp.master.commands import Alive, DeactivateSlave, Mode, RemoveSlave, SendControl, SetMode
from dpstack.dp.master.events import (
    ApplicationSilent,
    Blocked,
    ForcedClear,
    ModeChanged,
    SlaveState,
    Stalled,
)
from dpstack.errors import BusError
from dpstack.machine import HeldUp, LineDown, LineUp

ZEROS = bytes(4)


def running(*addresses: int, **options: Any) -> ScriptedLink:
    """Slaves with the outputs RUN, a watchdog of 200 ms and zeros as safe values, in Operate."""
    return operating(*(setup(address, initial=RUN) for address in addresses), **options)


def test_no_old_output_goes_out_after_a_gap_longer_than_the_watchdog() -> None:
    bus = running(3, 4)
    bus.stall(201 * MS, 300 * MS)
    assert mode_of(bus) is Mode.CLEAR
    assert outputs(bus, 3) == outputs(bus, 4) == [ZEROS]
    (stall,) = bus.events_of(Stalled)
    assert stall.slaves == (3, 4)
    assert 201 <= present(stall.gap_ns) / MS < 202
    clear = [r.data for r in bus.requests if r.dsap == 58]
    assert set(clear) == {b"\x02\x00"}  # Global_Control: Clear, never Operate
    assert "slave 3 (s3) was not asked for 201 ms, longer than its watchdog of 200 ms" in stall.text
    bus.send_anew(SetMode(Mode.OPERATE), 10 * MS)
    assert outputs(bus) == [RUN]
    assert [event.mode for event in bus.events_of(ModeChanged)] == [Mode.CLEAR, Mode.OPERATE]


def test_safe_values_first_where_they_are_not_zeros() -> None:
    bus = operating(setup(3, initial=RUN, safe=SAFE))
    bus.stall(300 * MS, 100 * MS)
    assert outputs(bus) == [SAFE, ZEROS]
    assert mode_of(bus) is Mode.CLEAR


@pytest.mark.parametrize(
    ("gap_ms", "watchdogs", "options"),
    [
        (198, {3: 200, 4: 200}, {}),
        (5_000, {3: 0, 4: 0}, {}),
        (5_000, {3: 200, 4: 200}, {"safe_after_stall": False}),
    ],
    ids=["a shorter gap", "no watchdogs", "resume"],
)
def test_nothing_changes(gap_ms: int, watchdogs: dict[int, int], options: dict[str, Any]) -> None:
    slaves = [setup(address, initial=RUN, watchdog_ms=ms) for address, ms in watchdogs.items()]
    bus = operating(*slaves, **options)
    bus.stall(gap_ms * MS, 300 * MS)
    assert mode_of(bus) is Mode.OPERATE
    assert outputs(bus, 3) == outputs(bus, 4) == [RUN]
    assert not bus.events_of(Stalled)


def test_a_station_that_nobody_ran_has_not_lost_its_token_by_that() -> None:
    """Its slaves stay in data exchange: a gap shorter than their watchdogs changes nothing."""
    bus = operating(setup(3, initial=RUN, watchdog_ms=10_000))
    bus.now += 3_000 * MS
    bus.send(HeldUp(3_000 * MS, "the program was stopped for 3000 ms"))
    bus.master.tick(bus.now)
    assert bus.state(3) is SlaveState.DATA_EXCHANGE
    bus.now += 3_000 * MS  # and now it runs, but there is no token
    bus.master.tick(bus.now)
    assert "holds no token" in bus.fault(3).text


def test_a_slave_without_a_watchdog_gets_no_old_outputs_either() -> None:
    """The bus goes to Clear before anything old goes out, whoever is asked first."""
    bus = operating(setup(3, initial=RUN, watchdog_ms=0), setup(4, initial=RUN, watchdog_ms=300))
    bus.stall(301 * MS, 20 * MS)
    assert outputs(bus, 3) == outputs(bus, 4) == [ZEROS]
    assert bus.events_of(Stalled)[0].slaves == (4,)


def test_a_restart_of_one_slave_changes_nothing() -> None:
    bus = running(3, 4)
    bus.slave.configured = False
    bus.run_long(3_000 * MS)
    assert bus.states(3)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE
    with bus.without(4):
        bus.run_long(2_000 * MS)
    bus.run_long(2_000 * MS)
    assert bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE


@pytest.fixture
def bus() -> ScriptedLink:
    return running(3)


def test_the_only_slave_may_restart(bus: ScriptedLink) -> None:
    bus.slave.configured = False
    bus.run_long(3_000 * MS)
    assert bus.states(3)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE


def test_all_slaves_want_parameters_at_once() -> None:
    """The clock shows no gap, but the watchdogs of all slaves ran out: the computer's clocks stood still."""
    bus = running(3, 4)
    bus.slave.configured = bus.slaves[4].configured = False
    bus.run_long(3_000 * MS)
    assert bus.states(3)[-1] == bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.CLEAR
    refused = [r for r in bus.requests if r.dsap == 61]
    after = bus.requests[bus.requests.index(refused[-1]) :]
    assert {r.data for r in after if r.dsap is None} == {bytes(4)}
    (stall,) = bus.events_of(Stalled)
    assert (stall.gap_ns, stall.slaves, stall.blocked) == (None, (3, 4), None)


def test_slaves_that_leave_one_after_the_other_are_no_stall() -> None:
    """The first one is back before the second leaves, as it is not held for a slave that flaps."""
    bus = running(3, 4)
    bus.run(1_100 * MS)
    for address in (3, 4):
        bus.slaves[address].configured = False
        bus.run(100 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_an_operate_after_it_stays_though_slaves_still_want_parameters() -> None:
    bus = running(3, 4)
    bus.slave.configured = bus.slaves[4].configured = False
    while not bus.events_of(Stalled):
        bus.hold()
    assert "data_exchange" not in (bus.state(3).value, bus.state(4).value)
    bus.send(SetMode(Mode.OPERATE))
    bus.run_long(3_000 * MS)
    assert bus.states(3)[-1] == bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE
    assert len(bus.events_of(Stalled)) == 1


def test_one_refuses_for_another_reason() -> None:
    """Slave 4 refuses data at the same time, but does not want parameters."""
    bus = running(3, 4)
    bus.slave.configured = False
    bus.slaves[4].answers[None] = refuses(0x03)
    bus.run(100 * MS)
    assert mode_of(bus) is Mode.OPERATE


# --- what blocked -----------------------------------------------------------------------------------------------------


def test_the_computer_was_suspended(bus: ScriptedLink) -> None:
    """The machine's time does not contain it."""
    gap = HeldUp(3_000 * MS, "the computer was suspended for 3000 ms", suspended=True)
    bus.send(gap, 20 * MS)
    assert outputs(bus) == [ZEROS]
    (stall,) = bus.events_of(Stalled)
    assert stall.blocked is Blocked.SUSPENDED
    assert 3_000 <= present(stall.gap_ns) / MS < 3_001
    assert "suspended for 3000 ms" in stall.text


@pytest.mark.parametrize(
    ("held_up", "blocked", "words"),
    [
        (498 * MS, Blocked.PROGRAM, "the process was stopped for 498 ms"),
        (0, Blocked.TOKEN, "the token did not come for 500"),
    ],
    ids=["the master did not run", "the token did not come"],
)
def test_most_of_the_gap_is_the_reason(bus: ScriptedLink, held_up: int, blocked: Blocked, words: str) -> None:
    bus.now += 500 * MS
    if held_up:
        bus.send(HeldUp(held_up, "the process was stopped for 498 ms"))
    bus.run(20 * MS)
    assert bus.events_of(Stalled)[0].blocked is blocked
    assert words in bus.events_of(Stalled)[0].text


@pytest.mark.parametrize(("away_ms", "mode"), [(150, Mode.OPERATE), (250, Mode.CLEAR)])
def test_a_lost_port(away_ms: int, mode: Mode) -> None:
    bus = running(3, 4)
    bus.send(LineDown("the adapter was pulled"))
    for slave in bus.slaves.values():
        slave.configured = away_ms < 200
    bus.now += away_ms * MS
    bus.send(LineUp(), 1_000 * MS)
    assert bus.states(3)[-1] == bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is mode
    if mode is Mode.CLEAR:
        assert outputs(bus, 3) == outputs(bus, 4) == [ZEROS]
        assert bus.events_of(Stalled)[0].blocked is Blocked.PORT
        assert "the port vanished (the adapter was pulled)" in bus.events_of(Stalled)[0].text


def test_operate_between_two_slaves_that_a_stall_has_cost_delays_neither() -> None:
    """One has left data exchange before the order and one after it, so the master never sees both want parameters."""
    bus = running(3, 4)
    bus.now += 500 * MS
    bus.slave.configured = bus.slaves[4].configured = False
    while not (bus.states(3) or bus.states(4)):
        bus.run(MS // 10)
    assert mode_of(bus) is Mode.CLEAR
    bus.send(SetMode(Mode.OPERATE), 200 * MS)
    assert bus.states(3)[-1] == bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE
    assert len(bus.events_of(Stalled)) == 1


def test_the_token_was_away_so_long_that_the_line_counts_as_lost(bus: ScriptedLink) -> None:
    bus.now += 3_000 * MS
    bus.master.tick(bus.now)
    bus.run(1_000 * MS)
    assert outputs(bus) == [ZEROS]
    assert bus.events_of(Stalled)[0].blocked is Blocked.TOKEN


def test_a_port_that_comes_back_when_its_slaves_are_gone_lets_nothing_old_out(bus: ScriptedLink) -> None:
    """Slave 3 was asked in vain at once, which is no sign that its watchdog was kept alive before."""
    bus.send(LineDown("pulled"))
    bus.now += 400 * MS
    with bus.without(3):
        bus.send(LineUp())
        bus.run_long(2_000 * MS)
    bus.run_long(2_000 * MS)
    assert bus.states(3)[-1] == "data_exchange"
    assert outputs(bus) == [ZEROS]


# --- who is no stall --------------------------------------------------------------------------------------------------


def test_a_gap_in_clear_tells_nothing(bus: ScriptedLink) -> None:
    bus.send(SetMode(Mode.CLEAR), 100 * MS)
    bus.stall(5_000 * MS, 100 * MS)
    assert not bus.events_of(Stalled)
    bus.send(SetMode(Mode.OPERATE), 300 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_operate_after_stop_begins_anew(bus: ScriptedLink) -> None:
    bus.send(SetMode(Mode.STOP), 1_000 * MS)
    bus.slave.configured = False
    bus.send(SetMode(Mode.OPERATE), 300 * MS)
    assert bus.states(3)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE


def test_a_stop_by_order_is_no_stall_of_all_slaves() -> None:
    """Their watchdogs have run out in Stop, so all want parameters at the next Operate. Afterwards the rule counts."""
    bus = running(3, 4)
    bus.send(SetMode(Mode.STOP), 1_500 * MS)
    bus.slave.configured = bus.slaves[4].configured = False
    bus.send(SetMode(Mode.OPERATE))
    bus.run_long(3_000 * MS)
    assert bus.states(3)[-1] == bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE
    assert not bus.events_of(Stalled)
    bus.slave.configured = bus.slaves[4].configured = False
    bus.run_long(3_000 * MS)
    assert mode_of(bus) is Mode.CLEAR
    assert len(bus.events_of(Stalled)) == 1


def test_a_slow_bring_up_is_no_stall() -> None:
    bus = link(setup(3, initial=RUN))
    bus.send(SetMode(Mode.OPERATE))
    bus.slave.ready = DIAG_NOT_READY  # Station_Not_Ready
    bus.run(1_000 * MS)
    bus.slave.ready = DIAG_READY
    bus.run_long(2_000 * MS)
    assert bus.states(3)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.OPERATE


@pytest.mark.parametrize("order", [RemoveSlave(3), DeactivateSlave(3)])
def test_a_slave_that_was_given_up_does_not_count(order: object) -> None:
    bus = operating(setup(3, initial=RUN), setup(4, initial=RUN, watchdog_ms=0))
    bus.send(order)
    bus.stall(1_000 * MS, 300 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_a_slave_in_every_nth_round_within_its_watchdog() -> None:
    bus = operating(setup(3, initial=RUN, every=50), setup(4, initial=RUN))
    bus.run(1_000 * MS)
    assert mode_of(bus) is Mode.OPERATE


# --- one way to Clear and back ----------------------------------------------------------------------------------------


def test_operate_on_the_way_down_is_told() -> None:
    bus = operating(setup(3, initial=RUN, safe=SAFE))
    bus.stall(300 * MS, 5 * MS)
    assert mode_of(bus) is Mode.OPERATE  # safe values stand for 50 ms
    bus.send(SetMode(Mode.OPERATE), 200 * MS)
    assert mode_of(bus) is Mode.OPERATE
    assert outputs(bus)[-1] == RUN
    assert len(bus.events_of(ModeChanged)) == 1


def test_operate_that_waits_for_slaves_ends_by_a_stall() -> None:
    bus = link(setup(3, initial=RUN), setup(4), auto_clear=True)
    with bus.without(4):
        bus.send(SetMode(Mode.OPERATE), 100 * MS)
        bus.stall(500 * MS, 10 * MS)
    assert len(bus.events_of(Stalled)) == 1
    bus.run_long(2_000 * MS)
    assert bus.states(4)[-1] == "data_exchange"
    assert mode_of(bus) is Mode.CLEAR
    assert outputs(bus) == [ZEROS]


def test_only_one_reason_for_one_clear() -> None:
    """The slaves are late for auto_clear, too."""
    bus = running(3, auto_clear=True, data_control_ns=300 * MS)
    bus.now += 2_000 * MS
    bus.run_long(2_000 * MS)
    assert [type(e) for e in bus.events_of(ForcedClear)] == [Stalled]


def test_a_second_stall_is_told_again(bus: ScriptedLink) -> None:
    for count in (1, 2):
        bus.stall(300 * MS, 100 * MS)
        assert len(bus.events_of(Stalled)) == count
        bus.send(SetMode(Mode.OPERATE), 100 * MS)
        assert mode_of(bus) is Mode.OPERATE


def test_a_repetition_with_old_outputs_is_not_sent(bus: ScriptedLink) -> None:
    """The link layer asks before it repeats."""
    request = bus.next_request()
    assert request.still is not None
    bus.master.started(request, bus.now)
    assert request.still(bus.now + 199 * MS)
    assert not request.still(bus.now + 201 * MS)
    assert [type(e) for e in bus.master.take_events()][:1] == [Stalled]


def test_diag_free_is_what_a_slave_says_whose_watchdog_ran_out() -> None:
    """All slaves answer as after the end of their watchdogs: nothing old before, during or after their bring-up."""
    bus = running(3, 4)
    for slave in bus.slaves.values():
        slave.configured = False
        slave.free = DIAG_FREE
    bus.now += 800 * MS
    bus.run_long(3_000 * MS)
    assert bus.states(3)[-1] == bus.states(4)[-1] == "data_exchange"
    assert outputs(bus, 3) == outputs(bus, 4) == [ZEROS]
    assert len(bus.events_of(Stalled)) == 1


# --- the application watchdog -----------------------------------------------------------------------------------------


def test_the_application_watchdog_runs_out() -> None:
    bus = running(3, application_watchdog_ns=100 * MS)
    began = bus.now
    for _ in range(20):
        bus.send(Alive(), 90 * MS)
    assert mode_of(bus) is Mode.OPERATE
    assert bus.now - began > 1_800 * MS
    last = bus.now - 90 * MS
    while mode_of(bus) is Mode.OPERATE:
        bus.requests.clear()
        bus.hold()
    bus.run(10 * MS)
    (event,) = bus.events_of(ApplicationSilent)
    assert 99 <= (event.t_ns - last) / MS <= 102
    assert "alive() was not called for 100 ms" in event.text
    assert outputs(bus) == [ZEROS]
    bus.send(Alive(), 200 * MS)  # does not bring it back
    assert mode_of(bus) is Mode.CLEAR
    assert len(bus.events_of(ApplicationSilent)) == 1
    bus.send(SetMode(Mode.OPERATE), 50 * MS)
    assert mode_of(bus) is Mode.OPERATE
    bus.run(60 * MS)
    assert mode_of(bus) is Mode.CLEAR  # operate() armed it again


def test_the_application_watchdog_is_armed_by_operate_and_off_in_clear() -> None:
    bus = link(setup(3), application_watchdog_ns=100 * MS)
    bus.run(1_000 * MS)
    bus.send(Alive())
    assert not bus.events_of(ApplicationSilent)
    bus.send(SetMode(Mode.OPERATE), 50 * MS)
    bus.send(SetMode(Mode.CLEAR), 1_000 * MS)
    assert not bus.events_of(ApplicationSilent)


def test_without_an_application_watchdog_alive_changes_nothing(bus: ScriptedLink) -> None:
    bus.send(Alive())
    bus.run_long(2_000 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_a_program_arms_the_watchdog_for_a_time_of_its_own_and_switches_it_off() -> None:
    """As long as something that was ordered from outside is in effect."""
    bus = running(3)
    bus.send(Alive(limit_ns=100 * MS))
    bus.run(90 * MS)
    bus.send(Alive(limit_ns=0))
    bus.run(500 * MS)
    bus.send(Alive())  # it is off
    assert mode_of(bus) is Mode.OPERATE
    bus.send(Alive(limit_ns=100 * MS))
    bus.run(90 * MS)
    bus.send(Alive(limit_ns=100 * MS))
    bus.run(90 * MS)
    assert mode_of(bus) is Mode.OPERATE
    bus.run(60 * MS)
    (event,) = bus.events_of(ApplicationSilent)
    assert event.limit_ns == 100 * MS
    bus.send(Alive(limit_ns=100 * MS))  # does not bring it back, and is off in Clear
    bus.run(500 * MS)
    assert len(bus.events_of(ApplicationSilent)) == 1
    bus.send(SetMode(Mode.OPERATE))
    bus.run(500 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_the_watchdog_of_the_settings_is_left_as_it_is_armed() -> None:
    bus = running(3, application_watchdog_ns=100 * MS)
    bus.send(Alive(limit_ns=5_000 * MS))
    bus.run(150 * MS)
    assert mode_of(bus) is Mode.CLEAR


def test_the_application_watchdog_runs_out_while_the_token_is_away() -> None:
    bus = running(3, application_watchdog_ns=100 * MS)
    bus.master.tick(bus.now)  # its watch over the token is moved on
    bus.now = bus.master.wake_at()
    bus.master.tick(bus.now)
    bus.run(10 * MS)
    assert len(bus.events_of(ApplicationSilent)) == 1
    assert outputs(bus) == [ZEROS]
    assert bus.state(3) is SlaveState.DATA_EXCHANGE


def test_requests_of_services_are_asked_before_nothing(bus: ScriptedLink) -> None:
    """Only outputs can be too old: a diagnosis is repeated as always."""
    bus.slave.configured = False
    bus.run(5 * MS)
    seen = [r for r in bus.requests if r.dsap is not None]
    assert seen
    assert all(r.still is None for r in seen)


@pytest.mark.parametrize(("apart_ms", "stalls"), [(0, True), (200, True), (201, False)])
def test_all_slaves_want_parameters_within_the_shortest_watchdog(apart_ms: int, stalls: bool) -> None:
    """Two slaves whose watchdogs of 200 and 300 ms ran out in the same stall lose their parameters within 200 ms."""
    bus = operating(setup(3, initial=RUN, watchdog_ms=200), setup(4, initial=RUN, watchdog_ms=300))
    for address, at in ((3, 0), (4, apart_ms)):
        bus.master.handlers[address].prm_req_at = bus.now + at * MS
    bus.send(HeldUp(0, "nothing"))
    bus.hold()
    assert bool(bus.events_of(Stalled)) is stalls


def test_no_order_of_sync_before_the_first_token() -> None:
    bus = link(setup(3, groups=(1,), sync=True))
    with pytest.raises(BusError, match="this station holds no token; try again when that is over"):
        bus.send(SendControl(1, (1,), sync=True))
    bus.hold()
    bus.send(SendControl(1, (1,), sync=True))
    bus.send(SetMode(Mode.OPERATE), 20 * MS)
    bus.send(SetMode(Mode.CLEAR))
    if mode_of(bus) is Mode.OPERATE:
        with pytest.raises(BusError, match="this station goes to a lower mode"):
            bus.send(SendControl(2, (1,), sync=True))


def test_the_application_watchdog_runs_before_the_first_token() -> None:
    bus = link(setup(3), application_watchdog_ns=30 * MS)
    bus.send(SetMode(Mode.OPERATE))
    assert bus.master.wake_at() == bus.now + 30 * MS
    bus.now += 30 * MS
    bus.master.tick(bus.now)
    bus.events += bus.master.take_events()
    assert len(bus.events_of(ApplicationSilent)) == 1
    assert mode_of(bus) is Mode.CLEAR
