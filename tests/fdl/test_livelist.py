"""The live list: types and readiness by FDL status, low priority, silent polls within their allowance."""

from __future__ import annotations

from itertools import count

import pytest
from ring_bus import ListUser, RingBus, fixed
from support import present

from dpstack.dp.master.scanner import SurveyOrder
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import DetachUser
from dpstack.fdl.events import StationFound
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.livelist import LiveList, LongLook, live_allowance, long_look
from dpstack.fdl.telegram import Kind, Req, StationType, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import ADAPTER, EXACT, HOST, Patience, slack
from dpstack.units import NS_PER_MS

#: FDL status of station 2 to 4 and to 126, answers: a slave
TO_4, SLAVE_4 = "10 04 02 49 4F 16", "10 02 04 00 06 16"
TO_126, SLAVE_126 = "10 7E 02 49 C9 16", "10 02 7E 00 80 16"


def list_of(bus: RingBus, live: LiveList, ms: int = 2000) -> ActiveStation:
    """Master 2 with ``live`` after ``ms``; station 4 is a slave."""
    bus.slaves[4] = fixed(TO_4, SLAVE_4)
    return bus.master(2, live, gap=0, run_ms=ms)


def polls(bus: RingBus, sender: int = 2) -> list[int]:
    return [s.octets[1] for s in bus.log if s.octets[0] == 0x10 and s.sender == sender and s.octets[3] == 0x49]


def test_all_addresses_but_the_own_one(bus: RingBus) -> None:
    live = LiveList(2)
    bus.slaves[126] = fixed(TO_126, SLAVE_126)
    list_of(bus, live)
    assert live.done
    assert live.stations == {4: StationType.SLAVE, 126: StationType.SLAVE}
    everybody = [a for a in range(127) if a != 2]
    silent = [a for a in everybody if a not in (4, 126)]
    assert polls(bus) == everybody + silent  # what was silent is asked a second time
    found = [(e.address, e.kind) for e in bus.events_of(StationFound)]
    assert found == [(4, StationType.SLAVE), (126, StationType.SLAVE)]


def test_one_poll_a_hold_after_all_other_traffic(bus: RingBus) -> None:
    user = ListUser(per_hold=[Request(9, Req.SDN_HIGH, b"\x01"), Request(9, Req.SDN_HIGH, b"\x02")])
    bus.master(2, user, LiveList(2), gap=0, run_ms=20)
    kinds = "".join({0xDC: "t", 0x10: "p", 0x68: "r"}[s.octets[0]] for s in bus.log[2:])
    assert kinds.startswith("rrptrrptrrpt")


def test_nothing_when_the_time_is_over(bus: RingBus) -> None:
    user = ListUser(per_hold=[Request(9, Req.SDN_HIGH, bytes(60))])
    station = bus.master(2, user, LiveList(2), gap=0, t_tr=256, run_ms=100)
    assert station.stats.tokens > 10
    assert len(polls(bus)) <= 1


def test_the_types_of_masters(bus: RingBus) -> None:
    live = LiveList(2)
    bus.master(2, live, hsa=10)
    bus.master(7, hsa=10, run_ms=1000)
    assert live.done
    assert live.stations == {7: StationType.MASTER_IN_RING}


def test_a_damaged_answer_hides_no_station(bus: RingBus) -> None:
    live = LiveList(2)
    answers = count()
    bus.drop = lambda sent: sent.sender == 4 and next(answers) == 0
    station = list_of(bus, live)
    assert next(answers) > 1
    assert live.stations == {4: StationType.SLAVE}
    assert live.unreadable == set()
    assert station.stats.stations[4].bad


def test_an_address_that_is_never_readable_is_reported(bus: RingBus) -> None:
    live = LiveList(2)
    bus.drop = lambda sent: sent.sender == 4
    list_of(bus, live)
    assert live.done
    assert live.stations == {}
    assert live.unreadable == {4}


def test_a_repeated_live_list_drops_stations_that_are_gone(bus: RingBus) -> None:
    live = LiveList(2, addresses=[3, 4], period_ns=100 * NS_PER_MS)
    list_of(bus, live, 300)
    assert live.stations == {4: StationType.SLAVE}
    assert live.done
    bus.slaves.clear()
    bus.run_ms(300)
    assert live.stations == {}
    found = [(e.address, e.kind) for e in bus.events_of(StationFound)]
    assert found == [(4, StationType.SLAVE), (4, None)]
    assert live.done


def test_the_next_list_begins_without_the_longer_time_outs_of_the_last_pass() -> None:
    live = LiveList(
        2, addresses=[3], passes=1, period_ns=1_000, long_look=LongLook(late_ns=10, extra_ns=50, most_ns=90)
    )
    given = []
    for now in (0, 100, 1_000):
        live.token_received(now)
        request = present(live.next_request(now, False))
        given.append(request.extra_ns)
        live.started(request, now)
        live.result(request, Failure.NO_ANSWER, now + 20)
    assert given == [0, 50, 0]


