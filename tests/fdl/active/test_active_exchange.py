"""Requests of an active station, against slaves that are literal octets: gates, repetitions, who holds the token."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from ring_bus import ListUser, ring_of

from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.phy.patience import HOST
from dpstack.trace import Notice
from dpstack.units import BAUD_RATES, NS_PER_MS
from tests.fdl.active.exchange_kit import DIAG, DIAG_ANSWER, DX, DX_ANSWER, Slave, bus_with


def test_literal_octets_of_a_bring_up() -> None:
    """The first of docs/reference/protocol.md#known-telegrams with its addresses: diagnosis first with FCB = 1, FCV =
    0, then toggling, SDN without."""
    slave = Slave(DIAG_ANSWER, b"\xe5", DX_ANSWER, DX_ANSWER)
    set_prm = Request(3, Req.SRD_HIGH, bytes.fromhex("88 01 14 0B 06 96 00"), 61, 62)
    clear = Request(127, Req.SDN_HIGH, b"\x02\x00", 58, 62)
    bus, user, _ = bus_with(slave, DIAG, set_prm, clear, DX, DX, run_ms=20)
    sent = [s.octets.hex(" ") for s in bus.log if s.sender == 2 and s.octets[0] == 0x68]
    assert sent == [
        "68 05 05 68 83 82 6d 3c 3e ec 16",
        "68 0c 0c 68 83 82 5d 3d 3e 88 01 14 0b 06 96 00 21 16",
        "68 07 07 68 ff 82 46 3a 3e 02 00 41 16",
        "68 05 05 68 03 02 7d 11 22 b5 16",
        "68 05 05 68 03 02 5d 11 22 95 16",
    ]
    assert [type(o) for o in user.outcomes] == [Telegram] * 5
    assert user.outcomes[1] is user.outcomes[2] is SHORT_ACK or user.outcomes[1] == SHORT_ACK


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_gates_are_exact_at_every_rate(baud: int) -> None:
    clear = Request(127, Req.SDN_HIGH, b"\x02\x00", 58, 62)
    bus, user, station = bus_with(Slave(), DX, clear, DX, baud=baud)
    p = station.params
    bus.run_bits(p.t_to + 5_000)
    at = [i for i, s in enumerate(bus.log) if s.octets[0] != 0xDC]
    first, answer, sdn, second = (bus.log[i] for i in at[:4])
    assert first.start - bus.log[at[0] - 1].end == bus.ns(p.t_id1)
    assert sdn.start - answer.end == bus.ns(p.t_id1)
    assert second.start - sdn.end == bus.ns(p.t_id2)
    assert [at for _, at in user.starts] == [first.start, sdn.start, second.start]
    assert len(user.results) == 3


@pytest.mark.parametrize("mode", ["whole", "octets", "chunk"])
def test_an_answer_may_begin_until_t_sl_is_over(mode: str) -> None:
    limit = 200 if mode == "whole" else 200 - 11 - (88 + 22 if mode == "chunk" else 0)
    for delay, fine in ((limit - 1, True), (limit + 12, False)):
        _, user, _ = bus_with(Slave(delay=delay), DX, mode=mode, run_ms=20)
        assert isinstance(user.outcomes[0], Telegram) is fine


@pytest.mark.parametrize(
    ("plan", "requests", "fcs", "answered", "retries"),
    [
        ([None], [DX], "6D", [False], 0),
        ([DX_ANSWER, None, DX_ANSWER, DX_ANSWER], [DX] * 3, "6D 5D 5D 7D", [True] * 3, 1),
        ([DX_ANSWER, None, None, DX_ANSWER], [DX] * 4, "6D 5D 5D 6D 5D", [True, False, True, True], 1),
        (
            [DX_ANSWER, None],
            [DX, replace(DX, retry=False), DX, replace(DX, restart=True)],
            "6D 5D 6D 6D",
            [True, False, True, True],
            0,
        ),
    ],
    ids=[
        "the first request is not repeated",
        "an operational station gets a repetition with the same FCB",
        "a station given up begins anew",
        "a request without retry is not repeated, and restart begins anew",
    ],
)
def test_repetitions_and_fcb(
    plan: list[bytes | None], requests: list[Request], fcs: str, answered: list[bool], retries: int
) -> None:
    slave = Slave(*plan)
    _, user, station = bus_with(slave, *requests, run_ms=20)
    assert slave.fcs == fcs.split()
    assert [isinstance(outcome, Telegram) for outcome in user.outcomes] == answered
    assert {outcome for outcome in user.outcomes if isinstance(outcome, Failure)} <= {Failure.NO_ANSWER}
    assert len(user.starts) == len(user.results) == len(requests)
    stats = station.stats.stations[3]
    assert (stats.timeouts, stats.retries) == (answered.count(False), retries)


def test_three_silent_rounds_then_the_probe_and_one_notice() -> None:
    class OnlyFcv(Slave):
        def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
            answer = super().__call__(octets, now)
            return answer if octets[6] & 0x10 else None

    slave = OnlyFcv()
    bus, _, _ = bus_with(slave, *[DX] * 6, run_ms=20)
    assert slave.fcs == ["6D", "6D", "6D", "5D", "7D", "5D"]
    notices = [e.text for e in bus.events if isinstance(e, Notice)]
    assert len(notices) == 1
    assert "station 3 answered a request with FCV = 1 after three silent ones with FCV = 0" in notices[0]
    assert "its answers came too late" in notices[0]  # a busy computer's, say


def test_fdl_status_of_a_user() -> None:
    slave = Slave(answer=bytes.fromhex("10 02 03 00 05 16"))
    _, user, _ = bus_with(slave, Request(3, Req.FDL_STATUS), Request(3, Req.FDL_STATUS), run_ms=20)
    assert [o.hex(" ") for o in slave.heard] == ["10 03 02 49 4e 16"] * 2
    assert all(isinstance(o, Telegram) for o in user.outcomes)


# --- who holds the token ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("foreign", ["dc 09 07", "10 04 07 49 54 16", "68 05 05 68 83 87 6D 3C 3E F1 16"])
def test_another_holder_makes_us_withdraw(foreign: str) -> None:
    slave = Slave((60, bytes.fromhex(foreign)))
    bus, user, station = bus_with(slave, DX)
    while not slave.heard:
        bus.run(500)
    bus.run_bits(60 + 11 * 12)
    assert station.state is State.ACTIVE_IDLE
    assert user.outcomes == [Failure.ABANDONED]
    assert station.stats.withdrawn == 1
    bus.run_ms(20)
    assert station.in_ring


def test_the_request_after_one_that_was_sent_and_abandoned_begins_with_fcv_0() -> None:
    """The slave may have carried it out or not, so neither FCB would be that of a new request: with the wrong one the
    slave gives its last answer again, and the outputs are lost."""
    slave = Slave(DX_ANSWER, (60, bytes.fromhex("dc 09 07")), DX_ANSWER, DX_ANSWER)
    _, user, station = bus_with(slave, DX, DX, DX, DX, run_ms=30)
    assert station.stats.withdrawn == 1
    assert [o is Failure.ABANDONED for o in user.outcomes] == [False, True, False, False]
    assert slave.fcs == ["6D", "5D", "6D", "5D"]


def test_a_request_that_was_not_sent_when_it_was_abandoned_leaves_the_fcb() -> None:
    bus, user, station = bus_with(Slave(), DX, DX, DX)
    while len(user.outcomes) < 1:
        bus.run(500)
    before = list(station._exchange.fcb.bits)
    assert station._exchange.line.tx is not None  # the next one waits for its gate
    station._exchange.abandon(bus.now)
    assert user.outcomes[-1] is Failure.ABANDONED
    assert station._exchange.fcb.bits == before


def test_a_repeated_token_before_we_started_is_still_ours() -> None:
    bus = ring_of(2, 5, hsa=6)
    a = bus.stations[0]
    user = ListUser(per_hold=[Request(4, Req.SDN_HIGH)])
    a._users.attach(user)
    bus.until(a, State.USE_TOKEN)
    a.telegram(Telegram(Kind.SD4, 2, 5), bus.now)
    bus.pump(a)
    assert a.state is State.USE_TOKEN
    assert a.stats.withdrawn == 0
    edge = bus.now
    bus.run_bits(40)
    assert bus.log[-1].start == edge + bus.ns(37)


def test_receiving_while_sending_implies_sent() -> None:
    user = ListUser(high=[DX, DX])
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [user], patience=HOST)
    now, sent = 0, []

    def port(octets: bytes, at: int) -> int:
        sent.append(at)
        return at + 5 * NS_PER_MS  # the port's guess is far too late

    station.command(GoOnline(), now)
    while not user.starts:
        now = max(now, pump(station, b"", now, port))
    now += NS_PER_MS
    deadline = pump(station, DX_ANSWER, now, port)
    assert len(user.results) == 1
    assert deadline == now + station.params.ns(37)
    pump(station, b"", deadline, port)
    assert sent[-1] == deadline
