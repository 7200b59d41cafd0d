"""The UART level: its times by hand at four rates, also on a slow port; noise on it against the truth: who saw what
damaged, and what reached the application."""

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
from ring_bus import ListUser, RingBus, fixed
from support import MS, S
from wire_truth import arriving

from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.fdl.decoder import Decoder
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Req
from dpstack.params import T_SYN, BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import ADAPTER, EXACT, HOST, Patience, slack
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.units import NS_PER_MS

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

    #: all outputs, with their numbers
    sent: dict[bytes, int] = field(default_factory=lambda: {bytes(12): 0})
    seen: list[int] = field(default_factory=list)

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        if inputs:
            self.seen.append(self.sent[inputs])  # a wrong octet: KeyError
        outputs = self.next_outputs()
        assert self.sent.setdefault(outputs, len(self.sent)) == len(self.sent) - 1
        return outputs


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


#: rate: T_SYN, T_ID1, T_ID2, min T_SDR, max T_SDR, T_SL, T_SET, T_QUI; T_ID1 = T_QUI + 2 T_SET + 2 + T_SYN
TIMES = {
    187_500: (33, 37, 60, 11, 60, 100, 1, 0),
    500_000: (33, 37, 100, 11, 100, 200, 1, 0),
    3_000_000: (33, 46, 250, 11, 250, 400, 4, 3),
    12_000_000: (33, 76, 800, 11, 800, 1000, 16, 9),
}


@pytest.mark.parametrize("baud", TIMES)
def test_the_times_at_a_rate(baud: int) -> None:
    p = BusParams.preset(baud)
    found = (T_SYN, p.t_id1, p.t_id2, p.min_tsdr, p.max_tsdr, p.t_sl, p.t_set, p.t_qui)
    assert found == TIMES[baud]
    assert p.t_qui < p.min_tsdr  # the own transmitter is off before an answer can begin


def test_the_print_out_of_another_configuration_tool() -> None:
    """COM PROFIBUS, 1.5 Mbit/s, optimised: T_SL 200, max T_SDR 100 give T_ID1 37 and T_ID2 100."""
    p = BusParams.preset(1_500_000).replace(t_sl=200, max_tsdr=100)
    assert (p.t_id1, p.t_id2) == (37, 100)


def test_a_line_has_them_in_nanoseconds() -> None:
    line = Line(BusParams.preset(500_000, address=3))
    times = (line.t_id1_ns, line.t_id2_ns, line.t_sdr_ns, line.t_sl_ns, line.t_to_ns, line.t_stall_ns)
    assert times == (74_000, 200_000, 22_000, 400_000, 12 * 400_000, 66_000)


def gaps(patience: Patience, extra_idle: int = 0) -> tuple[set[int], set[int], set[int]]:
    """Silence in bits after an answer, after an SDN and after a token, of a master on a port with ``patience``."""
    bus = RingBus(mode="chunk")
    user = ListUser(
        per_hold=[
            Request(9, Req.SRD_HIGH, b"\x01", patient=True, restart=True),
            Request(127, Req.SDN_HIGH, b"\x00\x00", 58, 62),
            Request(9, Req.SDN_HIGH, b"\x01"),
        ]
    )
    bus.slaves[9] = fixed("68 04 04 68 09 02 6D 01 79 16", "E5")
    bus.master(2, user, patience=patience, gap=0, extra_idle=extra_idle)
    bus.run(2_000 * NS_PER_MS)
    after_answer, after_sdn, after_token = set(), set(), set()
    for before, after in pairwise(bus.log[2:]):
        silence = (after.start - before.end) // 2_000
        if before.sender == 9:
            after_answer.add(silence)
        elif before.octets[6:7] == b"\x46":
            after_sdn.add(silence)
        elif before.octets[0] == 0xDC:
            after_token.add(silence)
    return after_answer, after_sdn, after_token


@pytest.mark.parametrize("patience", [EXACT, HOST, slack(500 * NS_PER_MS)], ids=["exact", "host", "500 ms"])
def test_slack_lengthens_no_gap(patience: Patience) -> None:
    assert gaps(patience) == ({37}, {100}, {37})
    assert gaps(patience, extra_idle=300) == ({337}, {400}, {337})


def test_only_where_the_end_of_a_telegram_is_not_known_its_latest_counts() -> None:
    """An adapter may send 1 ms later (500 bits) than it was told to; an answer says when it has."""
    assert gaps(ADAPTER) == ({37}, {600}, {537})
