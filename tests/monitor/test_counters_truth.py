"""Counters of a listening station against the world's own account: exact where every transmission arrives intact.

The account (``wire_truth``) is made of the wire log. The masters' and the slaves' own statistics are a third count.
"""

from __future__ import annotations

from collections import Counter

import pytest
from bus_kit import IDENT, SimBus, mirror, setup
from fire_kit import FireRing
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from support import MS, S
from wire_truth import HEADS, UNANSWERED, Truth, arriving, truth_of

from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Damage
from dpstack.capture.transmission import Transmission as Heard
from dpstack.dp.acyclic.class2 import ReadService, Service
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.codec import encode_sd1, encode_sd2, encode_token
from dpstack.fdl.interface import Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, StationType, Telegram
from dpstack.monitor.counters import MAX_DEPTH, Change, Counters, State
from dpstack.monitor.evidence import finding
from dpstack.params import BusParams
from dpstack.sim.faults import Which
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.stats import Histogram

PARAMS = BusParams.preset(500_000, address=2, gap=2, hsa=12)


#: fewer telegrams where seconds of silence are waited for
SLOW = BusParams.preset(93_750, address=2, gap=2, hsa=12)
#: one octet each way: the answer is shorter than T_SL, so that its sender hears the repetition
SHORT = bytes.fromhex("10 20")


class Watched:
    """A world with a monitor in it from the first telegram on."""

    def __init__(self, seed: int = 1, baud: int = 500_000, *, referee: bool = False) -> None:
        self.world = World(seed=seed, keep=1_000_000, referee=referee)
        self.changes: list[Change] = []
        self.counters = Counters(self.changes.append)
        self.world.add(Listener(0, self.counters.add, baud=baud), name="listener")

    def watch(self) -> list[Transmission]:
        """Everything that is sent from now on, with what noise does to it."""
        sent: list[Transmission] = []

        def seen(tx: Transmission) -> bool:
            sent.append(tx)
            return False

        self.world.faults.drop(seen, times=None)
        return sent

    def run(self, ns: int) -> None:
        self.world.run_for(ns)

    def truth(self) -> Truth:
        """The world's account up to now; nothing is on the wire at this moment."""
        while self.world.log and list(self.world.log)[-1].end_ns > self.world.now:
            self.world.step()
        return truth_of(self.world.log)

    def check(self) -> Truth:
        """Every counter is the world's."""
        truth, counters = self.truth(), self.counters
        assert (counters.telegrams, counters.octets) == (truth.telegrams, truth.octets)
        assert (counters.damaged, counters.unattributed, counters.strays) == ({}, 0, 0)
        stations = counters.stations
        assert {a: s.requests for a, s in stations.items() if s.requests} == dict(truth.requests)
        for address, one in stations.items():
            assert (one.answers, one.no_answer, one.damaged) == (truth.answers[address], truth.no_answer[address], 0)
            assert (one.late, one.rs, one.rr) == (truth.late[address], truth.rs[address], truth.rr[address])
            assert one.repetitions == truth.repetitions[address]
            assert one.repeated_polls == truth.repeated_polls[address]
            depth = [truth.depth[address, number + 1] for number in range(MAX_DEPTH)]
            assert one.retry_depth == depth
            assert one.requests == one.answers + one.no_answer + (truth.open == address)
            assert one.answer_ns.count == one.answers
        assert (None if counters.asked is None else counters.asked.address) == truth.open
        masters = counters.masters
        assert {a: m.tokens for a, m in masters.items() if m.tokens} == dict(truth.tokens)
        assert {a: m.gap_polls for a, m in masters.items() if m.gap_polls} == dict(truth.status_polls)
        return truth


def of(sender: str) -> Which:
    """Selects the Data_Exchange answers of a station."""
    return lambda tx: tx.sender == sender and tx.octets[0] == 0x68 and tx.octets[4] < 0x80


