"""Anything may arrive at any time: a station never raises, always settles, and always finds back into the ring."""

from __future__ import annotations

import random
from functools import partial

from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from ring_bus import ListUser, RingBus, Sent

from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Telegram
from dpstack.machine import LineDown, LineUp, pump
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, HOST
from dpstack.units import NEVER, NS_PER_MS, chars_to_ns

ADDRESSES = st.sampled_from([2, 3, 5, 9, 127])
TELEGRAMS = st.one_of(
    st.just(SHORT_ACK),
    st.builds(Telegram, st.just(Kind.SD4), ADDRESSES, st.sampled_from([2, 3, 5, 9])),
    st.builds(
        Telegram,
        st.sampled_from([Kind.SD1, Kind.SD2, Kind.SD3]),
        ADDRESSES,
        st.sampled_from([2, 3, 5, 9]),
        st.integers(0, 255),
        st.sampled_from([None, 0, 60]),
        st.sampled_from([None, 0, 62]),
        st.binary(max_size=8),
    ),
)
OCTETS = st.one_of(
    st.binary(min_size=1, max_size=20),
    st.sampled_from([bytes.fromhex(t) for t in ("E5", "DC 02 05", "DC 05 02", "10 02 05 49 50 16", "68 05 05 68")]),
)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("telegram"), TELEGRAMS),
        st.tuples(st.just("octets"), OCTETS),
        st.tuples(st.just("edge"), st.none()),
        st.tuples(st.just("wait"), st.integers(0, 3_000_000)),
        st.tuples(st.just("deadline"), st.none()),
        st.tuples(st.just("command"), st.sampled_from([GoOnline(), GoOffline(), LineDown("x"), LineUp()])),
    ),
    max_size=60,
)


def requests(count: int) -> list[Request]:
    kinds = [
        Request(3, Req.SRD_HIGH, b"\x01", patient=True),
        Request(5, Req.SRD_LOW, b"", 60, 62),
        Request(127, Req.SDN_HIGH, b"\x00\x00", 58, 62),
        Request(9, Req.FDL_STATUS),
        Request(3, Req.SDA_LOW, b"\x01", restart=True, retry=False),
    ]
    return [kinds[i % len(kinds)] for i in range(count)]


@examples(50, soak=1_500)
@given(STEPS, st.booleans())
def test_anything_settles_and_comes_back(steps: list[tuple[str, object]], slow: bool) -> None:
    user = ListUser(per_hold=requests(3))
    params = BusParams.preset(500_000, address=2, hsa=9, gap=1)
    station = ActiveStation(params, [user], patience=HOST if slow else EXACT)
    now = 0
    busy = 0

    def port(octets: bytes, at: int) -> int:
        nonlocal busy
        assert slow or at >= busy  # a slow port is believed to have sent once something is received
        busy = at + chars_to_ns(len(octets), 500_000)
        return busy

    def advance(until: int) -> None:
        nonlocal now
        while (at := pump(station, b"", now, port)) <= until:
            now = max(now, at)
        now = max(now, until)

    station.command(GoOnline(), 0)
    for what, value in steps:
        if what == "telegram" and isinstance(value, Telegram):
            station.telegram(value, now)
            pump(station, b"", now, port)
        elif what == "octets" and isinstance(value, bytes):
            pump(station, value, now, port)
        elif what == "edge":
            station.activity(now)
            pump(station, b"", now, port)
        elif what == "command":
            station.command(value, now)
            pump(station, b"", now, port)
        elif what == "deadline":
            advance(min(station.wake_at(), now + 100 * NS_PER_MS))
        elif isinstance(value, int):
            advance(now + value)
        station.take_events()
    # every request asked for was started or abandoned, and ended once
    started = len(user.starts)
    assert len(user.results) >= started - 1
    station.command(LineUp(), now)
    station.command(GoOnline(), now)
    latest = now + 3_000 * NS_PER_MS
    while not station.in_ring and now < latest:
        advance(now + 10 * NS_PER_MS)
    advance(now + 50 * NS_PER_MS)
    assert station.in_ring
    assert station.wake_at() < NEVER


@examples(10, soak=250)
@given(
    st.sets(st.integers(0, 14), min_size=2, max_size=8),
    st.integers(0, 2**32),
    st.lists(st.sampled_from(["kill", "join", "leave", "noise", "deaf"]), max_size=8),
)
def test_the_ring_heals(addresses: set[int], seed: int, troubles: list[str]) -> None:
    rng = random.Random(seed)
    bus = RingBus(1_500_000, mode=rng.choice(["whole", "octets"]))
    bus.slaves[13] = lambda octets, now: (rng.choice([11, 60, 290, 400, 700]), bytes.fromhex("E5"))
    pool = sorted(addresses)
    for address in pool:
        bus.master(address, ListUser(per_hold=[Request(13, Req.SRD_HIGH, b"\x01")]), hsa=14, gap=1, t_tr=20_000)
    bus.run(rng.randrange(60 * NS_PER_MS))
    gone: list[int] = []
    for trouble in troubles:
        victim = rng.choice(bus.stations)
        match trouble:
            case "kill" if len(bus.stations) > 1:
                bus.kill(victim)
                gone.append(victim.address)
            case "leave":
                bus.command(victim, GoOffline())
                back = rng.randrange(50 * NS_PER_MS)
                bus.at(bus.now + back, partial(bus.command, victim, GoOnline()))
            case "join" if gone:
                bus.master(gone.pop(), hsa=14, gap=1, t_tr=20_000)
            case "deaf":
                bus.deaf.add(victim)
                bus.at(bus.now + 2 * NS_PER_MS, bus.deaf.clear)
            case _:
                until = bus.now + rng.randrange(5 * NS_PER_MS)

                def noisy(sent: Sent, until: int = until) -> bool:
                    return sent.start < until and rng.random() < 0.3

                bus.drop = noisy
        bus.run(rng.randrange(20 * NS_PER_MS))
    bus.run_ms(60)  # whoever was sent away is back
    bus.drop = lambda sent: False
    bus.deaf.clear()
    bus.slaves.clear()
    params = bus.stations[0].params
    # one GAP pass of everybody may have just ended: G x T_TR until the next
    bus.run_bits(params.gap * params.t_tr + 40 * 300 + 15 * 300)
    bus.run_bits(params.gap * params.t_tr)
    everybody = {station.address for station in bus.stations}
    assert [set(s.las) for s in bus.stations] == [everybody] * len(bus.stations)
    assert all(s.in_ring for s in bus.stations)
