"""The tap: a bounded count of calls, no octet more or less than on the line, losses in their place."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import CodeType, FrameType

import pytest
from bus_kit import SimBus
from far_ends import until
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from support import MS, S

from dpstack.drivers.line import line_runtime
from dpstack.drivers.tap import Tap, Tapped, TapStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import WireEntry
from tests.drivers.driver_rig import REQUEST, TOKEN, Rig

# --- the ring ---


def entry(number: int) -> Tapped:
    return (number, 500_000, bytes((number % 256,)), False)


@examples(60)
@given(
    st.integers(1, 5),
    st.lists(st.one_of(st.just("add"), st.integers(1, 7), st.tuples(st.integers(0, 6), st.integers(0, 3)))),
)
def test_every_loss_is_told_in_its_place(capacity: int, steps: list[str | int | tuple[int, int]]) -> None:
    """Beside a list without a bound: what is taken, with a hole of the size told, is all that was put in."""
    tap = Tap(capacity)
    given_in: list[Tapped | None] = []  # None: lost by another ring
    got: list[Tapped | None] = []

    def take(most: int) -> None:
        lost, entries = tap.take(most)
        assert len(entries) <= most
        got.extend([None] * lost)
        got.extend(entries)

    number = 0
    for step in steps:
        if step == "add":
            number += 1
            given_in.append(entry(number))
            tap.add(entry(number))
        elif isinstance(step, int):
            take(step)
        elif isinstance(step, tuple):
            count, lost = step
            entries = [entry(number + 1 + n) for n in range(count)]
            number += count
            given_in += [*[None] * lost, *entries]
            tap.extend(entries, lost)
        assert len(tap.ring) <= capacity
    while tap.waiting:
        take(3)
    assert len(got) == len(given_in)
    assert all(one is None or one == there for one, there in zip(got, given_in, strict=True))
    if len(given_in) <= capacity:
        assert got == given_in


# --- the hot path of a real-time driver ---


class Calls:
    """Counts what the interpreter calls, by code object."""

    def __init__(self) -> None:
        self.python: list[CodeType] = []
        self.of_c = 0

    def __enter__(self) -> Calls:
        sys.setprofile(self._profile)
        return self

    def __exit__(self, *_exc: object) -> None:
        sys.setprofile(None)
        self.of_c -= 1  # setprofile itself

    def _profile(self, frame: FrameType, event: str, _argument: object) -> None:
        if event == "call":
            self.python.append(frame.f_code)
        elif event == "c_call":
            self.of_c += 1

    @property
    def names(self) -> list[str]:
        return sorted(code.co_name for code in self.python)

    def of_tap(self) -> list[str]:
        return [code.co_name for code in self.python if code.co_filename.endswith("drivers/tap.py")]


def one_exchange(rig: Rig) -> Calls:
    """The driver gets a telegram and sends one."""
    rig.far.write(REQUEST)
    chunk = rig.port.read_now()
    with Calls() as calls:
        rig.driver._step(chunk)
    assert rig.far.read_now() == TOKEN
    return calls


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that stands still: no step is late, no deadline near."""
    monkeypatch.setattr(line_runtime, "monotonic_ns", lambda: 10**15)


@pytest.mark.usefixtures("each_driver", "still", "no_collection")
async def test_a_tap_adds_two_calls_and_two_entries_to_an_exchange() -> None:
    async with Rig() as rig:
        rig.machine.on_receive = lambda _chunk, _now: rig.machine.tx.append(TOKEN)
        for _ in range(20):  # the length of the answers is learned
            one_exchange(rig)
        without = [one_exchange(rig) for _ in range(3)]
        tap = Tap()
        rig.driver.tap(tap)
        tapped = [one_exchange(rig) for _ in range(3)]
        assert len(tap.ring) == 6
        full = Tap(capacity=0)
        rig.driver.tap(full)
        filled = [one_exchange(rig) for _ in range(3)]
        assert full.lost == 6
        rig.driver.tap(None)
        after = [one_exchange(rig) for _ in range(3)]
    # the same at each time, and nothing without a tap
    for calls in (*without, *after):
        assert (calls.names, calls.of_c) == (without[0].names, without[0].of_c)
        assert not calls.of_tap()
    for calls in tapped:
        more = sorted([*without[0].names, "receive", "_put_and_copy", "<lambda>"])  # the lambda is the clock above
        assert calls.names == more
        assert calls.of_c - without[0].of_c == 5  # the length and append of the ring twice, the length of the octets
    for calls in filled:
        assert calls.names == sorted([*without[0].names, "receive", "_put_and_copy"])
        assert calls.of_c - without[0].of_c == 2


@pytest.mark.usefixtures("each_driver", "still", "no_collection")
async def test_an_exchange_with_a_tap_keeps_its_two_entries_and_nothing_else() -> None:
    def blocks(rig: Rig) -> int:
        chunks = [bytes(REQUEST) for _ in range(200)]
        step = rig.driver._step
        before = sys.getallocatedblocks()
        for chunk in chunks:
            step(chunk)
        return sys.getallocatedblocks() - before

    async with Rig() as rig:
        rig.machine.log = Forgets()
        rig.machine.on_receive = lambda _chunk, _now: rig.machine.tx.append(TOKEN)
        blocks(rig)
        without = blocks(rig)
        rig.driver.tap(Tap())
        assert blocks(rig) - without <= 200 * 2 * 2 + 20  # a tuple and a time for each telegram; blocks of the ring
        full = Tap(capacity=0)
        rig.driver.tap(full)
        assert blocks(rig) - without <= 20


