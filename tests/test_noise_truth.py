"""Noise on the bit-accurate medium against the truth: who saw what damaged, and what reached the application.

The truth is what the wire carried (octets as sent, inverted bits) and a UART's parity rule in this file's own words.
Of every receiver: exactly the damaged telegrams of which an octet came through are counted, and nothing else. There is
one exception: a token has no check sequence, so two errors in one octet make another token of it. Damaged octets are
dropped, so three of them in a row look like the end of a telegram.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from bus_kit import SimBus
from faults.counting_plugin import CountingPlugin
from fire_kit import FireRing
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from support import MS, S
from wire_truth import arriving

from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.fdl.decoder import Decoder
from dpstack.params import BusParams
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World

MASTER = "2"


class Wire:
    """Everything that is sent in ``world`` from now on, with what noise does to it."""

    def __init__(self, world: World) -> None:
        self.sent: list[Transmission] = []
        world.faults.drop(self._seen, times=None)

    def _seen(self, tx: Transmission) -> bool:
        self.sent.append(tx)
        return False

    def damaged(self, receiver: str) -> list[Transmission]:
        """The transmissions that ``receiver`` received damaged."""
        return [tx for tx in self.sent if tx.flips and tx.sender != receiver and arriving(tx)]


@dataclass
class Ear:
    """The damaged telegrams that one receiver counted, by time."""

    world: World
    decoder: Decoder
    counted: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._before = self.decoder.on_bad
        self.decoder.on_bad = self._bad

    def _bad(self, cause: str, times: int) -> None:
        self.counted += [self.world.now] * times
        if self._before is not None:
            self._before(cause, times)

    def check(self, heard: list[Transmission]) -> None:
        """Every one of ``heard`` was counted, and nothing without one of them."""
        # a telegram whose rest does not come is given up 33 bit times later, and before the next one can begin
        times = iter(sorted(self.counted))
        at = next(times, None)
        for tx in heard:
            end = tx.end_ns + 33 * 1_000_000_000 // tx.baud + 1
            assert at is None or at >= tx.start_ns, f"counted at {at} ns without a damaged telegram"
            found = False
            while at is not None and at <= end:
                found = True
                at = next(times, None)
            if not found:  # passes for another token: no octet is missing
                assert tx.octets[0] == 0xDC, tx.octets.hex(" ")
                assert arriving(tx) == [0, 1, 2]
        assert at is None, f"counted at {at} ns without a damaged telegram"


@dataclass
class Application(CountingPlugin):
    """The application of one slave, called in every rotation: no two outputs are the same, every input is looked at."""

    START_OCTETS = b"\x68\xe5\x16"

    sent: list[bytes] = field(default_factory=lambda: [bytes(12)])
    seen: list[int] = field(default_factory=list)

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        if inputs:
            self.seen.append(self.sent.index(inputs))  # a wrong octet: ValueError
        self.sent.append(self.next_outputs())
        return self.sent[-1]


def silent_inside(tx: Transmission) -> bool:
    """Three octets in a row, 33 bit times, are lost within it."""
    return any(later - earlier > 3 for earlier, later in pairwise(arriving(tx)))


def attempts_without_answer(wire: list[Transmission]) -> int:
    """Requests of the master that want an answer and were not followed by an undamaged one."""
    failed = 0
    for tx, then in pairwise(wire):
        at = {0x10: 1, 0x68: 4}.get(tx.octets[0])
        if tx.sender == MASTER and at is not None and tx.octets[at + 2] & 0x4F in (0x4C, 0x4D):  # SRD
            answered = then.sender == str(tx.octets[at] & 0x7F) and not then.flips
            failed += not answered
    return failed


def hold_against_the_truth(seed: int, rate: float, baud: int, bits: int) -> tuple[int, int]:
    """Exchanges and damaged telegrams of a master and three slaves while ``bits`` bit times pass."""
    world = World(seed=seed)
    bus = SimBus(world, BusParams.preset(baud, address=2, gap=0), [5, 9, 100], watchdog_ms=60_000_000 // baud + 200)
    applications = [Application(address) for address in bus.master.handlers]
    bus.until_exchanging(within_ns=60 * S)
    for application in applications:
        bus.master.images[application.address].plugin = application
    wire = Wire(world)
    world.run_for(bits * 100_000_000 // baud)  # a tenth without noise: what is under way now is over then
    assert sum(s.retries + s.timeouts for s in bus.station.stats.stations.values()) == 0
    ears = {MASTER: Ear(world, bus.station._decoder)}
    ears |= {str(address): Ear(world, slave.decoder) for address, slave in bus.slaves.items()}
    begun = {name: ear.decoder.stats.octets for name, ear in ears.items()}
    done = sum(handler.exchanges for handler in bus.master.handlers.values())
    world.faults.noise(rate)
    world.run_for(bits * 1_000_000_000 // baud)
    world.faults.noise(0.0)
    until = world.now + 30 * S
    assert world.run(until, lambda: bus.exchanging), "a slave did not come back"
    world.run_for(10_000 * 1_000_000_000 // baud)  # what was under way is over

    collided = [tx for tx in wire.sent if tx.collided]
    if collided:  # three octets lost in a row are the silence that ends a telegram: the master goes on in its middle
        assert any(silent_inside(tx) for tx in collided)
    else:
        for name, ear in ears.items():
            damaged = wire.damaged(name)
            ear.check(damaged)
            # intact telegrams come whole: no octet but those of damaged ones went through the decoder
            assert ear.decoder.stats.octets - begun[name] == sum(len(arriving(tx)) for tx in damaged)
        asked = bus.station.stats.stations.values()
        # The one other way to fail: after three silent first requests a probe with FCV = 1 is tried. A slave with just
        # that FCB repeats the answer it kept, of another service: refused as wrong, never taken for this one's.
        wrong = sum(s.wrong for s in asked)
        assert sum(s.retries + s.timeouts for s in asked) == attempts_without_answer(wire.sent) + wrong
    asked = bus.station.stats.stations.values()
    for application in applications:
        assert application.seen == sorted(application.seen), "an older input came after a newer one"
        assert application.seen[-1] >= len(application.sent) - 3
    lost = [e for e in bus.events if isinstance(e, SlaveStateChanged) and e.state is SlaveState.OFFLINE]
    given_up = sum(s.timeouts for s in asked)
    assert len(lost) <= given_up
    assert world.referee is not None
    world.referee.check()
    return sum(h.exchanges for h in bus.master.handlers.values()) - done, sum(bool(tx.flips) for tx in wire.sent)


@pytest.mark.parametrize(
    ("rate", "baud"), [(1e-3, 500_000), (1e-3, 9_600), (1e-4, 12_000_000), (1e-5, 1_500_000), (3e-3, 500_000)]
)
def test_every_damaged_telegram_is_counted_and_no_wrong_octet_gets_through(rate: float, baud: int) -> None:
    exchanges, damaged = hold_against_the_truth(1, rate, baud, 500_000)
    assert damaged > 0
    assert exchanges > 0


@examples(12)
@given(
    seed=st.integers(0, 1 << 32),
    rate=st.sampled_from([1e-5, 1e-4, 3e-4, 1e-3, 2e-3]),
    baud=st.sampled_from([9_600, 45_450, 187_500, 500_000, 3_000_000, 12_000_000]),
)
def test_any_noise(seed: int, rate: float, baud: int) -> None:
    hold_against_the_truth(seed, rate, baud, 100_000)


@pytest.mark.soak
@pytest.mark.parametrize("rate", [1e-5, 1e-4, 1e-3, 3e-3])
def test_many_seeds(rate: float) -> None:
    for seed in range(25):
        for baud in (9_600, 187_500, 500_000, 12_000_000):
            hold_against_the_truth(seed, rate, baud, 200_000)


@pytest.mark.parametrize("rate", [1e-4, 1e-3])
def test_every_master_of_a_ring_counts_what_it_hears_damaged(rate: float) -> None:
    """The members of a ring hear everything; who is Offline by order hears nothing."""
    world = World(seed=4)
    ring = FireRing(world, BusParams.preset(500_000, address=2, hsa=10, gap=1), (2, 3, 4), slaves=True)
    exchanging = [user.handlers for user in ring.dp.values()]
    up = SlaveState.DATA_EXCHANGE
    assert world.run(20 * S, lambda: all(h.state is up for handlers in exchanging for h in handlers.values()))
    wire = Wire(world)
    ears = {str(address): Ear(world, station._decoder) for address, station in ring.masters.items()}
    world.faults.noise(rate)
    world.run_for(S)
    world.faults.noise(0.0)
    world.run_for(100 * MS)
    for name, ear in ears.items():
        assert len(wire.damaged(name)) > 30
        ear.check(wire.damaged(name))
    assert all(h.image.inputs == bytes(12) for handlers in exchanging for h in handlers.values())
