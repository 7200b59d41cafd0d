"""Acyclic traffic without end beside other masters, to silent slaves, and on a port that delivers late.

What it costs the rotation stays within the plan's longest one, and nobody starves. All in exact bus time; slaves answer
a Write of 240 octets at once, which is the longest service there is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from property_kit import examples
from support import MS, S, WorldFactory

from bench.acyclic_plant import Answers, AnswersAtOnce, RecordDevice
from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.plan.cycle_check import CycleVerdict, least_ns
from dpstack.dp.plan.rotation_time import Case, Figures, OtherMasters, rotation
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.interface import LinkUser, Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import SAP_MS1, SAP_RD_INP, Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, HOST, Patience
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import Event

BAUD: Final = 500_000
PPO1: Final = bytes.fromhex("F3 F1")
#: services that wait for each slave
WAITING: Final = 2


class Mute(SlaveApp):
    """Exchanges data, and never answers at SAPs 51 and 56."""

    def serve(self, request: Telegram, now: int) -> Reply | None:
        return None if request.dsap in (SAP_MS1, SAP_RD_INP) else super().serve(request, now)


def setups(first: int, count: int, response_ns: int = S) -> list[SlaveParams]:
    dpv1 = Dpv1(c1_response_timeout_ns=response_ns)
    return [
        SlaveParams(
            address=address, name=f"s{address}", ident=0x1234, config=PPO1, user_prm=bytes(3), dpv1=dpv1, max_diag_len=6
        )
        for address in range(first, first + count)
    ]


@dataclass
class Loaded:
    """A master, its slaves, and how often each had an end of a Write of 240 octets."""

    world: World
    params: BusParams
    slaves: Sequence[SlaveParams]
    app: type[SlaveApp] = AnswersAtOnce
    cycle_ns: int = 0
    patience: Patience = EXACT
    t_sdr: int = 11
    orders: int = 0
    done: list[RecordDone] = field(default_factory=list)
    others: list[ServiceDone] = field(default_factory=list)
    waiting: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for setup in self.slaves:
            app = self.app(RecordDevice(Answers.AT_ONCE), address=setup.address)
            self.world.add(PassiveStation(setup.address, app, self.params, t_sdr=self.t_sdr))
        self.master = Master(self.params, self.slaves, MasterSettings(cycle_ns=self.cycle_ns, watchdog_ms=60_000))
        users: list[LinkUser] = [self.master, acyclic_services(self.params.address, self.master)]
        self.station = ActiveStation(
            self.params, users, patience=self.patience, window=self.master.window, now=self.world.now
        )
        self.world.add(self.station, on_events=self._on_events)
        self.world.command(self.station, GoOnline())
        self.world.command(self.station, SetMode(Mode.OPERATE))

    def _on_events(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, RecordDone):
                self.done.append(event)
                self.waiting.pop(event.token, None)
            elif isinstance(event, ServiceDone):
                self.others.append(event)

    @property
    def exchanging(self) -> bool:
        return all(h.state is SlaveState.DATA_EXCHANGE for h in self.master.handlers.values())

    def keep_busy(self) -> None:
        for setup in self.slaves:
            for _ in range(WAITING - sum(address == setup.address for address in self.waiting.values())):
                self.orders += 1
                self.waiting[self.orders] = setup.address
                write = RecordOrder(
                    self.orders, Function.WRITE, 1, 240, data=bytes(240), address=setup.address, timeout_ns=60 * S
                )
                self.world.command(self.station, write)

    def longest_wait(self, since: int, until: int) -> int:
        """Between two ends at one slave, in ns."""
        longest = 0
        for setup in self.slaves:
            at = [since, *(e.t_ns for e in self.done if e.address == setup.address), until]
            longest = max(longest, *(b - a for a, b in pairwise(at)))
        return longest


def ring(world: World, counts: Sequence[int], t_tr: int | None, t_sdr: int) -> tuple[list[Loaded], list[Figures]]:
    """Masters with so many slaves each after ``S`` of traffic, and what each one's plan says. None: T_TR as needed."""
    params = BusParams.preset(BAUD, gap=10, hsa=2 + len(counts))
    plants = [setups(20 + 10 * n, count) for n, count in enumerate(counts)]
    planned = [
        Figures(params, slaves, others=OtherMasters(rounds=_others(params, plants, n, Case.LONGEST)))
        for n, slaves in enumerate(plants)
    ]
    if t_tr is None:
        t_tr = Figures(params, plants[0], OtherMasters(rounds=_others(params, plants, 0, Case.NORMAL))).t_tr_needed
    params = params.replace(t_tr=t_tr)
    masters = [Loaded(world, params.replace(address=2 + n), slaves, t_sdr=t_sdr) for n, slaves in enumerate(plants)]
    while not all(master.exchanging for master in masters):
        assert world.now < 20 * S
        world.run_for(50 * MS)
    for each in masters:
        each.master.rotation = Histogram()
    end = world.now + S
    while world.now < end:
        for each in masters:
            each.keep_busy()
        world.run_for(MS)
    return masters, planned