@pytest.mark.parametrize("max_retry", range(9))
def test_answers_that_get_lost_are_counted_by_depth(max_retry: int) -> None:
    w = Watched()
    slaves = [setup(5, config=SHORT), setup(6)]
    bus = SimBus(w.world, PARAMS.replace(max_retry=max_retry), slaves, silent=[6], watchdog_ms=5_000)
    w.world.run(S, lambda: bus.state(5) is SlaveState.DATA_EXCHANGE)
    w.run(20 * MS)
    for number in range(1, max_retry + 1):
        w.world.faults.drop(of("5"), times=number)
        w.run(10 * MS)
    w.check()
    station = w.counters.stations[5]
    assert station.retry_depth == [int(number < max_retry) for number in range(MAX_DEPTH)]
    assert (station.lost, station.syncs, station.state) == (0, 1, State.DATA_EXCHANGE)
    # the master and the slave counted the same
    asked, slave = bus.station.stats.stations[5], bus.slaves[5].stats
    assert station.repetitions == asked.retries == slave.repeats
    assert station.requests == slave.requests + slave.repeats + slave.status
    # one more: the master's exchange is lost, and begins anew
    w.world.faults.drop(of("5"), times=max_retry + 1)
    w.run(150 * MS)
    w.check()
    assert (station.lost, station.syncs, station.state) == (1, 2, State.DATA_EXCHANGE)


def test_requests_that_get_lost_are_not_on_the_wire() -> None:
    w = Watched()
    bus = SimBus(w.world, PARAMS.replace(max_retry=3), [setup(5, config=SHORT)], watchdog_ms=5_000)
    w.world.run(S, lambda: bus.state(5) is SlaveState.DATA_EXCHANGE)
    w.run(20 * MS)
    w.world.faults.drop(lambda tx: tx.sender == "2" and tx.octets[:1] == b"\x68", times=2)
    w.run(20 * MS)
    truth = w.check()
    # the master repeated the first one, which nobody heard; its second repetition is the first on the wire
    assert (truth.repetitions[5], bus.station.stats.stations[5].retries) == (0, 2)


def test_a_ring_of_masters_with_their_slaves() -> None:
    w = Watched()
    ring = FireRing(w.world, PARAMS.replace(hsa=10, gap=1), (2, 3, 4), slaves=True, watchdog_ms=2_000)
    assert w.world.run(10 * S, lambda: ring.whole and ring.exchanging)
    w.run(50 * MS)
    w.check()
    masters = w.counters.masters
    assert {address for address, one in masters.items() if one.in_ring} == {2, 3, 4}
    assert [masters[address].slaves for address in (2, 3, 4)] == [{102}, {103}, {104}]
    drops = masters[3].drops
    gone = ring.die(3)
    w.run(300 * MS)
    assert not masters[3].in_ring
    assert masters[3].drops == drops + 1
    assert {address for address, one in masters.items() if one.in_ring} == ring.masters[2].las == {2, 4}
    assert gone.address == 3
    ring.join(3)
    assert w.world.run(w.world.now + 10 * S, lambda: ring.whole and ring.exchanging)
    w.run(50 * MS)
    assert {address for address, one in masters.items() if one.in_ring} == {2, 3, 4}
    w.world.faults.drop(lambda tx: tx.octets[0] == 0xDC, times=3)
    w.run(300 * MS)
    truth = w.truth()
    assert {a: m.tokens for a, m in masters.items()} == dict(truth.tokens)


def test_every_rotation_of_the_token_is_one_sample() -> None:
    w = Watched()
    ring = FireRing(w.world, PARAMS.replace(hsa=4, gap=2), (2, 3))
    assert w.world.run(10 * S, lambda: ring.whole)
    w.run(5 * MS)
    before = {address: one.token_ns.count for address, one in w.counters.masters.items()}
    tokens = {address: station.stats.tokens for address, station in ring.masters.items()}
    w.run(20 * MS)
    for address, station in ring.masters.items():
        got = w.counters.masters[address].token_ns.count - before[address]
        # the token of this moment may be on the wire, or just received
        assert abs(got - (station.stats.tokens - tokens[address])) <= 1


