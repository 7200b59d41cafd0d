"""USB adapters in virtual time: each habit by hand, and a master that works on all of them."""

from __future__ import annotations

from functools import partial

import pytest
from adapter_model import FTDI, FTDI_LOW_LATENCY, Adapter, Habits
from bus_kit import SimBus
from msgspec import structs
from msgspec.structs import replace
from support import MS, US, Dummy, S, WorldFactory, present

from dpstack.api.bus.ring_entry import OtherMasterNotices, join_limit_s, pass_ns
from dpstack.dp.master.commands import Mode
from dpstack.drivers.snapshots import BusSnapshot
from dpstack.errors import ConfigError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.events import AddressCollision, MasterSeen
from dpstack.fdl.telegram import token
from dpstack.params import BusParams
from dpstack.phy.neighbours import Neighbours, t_sl_of_answers
from dpstack.phy.patience import ADAPTER, EXACT, HOST, Patience, measured, slack
from dpstack.sim.referee import Rule
from dpstack.sim.world import World
from dpstack.trace import Severity

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
    share = 600 * MS if baud < 100_000 else 200 * MS  # enough for four exchanges of both slaves
    for number in range(1, 6):
        begun = exchanges(bus)
        for address, image in bus.master.images.items():
            image.outputs = bytes([number, address] * 6)
        bus.world.run_for(share)
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
    for number in range(20):
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


# --- Rings with USB adapters in virtual time: the T_SL that the neighbours need, by hand, and what happens without it


# --- the sums ---
@pytest.mark.parametrize(
    ("baud", "patience", "lowest", "t_sl"),
    [
        # 20 ms are 10 000 bit times at 500 kbit/s; max T_SDR 100 + 15
        (500_000, ADAPTER, 2, 10_115),
        # 3750 at 187.5 kbit/s; max T_SDR 60 + 15
        (187_500, ADAPTER, 2, 3_825),
        (187_500, ADAPTER, 0, 3_825),
        # measured 1 ms: 2 ms at least, 1000 + 115; but 20 + 2 ms of slack are 11 000, and T_TO of master 0 is 6 T_SL
        (500_000, measured(MS), 2, 1_223),
        (500_000, measured(MS), 0, 2_201),
        # the user's 100 ms: 50 000 + 115, which no T_SL of 14 bits is
        (500_000, slack(100 * MS, ADAPTER), 2, 50_115),
        # programs at the other ends have a slack of their own
        (500_000, HOST, 2, 0),
        (500_000, EXACT, 2, 0),
    ],
)
def test_the_t_sl_that_neighbours_need(baud: int, patience: Patience, lowest: int, t_sl: int) -> None:
    assert Neighbours(BusParams.preset(baud, address=5), patience, lowest).t_sl == t_sl


def test_the_advice_has_the_figures_and_what_to_do() -> None:
    params = BusParams.preset(187_500, address=5)
    advice = Neighbours(params, ADAPTER, 1).advice()
    assert advice.startswith("other masters need t_sl = 3825 (20.4 ms at 187.5 kbit/s) or more, this one has 100: ")
    assert "comes up to 20 ms late (assumed until it is measured), where they wait 0.533 ms" in advice
    # T_SL + 60 + 20 ms; T_TO = (6 + 2) T_SL
    assert "while it waits 80.5 ms for a silent station master 1 claims the token after 4.27 ms" in advice
    assert advice.endswith("set t_sl on all of them")
    assert Neighbours(params.replace(t_sl=3_824), ADAPTER, 1).advice()
    assert Neighbours(params.replace(t_sl=3_825), ADAPTER, 1).advice() == ""
    assert Neighbours(params, HOST, 1).advice() == ""


def test_where_no_t_sl_is_enough_the_advice_names_a_rate() -> None:
    advice = Neighbours(BusParams.preset(1_500_000), ADAPTER).advice()
    assert advice.startswith("no other master can share the bus at 1.5 Mbit/s: ")
    assert advice.endswith("take an adapter that is faster, or 500 kbit/s at most")
    assert "or 6 Mbit/s at most" in Neighbours(BusParams.preset(12_000_000), measured(MS), 2).advice()
    hopeless = Neighbours(BusParams.preset(500_000), slack(5 * S, ADAPTER)).advice()
    assert hopeless.endswith("take an adapter that is faster")


def test_a_simulated_slave_needs_t_sl_for_its_answers_only() -> None:
    params = BusParams.preset(500_000)
    assert t_sl_of_answers(params, ADAPTER) == 10_115
    assert t_sl_of_answers(params, measured(MS)) == 1_115
    assert t_sl_of_answers(params, HOST) == 0


def test_joining_takes_as_long_as_computed() -> None:
    """G x T_TR of 267 ms; 127 polls of 2.592 ms on a pty are 10.97 % of 3 s, so 10 %; of 20.592 ms on an adapter."""
    params = BusParams.preset(187_500, address=5)
    assert pass_ns(params, HOST) / MS == pytest.approx(266.7 + 127 * 25.92, abs=1)
    assert pass_ns(params, ADAPTER) / MS == pytest.approx(266.7 + 127 * 205.92, abs=1)
    assert pass_ns(params.replace(hsa=31), HOST) / MS == pytest.approx(266.7 + 3_000, rel=0.05)
    assert join_limit_s(params, HOST) == join_limit_s(params, EXACT) == 30
    assert join_limit_s(params, ADAPTER) == 53
    slow = BusParams.preset(9_600, address=5)
    assert join_limit_s(slow, ADAPTER) == pytest.approx(2 * (5.208 + 127 * 0.31563), abs=1)