def test_silent_polls_on_a_host_port_keep_to_their_share_and_leave_the_gap_its_own() -> None:
    bus = RingBus(mode="chunk")
    params = BusParams.preset(500_000, address=2)
    live = LiveList(2, period_ns=1, allowance=live_allowance(params, HOST, 0))
    station = bus.master(2, live, patience=HOST, run_ms=20_000)
    cost = 2 * NS_PER_MS + bus.ns(200 + 11)
    mine = len(polls(bus)) - station.stats.gap_polls
    assert mine * cost < 20_000 * NS_PER_MS // 200 + 17 * cost
    assert mine > 17
    assert station.stats.gap_polls > 17


def test_a_user_that_comes_and_goes(bus: RingBus) -> None:
    station = bus.master(2, gap=0, run_ms=10)
    bus.command(station, SurveyOrder(1, tuple(range(127)), (), configs=False, quick=True), run_ms=10)
    asked = len(polls(bus))
    assert asked
    bus.command(station, DetachUser(1), run_ms=10)
    assert len(polls(bus)) == asked
    assert station.in_ring


def test_soon_and_forgotten(bus: RingBus) -> None:
    live = LiveList(2, addresses=range(10))
    live.ask_soon(77)
    live.ask_soon(77)
    list_of(bus, live, 100)
    assert polls(bus)[:3] == [77, 0, 1]
    live.forget(4, bus.now)
    assert live.stations == {}


def asked(live: LiveList, took_ns: int, answers: dict[int, Telegram], first_ns: int = 0) -> list[Request]:
    """The whole list as a link would ask it, each silence noticed after ``took_ns`` (``first_ns``) and ``extra_ns``."""
    requests: list[Request] = []
    now = 0
    while not live.done:
        now += NS_PER_MS
        live.token_received(now)
        request = present(live.next_request(now, False))
        requests.append(request)
        live.started(request, now)
        now += (took_ns if requests[1:] else max(took_ns, first_ns)) + request.extra_ns
        answer = answers.get(request.da) if request.extra_ns else None
        live.result(request, Failure.NO_ANSWER if answer is None else answer, now)
    return requests


def test_a_busy_computer_looks_once_more_with_patience() -> None:
    """At 500 kbit/s: 6 octets, T_SL of 200 and one octet are 554 us; 2 ms of slack, 1 ms of it more is busy."""
    params = BusParams.preset(500_000, address=2)
    look = long_look(params, HOST)
    assert look == LongLook(3_554_000, 18 * NS_PER_MS, 48 * NS_PER_MS)
    late = {4: Telegram(Kind.SD1, 2, 4, fc=0)}
    addresses = [3, 4, 5]

    in_time = LiveList(2, addresses=addresses, long_look=look)
    assert [r.da for r in asked(in_time, 3_553_999, late)] == addresses * 2
    assert in_time.stations == {}

    # one of 52 is late: no more than what happens on any computer; one of 50 is more
    for size, extra in ((26, 0), (25, 25)):
        once = LiveList(2, addresses=range(3, 3 + size), long_look=look)
        assert len(asked(once, 3_553_999, {}, first_ns=3_554_000)) == 2 * size + extra

    busy = LiveList(2, addresses=addresses, long_look=look)
    requests = asked(busy, 3_554_000, late)
    patient = [(a, 18 * NS_PER_MS) for a in (3, 4, 5, 3, 5)]  # that found somebody, so once more
    assert [(r.da, r.extra_ns) for r in requests] == [(a, 0) for a in addresses * 2] + patient
    assert busy.stations == {4: StationType.SLAVE}


@pytest.mark.parametrize(("late_ms", "extra_ms"), [(0, 18), (18, 18), (31, 31), (48, 48), (500, 48)])
def test_the_later_the_polls_the_longer_the_look(late_ms: int, extra_ms: int) -> None:
    """A computer that stalls for longer hides a station for longer; 50 ms are the most, 2 of them are given before."""
    look = long_look(BusParams.preset(500_000, address=2), HOST)
    requests = asked(
        LiveList(2, addresses=[3], long_look=look), 3_554_000, {}, first_ns=3_554_000 + late_ms * NS_PER_MS
    )
    assert [r.extra_ns for r in requests] == [0, 0, extra_ms * NS_PER_MS]


@pytest.mark.parametrize("patience", [EXACT, ADAPTER, slack(20 * NS_PER_MS)])
def test_no_long_look_where_every_look_is_one(patience: Patience) -> None:
    assert long_look(BusParams.preset(500_000), patience) is None


def test_extra_time_for_an_answer() -> None:
    """The answer begins 18 ms after the request; HOST waits 2 ms, T_SL and one octet."""
    outcomes = []
    for extra_ns in (0, 18 * NS_PER_MS):
        bus = RingBus(mode="chunk")
        bus.slaves[4] = fixed(TO_4, SLAVE_4, 9_000)
        user = ListUser(low=[Request(4, Req.FDL_STATUS, retry=False, extra_ns=extra_ns)])
        bus.master(2, user, gap=0, patience=HOST, run_ms=500)
        ((_, outcome, _),) = user.results
        outcomes.append(outcome)
    assert outcomes[0] is Failure.NO_ANSWER
    assert isinstance(outcomes[1], Telegram)