def test_durations_are_those_of_the_world() -> None:
    """T_SDR, the DP cycle and the token rotation, against slave, master and station."""
    w = Watched()
    bus = SimBus(w.world, PARAMS.replace(gap=0), [5, 6], t_sdr=30)
    bus.until_exchanging()
    w.run(5 * MS)
    master = w.counters.masters[2]
    master.rotation_ns = Histogram()
    bus.master.rotation = Histogram()
    w.run(30 * MS)
    for address in (5, 6):
        times = w.counters.stations[address].answer_ns
        assert times.min_ns == times.max_ns == PARAMS.ns(30)
    mine, own = master.rotation_ns, bus.master.rotation
    assert (mine.min_ns, mine.max_ns) == (own.min_ns, own.max_ns)
    assert abs(mine.count - own.count) <= 1
    assert abs(master.token_ns.quantile_ns(0.5) - bus.station.token_rotation.quantile_ns(0.5)) <= PARAMS.ns(33)


def test_class_2_services_and_modes() -> None:
    w = Watched()
    bus = SimBus(w.world, PARAMS, [5, 6])
    bus.until_exchanging()
    for token, service in enumerate((Service.CONFIG, Service.INPUTS, Service.OUTPUTS, Service.DIAGNOSIS)):
        bus.send(ReadService(token, 5, service))
    w.run(50 * MS)
    assert w.counters.masters[2].mode == "operate"
    bus.send(SetMode(Mode.CLEAR))
    w.run(200 * MS)
    assert w.counters.masters[2].mode == "clear"
    bus.send(SetMode(Mode.OPERATE))
    w.run(50 * MS)
    truth = w.check()
    assert [c.text for c in w.changes if c.kind == "mode"] == [
        f"master 2 is in {mode}" for mode in ("Operate", "Clear", "Operate")
    ]
    station, asked, slave = w.counters.stations[5], bus.station.stats.stations[5], bus.slaves[5].stats
    assert station.requests == slave.requests + slave.repeats + slave.status
    assert station.requests - truth.status_polls[2] <= asked.requests + asked.retries
    assert (station.lost, station.syncs, station.state) == (0, 1, State.DATA_EXCHANGE)


def test_a_second_master_reads_slaves_of_the_first_and_takes_none_away() -> None:
    """A class 2 master that is refused, repeats and begins anew: the slave stays in data exchange with its master."""
    w = Watched()
    params = PARAMS.replace(hsa=10, gap=1)
    bus = SimBus(w.world, params, [setup(5, config=SHORT)], watchdog_ms=5_000)
    bus.until_exchanging()
    reader = SimBus(w.world, params.replace(address=3), [])
    assert w.world.run(10 * S, lambda: reader.station.in_ring)
    syncs = w.counters.stations[5].syncs
    # the answers to the reader get lost: its first requests with FCV = 0 are not repetitions of the cyclic master's
    w.world.faults.drop(lambda tx: tx.sender == "5" and tx.octets[4:5] == b"\x83", times=4)
    for token in range(4):
        reader.send(ReadService(token, 5, Service.DIAGNOSIS))
    w.run(300 * MS)
    truth = w.check()
    station = w.counters.stations[5]
    assert truth.no_answer[5] >= 4
    assert (station.state, station.master, station.lost, station.syncs) == (State.DATA_EXCHANGE, 2, 0, syncs)


@pytest.mark.parametrize("bits", [250, 400, 900])
@pytest.mark.parametrize("max_retry", [0, 1, 3])
def test_answers_that_come_late(bits: int, max_retry: int) -> None:
    w = Watched()
    params = PARAMS.replace(max_retry=max_retry)
    bus = SimBus(w.world, params, [setup(5, config=SHORT), setup(6, config=SHORT)], watchdog_ms=5_000)
    bus.until_exchanging()
    w.run(20 * MS)
    for _ in range(3):
        w.world.faults.delay(of("5"), params.ns(bits))
        w.run(20 * MS)
    truth = w.truth()
    if any("collision" in entry.note for entry in w.world.log):
        check_totals(w)
    else:
        w.check()
        assert truth.late[5] == w.counters.stations[5].late