class Forgets(list[tuple[object, ...]]):
    """A log that keeps nothing."""

    def append(self, _entry: object, /) -> None:
        return


@pytest.mark.usefixtures("each_driver")
async def test_the_octets_on_the_line_in_their_order_and_no_dropped_telegram() -> None:
    async with Rig() as rig:
        tap = Tap()
        rig.driver.tap(tap)
        rig.machine.on_receive = lambda _chunk, _now: rig.machine.tx.append(TOKEN)
        rig.far.write(REQUEST)
        await rig.settle()
        rig.port._peer._inbox += bytes(22_000)  # type: ignore[union-attr]  # the line takes no more
        rig.far.write(REQUEST[:3])
        await rig.settle()
        assert rig.port.dropped == 1
        assert [(octets, sent) for _, _, octets, sent in tap.ring] == [
            (REQUEST, False), (TOKEN, True), (REQUEST[:3], False)
        ]  # fmt: skip
        times = [end_ns for end_ns, *_ in tap.ring]
        assert times == sorted(times)
        assert times[0] == rig.machine.did("receive")[0][2]
        assert {baud for _, baud, _, _ in tap.ring} == {500_000}


@pytest.mark.usefixtures("each_driver")
async def test_a_lost_port_and_its_return_are_entries_without_octets() -> None:
    rig = Rig()
    tap = Tap()
    rig.driver.tap(tap)  # before it is open
    async with rig:
        rig.port.unplug()
        await until(lambda: bool(tap.ring), "the loss")
        rig.port.plug()
        await until(lambda: len(tap.ring) == 2, "the return")
        rig.far.write(REQUEST)
        await until(lambda: len(tap.ring) == 3, "octets")
    assert [(baud, octets) for _, baud, octets, _ in tap.ring] == [(0, b""), (500_000, b""), (500_000, REQUEST)]
    rig.driver.tap(None)  # after its end


@pytest.mark.usefixtures("each_driver")
async def test_an_entry_has_the_rate_of_its_time() -> None:
    async with Rig() as rig:
        tap = Tap()
        rig.driver.tap(tap)
        for rate in (19_200, 1_500_000):
            rig.machine.baud = rate
            rig.driver.command(TOKEN)  # the driver follows after this step
            rig.driver.command(TOKEN)
            rig.far.write(REQUEST)
            await rig.settle()
    assert [(baud, octets) for _, baud, octets, _ in tap.ring] == [
        (500_000, TOKEN), (19_200, TOKEN), (19_200, REQUEST), (19_200, TOKEN), (1_500_000, TOKEN), (1_500_000, REQUEST)
    ]  # fmt: skip


@pytest.mark.usefixtures("each_driver")
async def test_octets_thrown_away_unread_are_a_loss_each_time() -> None:
    async with Rig() as rig:
        tap = Tap()
        for tapped, losses in ((False, 0), (True, 1), (True, 2), (False, 2)):
            rig.driver.tap(tap if tapped else None)
            rig.port.discarded += 5
            rig.driver._drain()
            assert tap.lost == losses
        await rig.settle()
        notices = [event.text for event in rig.events]
        assert [text.split(", ")[1].split()[0] for text in notices] == ["5"]  # the next one at 50


# --- the simulated bus ---


def bus_in(world: World, seconds: float, attach: Callable[[SimBus], TapStation | None]) -> list[WireEntry]:
    """What is on the wire of a bus with noise, tapped from 0.1 s on."""
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4])
    assert world.run(world.now + 60 * S, lambda: bus.exchanging)
    world.faults.noise(1e-4)
    station = attach(bus)
    begun = world.now
    world.run_for(round(seconds * S))
    if station is not None:
        world.remove(station)
    world.run_for(20 * MS)
    return [one for one in world.log if one.start_ns >= begun]


def test_a_tap_on_the_simulated_bus_changes_nothing_there() -> None:
    tap = Tap(100_000)

    def tapped(bus: SimBus) -> TapStation:
        station = TapStation(bus.station, tap)
        bus.world.add(station, name="tap")
        return station

    plain = bus_in(World(seed=3, keep=100_000), 0.2, lambda bus: None)
    heard = bus_in(World(seed=3, keep=100_000), 0.2, tapped)
    assert heard == plain
    assert tap.lost == 0
    # whole telegrams come whole with the end of their last bit; of damaged ones come the octets that a UART receives
    whole = {(one.end_ns, one.octets) for one in heard if not one.note}
    got = [(end_ns, octets) for end_ns, _, octets, _ in tap.ring]
    until_ns = heard[-1].end_ns - 20 * MS
    assert {one for one in whole if one[0] <= until_ns} <= set(got)
    others = [one for one in got if one not in whole]
    assert all(len(octets) == 1 for _, octets in others)
    assert len(others) <= sum(len(one.octets) for one in heard if one.note)
    assert [end_ns for end_ns, _ in got] == sorted(end_ns for end_ns, _ in got)
