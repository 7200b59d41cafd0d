"""A ring of two to eight masters heals in a bounded time after any disturbance; the bounds are in ``fire_kit``.

From the end of the trouble on, the ring is *quiet* after T_TO of the highest address + three token rotations +
HSA x T_SL: no token is lost, repeated or claimed any more, nobody withdraws or leaves, and the referee finds nothing.

That every master is *in* the ring again cannot have that bound: who was dropped comes back by a GAP poll only, the next
pass over the GAP begins up to G x T_TR later, and polls one address a token hold
(docs/reference/protocol.md#gap-update). So it takes one ``inclusion_bits`` more, and ten T_TO more where
somebody heard its own address and backed off.
"""

from __future__ import annotations

from typing import NamedTuple

import pytest
from fire_kit import FireRing, fire_params, healing_bits, inclusion_bits
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from support import wire_log

from dpstack.fdl.active.states import State
from dpstack.fdl.events import AddressCollision
from dpstack.sim.world import World

#: Data_Exchange of the masters' slaves, twice a hold, in bit times
TRAFFIC = 1_020
HOLDING = (State.USE_TOKEN, State.AWAIT_STATUS_RESPONSE, State.PASS_TOKEN, State.CHECK_TOKEN_PASS)


TROUBLES = (
    "join", "leave", "die", "die_with_the_token", "noise", "deaf", "octets", "lost_tokens", "doubled_token",
    "late_answers",
)  # fmt: skip


class Trouble(NamedTuple):
    what: str
    who: int  # which of the masters, and which address joins
    bits: int  # how long, or how late
    times: int
    pause: int  # in bits, until the next one


TROUBLE = st.builds(
    Trouble,
    st.sampled_from(TROUBLES),
    st.integers(0, 7),
    st.integers(1, 6_000),
    st.integers(1, 5),
    st.integers(0, 4_000),
)


class Scenario(NamedTuple):
    pool: list[int]
    at_first: int  # so many of the pool are there from the beginning
    seed: int
    t_tr: int
    gap: int
    settled: int  # in bits, before the trouble begins
    troubles: list[Trouble]


SCENARIOS = st.builds(
    Scenario,
    st.lists(st.integers(0, 20), min_size=8, max_size=8, unique=True).map(sorted),
    st.integers(2, 8),
    st.integers(0, 1 << 32),
    st.sampled_from([2_000, 5_000, 20_000]),
    st.sampled_from([1, 5]),
    st.sampled_from([0, 3_000, 100_000]),
    st.lists(TROUBLE, max_size=8),
)


def befall(ring: FireRing, pool: list[int], trouble: Trouble) -> None:
    """Cause ``trouble`` in ``ring``."""
    what, who, bits, times, _ = trouble
    world, live = ring.world, sorted(ring.masters)
    victim = live[who % len(live)]
    match what:
        case "join":
            absent = [address for address in pool if address not in ring.masters]
            if absent:
                ring.join(absent[who % len(absent)])
        case "die" | "die_with_the_token" if len(live) > 2:
            if what == "die_with_the_token":
                goal = world.now + ring.params.ns(20_000)
                world.run(goal, lambda: ring.masters[victim].state in HOLDING)
                ring.run_bits(bits % 300)
            ring.die(victim)
        case "leave":
            ring.leave(victim)
            ring.run_bits(bits)
            ring.back(victim)
        case "noise":
            world.faults.noise(10.0 ** -(1 + times % 4))
            ring.run_bits(bits)
            world.faults.noise(0.0)
        case "lost_tokens":
            ring.drop_tokens(times)
        case "late_answers":
            world.faults.delay(
                lambda tx: tx.telegram is not None and tx.telegram.fc >= 0 and not tx.telegram.is_request,
                ring.params.ns(bits % 600),
                times=times,
            )
        case "deaf":
            world.silence(ring.masters[victim], ring.params.ns(bits), deaf=True)
        case "doubled_token":
            world.inject(bytes((0xDC, victim, live[times % len(live)])))
        case "octets":
            world.inject([b"\xe5", b"\x00", b"\x10\x05", b"\x68\x05\x05\x68", bytes(30)][times % 5])


def run(scenario: Scenario, *, slaves: bool) -> None:
    pool, at_first, seed, t_tr, gap, settled, troubles = scenario
    world = World(seed=seed)
    ring = FireRing(world, fire_params(t_tr=t_tr, gap=gap), tuple(pool[:at_first]), slaves=slaves)
    ring.run_bits(settled)
    for trouble in troubles:
        befall(ring, pool, trouble)
        ring.run_bits(trouble.pause)
    ring.run_bits(6_000)  # whoever was deaf hears again
    world.faults.clear()
    masters, highest = len(ring.masters), max(ring.masters)
    traffic = TRAFFIC if slaves else 0
    healing = healing_bits(ring.params, highest, masters, traffic)
    if any(isinstance(event, AddressCollision) for event in ring.events):
        healing += 10 * ring.params.replace(address=highest).t_to
    inclusion = inclusion_bits(ring.params, masters, traffic)

    ring.run_bits(healing)
    quiet_at, trouble_seen = world.now, ring.trouble
    assert ring.one_ring, wire_log(world)
    assert world.run(quiet_at + ring.params.ns(inclusion), lambda: ring.whole), wire_log(world)
    ring.run_bits(20 * t_tr)
    assert ring.whole
    assert ring.trouble == trouble_seen, wire_log(world)
    late = [str(violation) for violation in ring.referee.violations if violation.t_ns > quiet_at]
    assert not late, late
    if slaves:
        ring.until(lambda: ring.exchanging, 5_000_000)


@examples(25, soak=1_000)
@given(SCENARIOS)
def test_bare_masters_heal(scenario: Scenario) -> None:
    run(scenario, slaves=False)


@examples(12, soak=500)
@given(SCENARIOS)
def test_masters_with_slaves_heal(scenario: Scenario) -> None:
    run(scenario, slaves=True)


@pytest.mark.parametrize("bits", [660, 690])
def test_two_stations_that_claim_in_step_are_set_apart_by_their_addresses(bits: int) -> None:
    """Neither heard the other claim; without that they send at the same time for ever, each deaf while it sends."""
    troubles = [
        Trouble("join", 0, 1, 1, 0),
        Trouble("leave", 0, bits, 1, 0),
        Trouble("lost_tokens", 0, 1, 4, 0),
    ]
    run(Scenario([0, 2, 3, 4, 5, 6, 7, 8], 2, 1, 2_000, 1, 0, troubles), slaves=True)
