"""The short ways of the simulated medium against the long ones: the same wire log, events and violations.

Long ways: each step of a station is a step of the world of its own; single steps take every
event through the heap; without expected answers the master judges each telegram anew.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from adapter_model import Habits
from bus_kit import SimBus, mirror
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support import MS, Dummy, present

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.fdl.active import exchange
from dpstack.fdl.codec import NO_FRAME
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.phy.patience import ADAPTER, EXACT
from dpstack.sim.referee import RefereeError
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry, WireFields

P500 = BusParams.preset(500_000, address=2, hsa=6)
SLAVES = (5, 6)
#: FDL status request 2 -> 5, its first octets, SC
INJECTED = (bytes.fromhex("10 05 02 49 50 16"), bytes.fromhex("10 05 02"), b"\xe5")

#: what happens, station, duration in us; then so many us pass
Step = tuple[str, int, int, int]
STEPS = st.lists(
    st.tuples(
        st.sampled_from(("deaf", "mute", "plug", "move", "twin", "inject", "outputs", "mode", "pass", "heard", "call")),
        st.integers(0, 2),
        st.integers(1, 30_000),
        st.integers(1, 6_000),
    ),
    max_size=8,
)
Run = Callable[[World, int], None]


def run(world: World, until: int) -> None:
    world.run_until(until)


def single_steps(world: World, until: int) -> None:
    while world.next_at() <= until:
        world.step()
    world.run_until(until)


class Stops:
    """Runs that are stopped again and again, and go on; each ends where it was left on the short way if it can."""

    def __init__(self) -> None:
        self.ends: list[int] = []
        self.left = 0

    def __call__(self, world: World, until: int) -> None:
        while world.run(until, [True, *[False] * (1 + self.left % 4 * 2)].pop):
            self.left += world._left is not None
            if world._left is not None and until - world.now < 2 * MS and self.left % 3:
                break
        self.ends.append(world.now)

    def single_steps(self, world: World, _until: int) -> None:
        """The same runs in single steps."""
        single_steps(world, self.ends.pop(0))


class Story:
    """A master with two slaves, to which ``steps`` happen; ``careful``: each transmission goes the long way."""

    def __init__(self, run: Run, *, careful: bool = False, habits: Habits | None = None) -> None:
        self.world = world = World(seed=1)
        self.log: list[WireEntry] = []
        self.then: list[Callable[[], None]] = []  # what who listens does with the next telegrams
        world.log.listener = self.listen
        if careful:
            world._run_on = lambda node, _=None: world.run_station(node, node.station.wake_at())  # type: ignore
        self.run = run
        patience = EXACT if habits is None else ADAPTER
        self.bus = SimBus(world, P500, SLAVES, watchdog_ms=1000, patience=patience, habits=habits)
        self.behind_adapter = habits is not None
        self.unplugged: set[int] = set()
        self.has_twin = False
        run(world, 150 * MS if habits is None else 500 * MS)
        assert self.bus.exchanging

    def listen(self, entry: WireEntry) -> None:
        self.log.append(entry)
        if self.then:
            self.then.pop()()

    def tell(self, steps: list[Step]) -> list[object]:
        world = self.world
        for name, number, lasts_us, passes_us in steps:
            if self.behind_adapter and (number == len(SLAVES) or name == "mode"):
                continue  # the master is not on the medium itself
            self.change(name, number, lasts_us * 1_000)
            self.run(world, world.now + passes_us * 1_000)
        self.run(world, world.now + 20 * MS)
        return [self.log, self.bus.events, present(world.referee).violations, world.now]

    def change(self, name: str, number: int, lasts: int) -> None:
        world, bus = self.world, self.bus
        address = SLAVES[number % len(SLAVES)]
        slave = bus.slaves[address]
        is_there = address not in self.unplugged
        match name:
            case "deaf" | "mute" if number == len(SLAVES) or is_there:
                world.silence(bus.station if number == len(SLAVES) else slave, lasts, deaf=name == "deaf")
            case "plug" if is_there:
                world.remove(slave)
                self.unplugged.add(address)
            case "plug":
                world.add(slave)
                self.unplugged.remove(address)
            case "move" if is_there:
                slave.set_address(9 if slave.address == address else address)
                world.poke(slave)
            case "twin" if not self.has_twin:
                self.has_twin = True
                world.add(mirror(address, P500, t_sdr=12))
            case "inject":
                world.inject(INJECTED[number], baud=P500.baud)
            case "heard" if number == len(SLAVES):
                self.then += [lambda: world.silence(slave, lasts), *[lambda: None] * (lasts % 5)]
            case "heard":
                self.then += [lambda: world.inject(INJECTED[number], baud=P500.baud), *[lambda: None] * (lasts % 5)]
            case "call":
                self.then += [lambda: world.call_at(world.now + lasts // 100, lambda: self.change("inject", number, 1))]
            case "outputs":
                for image in bus.master.images.values():
                    image.outputs = bytes([lasts & 0xFF]) * image.output_len
            case "mode":
                bus.send(SetMode((Mode.OPERATE, Mode.CLEAR, Mode.STOP)[number]))


@given(steps=STEPS)
@example(steps=[("deaf", 0, 20_000, 100), ("mute", 0, 1, 20_000)])
@example(
    steps=[(name, number, lasts, 5_000) for name in ("heard", "call") for number in (0, 1) for lasts in (1, 17, 53)]
)
@settings(max_examples=15, deadline=None)
def test_short_and_long_ways_give_the_same_log(steps: list[Step]) -> None:
    short = Story(run).tell(steps)
    assert Story(run, careful=True).tell(steps) == short
    assert Story(single_steps).tell(steps) == short


@given(steps=STEPS)
@example(steps=[("inject", 0, 1, 2_000), ("mute", 2, 300, 3_000), ("mode", 1, 1, 1)])
@example(steps=[("plug", n % 2, 1, 1_100 + n) for n in range(12)])
@settings(max_examples=8, deadline=None)
def test_a_run_that_is_stopped_on_the_short_way_goes_on_there(steps: list[Step]) -> None:
    stops = Stops()
    assert Story(stops).tell(steps) == Story(stops.single_steps).tell(steps)
    assert stops.left > 10


@pytest.mark.parametrize("habits", [None, Habits()], ids=["medium", "adapter"])
@given(steps=STEPS)
@settings(max_examples=10, deadline=None)
def test_an_expected_answer_is_judged_as_any_other(habits: Habits | None, steps: list[Step]) -> None:
    short = Story(run, habits=habits).tell(steps)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exchange, "plain_frame_of", lambda _: NO_FRAME)  # no answer is expected
        assert Story(run, habits=habits).tell(steps) == short


def test_a_deaf_station_stays_deaf_after_it_has_sent() -> None:
    world = World(referee=False)
    station = Dummy(5, plan=[(2 * MS, INJECTED[0])])
    world.add(station)
    world.silence(station, 10 * MS, deaf=True)
    world.silence(station, MS)  # it may send again, and still receives nothing
    world.call_at(5 * MS, lambda: world.inject(INJECTED[0]))
    world.call_at(11 * MS, lambda: world.inject(INJECTED[0]))
    world.run_until(20 * MS)
    assert [entry.note for entry in world.log] == ["", "", ""]
    assert len(station.heard) == 1


class _Plain(Dummy):
    """A script that sends on the short way."""

    on_move: Callable[[], None] | None = None
    unread: Sequence[Sequence[Event]] = ()

    def sent(self, at: int) -> int:
        super().sent(at)
        return self.wake_at()

    def hear(self, telegram: Telegram, start: int, end: int) -> int:
        self.telegram(telegram, end)
        return self.wake_at()


def test_what_is_kept_is_what_is_heard_with_a_violation_among_those_that_are_judged_together() -> None:
    logs, violations, reports = [], [], []
    taken: list[WireFields] = []
    for listens in ("kept", "heard", "handed out"):
        bus = SimBus(World(seed=1, keep=5_000), P500, SLAVES)
        world, log = bus.world, bus.world.log
        heard: list[WireEntry] = []
        if listens == "heard":
            log.listener = heard.append
        elif listens == "handed out":
            log.hand_to(taken.extend)
        world.run_until(150 * MS)
        log.settle()
        world.run_until(160 * MS)
        world.remove(bus.station)
        # station 2 has the token, and the SC answers nothing
        plan = [(200 * MS, INJECTED[0]), (201 * MS, INJECTED[0]), (202 * MS, INJECTED[2]), (203 * MS, INJECTED[0])]
        world.add(_Plain(9, plan=plan))
        world.run_until(204 * MS)
        assert len(log.waiting) == (0 if listens == "heard" else 7)
        assert [entry.note for entry in list(log)[-7:]] == ["TWO TOKENS", "", "", "", "ANSWER NOBODY ASKED FOR", "", ""]
        logs.append(heard or [*map(WireEntry._make, taken)] or list(log))
        assert logs[-1] == list(log)
        violations.append(present(world.referee).violations)
        with pytest.raises(RefereeError) as report:
            present(world.referee).check()
        reports.append(str(report.value))
    assert logs[0] == logs[1] == logs[2]
    assert violations[0] == violations[1] == violations[2]
    assert reports[0] == reports[1] == reports[2]
