"""Rate groups on the wire against the plan: its fullest cycle is the fullest one there is, to the bit."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

from bus_kit import SimBus
from hypothesis import given
from hypothesis import strategies as st
from planned_bus import FIRST, identifiers, kind, setups
from property_kit import examples
from support import S, WorldFactory

from dpstack.dp.plan.plan import make_plan
from dpstack.dp.plan.rotation_time import Case
from dpstack.params import BusParams
from dpstack.trace import WireEntry
from dpstack.units import ns_to_bits

#: in, out, every
SLAVES = st.tuples(st.integers(0, 40), st.integers(0, 40), st.sampled_from((1, 2, 2, 3, 4, 6)))


@examples(10)
@given(st.sampled_from((93_750, 500_000, 1_500_000, 12_000_000)), st.lists(SLAVES, min_size=1, max_size=7))
def test_the_fullest_cycle_is_the_one_of_the_plan(baud: int, given_: list[tuple[int, int, int]]) -> None:
    factory = WorldFactory()
    w = factory()
    params = BusParams.preset(baud, gap=0)
    plain = setups([identifiers(i, o) for i, o, _ in given_])
    slaves = [replace(setup, every=every) for setup, (_, _, every) in zip(plain, given_, strict=True)]
    planned = make_plan(params, slaves).rotations[Case.SHORTEST]
    cycle_ns = 2 * params.ns(planned.bits + 3000)
    params = params.replace(t_tr=max(params.t_tr, 4 * planned.bits))
    bus = SimBus(w, params, slaves, watchdog_ms=650_000, cycle_ns=cycle_ns).until_exchanging(60 * S)
    master = bus.master
    w.run_for(13 * cycle_ns)  # those that came late have found their turns
    entries: list[WireEntry] = []
    w.log.listener = entries.append
    origin = master.cycle.due_ns if master.cycle else master._cadence.due_at
    w.run_for(25 * cycle_ns)
    data: dict[int, list[WireEntry]] = defaultdict(list)
    for entry in entries:
        if kind(entry) in ("request", "answer"):
            data[(entry.start_ns - origin) // cycle_ns].append(entry)
    whole = [data[n] for n in sorted(data)[1:-1]]
    assert len(whole) >= 20 or any(s.every > 1 for s in slaves)
    took = [cycle[-1].end_ns - cycle[0].start_ns for cycle in whole]
    fullest = whole[took.index(max(took))]
    asked = {e.octets[1 if e.octets[0] == 0x10 else 4] for e in fullest if kind(e) == "request"}
    # the idle time after its last answer is part of the plan's
    assert abs(ns_to_bits(max(took), baud) + params.t_id1 - planned.data) <= 1
    assert sum(planned.slaves[a] for a in asked) == sum(planned.slaves[a] for a in planned.together) == planned.data
    assert min(asked) >= FIRST
    assert master.cycles.missed == 0
    factory.check()
