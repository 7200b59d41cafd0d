"""A fixed cycle held against the plan: verdicts, refusals, what will be missed and how often, the rate it needs."""

from __future__ import annotations

import pytest
from bus_kit import IDENT
from planned_bus import identifiers
from support import present

from dpstack.dp.plan.cycle_check import CycleVerdict, slowest_rates, token_wait_ns
from dpstack.dp.plan.plan import Plan, make_plan
from dpstack.dp.plan.rotation_time import Figures, OtherMasters
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NS_PER_MS

#: five slaves with four octets each way at 1.5 Mbit/s, the GAP on; 13 characters each way are 143 bit times
SHORTEST = 5 * (143 + 11 + 143 + 37) + 70
TYPICAL = 5 * (143 + 60 + 143 + 37) + 70 + 366
SLOW = 5 * (143 + 150 + 143 + 37) + 70
#: a diagnosis with 6 octets (17 characters in all), a Write with a full telegram (255) and its answer (15)
DIAGNOSIS = 121 + 150 + 17 * 11 + 37
ACYCLIC = 255 * 11 + 150 + 15 * 11 + 37
BIT_NS = 2000 / 3


def slave(address: int, *, every: int = 1, watchdog: int | None = None, interval_us: int = 0) -> SlaveParams:
    return SlaveParams(
        address=address,
        name=f"s{address}",
        ident=IDENT,
        config=identifiers(4, 4),
        every=every,
        watchdog_ms=watchdog,
        min_slave_interval_ns=interval_us * 1000,
        max_diag_len=6,
    )


FIVE = [slave(n) for n in range(3, 8)]


def plan(cycle_ms: float, slaves: list[SlaveParams] = FIVE, baud: int = 1_500_000) -> Plan:
    return make_plan(BusParams.preset(baud), slaves, cycle_ns=round(cycle_ms * NS_PER_MS))


def verdict(bits: float) -> CycleVerdict:
    found = present(plan(bits * BIT_NS / NS_PER_MS).cycle)
    return found.verdict


def test_without_a_cycle_there_is_nothing_to_judge() -> None:
    free = make_plan(BusParams.preset(1_500_000), FIVE)
    assert free.cycle is None
    assert free.refusals == ()
    assert "cycle" not in free.as_dict()


def test_the_verdicts_and_where_they_begin() -> None:
    plain = make_plan(BusParams.preset(1_500_000), FIVE)
    longest = next(r.bits for case, r in plain.rotations.items() if case.value == "max")
    undisturbed = SLOW + ACYCLIC  # a service is longer than the diagnosis, Global_Control and a GAP poll
    assert [verdict(bits - 1) for bits in (SHORTEST, TYPICAL, undisturbed, longest)] == [
        CycleVerdict.IMPOSSIBLE,
        CycleVerdict.POSSIBLE,
        CycleVerdict.TYPICAL,
        CycleVerdict.UNDISTURBED,
    ]
    assert [verdict(bits + 1) for bits in (SHORTEST, TYPICAL, undisturbed, longest)] == [
        CycleVerdict.POSSIBLE,
        CycleVerdict.TYPICAL,
        CycleVerdict.UNDISTURBED,
        CycleVerdict.ALWAYS,
    ]


def test_shorter_than_possible_is_refused_with_the_shortest_that_is() -> None:
    (refusal,) = plan(1).refusals
    assert (
        refusal.what
        == "cycle_ms = 1 is shorter than possible: the shortest rotation with 5 slaves takes 1.16 ms at 1.5 Mbit/s"
    )
    assert refusal.todo == (
        "take cycle_ms = 1.16 or more, a larger every for slaves that need not be in each cycle, or a faster rate"
    )
    assert plan(1).findings[0] == refusal.text
    assert plan(1.16).refusals == ()
    (refusal,) = plan(0.2, FIVE[:1]).refusals
    assert refusal.text == (
        "cycle_ms = 0.2 is shorter than possible: the shortest rotation with 1 slave takes 0.27 ms at 1.5 Mbit/s; "
        "take cycle_ms = 0.27 or more, or a faster rate"
    )


def test_the_cycle_that_a_refusal_names_is_accepted() -> None:
    """Also where the rate makes an odd number of ns: rounded up to the next microsecond."""
    for baud in BAUD_RATES:
        (refusal,) = plan(0.001, baud=baud).refusals
        named = float(refusal.todo.split()[3])
        assert plan(named, baud=baud).refusals == ()
        assert plan(named - 0.0011, baud=baud).refusals != ()


