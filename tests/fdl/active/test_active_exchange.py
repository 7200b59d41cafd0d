"""Requests of an active station, against slaves that are literal octets: gates, repetitions, who holds the token."""

from __future__ import annotations

import pytest
from ring_bus import ListUser, RingBus, Sent, ring_of

from dpstack.fdl.active.services import answers
from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.phy.patience import HOST, Patience
from dpstack.trace import Notice, WireEntry
from dpstack.units import BAUD_RATES, NEVER, NS_PER_MS
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
            [DX, DX.replaced(retry=False), DX, DX.replaced(restart=True)],
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


# --- Answers as an active station judges them: right, wrong, garbled, early and late ones ---------------------------


# --- what is an answer -----------------------------------------------------------------------------------------------
RS = Telegram(Kind.SD1, 2, 3, 0x03)


@pytest.mark.parametrize(
    ("request_", "telegram", "fits"),
    [
        (DX, Telegram(Kind.SD2, 2, 3, 0x08, data=b"\xaa"), True),
        (DX, Telegram(Kind.SD2, 2, 3, 0x0A, data=b"\xaa"), True),
        (DX, SHORT_ACK, True),
        (DX, Telegram(Kind.SD2, 2, 4, 0x08, data=b"\xaa"), False),
        (DX, Telegram(Kind.SD2, 2, 3, 0x08, 62, 60, b"\xaa"), False),
        (DX, RS, True),
        (DIAG, Telegram(Kind.SD2, 2, 3, 0x08, 62, 60, b"\xaa"), True),
        (DIAG, Telegram(Kind.SD2, 2, 3, 0x08, 60, 62, b"\xaa"), False),
        (DIAG, Telegram(Kind.SD2, 2, 3, 0x08, 62, 59, b"\xaa"), False),
        (DIAG, Telegram(Kind.SD2, 2, 3, 0x08, data=b"\xaa"), False),
        (DIAG, Telegram(Kind.SD1, 2, 3, 0x08), False),
        (DIAG, SHORT_ACK, True),
        (DIAG, RS, True),
        (Request(3, Req.SRD_LOW, b"", 0, 0), Telegram(Kind.SD2, 2, 3, 0x08, 0, 0, b"\xaa"), True),
        (Request(3, Req.SRD_LOW, b"", 0, 0), Telegram(Kind.SD2, 2, 3, 0x08, data=b"\xaa"), False),
        (Request(3, Req.FDL_STATUS), Telegram(Kind.SD1, 2, 3, 0x00), True),
        (Request(3, Req.FDL_STATUS), Telegram(Kind.SD2, 2, 3, 0x08, data=b"\xaa"), False),
        (Request(3, Req.FDL_STATUS), SHORT_ACK, False),
        (Request(3, Req.IDENT), SHORT_ACK, False),
    ],
)
def test_a_telegram_answers_the_request_to_its_sender_and_saps(
    request_: Request, telegram: Telegram, fits: bool
) -> None:
    assert answers(request_, telegram) is fits


def test_a_wrong_answer_ends_as_wrong() -> None:
    slave = Slave(answer=DIAG_ANSWER)
    _, user, station = bus_with(slave, DX, run_ms=20)
    assert user.outcomes == [Failure.WRONG]
    assert station.stats.stations[3].wrong == 1


@pytest.mark.parametrize("mode", ["whole", "octets", "chunk"])
@pytest.mark.parametrize(
    "other", [DIAG, Request(3, Req.FDL_STATUS, patient=True), DX.replaced(dsap=0), DX.replaced(ssap=62)]
)
def test_the_octets_of_a_good_answer_answer_no_other_service(other: Request, mode: str) -> None:
    _, user, station = bus_with(Slave(), DX, DX, other, DX, mode=mode, run_ms=20)
    data = Telegram(Kind.SD2, 2, 3, 0x08, data=b"\xaa\xbb")
    assert user.outcomes == [data, data, Failure.WRONG, data]
    assert station.stats.stations[3].wrong >= 1


def test_a_garbled_answer_ends_as_garbled() -> None:
    for mode in ("octets", "chunk"):
        bus, user, station = bus_with(Slave(), DX, mode=mode)
        bus.drop = lambda sent: sent.sender == 3
        bus.run_ms(20)
        assert user.outcomes == [Failure.GARBLED]
        assert station.stats.garbled == 1


def test_a_slave_that_loses_its_power_in_the_middle_of_its_answer_gives_none() -> None:
    """The repetition meets silence: this is no noise."""
    slave = Slave()
    slave.plan = [DX_ANSWER, DX_ANSWER[:6], None]
    bus, user, station = bus_with(slave, DX, DX, mode="octets")
    bus.run(20 * NS_PER_MS)
    assert slave.plan == []
    assert user.outcomes[1:] == [Failure.NO_ANSWER]
    assert station.stats.garbled == 0


