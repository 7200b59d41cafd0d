"""The end of a class 2 connection at the slave: by silence (to the nanosecond) and otherwise; each row of the table."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from octet_class2 import (
    ABORT,
    ABORT_REQUEST,
    ABORT_SEQUENCE,
    ABORT_TIMEOUT,
    IDLE,
    INITIATE,
    RS,
    SC,
    Class2,
)
from octet_wire import MS
from slave_kit import Recorder

from dpstack.dp.slave.auto_baud import SearchingSlave
from dpstack.dpv1.pdu.ms2 import Abort
from dpstack.dpv1.slave.ms2_states import TABLE, Act, Ms2Trigger, State
from dpstack.dpv1.slave.resource_manager import ms2_of
from tests.dpv1.ms2_slave_kit import READ, TIMEOUT, Later, Slave, cyclic, reach

# --- time -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def later() -> Later:
    return Later()


@pytest.fixture
def slave() -> Slave:
    return Slave(count=1)


@pytest.mark.parametrize(
    ("step", "factor"),
    [("initiate", 1), ("opened", 2), ("asked", 1), ("fetched", 2), ("idle", 1), ("idle answered", 2)],
)
def test_silence_ends_a_connection_to_the_nanosecond(later: Later, step: str, factor: int) -> None:
    slave = Slave(later, count=1)
    reach(slave, later, step)
    deadline = slave.master.heard + factor * TIMEOUT
    slave.wire.pass_time(deadline - 1 - slave.wire.now)
    assert slave.saps() == [48]
    assert slave.app.wake_at() == deadline
    slave.wire.pass_time(1)
    assert slave.saps() == []
    assert slave.texts()[-1].endswith(f"nothing was heard of its master for {factor * 2000} ms")
    # the Abort waits for another send time-out, then the connection is forgotten
    assert slave.app.wake_at() == deadline + TIMEOUT
    slave.wire.pass_time(TIMEOUT - 1)
    assert slave.app.wake_at() == deadline + TIMEOUT
    slave.wire.pass_time(1)
    assert slave.app.wake_at() > deadline + 10 * TIMEOUT
    assert slave.master.ask(48) == RS
    assert slave.all_free()


def test_each_connection_has_its_own_time_out() -> None:
    slave = Slave(count=3)
    heard = []
    for _ in range(3):
        slave.master.connect()
        heard.append(slave.master.heard)
        slave.wire.pass_time(100 * MS)
    open_ones = [48, 47, 46]
    for last in heard:
        deadline = last + 2 * TIMEOUT
        slave.wire.pass_time(deadline - 1 - slave.wire.now)
        assert slave.saps() == open_ones
        assert slave.app.wake_at() == deadline
        slave.wire.pass_time(1)
        open_ones = open_ones[1:]
        assert slave.saps() == open_ones


def test_the_abort_after_silence_is_fetched(later: Later) -> None:
    slave = Slave(later, count=1)
    reach(slave, later, "asked")
    dropped: list[int] = []
    later.requests[0].abandoned = lambda: dropped.append(1)
    slave.wire.pass_time(TIMEOUT + MS)
    assert dropped == [1]
    assert not later.requests[0].asker.open
    assert slave.master.ask(48, READ) == SC  # nothing is left but the Abort
    assert slave.master.ask(48) == ABORT_TIMEOUT
    assert slave.master.ask(48) == RS
    assert len(later.requests) == 1
    slave.master.connect()


def test_the_sap_of_a_connection_that_is_over_goes_to_the_next_master(slave: Slave) -> None:
    slave.master.connect()
    slave.wire.pass_time(2 * TIMEOUT + MS)
    other = Class2(slave.wire, 3)
    assert other.connect() == 48
    assert slave.master.ask(48) == RS
    assert [connection.master for connection in ms2_of(slave.app).connections] == [3]


def test_polls_and_idle_keep_a_connection(slave: Slave) -> None:
    sap = slave.master.connect()
    for _ in range(4):
        slave.wire.pass_time(2 * TIMEOUT - 20 * MS)
        assert slave.master.service(sap, IDLE) == IDLE
        slave.wire.pass_time(2 * TIMEOUT - 20 * MS)
        assert slave.master.ask(sap) == SC
    assert len(ms2_of(slave.app).connections) == 1


# --- every way out ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", ["initiate", "manager", "opened", "asked", "fetched", "idle", "idle answered"])
def test_an_abort_of_the_master_at_every_step(later: Later, step: str) -> None:
    slave = Slave(later, count=1)
    reach(slave, later, step)
    assert slave.master.ask(48, ABORT) == SC
    assert slave.master.ask(48) == RS
    assert slave.master.ask(49) == SC
    assert slave.all_free()
    assert all(not request.open or request.response for request in later.requests)
    slave.master.connect()


@pytest.mark.parametrize("subnet", [0, 1, 2, 7])
@pytest.mark.parametrize("instance", [0, 1, 2, 3])
@pytest.mark.parametrize("reason", [1, 2, 3, 4, 5, 6, 7, 8, 15, 0, 12])
def test_each_reason_of_an_abort_is_reported(slave: Slave, subnet: int, instance: int, reason: int) -> None:
    sap = slave.master.connect()
    slave.master.ask(sap, f"58 {subnet:02X} {instance << 4 | reason:02X} 00")
    assert slave.texts()[-1].endswith(f"its master aborted it: {Abort(reason, instance, subnet).text}")
    assert slave.all_free()


@pytest.mark.parametrize("short", ["58", "58 00", "58 00 25", "58 00 25 00 01 02 03"])
def test_an_abort_of_another_length_is_an_abort(slave: Slave, short: str) -> None:
    assert slave.master.ask(slave.master.connect(), short) == SC
    assert slave.all_free()


def _set_address(slave: Slave) -> None:
    assert cyclic(slave, 0x16D, "37 3E 09 0A 35 00") == "E5"


@pytest.mark.parametrize("step", ["initiate", "opened", "asked", "fetched"])
@pytest.mark.parametrize(
    ("end", "reason"),
    [
        (lambda slave: slave.app.restart(slave.wire.now), "the slave was switched off"),
        (lambda slave: slave.app.initial_reset(slave.wire.now), "the slave was switched off"),
        (lambda slave: slave.app.rate_lost(slave.wire.now), "the baud rate was lost"),
        (_set_address, "the slave has another address"),
    ],
    ids=["restart", "initial reset", "rate lost", "address"],
)
def test_the_slave_itself_ends_it(later: Later, end: Callable[[Slave], None], reason: str, step: str) -> None:
    device = Recorder()
    device.set_slave_add = True
    slave = Slave(later, count=1, device=device)
    reach(slave, later, step)
    slave.texts()
    now = slave.wire.now
    end(slave)
    assert slave.all_free()
    (text,) = [text for text in slave.texts() if "class 2 connection" in text]
    assert text.endswith(f": {reason}")
    assert all(not request.open or request.response for request in later.requests)
    later.requests.clear()
    assert slave.app.wake_at() > now + 100 * TIMEOUT


def test_a_slave_that_searches_its_rate_ends_its_connections(slave: Slave) -> None:
    searching = SearchingSlave(slave.wire.station, slave.app, rates=[500_000])
    slave.master.connect()
    searching._reach(searching.state.SEARCH, slave.wire.now)
    assert slave.all_free()


# --- the table --------------------------------------------------------------------------------------------------------


REQUESTS = {
    Ms2Trigger.POLL: "",
    Ms2Trigger.SERVICE: READ,
    Ms2Trigger.IDLE: IDLE,
    Ms2Trigger.ABORT: ABORT,
    Ms2Trigger.OUT_OF_PLACE: INITIATE,
    Ms2Trigger.UNREADABLE: "4A",
}


def test_the_table_has_every_state_and_trigger() -> None:
    assert set(TABLE) == {(state, event) for state in State for event in Ms2Trigger}
    assert all(row.source for row in TABLE.values())


@pytest.mark.parametrize(("state", "event"), list(TABLE))
def test_every_row_of_the_table(later: Later, state: State, event: Ms2Trigger) -> None:
    slave = Slave(later, count=1)
    master = slave.master
    reach(slave, later, {State.OPEN: "fetched", State.ANSWERED: "idle"}.get(state, "asked"))
    if state is State.OVER:
        master.ask(48, INITIATE)
    requests = len(later.requests)
    slave.texts()
    act = TABLE[state, event].act
    if event is Ms2Trigger.SILENCE:
        slave.wire.pass_time(2 * TIMEOUT)
        assert slave.all_free()
        after = master.ask(48)
        assert after == (RS if act is Act.FREE else ABORT_TIMEOUT)
        return
    first = master.ask(48, REQUESTS[event])
    again = master.ask(48)
    told = slave.texts()
    aborts = {Act.SEQUENCE: ABORT_SEQUENCE, Act.REQUEST_PDU: ABORT_REQUEST}
    if event is Ms2Trigger.POLL:
        answers = {State.OPEN: SC, State.WORKING: SC, State.ANSWERED: IDLE, State.OVER: ABORT_SEQUENCE}
        assert first == answers[state]
        assert again == (RS if state is State.OVER else SC)
    elif act is Act.FREE:
        assert (first, again) == (SC, RS)
    elif act in aborts:
        assert (first, again) == (SC, aborts[act])
        assert master.ask(48) == RS
        assert len(told) == 1
    else:
        expected = {
            State.OPEN: IDLE if event is Ms2Trigger.IDLE else SC,
            State.ANSWERED: IDLE,
            State.OVER: ABORT_SEQUENCE,
        }
        assert (first, again) == (SC, expected.get(state, SC))
    assert len(later.requests) == requests + (act is Act.SERVE)
    assert slave.all_free() is (act in (Act.FREE, Act.SEQUENCE, Act.REQUEST_PDU) or state is State.OVER)
