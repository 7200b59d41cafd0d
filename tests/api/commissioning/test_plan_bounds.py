"""The bounds of a plan, for random plants: shortest <= typical <= longest, and the simulated bus stays within them.

``make soak`` simulates a minute of each bus, or 2000 rotations.
"""

from __future__ import annotations

from typing import Final

from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples, soaking
from support import present

from dpstack.api.bus.compose import Case, Plan, plan_bus
from dpstack.api.bus.virtual import run_virtual
from dpstack.api.commissioning.plan_simulation import PlanSimulation, SimulatedPlan
from dpstack.api.config.config import Config, parse_config
from dpstack.units import BAUD_RATES, NS_PER_S

CASES: Final = (Case.SHORTEST, Case.TYPICAL, Case.LONGEST)
#: rotations of one simulated bus
ROTATIONS: Final = 2_000 if soaking() else 30
BUSES = st.fixed_dictionaries(
    {"baud": st.sampled_from(BAUD_RATES), "gap": st.sampled_from([0, 1, 10]), "max_retry": st.integers(0, 3)}
)
#: keys of a slave; identifier octets: one way or both, long ones, none
SLAVES = st.fixed_dictionaries(
    {"config": st.sampled_from(["10", "20", "10 20", "1F 2F", "5F 6F", "00", "71"])},
    optional={
        "min_slave_interval": st.sampled_from([1, 3, 10, 100, 250]),
        "every": st.sampled_from([2, 3, 5]),
        "dpv1": st.just({"alarms": [], "alarm_mode": 0}),
    },
)


def config_of(bus: dict[str, object], slaves: list[dict[str, object]], **keys: object) -> Config:
    lines = ["[bus]", 'port = "virtual"', *(f"{key} = {value}" for key, value in (bus | keys).items())]
    for number, slave in enumerate(slaves):
        lines += ["[[slave]]", f'name = "s{number}"', f"address = {3 + number}", "ident = 0x1234"]
        lines += [f"{key} = {value!r}" for key, value in slave.items() if key != "dpv1"]
        if "dpv1" in slave:
            lines += ['user_prm = "00 00 00"', "dpv1 = { alarms = [], alarm_mode = 0 }"]
    return parse_config("\n".join(lines).replace("'", '"'))


def simulate(config: Config, plan: Plan) -> SimulatedPlan:
    longest = plan.rotation_ns(Case.LONGEST) / NS_PER_S
    seconds = min(60.0, ROTATIONS * max(plan.rotation_ns(Case.TYPICAL), config.bus.cycle_ns) / NS_PER_S + 2 * longest)

    async def run() -> SimulatedPlan | None:
        simulation = PlanSimulation(config, plan)
        await simulation.run(seconds, lambda _done: None)
        return simulation.result()

    found = present(run_virtual(run()))
    assert found.missing == ()
    assert found.rotation.count
    return found


def in_order(plan: Plan) -> bool:
    shortest, typical, longest = (plan.rotation_ns(case) for case in CASES)
    return shortest <= typical <= longest


def test_a_round_that_waits_for_a_min_slave_interval() -> None:
    """25 ms are 12 500 bit times. A round of 37 + 110 + 11 + 110 and its token of 70 end long before; the typical one
    ends with the first turn of the token after them, the longest one with a turn that has all else."""
    slaves: list[dict[str, object]] = [{"config": "10 20", "min_slave_interval": 250}]
    plan = plan_bus(config_of({"baud": 500_000, "gap": 0}, slaves))
    bits = [plan.rotations[case].bits for case in CASES]
    typical = 110 + 60 + 110 + 37 + 70
    assert bits[0] == 12_500
    assert bits[1] == typical + -(-(12_500 - typical) // 70) * 70
    longest = plan.rotations[Case.LONGEST]
    assert bits[2] == 12_500 + longest.beside + 70
    assert plan.as_dict()["rotation_us"] == {"min": 25_000.0, "typical": 2 * bits[1], "max": 2 * bits[2]}


def test_the_shortest_rotation_of_rate_groups_is_the_emptiest_round() -> None:
    """Slave 3 in each round; 4, 5 and 6 take turns, the last one with 41 characters of 11 bits each way."""
    slaves: list[dict[str, object]] = [{"config": "10 20"}, *({"config": "10", "every": 3} for _ in range(2))]
    slaves.append({"config": "5F 6F", "every": 3})
    plan = plan_bus(config_of({"baud": 500_000, "gap": 0}, slaves))
    each, short, long = 110 + 11 + 110 + 37, 66 + 11 + 110 + 37, 451 + 11 + 451 + 37
    assert plan.rotations[Case.SHORTEST].bits == each + short + 70
    assert plan.rotations[Case.TYPICAL].bits == each + long + 2 * 49 + 70


def test_rounds_without_a_slave_belong_to_the_rotation() -> None:
    """One slave in every fifth round: four rounds of one token (70 bit times) follow."""
    plan = plan_bus(config_of({"baud": 500_000, "gap": 0}, [{"config": "10 20", "every": 5}]))
    assert plan.rotations[Case.TYPICAL].bits == 110 + 60 + 110 + 37 + 70 + 4 * 70
    assert plan.figures.full_ns(Case.TYPICAL) == 2000 * (110 + 60 + 110 + 37 + 70)


@given(BUSES, st.lists(SLAVES, min_size=1, max_size=8), st.sampled_from(["0", "1", "3", "[3.5, 20]"]))
@examples(60)
def test_the_cases_are_in_order(bus: dict[str, object], slaves: list[dict[str, object]], others: str) -> None:
    assert in_order(plan_bus(config_of(bus, slaves, other_masters=others)))


@given(BUSES, st.lists(SLAVES, min_size=1, max_size=5))
@examples(12, soak=40)
def test_the_simulated_bus_stays_within_the_plan(bus: dict[str, object], slaves: list[dict[str, object]]) -> None:
    config = config_of(bus, slaves)
    plan = plan_bus(config)
    times = simulate(config, plan).rotation
    bit = plan.params.ns(1)  # the plan counts whole bit times
    assert in_order(plan)
    assert times.min_ns >= plan.rotation_ns(Case.SHORTEST) - bit
    assert times.max_ns <= plan.rotation_ns(Case.LONGEST) + bit


@given(BUSES, st.lists(SLAVES, min_size=1, max_size=5), st.sampled_from([1, 3, 10, 100] if soaking() else [1, 3]))
@examples(4, soak=25)
def test_the_simulated_cycles_stay_within_the_plan(
    bus: dict[str, object], slaves: list[dict[str, object]], cycle_ms: int
) -> None:
    """With a fixed cycle the time from round to round is whole cycles, but for the delays of their beginnings."""
    config = config_of(bus, slaves, cycle_ms=cycle_ms)
    plan = plan_bus(config)
    if plan.refusals:
        return
    found = simulate(config, plan)
    late = present(found.cycles).late.max_ns + plan.params.ns(1)
    assert found.rotation.min_ns >= plan.figures.between_ns(Case.SHORTEST) - late
    assert found.rotation.max_ns <= plan.figures.between_ns(Case.LONGEST) + late
