"""USB adapters in virtual time: each habit by hand, and a master that works on all of them."""

from __future__ import annotations

from functools import partial

import pytest
from bus_kit import SimBus
from msgspec.structs import replace
from support import MS, US, Dummy, S, WorldFactory

from dpstack.errors import ConfigError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.events import AddressCollision
from dpstack.fdl.telegram import token
from dpstack.params import BusParams
from dpstack.phy.patience import ADAPTER, Patience, slack
from dpstack.sim.adapter import FTDI, FTDI_LOW_LATENCY, Adapter, Habits
from dpstack.sim.referee import Rule
from dpstack.sim.world import World

TOKEN = bytes.fromhex("DC 02 05")
STATUS = bytes.fromhex("10 07 02 49 52 16")


# --- the habits, by hand ---
def plugged(world: World, habits: Habits, **dummy: object) -> Dummy:
    host = Dummy(hears_all=True, **dummy)  # type: ignore[arg-type]
    world.add(Adapter(host, habits))
    return host


@pytest.fixture
def w(world: WorldFactory) -> World:
    return world(referee=False)


@pytest.mark.parametrize(
    ("habits", "injected", "delivered"),
    [
        # the token is over at 10.366 ms
        (FTDI_LOW_LATENCY, [(10_300 * US, TOKEN)], [(11 * MS, TOKEN)]),
        # octets end every 22 us: four of them before 11 ms
        (FTDI_LOW_LATENCY, [(10_910 * US, STATUS)], [(11 * MS, STATUS[:4]), (12 * MS, STATUS[4:])]),
        (
            FTDI,
            [(2 * MS, TOKEN), (15 * MS, TOKEN), (17 * MS, TOKEN), (40 * MS, TOKEN)],
            [(16 * MS, TOKEN + TOKEN), (32 * MS, TOKEN), (48 * MS, TOKEN)],
        ),
        # 62 octets are over after 1.364 ms, 124 after 2.728, 186 after 4.092; then the timer starts afresh
        (
            FTDI,
            [(MS, bytes(200))],
            [(3 * MS, bytes(62)), (4 * MS, bytes(62)), (6 * MS, bytes(62)), (22 * MS, bytes(14))],
        ),
    ],
    ids=[
        "octets wait for the next frame",
        "a telegram across a frame comes in pieces",
        "the latency timer runs from packet to packet",
        "a full packet does not wait for the timer",
    ],
)
def test_octets_reach_the_host_in_packets_and_frames(
    w: World, habits: Habits, injected: list[tuple[int, bytes]], delivered: list[tuple[int, bytes]]
) -> None:
    host = plugged(w, habits)
    for at, octets in injected:
        w.call_at(at, partial(w.inject, octets))
    w.run_until(100 * MS)
    assert host.octets == delivered
    assert host.edges == []
    assert host.heard == []


def test_sending_begins_at_the_next_frame_and_the_host_believes_at_once(w: World) -> None:
    host = plugged(w, FTDI_LOW_LATENCY, plan=[(4_200 * US, STATUS), (4_400 * US, TOKEN)])
    w.run_until(20 * MS)
    sent = [(entry.start_ns, entry.octets) for entry in w.log]
    assert sent == [(5 * MS, STATUS), (5 * MS + 132 * US, TOKEN)]  # behind each other without a pause
    assert host.ends == [4_200 * US + 132 * US, 4_400 * US + 66 * US]


def test_echo(w: World) -> None:
    host = plugged(w, Habits(echo=True), plan=[(4_990 * US, STATUS)])
    w.call_at(5_140 * US, lambda: w.inject(TOKEN))
    w.run_until(20 * MS)
    assert host.octets == [(6 * MS, STATUS + TOKEN)]


def test_damaged_octets_and_collisions_reach_a_port_as_they_reach_others(w: World) -> None:
    host = plugged(w, FTDI_LOW_LATENCY)
    plain = Dummy(hears_all=True)
    w.add(plain)
    w.faults.damage(lambda tx: True, octet=1, flips=0x006)
    w.inject(STATUS)
    w.run_for(5 * MS)
    w.inject(STATUS)
    w.run_for(60 * US)
    w.inject(bytes(8))
    w.run_for(5 * MS)
    assert host.text == plain.text
    assert host.text[:6] == b"\x10\x04" + STATUS[2:]
    assert host.text[6:8] == STATUS[:2]


def test_a_sender_that_is_cut_off_gives_no_octet_twice(w: World) -> None:
    host = plugged(w, FTDI_LOW_LATENCY)
    sender = Dummy(address=9, plan=[(MS, STATUS)])
    w.add(sender)
    w.run_until(MS + 50 * US)
    w.remove(sender)
    w.run_for(5 * MS)
    assert host.text == STATUS[:2]


def test_the_cost_of_reception_is_counted(w: World) -> None:
    adapter = Adapter(Dummy(hears_all=True), FTDI)
    w.add(adapter)
    w.call_at(2 * MS, lambda: w.inject(TOKEN))
    w.run_until(100 * MS)
    assert adapter.cost.count == 1
    assert adapter.cost.max_ns == 16 * MS - (2 * MS + 22 * US)


def test_impossible_habits_are_refused() -> None:
    with pytest.raises(ConfigError, match="must be 1 or more"):
        Habits(packet=0)


def test_whole_telegrams_are_refused() -> None:
    adapter = Adapter(Dummy(hears_all=True))
    with pytest.raises(RuntimeError, match="octets only"):
        adapter.telegram(token(2, 2), 0)