def check_totals(w: Watched) -> None:
    """What holds whatever happens to the octets."""
    counters = w.counters
    for one in counters.stations.values():
        assert one.requests == one.answers + one.damaged + one.no_answer + (counters.asked is one)
    damaged = sum(one.damaged for one in counters.stations.values())
    assert sum(counters.damaged.values()) == damaged + counters.unattributed + counters.open_pieces


# --- nothing dead is shown as alive ---


def test_a_slave_is_switched_off_and_on() -> None:
    w = Watched(baud=93_750)
    bus = SimBus(w.world, SLOW, [5, 6], watchdog_ms=1_000)
    bus.until_exchanging()
    w.run(50 * MS)
    station = w.counters.stations[5]
    assert w.world.run(w.world.now + S, lambda: list(w.world.log)[-1].octets[0] == 0xDC)  # no answer is cut off
    w.world.remove(bus.slaves[5])
    w.run(2_500 * MS)
    assert (station.state, station.lost, station.syncs) == (State.OFFLINE, 1, 1)
    assert w.counters.stations[6].state == State.DATA_EXCHANGE
    w.world.add(mirror(5, SLOW))
    w.run(3 * S)
    assert (station.state, station.lost, station.syncs) == (State.DATA_EXCHANGE, 1, 2)
    told = [(c.kind, c.address) for c in w.changes if c.kind in ("lost", "back") and c.address == 5]
    assert told == [("back", 5), ("lost", 5), ("back", 5)]
    w.check()


def test_a_bus_that_falls_silent_shows_nobody_alive() -> None:
    w = Watched()
    bus = SimBus(w.world, PARAMS, [5, 6])
    bus.until_exchanging()
    w.run(50 * MS)
    w.world.remove(bus.station)
    w.run(10 * MS)
    counters = w.counters
    counters.look(w.world.now + S)
    assert counters.masters[2].in_ring
    assert counters.stations[5].state == State.DATA_EXCHANGE
    counters.look(w.world.now + 3 * S)
    master = counters.masters[2]
    assert (master.in_ring, master.is_silent, master.mode) == (False, True, "unknown")
    assert [counters.stations[address].state for address in (2, 5, 6)] == [State.OFFLINE] + [State.UNKNOWN] * 2
    assert ("left", 2) in [(c.kind, c.address) for c in w.changes]


def test_silence_is_no_rotation_and_no_token_time() -> None:
    """A capture with an hour of silence in it."""
    w = Watched()
    bus = SimBus(w.world, PARAMS, [5])
    bus.until_exchanging()
    w.run(50 * MS)
    heard = list(w.world.log)
    counters = Counters()
    for pause in (0, 3_600 * S):
        for entry in heard:
            counters.add(Heard(entry.octets, entry.start_ns + pause, 500_000))
    master = counters.masters[2]
    assert max(master.rotation_ns.max_ns, master.token_ns.max_ns, master.hold_ns.max_ns) < S
    assert counters.stations[5].answer_ns.max_ns < S


def test_noise_behind_gap_polls_makes_no_station() -> None:
    """Two damaged answers of an empty address are noise; where most polls are followed by octets, somebody is there."""
    counters = Counters()
    poll = encode_sd1(9, 2, 0x49)
    at = 0
    for number in range(8):
        at += MS
        counters.add(Heard(poll, at, 500_000))
        if number in (2, 5):
            counters.add(Heard(b"\x00\x11", at + 200_000, 500_000, damage=Damage.START_DELIMITER))
    assert counters.stations[9].damaged == 2
    present = [counters.stations[9].is_present]
    for _ in range(9):
        at += MS
        counters.add(Heard(poll, at, 500_000))
        counters.add(Heard(b"\x00\x11", at + 200_000, 500_000, damage=Damage.START_DELIMITER))
    present.append(counters.stations[9].is_present)
    assert present == [False, True]
    assert counters.stations[9].state == State.UNKNOWN