def _others(params: BusParams, plants: Sequence[list[SlaveParams]], own: int, case: Case) -> tuple[int, ...]:
    rounds = [rotation(params, slaves, case).bits for slaves in plants]
    return (*rounds[:own], *rounds[own + 1 :])


def hold(world: World, counts: Sequence[int], t_tr: int | None, t_sdr: int) -> None:
    """Within the longest rotation of the plan, and every slave's service has its turn: one request for each hold.

    With the T_TR that the plan needs there is room for a service in every hold, so no round goes over two holds, and
    nothing is repeated here: all normal rounds and their services. With less the other masters may come in between once
    more.
    """
    began = world.now
    masters, planned = ring(world, counts, t_tr, t_sdr)
    normal = [rotation(each.params, each.slaves, Case.NORMAL) for each in masters]
    loaded = [(r.bits + p.acyclic_bits, r.hold + p.acyclic_bits) for r, p in zip(normal, planned, strict=True)]
    everybody, longest_hold = sum(bits for bits, _ in loaded), max(hold for _, hold in loaded)
    if t_tr is None:
        assert masters[0].params.t_tr == everybody + longest_hold
    for each, plan in zip(masters, planned, strict=True):
        longest = plan.ns(Case.LONGEST)
        if each.params.t_tr >= everybody + longest_hold:
            bound = each.params.ns(everybody)
        else:
            bound = longest + each.params.ns(plan.rotations[Case.LONGEST].others)
        assert 0 < each.master.rotation.max_ns <= bound
        assert all(done.outcome.failure is None for done in each.done)
        # all slaves in turn, a service in one of two rounds at the least: where T_TR is too small, what small masters
        # spend beside their few slaves is taken from the hold of a large one
        assert each.longest_wait(max(began, world.now - S), world.now) <= 2 * (len(each.slaves) + 1) * longest
        assert each.exchanging


@pytest.mark.parametrize("t_tr", [None, 100_000], ids=["T_TR as needed", "the preset T_TR"])
@pytest.mark.parametrize("counts", [[6, 6], [6, 2, 1]])
def test_beside_other_masters_with_traffic_of_their_own(
    counts: list[int], t_tr: int | None, world: WorldFactory
) -> None:
    hold(world(), counts, t_tr, 11)


COUNTS: Final = [1, 8, 1, 1]


def normal_rounds() -> int:
    """All normal rounds of COUNTS and once more the longest, without room for services."""
    params = BusParams.preset(BAUD, gap=10, hsa=2 + len(COUNTS))
    rounds = [rotation(params, setups(20, count), Case.NORMAL) for count in COUNTS]
    return sum(each.bits for each in rounds) + max(each.hold for each in rounds)


def test_a_round_over_two_holds_is_longer_than_the_longest_in_one(world: WorldFactory) -> None:
    """A large master between small ones, T_TR without room for their services: they come in between once more."""
    masters, planned = ring(world(), COUNTS, normal_rounds(), 100)
    large, plan = masters[1], planned[1]
    others = large.params.ns(plan.rotations[Case.LONGEST].others)
    assert plan.ns(Case.LONGEST) < large.master.rotation.max_ns <= plan.ns(Case.LONGEST) + others


@pytest.mark.soak
@examples(4)
@example(COUNTS, None, 100)
@example(COUNTS, normal_rounds(), 100)
@given(
    st.lists(st.integers(1, 8), min_size=2, max_size=4), st.sampled_from((None, 50_000, 100_000)), st.integers(11, 100)
)
def test_any_ring(counts: list[int], t_tr: int | None, t_sdr: int) -> None:
    factory = WorldFactory()
    hold(factory(), counts, t_tr, t_sdr)
    factory.check()


# --- silence ---


def silent(world: World, *, cycle_ns: int = 0, patience: Patience = EXACT, response_ns: int = S) -> Loaded:
    """Three slaves in data exchange that never answer services."""
    params = BusParams.preset(BAUD, address=2, gap=0)
    plant = Loaded(world, params, setups(20, 3, response_ns), Mute, cycle_ns, patience)
    while not plant.exchanging:
        assert world.now < 10 * S
        world.run_for(50 * MS)
    world.run_for(5 * max(cycle_ns, 10 * MS))
    plant.master.rotation = Histogram()
    return plant


def planned(plant: Loaded) -> Figures:
    return Figures(plant.params, plant.slaves, host_slack_ns=plant.patience.known_ns)


def order(token: int, address: int, *, write: bool) -> RecordOrder:
    return (
        RecordOrder(token, Function.WRITE, 1, 240, data=bytes(240), address=address)
        if write
        else RecordOrder(token, Function.READ, 1, 240, address=address)
    )


