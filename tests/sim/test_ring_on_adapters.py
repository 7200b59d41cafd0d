"""Rings with USB adapters in virtual time: the T_SL that the neighbours need, by hand, and what happens without it."""

from __future__ import annotations

import pytest
from bus_kit import SimBus
from msgspec import structs
from msgspec.structs import replace
from support import MS, S, WorldFactory, present

from dpstack.api.bus.ring_entry import OtherMasterNotices, join_limit_s, pass_ns
from dpstack.dp.master.commands import Mode
from dpstack.drivers.snapshots import BusSnapshot
from dpstack.fdl.events import MasterSeen
from dpstack.params import BusParams
from dpstack.phy.neighbours import Neighbours, t_sl_of_answers
from dpstack.phy.patience import ADAPTER, EXACT, HOST, Patience, measured, slack
from dpstack.sim.adapter import FTDI, FTDI_LOW_LATENCY, Habits
from dpstack.sim.referee import Rule
from dpstack.sim.world import World
from dpstack.trace import Severity


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
    assert waiting.message.startswith(
        "waiting for master 2 to let station 5 into the ring: up to 26.4 s where it is set"
    )
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
    ring.world.run_for(3 * S)
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