@pytest.mark.parametrize("octet", [b"\xe5", b"\x00", b"\xdc"])
def test_a_lone_octet_too_early_is_no_answer(octet: bytes) -> None:
    _, user, station = bus_with(Slave((5, octet)), DX, mode="octets", run_ms=20)
    assert len(user.outcomes) == 1
    assert isinstance(user.outcomes[0], Failure)
    assert station.stats.stray == (1 if octet == b"\xe5" else 0)


@pytest.mark.parametrize("mode", ["whole", "octets", "chunk"])
def test_a_late_answer_is_not_taken_for_that_of_another_station(mode: str) -> None:
    _, user, station = bus_with(Slave((330, DX_ANSWER)), DX, DX.replaced(da=4), mode=mode, run_ms=20)
    assert user.outcomes == [Failure.NO_ANSWER, Failure.NO_ANSWER]
    assert station.stats.late == 1
    assert station.stats.stations[3].late == 1


@pytest.mark.parametrize(
    ("requests", "delays", "got"),
    [
        # request 2 is answered 3 ms late: it arrives after request 3 was sent and before the answer to that one
        ([DX.replaced(retry=False)] * 8, {2: 1340, 3: 200}, [0, 1, None, 3, 4, 5, 6, 7]),
        # 2 is late; its repetition (3) is answered while 4, the next request, waits; the answer to 4 follows
        ([DX] * 6, {2: 1350, 3: 350, 4: 250}, [0, 1, 2, 4, 5, 6]),
    ],
    ids=["the answer to the request before", "the answers to both attempts"],
)
def test_a_late_answer_is_never_taken_for_the_next_one_of_the_same_station(
    requests: list[Request], delays: dict[int, int], got: list[int | None]
) -> None:
    """The port is later than its patience. The slave answers attempt n with octet n after 11 bits or ``delays[n]``."""
    patience = Patience(known_ns=2 * NS_PER_MS, unknown_ns=2 * NS_PER_MS, unknown_divisor=100, stall_ns=NS_PER_MS)
    plan = []
    for n in range(10):
        body = bytes((0x02, 0x03, 0x08, n))
        plan.append((delays.get(n, 11), b"\x68\x04\x04\x68" + body + bytes((sum(body) & 0xFF, 0x16))))
    _, user, station = bus_with(Slave(*plan), *requests, mode="chunk", patience=patience, run_ms=60)
    assert [o.data[0] if isinstance(o, Telegram) else None for o in user.outcomes] == got
    assert station.stats.late == 1


def test_a_station_that_answered_late_gets_more_slack() -> None:
    """A simulated slave on a busy machine needs 5 ms: its first answer is late, which shows that it is there."""
    user = ListUser()
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [user], patience=HOST)
    answer_at, answers_now, asked = NEVER, True, 0

    def port(octets: bytes, at: int) -> int:
        nonlocal answer_at
        if octets[0] == 0x68 and answers_now:
            answer_at = at + 5 * NS_PER_MS
        return at

    now = 0
    station.command(GoOnline(), now)
    due = now
    while len(user.results) < 5:
        if answer_at == NEVER and asked == len(user.results):
            asked += 1
            answers_now = asked <= 3
            user.high = [DIAG.replaced(restart=True)]
        now = max(now, min(due, answer_at))
        chunk = b""
        if answer_at <= now:
            chunk, answer_at = DIAG_ANSWER, NEVER
        due = pump(station, chunk, now, port)
    assert [isinstance(o, Telegram) for o in user.outcomes] == [False, True, True, False, False]
    assert station.stats.late == 1
    waited = [ended - started for (_, _, ended), (_, started) in zip(user.results, user.starts, strict=True)]
    assert waited[0] < 3 * NS_PER_MS
    assert waited[3] > 50 * NS_PER_MS
    assert waited[4] < 3 * NS_PER_MS  # silent once, it is as any other address


def test_a_kept_back_answer_counts_when_nothing_follows() -> None:
    _, user, station = bus_with(Slave(DX_ANSWER, None, None), *[DX] * 5, mode="chunk", patience=HOST, run_ms=400)
    assert [isinstance(o, Telegram) for o in user.outcomes] == [True, False, True, True, True]
    first, second = (user.results[i][2] - user.starts[i][1] for i in (2, 3))
    assert first > 10 * NS_PER_MS  # kept back once
    assert second < 2 * NS_PER_MS
    assert station.stats.late == 0


