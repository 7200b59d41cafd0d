"""Disturbances of a token ring, each with bare masters and with masters whose slaves must stay in data exchange."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest
from fire_kit import SLAVE_OF, FireRing, fire_params, healing_bits, inclusion_bits, make_ring
from foreign_master import ForeignMaster, fdl_status
from ring_bus import ListUser
from support import WorldFactory

from dpstack.dp.master.events import SlaveState, SlaveStateChanged
from dpstack.fdl.active.states import State
from dpstack.fdl.events import AddressCollision, RingJoined, StationFound, TokenLost
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Kind, Req
from dpstack.sim.referee import Rule
from dpstack.trace import WireEntry

Make = Callable[..., FireRing]
HOLDING = (State.USE_TOKEN, State.AWAIT_DATA_RESPONSE, State.AWAIT_STATUS_RESPONSE, State.PASS_TOKEN)
#: Data_Exchange with one slave of twelve octets each way, in bit times
DX_BITS = 231 + 11 + 231 + 37


@pytest.fixture(params=[False, True], ids=["bare", "with slaves"])
def ring_of(request: pytest.FixtureRequest, world: WorldFactory) -> Make:
    def make(*addresses: int, **options: int) -> FireRing:
        return make_ring(world, *addresses, slaves=request.param, **options)

    return make


def traffic(ring: FireRing) -> int:
    return 2 * DX_BITS if ring.with_slaves else 0


def heals(ring: FireRing) -> None:
    """The ring is quiet within the bound, whole within the bound of inclusion, and every slave is served."""
    count = len(ring.masters)
    ring.run_bits(healing_bits(ring.params, max(ring.masters), count, traffic(ring)))
    before = ring.trouble
    ring.until(lambda: ring.whole, inclusion_bits(ring.params, count, traffic(ring)))
    ring.run_rotations(20)
    assert ring.trouble == before
    assert ring.whole
    ring.until(lambda: ring.exchanging, 1_000_000)


def lost_slaves(ring: FireRing, since: int) -> set[int]:
    """Slaves that fell out of data exchange."""
    states: dict[int, SlaveState] = {}
    lost = set()
    for event in ring.events:
        if isinstance(event, SlaveStateChanged):
            if event.t_ns > since and states.get(event.address) is SlaveState.DATA_EXCHANGE:
                lost.add(event.address)
            states[event.address] = event.state
    return lost


def holder(ring: FireRing) -> int | None:
    return next((a for a, station in ring.masters.items() if station.state in HOLDING), None)


def entries(ring: FireRing, since: int) -> list[WireEntry]:
    return [entry for entry in ring.world.log if entry.start_ns >= since]


# --- coming and going ---
def test_a_master_joins_through_the_gap(ring_of: Make) -> None:
    ring = ring_of(2, 9)
    start = ring.world.now
    ring.join(5)
    ring.until(lambda: ring.whole, inclusion_bits(ring.params, 3, traffic(ring)) + healing_bits(ring.params, 9, 3))
    joined = [event for event in ring.events if isinstance(event, RingJoined) and event.t_ns > start]
    assert [(event.address, event.claimed, event.masters) for event in joined] == [(5, False, (2, 5, 9))]
    heals(ring)
    assert lost_slaves(ring, start) == set()


def test_a_master_leaves_in_order_and_the_token_is_not_lost(ring_of: Make) -> None:
    ring = ring_of(2, 5, 9)
    start = ring.world.now
    ring.until(lambda: holder(ring) == 5)
    ring.leave(5)
    ring.run_rotations(3)
    assert ring.masters[2].las == ring.masters[9].las == {2, 9}
    assert not any(isinstance(event, TokenLost) for event in ring.events)
    ring.back(5)
    heals(ring)
    assert lost_slaves(ring, start) <= {SLAVE_OF + 5}


@pytest.mark.parametrize("state", [*HOLDING, State.CHECK_TOKEN_PASS, State.ACTIVE_IDLE])
def test_a_master_dies_with_or_without_the_token(ring_of: Make, state: State) -> None:
    ring = ring_of(2, 5, 9)
    victim = ring.masters[5]
    if state is State.AWAIT_DATA_RESPONSE and not ring.with_slaves:
        return
    ring.until(lambda: victim.state is state)
    start = ring.world.now
    ring.die(5)
    heals(ring)
    assert lost_slaves(ring, start) == set()


def test_all_but_the_highest_die_at_once(ring_of: Make) -> None:
    ring = ring_of(2, 5, 9, 20)
    for address in (2, 5, 9):
        ring.die(address)
    quiet = ring.world.now
    heals(ring)
    claims = [entry for entry in entries(ring, quiet) if entry.octets == b"\xdc\x14\x14"]
    assert not claims or claims[0].start_ns - quiet <= ring.params.ns(ring.params.replace(address=20).t_to)


def test_the_token_is_claimed_by_the_lowest_address_after_its_t_to(ring_of: Make) -> None:
    ring = ring_of(3, 5, 9)
    # it has acted on the token, so its predecessor is content; nobody but T_TO finds out
    ring.until(lambda: ring.masters[3].state is State.AWAIT_STATUS_RESPONSE)
    ring.run_bits(70)
    quiet = list(ring.world.log)[-1].end_ns
    ring.die(3)
    ring.until(lambda: any(isinstance(event, TokenLost) and event.address == 5 for event in ring.events))
    ring.run_bits(40)
    claim = next(entry for entry in ring.world.log if entry.octets == b"\xdc\x05\x05" and entry.start_ns > quiet)
    last = max(entry.end_ns for entry in ring.world.log if entry.end_ns < claim.start_ns)
    assert claim.start_ns - last == ring.params.ns((6 + 2 * 5) * 200)
    heals(ring)


# --- tokens lost and doubled ---
@pytest.mark.parametrize("times", [1, 2, 3, 5])
def test_tokens_that_nobody_hears(ring_of: Make, times: int) -> None:
    ring = ring_of(2, 5, 9)
    start = ring.world.now
    ring.referee.allow(Rule.ORDER)  # it has not heard the attempts either
    ring.drop_tokens(times, "5")
    heals(ring)
    # its predecessor has not heard it either, so that one repeats its token too
    assert sum(station.stats.token_retries for station in ring.masters.values()) >= times // 2 + 1
    assert sum(station.stats.tokens_lost for station in ring.masters.values()) == 0
    assert lost_slaves(ring, start) == set()


@pytest.mark.parametrize("late_bits", [3, 38, 120, 400])
@pytest.mark.parametrize("taker", [2, 5, 9])
def test_a_doubled_token_becomes_one_again(ring_of: Make, taker: int, late_bits: int) -> None:
    """A reflection or a confused master sends the token once more, and its addressee takes it too."""
    ring = ring_of(2, 5, 9)
    start = ring.world.now
    ring.until(lambda: holder(ring) == 2)
    ring.until(lambda: ring.masters[2].state is State.CHECK_TOKEN_PASS)
    ring.run_bits(33 + late_bits)
    ring.referee.allow(*Rule)  # two holders collide; what counts is that it ends
    before = {2: 9, 5: 2, 9: 5}[taker]
    ring.world.inject(bytes((0xDC, taker, before)))
    heals(ring)
    assert len(ring.referee.allowed) < 60
    # while both hold a token they begin at the same instants, so their own slaves may be lost for a moment
    assert lost_slaves(ring, start) <= {SLAVE_OF + 5, SLAVE_OF + taker}


def test_two_holders_in_step_hear_each_other_at_the_last_repetition(world: WorldFactory) -> None:
    """Both begin at the same instant again and again, so that neither hears the other; only TS tells them apart."""
    ring = make_ring(world, 0, 2, 5, 9, slaves=True)
    ring.until(lambda: list(ring.world.log)[-1].octets == b"\xdc\x00\x09")
    ring.referee.expect(Rule.COLLISION)
    ring.referee.allow(*Rule)
    ring.run_bits(8)
    start = ring.world.now
    ring.world.inject(b"\xdc\x02\x00")  # while 0 waits for its turn: now both 0 and 2 have a token
    ring.run_bits(4_000)
    starts = [entry.start_ns for entry in entries(ring, start) if "collision" in entry.note]
    assert len(set(starts)) < len(starts)  # in step indeed
    heals(ring)
    assert lost_slaves(ring, start) <= {SLAVE_OF, SLAVE_OF + 2}


# --- noise after the token pass ---
@pytest.mark.parametrize("octets", [b"\xe5", b"\x00", b"\x10\x05", b"\x68\x05\x05\x68"], ids=lambda o: o.hex())
@pytest.mark.parametrize("dead", [False, True])
def test_octets_after_a_token_pass(ring_of: Make, octets: bytes, dead: bool) -> None:
    ring = ring_of(2, 5, 9)
    start = ring.world.now
    ring.until(lambda: ring.masters[2].state is State.CHECK_TOKEN_PASS)
    ring.run_bits(33 + 10)  # the token is on the line, its addressee waits for T_ID1
    if dead:
        ring.die(5)
    ring.world.inject(octets)
    heals(ring)
    assert lost_slaves(ring, start) == set()


def test_an_edge_of_which_nothing_comes_does_not_bring_all_claims_to_one_instant(world: WorldFactory) -> None:
    """T_TO of low addresses is over long before a telegram could be: they must not claim together at its end."""
    ring = make_ring(world, 0, 2, 4, 9)
    ring.until(lambda: holder(ring) == 9)
    ring.die(9)
    ring.run_bits(50)
    ring.world.faults.damage(lambda tx: tx.forced, octet=0, flips=0x001)
    ring.world.inject(b"\xe5")  # its start bit is missing: an edge, and nothing that a UART would see
    quiet = ring.world.now
    heals(ring)
    claims = [
        entry for entry in entries(ring, quiet) if entry.octets[:1] == b"\xdc" and entry.octets[1] == entry.octets[2]
    ]
    assert {entry.octets[1] for entry in claims} == {0}
    assert not any("collision" in entry.note.lower() for entry in entries(ring, quiet))


# --- one address twice ---
def test_a_second_master_with_the_address_stays_out_and_reports_it(ring_of: Make) -> None:
    ring = ring_of(2, 5)
    start = ring.world.now
    events = len(ring.events)
    twin = FireRing(ring.world, ring.params, ())
    second = twin.join(5)
    ring.run_bits(60_000)
    assert second.state is State.LISTEN_TOKEN
    assert [event.address for event in twin.events if isinstance(event, AddressCollision)] == [5]
    assert "give one of the two another address" in twin.events[0].text
    assert ring.whole
    assert not any(isinstance(event, AddressCollision) for event in ring.events[events:])
    assert lost_slaves(ring, start) == set()
    assert not any(entry.note for entry in entries(ring, start))  # it has not sent a single octet
    # the first one goes: ten T_TO after its last telegram the second one may come in
    ring.die(5)
    ring.masters[5] = second
    ring.run_bits(10 * second.params.t_to)
    heals(ring)


def test_a_foreign_master_with_our_address_makes_us_back_off(ring_of: Make) -> None:
    ring = ring_of(2, 5)
    start = ring.world.now
    ring.until(lambda: ring.masters[5].state is State.AWAIT_STATUS_RESPONSE)
    ring.run_bits(70)  # its GAP poll is on the line and stays without an answer
    ring.world.inject(fdl_status(3, 2), sender="foreign")
    ring.run_bits(100)
    assert ring.masters[2].state is State.LISTEN_TOKEN
    assert [event.address for event in ring.events if isinstance(event, AddressCollision)] == [2]
    ring.referee.allow(*Rule)  # the ring believes that the foreign one is 2
    ring.run_bits(5 * ring.masters[2].params.t_to)
    assert ring.masters[2].state is State.LISTEN_TOKEN
    ring.run_bits(6 * ring.masters[2].params.t_to)
    heals(ring)
    assert lost_slaves(ring, start) <= {SLAVE_OF + 2}


# --- with masters that are not ours ---
def test_a_foreign_master_in_our_ring(ring_of: Make) -> None:
    ring = ring_of(2, 9)
    start = ring.world.now
    clock = bytes.fromhex("68 05 05 68 FF 85 46 3A 3E 42 16")  # Global_Control without its command, to nobody's harm
    foreign = ForeignMaster(5, 9, says=(clock, fdl_status(6, 5)))
    ring.world.add(foreign)
    ring.until(lambda: foreign.tokens > 200, 1_000_000)
    assert ring.masters[2].las == ring.masters[9].las == {2, 5, 9}
    found = [(e.address, e.kind) for e in ring.events if isinstance(e, StationFound) and e.address == 5]
    assert found[0][0] == 5
    assert sum(station.stats.token_retries + station.stats.withdrawn for station in ring.masters.values()) == 0
    assert lost_slaves(ring, start) == set()


def test_a_foreign_master_dies_with_the_token(ring_of: Make) -> None:
    ring = ring_of(2, 9)
    foreign = ForeignMaster(5, 9, holds=10)
    ring.world.add(foreign)
    ring.until(lambda: foreign.tokens == 11)
    foreign.ready = False
    heals(ring)
    assert foreign.tokens == 11
    assert ring.masters[2].las == {2, 9}


def test_a_token_from_a_stranger_is_refused_once_and_accepted_the_second_time(ring_of: Make) -> None:
    ring = ring_of(2, 9)
    foreign = ForeignMaster(5, 2, ready=False)  # asks nobody, passes to 2 over 9
    ring.world.add(foreign)
    ring.referee.allow(Rule.RIGHT, Rule.TWO_TOKENS, Rule.ORDER)
    ring.until(lambda: holder(ring) == 9)
    ring.die(9)
    two = ring.masters[2]
    ring.run_bits(40)
    now = ring.world.now
    tokens = two.stats.tokens
    foreign.plan = [(now + foreign.bits(40), foreign.token())]
    ring.world.poke(foreign)
    ring.run_bits(150)
    assert two.state is State.ACTIVE_IDLE
    assert two.stats.tokens == tokens
    foreign.plan = [(ring.world.now, foreign.token())]
    ring.world.poke(foreign)
    ring.run_bits(40)
    assert two.stats.tokens == tokens + 1
    assert two.las >= {2, 5}
    heals(ring)


# --- services, T_TR and the GAP ---
def test_high_priority_once_low_while_time_is_left_gap_last(world: WorldFactory) -> None:
    """T_TR so short that every hold but the first is late: one high-priority service each, nothing else."""
    user = ListUser(per_hold=[Request(99, Req.SDN_HIGH, bytes(40))] * 3)
    user.low = [Request(99, Req.SDN_LOW, bytes(8))] * 50
    ring = FireRing(world(keep=100_000), fire_params(t_tr=256), ())
    ring.join(2, user)
    ring.run_bits(60_000)
    kinds = "".join({Kind.SD4: "t", Kind.SD1: "g", Kind.SD2: "r"}[Kind(e.octets[0])] for e in ring.world.log)[2:]
    first, *late = kinds.split("t")
    assert first.startswith("r")
    assert set(late[1:-1]) == {"r"}
    assert len(user.low) == 50
    assert set(user.asked[4:]) == {True}  # high_only


def test_with_time_left_the_order_is_high_low_gap(world: WorldFactory) -> None:
    user = ListUser(per_hold=[Request(99, Req.SDN_HIGH, b"\x01")] * 2)
    user.low = [Request(99, Req.SDN_LOW, bytes(8))] * 3
    ring = FireRing(world(keep=100_000), fire_params(t_tr=20_000), ())
    ring.join(2, user)
    ring.run_bits(10_000)
    first = [e.octets for e in ring.world.log][2:9]
    assert [o[0] for o in first] == [0x68] * 5 + [0x10, 0xDC]
    assert [o[6] for o in first[:5]] == [0x46, 0x46, 0x44, 0x44, 0x44]  # SDN high, SDN low


def test_gap_off_and_gap_slowed(world: WorldFactory) -> None:
    polls = {}
    for gap in (0, 1, 20):
        ring = FireRing(world(keep=1), fire_params(t_tr=2_000, gap=gap), ())
        station = ring.join(2)
        ring.run_bits(200_000)
        polls[gap] = station.stats.gap_polls
    # a pass is 20 addresses and takes longer than 1 x T_TR, so G = 1 polls all the time; G = 20 every 40 000 bits
    assert polls[0] == 0
    assert polls[20] == 20 * 5
    assert polls[1] > 5 * polls[20]


@pytest.mark.parametrize("rotations", [2_000, pytest.param(10_000, marks=pytest.mark.soak)])
def test_two_masters_keep_t_tr(world: WorldFactory, rotations: int) -> None:
    """Both have more low-priority services than time, and one of high priority in every hold."""
    t_tr = 2_000
    ring = FireRing(world(keep=1), fire_params(t_tr=t_tr), ())
    users = [ListUser(per_hold=[Request(99, Req.SDN_HIGH, bytes(4))]) for _ in range(2)]
    for address, user in zip((2, 5), users, strict=True):
        user.low = [Request(99, Req.SDN_LOW, bytes(20))] * (20 * rotations)
        ring.join(address, user)
    ring.until(lambda: ring.whole)
    ring.run_rotations(5)
    begun = [len(user.tokens) for user in users]
    ring.world.run(10**18, lambda: len(users[0].tokens) > begun[0] + rotations)
    # at the worst each master begins something in the last moment: a low-priority cycle, or its high-priority one, or a
    # GAP poll, and the token
    low, high = 11 * (11 + 20) + 100, 11 * (11 + 4) + 100
    poll = 66 + 200 + 37
    for user, first in zip(users, begun, strict=True):
        times = user.tokens[first:]
        assert len(times) >= rotations
        longest = max(later - earlier for earlier, later in pairwise(times))
        assert longest <= ring.params.ns(t_tr + 2 * (max(low, high, poll) + 33 + 37))
        assert times[-1] - times[0] >= 0.75 * ring.params.ns(t_tr) * (len(times) - 1)  # the time is used, too
    assert all(user.low for user in users)
    assert ring.whole