def test_a_damaged_token_makes_no_master_and_drops_none() -> None:
    counters = Counters()
    at = 0
    for number in range(20):
        for octets in ("dc0302", "dc0203") if number != 10 else ("dc0702", "dc0207"):
            at += MS
            counters.add(Heard(bytes.fromhex(octets), at, 500_000))
    assert {a: (m.in_ring, m.drops) for a, m in counters.masters.items()} == {2: (True, 0), 3: (True, 0)}
    assert counters.passed_tokens > 30


# --- slaves that refuse ---


class Refuses(SlaveApp):
    """Answers Data_Exchange with ``status``."""

    __slots__ = ("status",)

    def __init__(self, status: Resp) -> None:
        super().__init__(MirrorDevice(IDENT, SHORT))
        self.status = status

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap is None:
            return Reply(self.status)
        return super().serve(request, now)


@pytest.mark.parametrize("status", [Resp.RS, Resp.RR, Resp.UE])
def test_refusals_of_a_slave(status: Resp) -> None:
    w = Watched()
    w.world.add(PassiveStation(5, Refuses(status), PARAMS))
    SimBus(w.world, PARAMS, [setup(5, config=SHORT)], silent=[5])
    w.run(300 * MS)
    truth = w.check()
    assert (truth.rs[5] > 0) == (status is Resp.RS)
    assert (truth.rr[5] > 0) == (status is Resp.RR)
    assert w.counters.stations[5].state != State.DATA_EXCHANGE
    assert w.counters.stations[5].syncs == 0


class Deaf(SlaveApp):
    """Answers no service; its station still answers FDL_Status."""

    __slots__ = ()

    def serve(self, request: Telegram, now: int) -> Reply | None:
        return None


def test_a_slave_that_answers_fdl_status_only() -> None:
    w = Watched(baud=93_750)
    slave = PassiveStation(5, Deaf(MirrorDevice(IDENT, SHORT)), SLOW)
    w.world.add(slave)
    SimBus(w.world, SLOW.replace(hsa=8, gap=1), [setup(5, config=SHORT)], silent=[5])
    w.run(500 * MS)
    w.check()
    station = w.counters.stations[5]
    assert (station.state, station.station_type) == (State.UNKNOWN, StationType.SLAVE)
    assert station.is_present
    assert station.answers == slave.stats.status
    assert station.repeated_polls > 0
    w.world.remove(slave)
    w.run(3 * S)
    assert station.state == State.OFFLINE


# --- noise ---


@pytest.mark.parametrize(
    ("rate", "baud", "seed"),
    [
        (1e-5, 1_500_000, 1),
        (1e-4, 500_000, 2),
        (1e-3, 500_000, 3),
        (1e-3, 9_600, 4),
        (3e-3, 500_000, 5),
        (3e-4, 12_000_000, 6),
    ],
)
def test_under_noise_totals_are_exact_and_each_station_lies_within_bounds(rate: float, baud: int, seed: int) -> None:
    hold_against_noise(rate, baud, seed, 50_000)


@pytest.mark.soak
@pytest.mark.parametrize("rate", [1e-5, 1e-4, 1e-3, 3e-3])
def test_many_seeds_of_noise(rate: float) -> None:
    for seed in range(20):
        for baud in (9_600, 187_500, 500_000, 12_000_000):
            hold_against_noise(rate, baud, seed, 200_000)