# --- a master on them ---
def adapter_bus(
    world: World, baud: int, habits: Habits, patience: Patience = ADAPTER, *, slaves: int = 2, **changes: int
) -> SimBus:
    """A master on an adapter with ``habits`` and its slaves on the wire, in data exchange; the referee is on."""
    params = BusParams.preset(baud, address=2, hsa=10).replace(**changes)
    bus = SimBus(world, params, range(5, 5 + slaves), watchdog_ms=1000, patience=patience, habits=habits)
    bus.until_exchanging()
    return bus


def exchanges(bus: SimBus) -> int:
    return sum(handler.exchanges for handler in bus.master.handlers.values())


HABITS = {
    "frames": FTDI_LOW_LATENCY,
    "latency timer": FTDI,
    "small packets": Habits(packet=5),
    "echo": Habits(echo=True),
    "all of them": Habits(latency_ns=16 * MS, packet=20, echo=True),
}


@pytest.mark.parametrize("baud", [9_600, 45_450, 187_500, 500_000, 1_500_000, 12_000_000])
@pytest.mark.parametrize("habits", HABITS.values(), ids=HABITS.keys())
def test_bring_up_and_stable_exchange(world: WorldFactory, baud: int, habits: Habits) -> None:
    bus = adapter_bus(world(), baud, habits)
    for number in range(1, 6):
        begun = exchanges(bus)
        for address, image in bus.master.images.items():
            image.outputs = bytes([number, address] * 6)
        bus.world.run_for(600 * MS)
        assert exchanges(bus) - begun >= 4
        for address, image in bus.master.images.items():
            assert image.inputs == bytes([number, address] * 6)
    assert bus.exchanging
    assert not any(isinstance(event, AddressCollision) for event in bus.events)
    stations = bus.station.stats.stations.values()
    assert [(s.retries, s.timeouts, s.late, s.wrong) for s in stations] == [(0, 0, 0, 0)] * len(stations)
    assert bus.station.decoder_stats.bad == 0


@pytest.mark.parametrize(
    ("latency_ms", "slaves", "round_ms"),
    [
        # One frame until the request is on the wire, the next one brings the answer (0.946 ms later): 2 ms. The token
        # goes out one frame before the first request.
        (1, 1, 2 + 1),
        (1, 3, 3 * 2 + 1),
        # the answer waits for the timer, which the packet before has started; the token fits in between
        (16, 1, 16),
        (16, 3, 3 * 16),
    ],
)
def test_the_duration_of_an_exchange_on_an_adapter(
    world: WorldFactory, latency_ms: int, slaves: int, round_ms: int
) -> None:
    """500 kbit/s, twelve octets each way: 1.02 ms on the wire."""
    bus = adapter_bus(world(), 500_000, Habits(latency_ns=latency_ms * MS), slaves=slaves, gap=0)
    begun = exchanges(bus)
    bus.world.run_for(960 * MS)
    rounds = (exchanges(bus) - begun) / slaves
    # Global_Control (two frames) every 200 ms
    assert 960 / round_ms - 10 <= rounds <= 960 / round_ms + 1


def test_without_knowing_how_late_it_sends_the_idle_times_would_be_cut(world: WorldFactory) -> None:
    """What ``Patience.sending_ns`` is for: token and next request would go out in the same frame."""
    adapter_bus(world(expect=[Rule.IDLE]), 500_000, FTDI_LOW_LATENCY, replace(ADAPTER, sending_ns=0))


def test_the_users_own_slack_leaves_the_port_as_it_is(world: WorldFactory) -> None:
    patience = slack(40 * MS, ADAPTER)
    assert patience == Patience(
        known_ns=40 * MS, unknown_ns=40 * MS, unknown_divisor=100, stall_ns=40 * MS, sending_ns=ADAPTER.sending_ns
    )
    adapter_bus(world(), 500_000, FTDI, patience)


def test_slaves_that_need_a_longer_silence_get_it_on_an_adapter_too(world: WorldFactory) -> None:
    bus = adapter_bus(world(), 500_000, FTDI_LOW_LATENCY, extra_idle=900)  # the referee judges by it
    bus.world.run_for(S)
    assert bus.exchanging


@pytest.mark.parametrize("habits", HABITS.values(), ids=HABITS.keys())
def test_noise_on_an_adapter(world: WorldFactory, habits: Habits) -> None:
    bus = adapter_bus(world(seed=5), 500_000, habits)
    bus.world.faults.noise(1e-4)
    for number in range(40):
        for address, image in bus.master.images.items():
            image.outputs = bytes([number, address] * 6)
        bus.world.run_for(100 * MS)
        for address, image in bus.master.images.items():
            assert image.inputs[0] <= number
            assert image.inputs in (bytes(12), bytes([image.inputs[0], address] * 6))
    bus.world.faults.clear()
    bus.until_exchanging(15 * S)


def test_two_masters_on_adapters_share_a_ring_where_t_sl_allows_it(world: WorldFactory) -> None:
    """T_SL is what the others wait for a sign of life: with 16 ms at most, 500 kbit/s, it must be some 18 ms."""
    w = world()
    stations = []
    for address in (2, 5):
        params = BusParams.preset(500_000, address=address, hsa=6, t_sl=10_000)
        stations.append(ActiveStation(params, [], patience=ADAPTER))
        adapter = Adapter(stations[-1], FTDI)
        w.add(adapter)
        w.command(adapter, GoOnline())
    assert w.run(60 * S, lambda: all(s.las == {2, 5} and s.in_ring for s in stations))
    w.run_for(5 * S)
    assert all(station.stats.tokens_lost == station.stats.withdrawn == 0 for station in stations)
    assert all(station.las == {2, 5} for station in stations)
