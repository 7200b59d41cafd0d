"""Every row of the transition table is taken, and ends where the table says."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from ring_bus import ListUser

from dpstack.fdl.active.cycle_window import CycleWindow
from dpstack.fdl.active.states import TABLE, Handler, Input, Row, State, StateMachine
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram, token
from dpstack.machine import LineDown
from dpstack.params import BusParams
from dpstack.units import NEVER, chars_to_ns

TS = 2
BAUD = 500_000


class Rig:
    """One station without a bus: what it sends is written down, time goes from deadline to deadline."""

    def __init__(self, gap: int = 0) -> None:
        self.user = ListUser()
        self.window = CycleWindow()
        params = BusParams.preset(BAUD, address=TS, gap=gap)
        self.station = ActiveStation(params, [self.user], window=self.window)
        self.now = 0
        self.sent: list[bytes] = []
        self.taken: list[tuple[State, Input, State]] = []
        self._record(self.station._machine)

    def _record(self, machine: StateMachine) -> None:
        open_rows: list[list[State]] = []

        def wrap(state: State, what: Input, handler: Handler) -> Handler:
            def run(telegram: Telegram, now: int) -> None:
                if open_rows:
                    open_rows[-1].append(machine.state)  # the outer handler hands over here
                open_rows.append([])
                handler(telegram, now)
                entered = open_rows.pop()
                self.taken.append((state, what, entered[0] if entered else machine.state))

            return run

        machine.bind({s: tuple(wrap(s, i, machine.rows[s][i]) for i in Input) for s in State})

    def step(self) -> None:
        """To the next deadline, then one wake and one transmission at most."""
        self.now = max(self.now, self.station.wake_at())
        assert self.now < NEVER
        self.station.wake(self.now)
        octets = self.station.take_tx(self.now)
        if octets is not None:
            self.sent.append(octets)
            self.now += chars_to_ns(len(octets), BAUD)
            self.station.sent(self.now)

    def until(self, state: State) -> Rig:
        for _ in range(50):
            if self.station.state is state:
                return self
            self.step()
        raise AssertionError(f"{state.name} not reached, {self.station.state.name} instead")

    def hear(self, telegram: Telegram) -> None:
        self.now += 1_000_000
        self.station.telegram(telegram, self.now)

    def command(self, command: object) -> None:
        self.station.command(command, self.now)


def _listening() -> Rig:
    rig = Rig()
    rig.command(GoOnline())
    return rig


def _idle() -> Rig:
    rig = _listening()
    for _ in range(3):
        rig.hear(token(7, 5))
        rig.hear(token(5, 7))
    rig.hear(STATUS_REQUEST)
    rig.step()
    return rig


def _claiming() -> Rig:
    return _listening().until(State.CLAIM_TOKEN)


def _using() -> Rig:
    rig = _listening()
    rig.user.high.append(Request(3, Req.SRD_HIGH, b"\x01"))
    return rig.until(State.USE_TOKEN)


def _awaiting_status() -> Rig:
    rig = Rig(gap=1)
    rig.command(GoOnline())
    return rig.until(State.AWAIT_STATUS_RESPONSE)


def _watching() -> Rig:
    rig = _idle()
    rig.hear(token(TS, 7))
    return rig.until(State.CHECK_TOKEN_PASS)


def _keeping() -> Rig:
    rig = _claiming()
    rig.window.begin(rig.now + 4_000_000)  # a cycle is due in 4 ms
    while rig.station.state is not State.USE_TOKEN:
        rig.step()
    return rig


AT: dict[State, Callable[[], Rig]] = {
    State.OFFLINE: Rig,
    State.LISTEN_TOKEN: _listening,
    State.ACTIVE_IDLE: _idle,
    State.CLAIM_TOKEN: _claiming,
    State.USE_TOKEN: _using,
    State.AWAIT_DATA_RESPONSE: lambda: _using().until(State.AWAIT_DATA_RESPONSE),
    State.PASS_TOKEN: lambda: _listening().until(State.PASS_TOKEN),
    State.CHECK_TOKEN_PASS: _watching,
    State.AWAIT_STATUS_RESPONSE: _awaiting_status,
}

STATUS_REQUEST = Telegram(Kind.SD1, TS, 7, 0x49)
TELEGRAMS = {
    Input.TOKEN_TO_ME: token(TS, 7),
    Input.TOKEN_SEEN: token(7, 5),
    Input.OWN_ADDRESS: Telegram(Kind.SD1, 9, TS, 0x49),
    Input.STATUS_REQUEST: STATUS_REQUEST,
    Input.REQUEST_TO_ME: Telegram(Kind.SD2, TS, 7, 0x6D, 60, 62),
    Input.REQUEST_SEEN: Telegram(Kind.SD1, 3, 7, 0x49),
    Input.RESPONSE: Telegram(Kind.SD2, TS, 9, 0x08, data=b"\x00"),
    Input.RESPONSE_SEEN: Telegram(Kind.SD2, 7, 3, 0x08, data=b"\x00"),
}
COMMANDS = {
    Input.GO_ONLINE: GoOnline(),
    Input.GO_OFFLINE: GoOffline(),
    Input.LINE_DOWN: LineDown("unplugged"),
}


def happen(rig: Rig, what: Input) -> None:
    state = rig.station.state
    if what in TELEGRAMS:
        rig.hear(TELEGRAMS[what])
    elif what in COMMANDS:
        rig.command(COMMANDS[what])
    elif what is Input.ACTIVITY:
        rig.station.activity(rig.now)
    else:
        if what is Input.SENT and state in (State.LISTEN_TOKEN, State.ACTIVE_IDLE):
            rig.hear(STATUS_REQUEST)
        if state is State.AWAIT_DATA_RESPONSE and what is Input.SENT:
            rig.user.high.append(Request(3, Req.SRD_HIGH))
            rig.hear(SHORT_ACK)  # operational now: the next one is repeated
            rig.until(State.AWAIT_DATA_RESPONSE)
            rig.step()
        rig.step()


@pytest.mark.parametrize("row", TABLE, ids=lambda r: f"{r.state.name}-{r.input.name}")
def test_row(row: Row) -> None:
    if row.state is State.CHECK_ACCESS_TIME or row.input is Input.HOLD:
        rig = _claiming()
        rig.step()
    else:
        rig = _keeping() if (row.state, row.input) == (State.USE_TOKEN, Input.TIMEOUT) else AT[row.state]()
        assert rig.station.state is row.state
        rig.taken.clear()
        happen(rig, row.input)
    ends = [end for state, what, end in rig.taken if (state, what) == (row.state, row.input)]
    assert ends, f"not taken, but {rig.taken}"
    assert set(ends) <= set(row.next)


def test_table_has_no_pair_twice() -> None:
    pairs = [(row.state, row.input) for row in TABLE]
    assert len(set(pairs)) == len(pairs)


def test_every_state_can_be_entered_and_left() -> None:
    entered = {target for row in TABLE for target in row.next if target is not row.state}
    assert entered == set(State)
    assert {row.state for row in TABLE} == set(State)


def test_a_pair_without_a_row_is_ignored_and_counted() -> None:
    rig = _using()
    rig.command(GoOnline())
    assert rig.station.state is State.USE_TOKEN
    assert rig.station.stats.ignored == 1