def test_a_newcomer_reports_once_how_long_it_waits_and_what_the_others_need() -> None:
    params = BusParams.preset(187_500, address=5)
    bus = BusSnapshot(Mode.CLEAR, ADAPTER)
    beside = OtherMasterNotices(params, lambda: bus)
    assert list(beside.notices(MasterSeen(t_ns=5, address=2, present=False))) == []
    waiting, advice = beside.notices(MasterSeen(t_ns=7, address=2, present=True))
    assert (waiting.severity, advice.severity) == (Severity.INFO, Severity.WARNING)
    assert waiting.t_ns == 7
    assert waiting.message.startswith("waiting for master 2 to let station 5 into the ring: up to 26.4 s if it is set")
    assert advice.message.startswith("other masters need t_sl = 3825 ")
    assert list(beside.notices(MasterSeen(t_ns=9, address=2, present=True))) == []
    bus = structs.replace(bus, patience=measured(2 * MS))
    (advice,) = beside.notices(MasterSeen(t_ns=11, address=2, present=True))
    assert "comes up to 2 ms late (measured" in advice.message


# --- rings ---
class Ring:
    """Masters 2 and 5 with two slaves each; ``habits`` of each adapter, None: a master straight on the wire."""

    def __init__(
        self, world: World, habits: tuple[Habits | None, Habits | None], t_sl: int, patience: Patience
    ) -> None:
        self.world = world
        self.buses = [
            SimBus(
                world,
                BusParams.preset(500_000, address=address, hsa=30, t_sl=t_sl),
                (10 * address, 10 * address + 1),
                watchdog_ms=1000,
                patience=patience if plug else EXACT,
                habits=plug,
            )
            for address, plug in zip((2, 5), habits, strict=True)
        ]
        self.stations = [bus.station for bus in self.buses]

    @property
    def whole(self) -> bool:
        """Both in the ring, all slaves in data exchange."""
        return all(bus.exchanging for bus in self.buses) and all(
            station.in_ring and station.las == {2, 5} for station in self.stations
        )

    @property
    def broken(self) -> int:
        """Tokens lost and taken back."""
        return sum(s.stats.tokens_lost + s.stats.withdrawn + s.stats.token_retries for s in self.stations)


CASES = {
    "latency timers": (FTDI, FTDI, ADAPTER),
    "low latency, not measured": (FTDI_LOW_LATENCY, FTDI_LOW_LATENCY, ADAPTER),
    "low latency, measured": (FTDI_LOW_LATENCY, FTDI_LOW_LATENCY, measured(3 * MS)),
    "beside hardware": (None, FTDI, ADAPTER),
    "beside hardware, low latency": (None, FTDI_LOW_LATENCY, measured(3 * MS)),
}


@pytest.mark.parametrize(("one", "other", "patience"), CASES.values(), ids=CASES.keys())
def test_the_ring_is_stable_with_the_advised_t_sl(
    world: WorldFactory, one: Habits | None, other: Habits, patience: Patience
) -> None:
    t_sl = Neighbours(BusParams.preset(500_000, address=5), patience, 2).t_sl
    ring = Ring(world(), (one, other), t_sl, patience)
    assert ring.world.run(10 * S, lambda: ring.whole)
    begun = ring.broken
    ring.world.run_for(S)
    assert ring.whole
    assert ring.broken == begun
    # a slave that dies is waited for with all slack: nobody claims the token meanwhile
    ring.world.remove(ring.buses[1].slaves[50])
    ring.world.run_for(S)
    assert ring.broken == begun
    assert all(station.las == {2, 5} for station in ring.stations)


@pytest.mark.parametrize("name", ["beside hardware", "beside hardware, low latency"])
def test_without_it_hardware_lets_nobody_in(name: str) -> None:
    """The newcomer's answer to the GAP poll is late or not sent at all: it is never seen. The advice says why."""
    one, other, patience = CASES[name]
    ring = Ring(World(seed=1), (one, other), 200, patience)
    ring.world.run_for(S)
    assert ring.stations[0].las == {2}
    assert not ring.stations[1].in_ring
    assert "other masters need t_sl" in Neighbours(ring.stations[1].params, patience, 2).advice()


def test_without_it_two_adapters_talk_into_each_other() -> None:
    """Both have slack, so there may be a ring; what one says late, the other hears while it talks itself."""
    world = World(seed=1)
    ring = Ring(world, (FTDI, FTDI), 200, ADAPTER)
    world.run_for(2 * S)
    assert {Rule.LATE, Rule.COLLISION} <= {violation.rule for violation in present(world.referee).violations}
    assert Neighbours(ring.stations[0].params, ADAPTER, 2).advice()


def test_of_the_users_own_slack_only_the_port_is_judged() -> None:
    assert Neighbours(BusParams.preset(500_000), replace(HOST, known_ns=500 * MS), 0).advice() == ""