@pytest.mark.parametrize("write", [False, True])
def test_silence_is_in_the_longest_rotation(w: World, write: bool) -> None:
    """T_SL with every retry, to the bit: what is longer than without is that, and Global_Control now and then."""
    plant = silent(w)
    w.run_for(S)
    quiet = plant.master.rotation.min_ns
    for token, setup in enumerate(plant.slaves):
        w.command(plant.station, order(token, setup.address, write=write))
    w.run_for(S)
    assert [done.outcome.failure for done in plant.done] == [ServiceFailure.SILENT] * 3
    params = plant.params
    took = params.ns(2 * ((255 if write else 15) * 11 + 200))
    more = plant.master.rotation.max_ns - quiet
    assert took - params.ns(3) <= more <= took + params.ns(13 * 11 + params.t_id2 + 3)
    assert plant.master.rotation.max_ns <= planned(plant).ns(Case.LONGEST)
    assert plant.exchanging


@pytest.mark.parametrize(("write", "verdict"), [(False, CycleVerdict.UNDISTURBED), (True, CycleVerdict.ALWAYS)])
def test_silence_misses_no_cycle_where_every_attempt_fits(
    write: bool, verdict: CycleVerdict, world: WorldFactory
) -> None:
    """Each service first fetches what the one before may have left, by polls that nobody answers. Many of them would
    fit between two cycles; after more than one the link layer would probe FCV with the next Data_Exchange.
    """
    cycle_ns = least_ns(Figures(BusParams.preset(BAUD, address=2, gap=0), setups(20, 3)))[verdict]
    w = world()
    plant = silent(w, cycle_ns=cycle_ns, response_ns=30 * MS)
    book = plant.master.cycles
    begun, exchanges = book.begun, {a: h.exchanges for a, h in plant.master.handlers.items()}
    for n in range(9):
        for setup in plant.slaves:
            w.command(plant.station, order(10 * setup.address + n, setup.address, write=write))
    w.run_for(S)
    assert len(plant.done) >= 3
    assert {done.outcome.failure for done in plant.done} <= {ServiceFailure.SILENT, ServiceFailure.LATE}
    assert (book.missed, book.late.max_ns) == (0, 0)
    cycles = book.begun - begun
    assert cycles >= S // cycle_ns
    assert all(abs(h.exchanges - exchanges[a] - cycles) <= 1 for a, h in plant.master.handlers.items())


@pytest.mark.parametrize("class2", [True, False], ids=["class 2", "MS1"])
def test_on_a_port_that_delivers_late_silence_costs_what_a_dying_slave_costs(w: World, class2: bool) -> None:
    """MS1 waits with the patience of a station that is there (50 ms on a pty), once for each retry; so does the last
    attempt of a class 2 service, those before it wait 2 ms.
    """
    plant = silent(w, patience=HOST)
    w.run_for(S)
    quiet = plant.master.rotation.min_ns
    w.command(plant.station, ReadService(1, 20, Service.INPUTS) if class2 else order(1, 20, write=False))
    w.run_for(2 * S)
    done = plant.others if class2 else plant.done
    # it answers Slave_Diag: it is there, and leaves the service out
    failure = ServiceFailure.REFUSED if class2 else ServiceFailure.SILENT
    assert [each.outcome.failure for each in done] == [failure]
    params, octets = plant.params, 11 if class2 else 15
    took = 2 * (params.ns(octets * 11 + 200) + HOST.known_ns)
    more = plant.master.rotation.max_ns - quiet
    # a port shows octets at their end: one character more for each attempt
    assert took - params.ns(3) <= more <= took + params.ns(13 * 11 + params.t_id2 + 2 * 11 + 3)
    plan = planned(plant)
    assert plant.master.rotation.max_ns <= plan.ns(Case.LONGEST) + plan.dying_ns
    assert plant.exchanging


def test_an_unknown_slave_is_waited_for_on_a_late_port_between_two_cycles_only(w: World) -> None:
    """A class 2 service to an absent address: its last attempt has 50 ms, and never more than there is room."""
    plant = silent(w, cycle_ns=10 * MS, patience=HOST)
    book = plant.master.cycles
    missed = book.missed
    w.command(plant.station, ReadService(1, 99, Service.DIAGNOSIS))
    w.run_for(2 * S)
    assert [each.outcome.failure for each in plant.others] == [ServiceFailure.SILENT]
    assert book.missed == missed
    assert plant.exchanging


def test_in_stop_a_silent_slave_is_asked_as_often_as_otherwise(w: World) -> None:
    """There is no Data_Exchange to wait for: four attempts, a look whether it is there, and an end that says so."""
    plant = silent(w)
    w.command(plant.station, SetMode(Mode.STOP))
    w.run_for(S // 2)
    w.command(plant.station, ReadService(1, 20, Service.INPUTS))
    w.run_for(S)
    (done,) = plant.others
    assert done.outcome.failure is ServiceFailure.REFUSED
    assert "is there (it answers Slave_Diag)" in done.text