def test_rate_groups_that_do_not_fit() -> None:
    slaves = [slave(3), slave(4), *(slave(n, every=2) for n in range(5, 9))]
    # two in each cycle, two of four in every second one: 4 x 334 + 70 = 1406 bit times
    assert plan(0.938, slaves).refusals == ()
    (refusal,) = plan(0.9, slaves).refusals
    assert refusal.what == (
        "the rate groups do not fit into cycle_ms = 0.9: the fullest cycle has 4 slaves (3, 4, 5, 7) "
        "and takes 0.938 ms at least at 1.5 Mbit/s"
    )


def test_min_slave_interval_longer_than_the_cycle() -> None:
    (refusal,) = plan(2, [slave(3), slave(4, interval_us=20_000)]).refusals
    assert refusal.slave == 4
    assert refusal.text == (
        "slave 4 (s4): its Min_Slave_Interval of 20 ms is longer than cycle_ms = 2; "
        "give it every = 10, or take cycle_ms = 20"
    )
    assert plan(2, [slave(3), slave(4, interval_us=20_000, every=10)]).refusals == ()
    (refusal,) = plan(2, [slave(3), slave(4, interval_us=20_000, every=9)]).refusals
    assert "longer than cycle_ms = 2 x every = 9 (18 ms); give it every = 10, or take cycle_ms = 2.223" in refusal.text


def test_watchdog_shorter_than_the_slaves_turn() -> None:
    (refusal,) = plan(4, [slave(3), slave(4, every=10, watchdog=30)]).refusals
    assert refusal.text == (
        "slave 4 (s4): its watchdog of 30 ms is shorter than cycle_ms = 4 x every = 10 (40 ms): it would always trip; "
        "take watchdog_ms = 120 or more"
    )
    assert plan(4, [slave(3), slave(4, every=10, watchdog=0)]).refusals == ()
    # longer than its turn, shorter than its turn when every round is the longest one: a finding
    tight = plan(4, [slave(3), slave(4, every=10, watchdog=50)])
    assert tight.refusals == ()
    assert any("its watchdog of 50 ms is shorter than 10 of the longest rotations" in f for f in tight.findings)


def test_the_recommended_watchdog_outlasts_the_turns() -> None:
    assert plan(4).watchdog_ms == 200
    assert plan(100).watchdog_ms == 300
    assert plan(4, [slave(3), slave(4, every=100)]).watchdog_ms == 3 * 8 * 100  # the longest round takes two cycles
    assert plan(4, [slave(3), slave(4, every=100)]).findings == ()


def test_a_cycle_that_only_fast_slaves_keep() -> None:
    # 5 x 383 + 70 = 1985 bit times are 1.323 ms
    (finding,) = plan(1.2).findings
    assert finding == (
        "cycle_ms = 1.2 is shorter than the typical rotation (1.57 ms at 1.5 Mbit/s): with slaves that answer after "
        "60 bit times the data alone take 1.32 ms: cycles begin late and 9% are left out; "
        "take 1.568 or more, or a faster rate"
    )
    (finding,) = plan(1.4).findings
    assert "no GAP poll fits beside the data (1.32 ms), and each makes a cycle late; take 1.568 or more" in finding


def test_a_cycle_that_is_missed_now_and_then() -> None:
    (finding,) = plan(1.6).findings
    assert finding == (
        "cycle_ms = 1.6 is enough for the typical rotation (1.57 ms at 1.5 Mbit/s) only: misses are to be expected for "
        "rounds in which all slaves need their max T_SDR (1.62 ms), each repeated request that takes long (up to "
        "0.295 ms: 1 cycle), each diagnosis that takes long (up to 0.33 ms: 1 cycle), each acyclic service that takes "
        "long (up to 2.1 ms: 2 cycles); take 3.728 or more, or a faster rate"
    )


def test_a_cycle_that_is_kept_while_nothing_is_repeated() -> None:
    kept = plan(4)
    assert kept.findings == ()
    assert kept.notes == (
        "cycle_ms = 4 is kept at 1.5 Mbit/s while nothing is repeated: "
        "misses are to be expected for several repeated requests in one cycle",
    )
    # over a pty with 50 ms of patience: 0.3 ms of it are spare otherwise
    patient = make_plan(BusParams.preset(1_500_000), FIVE, cycle_ns=4 * NS_PER_MS, host_slack_ns=50 * NS_PER_MS)
    assert any("each repeated request that takes long (up to 50.3 ms: 12 cycles)" in note for note in patient.notes)