def test_a_late_gap_answer_is_not_taken_for_an_empty_data_exchange() -> None:
    patience = Patience(known_ns=NS_PER_MS, unknown_ns=NS_PER_MS, stall_ns=NS_PER_MS)
    bus = RingBus(mode="chunk")
    late = [False]

    def say(octets: bytes, now: int) -> tuple[int, bytes]:
        if octets[0] != 0x10:
            return (200 if late[0] else 11), DX_ANSWER
        return (910 if late[0] else 11), bytes.fromhex("10 02 03 00 05 16")

    bus.slaves[3] = say
    user = ListUser(per_hold=[DX])
    station = bus.master(2, user, patience=patience, hsa=3, t_tr=5000, run_ms=100)
    assert 3 in station.stations
    late[0] = True
    bus.run_ms(100)
    assert station.stats.late >= 1
    assert all(isinstance(o, Telegram) and o.data == b"\xaa\xbb" for o in user.outcomes)


def test_patience_can_be_changed_while_running() -> None:
    bus, user, station = bus_with(Slave(delay=300), mode="chunk", run_ms=20)
    station.set_patience(HOST, bus.now)
    user.high = [DX]
    bus.run_ms(20)
    assert isinstance(user.outcomes[-1], Telegram)


def test_octets_before_the_request_are_no_garbled_answer_to_it() -> None:
    bus, user, station = bus_with(Slave(), mode="chunk", patience=HOST)
    bus.slaves.clear()
    bus.until(station, State.PASS_TOKEN)
    user.high = [DIAG]
    bus.until(station, State.USE_TOKEN)
    bus.pump(station, b"\x55")
    bus.run_ms(20)
    assert user.outcomes == [Failure.NO_ANSWER]
    assert station.stats.garbled == 0


def test_answers_with_le_3_count_as_empty_and_are_reported_once() -> None:
    slave = Slave(answer=bytes.fromhex("68 03 03 68 02 03 08 0D 16"))
    bus, user, _ = bus_with(slave, DX, DX, DX, run_ms=20)
    assert [o.data for o in user.outcomes if isinstance(o, Telegram)] == [b"", b"", b""]
    (told,) = [e for e in bus.events_of(Notice) if "LE = 3" in e.text]
    assert "station 3 " in told.text


@pytest.mark.parametrize(
    "octets",
    [
        "68 03 03 68 09 03 08 14 16",  # LE = 3
        "68 04 04 68 89 03 08 41 D5 16",  # a region/segment address and no data unit
        "68 04 04 68 09 83 08 41 D5 16",
        "68 06 06 68 89 83 08 C1 3C 05 16 16",  # and a SAP behind it
        "A2 09 03 08 01 02 03 04 05 06 07 08 38 16",
    ],
)
def test_a_wire_listener_gets_the_octets_unchanged(octets: str) -> None:
    bus, _, station = bus_with(Slave())
    heard: list[WireEntry] = []
    station.wire = heard.append
    bus.pump(station, bytes.fromhex(octets))
    assert [entry.octets for entry in heard] == [bytes.fromhex(octets)]


# --- two stations with one address -----------------------------------------------------------------------------------
def asked_often(answer: bytes, *requests: Request, delay: int = 11, times: int = 60) -> tuple[RingBus, Slave]:
    """A station that asks slave 3 in every token hold; the slave answers ``answer`` after ``delay`` bit times."""
    slave = Slave(*[(delay, answer)] * times)
    bus, user, _ = bus_with(slave, mode="octets")
    user.per_hold = list(requests or (DX,))
    return bus, slave


def notices(bus: RingBus) -> list[str]:
    return [notice.message for notice in bus.events_of(Notice)]


@pytest.mark.parametrize("answer", [DX_ANSWER, b"\xe5"])
def test_two_answers_to_every_request_are_those_of_two_stations(answer: bytes) -> None:
    bus, _ = asked_often(answer + answer)
    bus.run_ms(60)
    (told,) = notices(bus)  # once
    assert told == (
        "station 3 gives more answers than it gets requests (10 more): two stations have address 3, and what is read "
        "may be of either; switch one off, and give it another address"
    )


def test_answers_that_are_late_are_no_second_stations() -> None:
    bus, slave = asked_often(DX_ANSWER, DX, DX.replaced(da=4), delay=330)  # T_SL is 200; nobody has address 4
    bus.run_ms(100)
    assert len(slave.heard) > 50
    assert bus.stations[0].stats.late > 20
    assert notices(bus) == []


def test_half_of_the_answers_cannot_be_read() -> None:
    bus, _ = asked_often(DX_ANSWER, times=1000)
    count = 0

    def every_other(sent: Sent) -> bool:
        nonlocal count
        count += sent.sender == 3
        return sent.sender == 3 and count % 3 != 0  # of three attempts the first two

    bus.drop = every_other
    bus.run_ms(400)
    (told,) = notices(bus)
    assert told == (
        "half of the answers of station 3 cannot be read: check its cable, shielding and the termination, and look "
        "for a second station with address 3"
    )