def hold_against_noise(rate: float, baud: int, seed: int, bits: int) -> None:
    """A master and three slaves under noise while ``bits`` bit times pass.

    The truth of a transmission is what a UART hands over (``arriving``). It is *intact* if nothing was inverted.
    *Odd* are damaged ones of which octets arrive. Bounds:

    * requests of a station: those that were intact, exactly, and so are its repetitions and its ends together;
    * answers: the intact ones to intact requests, and at most as many more as transmissions are odd (E5 among the
      octets of one whose first octet is lost looks like SC), at most as many less (an odd one makes a telegram);
    * damaged: at least the odd answers to intact requests; at most those and the odd transmissions of the master.
    """
    w = Watched(seed=seed, baud=baud)
    sent = w.watch()
    params = BusParams.preset(baud, address=2, gap=5)
    bus = SimBus(w.world, params, [5, 9, 100], watchdog_ms=60_000_000 // baud + 200)
    bus.until_exchanging(within_ns=60 * S)
    w.world.faults.noise(rate)
    w.run(bits * S // baud)
    w.world.faults.noise(0.0)
    w.run(5_000 * S // baud)
    sent = [tx for tx in sent if tx.end_ns <= w.world.now]
    check_totals(w)
    if any(tx.collided for tx in sent):
        return  # a collision garbles octets in a way that the wire log does not have
    counters = w.counters
    odd = [tx for tx in sent if tx.flips and arriving(tx)]
    requests, answers, broken = Counter[int](), Counter[int](), Counter[int]()
    asked = None
    for tx in sent:
        at = HEADS.get(tx.octets[0])
        if tx.sender == "2":
            if tx.flips:
                continue  # whoever was asked before it is still asked, as far as anybody hears
            asked = None
            if at is not None and tx.octets[at] != 0xFF and tx.octets[at + 2] & 0x0F not in UNANSWERED:
                asked = tx.octets[at] & 0x7F
                requests[asked] += 1
        elif asked == int(tx.sender):
            if not tx.flips:
                answers[asked] += 1
                asked = None
            else:
                broken[asked] += bool(arriving(tx))
    doubt = len(odd)
    own = sum(tx.sender == "2" for tx in odd)
    assert sum(counters.damaged.values()) >= sum(not looks_whole(tx) for tx in odd)
    for address, one in counters.stations.items():
        if not requests[address] and not one.requests:
            continue
        assert one.requests == requests[address], address
        assert abs(one.answers - answers[address]) <= doubt
        assert broken[address] - doubt <= one.damaged <= broken[address] + own
    # all stations together, without the doubt of each
    assert sum(one.damaged for one in counters.stations.values()) <= doubt
    assert set(counters.masters) == {2}
    if not odd:
        assert counters.damaged == {}


def looks_whole(tx: Transmission) -> bool:
    """A token has no check sequence: two errors in one octet make another token."""
    return tx.octets[0] == 0xDC and arriving(tx) == [0, 1, 2]


# --- octets of any kind ---

TELEGRAMS = st.one_of(
    st.builds(encode_token, st.integers(0, 126), st.integers(0, 126)),
    st.just(b"\xe5"),
    st.builds(encode_sd1, st.sampled_from([2, 3, 5, 127]), st.sampled_from([2, 3, 5]), st.integers(0, 255)),
    st.builds(
        encode_sd2,
        st.sampled_from([2, 5, 127]),
        st.sampled_from([2, 5]),
        st.integers(0, 255),
        st.binary(min_size=1, max_size=9),
        st.sampled_from([None, 55, 58, 60, 61, 62]),
        st.sampled_from([None, 62]),
    ),
    st.binary(max_size=12),
    st.binary(min_size=250, max_size=300),
)


@examples(60)
@given(
    st.lists(
        st.tuples(
            TELEGRAMS,
            st.one_of(st.none(), st.integers(0, 5 * S)),
            st.sampled_from([0, 9600, 500_000]),
            st.sampled_from([0, 0, 0, *Damage]),
            st.sampled_from(["", "", "", "", "gap", "look"]),
        ),
        max_size=40,
    )
)
def test_octets_of_any_kind_never_raise_and_the_sums_hold(
    steps: list[tuple[bytes, int | None, int, int, str]],
) -> None:
    counters = Counters()
    at = size = 0
    for heard, (octets, pause, baud, damage, order) in enumerate(steps, 1):
        at += pause or 0
        counters.add(Heard(octets, None if pause is None else at, baud, "", damage))
        size += len(octets)
        if order == "gap":
            counters.gap()
        elif order == "look":
            counters.look(at)
        assert counters.telegrams + sum(counters.damaged.values()) == heard
        assert counters.octets == size
        damaged = 0
        for one in counters.stations.values():
            assert one.requests == one.answers + one.damaged + one.no_answer + (counters.asked is one)
            assert min(one.requests, *one.retry_depth) >= 0
            damaged += one.damaged
        assert sum(counters.damaged.values()) == damaged + counters.unattributed + counters.open_pieces
        assert finding(counters).text