def test_the_longest_diagnosis_of_the_gsd_file_counts() -> None:
    """6 octets instead of 244: an acyclic service is longest then."""
    unknown = SlaveParams(address=3, name="s", ident=IDENT, config=identifiers(4, 4))
    known = SlaveParams(address=3, name="s", ident=IDENT, config=identifiers(4, 4), max_diag_len=6)
    params = BusParams.preset(1_500_000)
    of = [Figures(params, [each]).rotations for each in (unknown, known)]
    for case in of[0]:
        saved = of[0][case].bits - of[1][case].bits
        assert saved == (238 * 11 if case.value in ("normal", "max") else 0)


def test_other_masters_are_part_of_the_cycle() -> None:
    params = BusParams.preset(1_500_000)
    two = make_plan(params, FIVE, cycle_ns=2 * NS_PER_MS, others=OtherMasters(alike=1))
    (refusal,) = two.refusals
    assert refusal.what == (
        "cycle_ms = 2 is shorter than possible: the shortest rotation with 5 slaves and 1 other master takes 2.32 ms "
        "at 1.5 Mbit/s"
    )


def test_as_data() -> None:
    assert plan(2).as_dict()["cycle"] == {"cycle_ms": 2.0, "verdict": "typical", "load_percent": 78.4}


def test_the_rate_a_cycle_needs() -> None:
    at_rates = [Figures(BusParams.preset(baud), FIVE) for baud in BAUD_RATES]
    assert slowest_rates(at_rates, 4 * NS_PER_MS) == {
        CycleVerdict.POSSIBLE: 500_000,
        CycleVerdict.TYPICAL: 1_500_000,
        CycleVerdict.UNDISTURBED: 1_500_000,
        CycleVerdict.ALWAYS: None,
    }
    assert set(slowest_rates(at_rates, 1).values()) == {None}


def test_a_long_slot_time_makes_gap_polls_long() -> None:
    """As beside masters on adapters: 66 + 10 115 bit times at 500 kbit/s are 20.4 ms."""
    params = BusParams.preset(500_000, t_sl=10_115)
    for slaves in ([], FIVE):
        (finding,) = make_plan(params, slaves, cycle_ns=49 * NS_PER_MS // 2).findings[:1] or ("",)
        assert ("each GAP poll that takes long (up to 20.4 ms: 1 cycle)" in finding) is bool(slaves)


@pytest.mark.parametrize("number", [0, 1])
def test_buses_with_hardly_anything_on_them(number: int) -> None:
    few = plan(1000, FIVE[:number])
    assert present(few.cycle).verdict is CycleVerdict.ALWAYS
    assert few.findings == ()


def test_the_latest_begin_of_a_cycle_beside_others() -> None:
    """What the other one needs for its longest normal round, by hand, and both tokens."""
    params = BusParams.preset(1_500_000)
    found = make_plan(params, FIVE, cycle_ns=30 * NS_PER_MS, others=OtherMasters(alike=1))
    token = 33 + 37
    bits = SLOW - 70 + DIAGNOSIS + (13 * 11 + params.t_id2) + (66 + 300) + 2 * token
    assert token_wait_ns(found.figures) == params.ns(bits)
    (told,) = [note for note in found.notes if "token" in note]
    assert told == (
        f"cycle_ms = 30: a cycle begins when the token is there, up to {params.ns(bits) / 1e6:.3g} ms late while the "
        f"other master has its normal round"
    )
    tight = make_plan(params, FIVE, cycle_ns=8 * NS_PER_MS, others=OtherMasters(alike=2))
    (told,) = [note for note in tight.notes if "token" in note]
    assert told.endswith("2 other masters have their rounds; more than a tenth of it counts as missed, by token")
    assert not [n for n in plan(20).notes if "token" in n]


def test_the_share_of_cycles_for_requests_that_fit_between_no_two() -> None:
    # 1.6 ms leave 0.277 ms beside the data: once in eight rounds a service of 2.10 ms costs two cycles
    assert plan(1.6).notes == (
        "cycle_ms = 1.6: a request that fits between no two cycles goes out after every 8th round at most; such "
        "requests cost at most 2 of 10 cycles (20%), and requests that fit into the time of a cycle that is left out "
        "go out in it",
    )
    # with 104 octets each way the cycle is longer than any service
    (note,) = plan(
        9,
        [
            SlaveParams(address=n, name=f"s{n}", ident=IDENT, config=identifiers(104, 104), max_diag_len=6)
            for n in range(3, 8)
        ],
    ).notes
    assert "cost at most 1 of 9 cycles (11%)" in note
