"""Rotation times that others have published, against the typical one.

Sources: "Estimation formula" in Felser's PROFIBUS manual (felser.ch/profibus-manual/schatzformel.html): T = (380 + 300
slaves + 11 octets) t_bit + 75 us, said to be right within 10 % above 500 kbit/s, with two worked examples. "PROFIBUS-DP
response times" in the Saia-Burgess PCD0 manual 26/766 E2, section 13.10. "Available objects" in the manual of the Demag
Dedrive Compact, section 10.

Assumptions where a source is silent: each slave has inputs and outputs (the formula counts two telegrams with data a
slave, 300 = 33 + 2 x 99 + 32 + 37; what it is without is tested, too), and the GAP is on with a silent poll a rotation,
as the formula's 380 has it.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from planned_bus import identifiers, setups

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import load_config
from dpstack.dp.plan.rotation_time import Case, rotation
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def typical_us(baud: int, lengths: list[tuple[int, int]]) -> float:
    params = BusParams.preset(baud, gap=10)
    return params.ns(rotation(params, setups([identifiers(*each) for each in lengths]), Case.TYPICAL).bits) / 1000


def estimate_us(baud: int, slaves: int, octets: int) -> float:
    return (380 + 300 * slaves + 11 * octets) * 1e6 / baud + 75


def test_twenty_terminals_with_80_octets_at_1_5_mbit() -> None:
    """640 digital inputs and outputs: two octets each way at each of 20 slaves."""
    assert estimate_us(1_500_000, 20, 80) == pytest.approx(4915, abs=1)
    assert typical_us(1_500_000, [(2, 2)] * 20) == pytest.approx(4900, rel=0.1)


def test_four_slaves_with_46_octets_at_3_mbit() -> None:
    """The example gives inputs and outputs of each slave, so two telegrams are short ones without data."""
    slaves = [(3, 3), (5, 0), (10, 20), (0, 5)]
    assert sum(map(sum, slaves)) == 46
    assert typical_us(3_000_000, slaves) == pytest.approx(770, rel=0.1)
    assert typical_us(3_000_000, slaves) < 1000 < typical_us(1_500_000, slaves)  # the rate the example arrives at


@given(
    st.sampled_from([baud for baud in BAUD_RATES if baud > 500_000]),
    st.lists(st.tuples(st.integers(1, 244), st.integers(1, 244)), min_size=1, max_size=60),
)
def test_the_formula_everywhere_above_500_kbit(baud: int, lengths: list[tuple[int, int]]) -> None:
    estimate = estimate_us(baud, len(lengths), sum(map(sum, lengths)))
    assert typical_us(baud, lengths) == pytest.approx(estimate, rel=0.1)


@pytest.mark.parametrize("baud", [baud for baud in BAUD_RATES if baud > 500_000])
@pytest.mark.parametrize("slaves", [1, 2, 10, 50, 124])
@pytest.mark.parametrize("octets", [1, 2, 12, 244])
def test_the_formula_at_the_edges_of_its_domain(baud: int, slaves: int, octets: int) -> None:
    lengths = [(octets, octets)] * slaves
    assert typical_us(baud, lengths) == pytest.approx(estimate_us(baud, slaves, 2 * octets * slaves), rel=0.1)


#: a request without outputs is SD1 instead of SD2, an answer without inputs a single character
WITHOUT_OUTPUTS, WITHOUT_INPUTS = 3 * 11, 8 * 11


@given(
    st.sampled_from([baud for baud in BAUD_RATES if baud > 500_000]),
    st.lists(st.tuples(st.integers(0, 32), st.integers(0, 32)), min_size=1, max_size=60),
)
def test_the_formula_counts_two_telegrams_with_data_a_slave(baud: int, lengths: list[tuple[int, int]]) -> None:
    """Where one has none it is too much by those characters: up to 12 % without outputs, up to 40 % without both."""
    spared = sum(WITHOUT_OUTPUTS * (not out) + WITHOUT_INPUTS * (not in_) for in_, out in lengths)
    estimate = estimate_us(baud, len(lengths), sum(map(sum, lengths)))
    assert typical_us(baud, lengths) + spared * 1e6 / baud == pytest.approx(estimate, rel=0.1)


@pytest.mark.parametrize("baud", [baud for baud in BAUD_RATES if baud <= 500_000 and baud != 45_450])
@pytest.mark.parametrize("slaves", [5, 20, 100])
@pytest.mark.parametrize("octets", [1, 12, 60])
def test_below_its_domain_the_formula_holds_from_five_slaves_on(baud: int, slaves: int, octets: int) -> None:
    """Its 380 bit times have a slot time of 1.5 Mbit/s; at 45.45 kbit/s T_SET, and T_ID1 with it, are far larger."""
    lengths = [(octets, octets)] * slaves
    assert typical_us(baud, lengths) == pytest.approx(estimate_us(baud, slaves, 2 * octets * slaves), rel=0.1)


def test_ten_nodes_with_8_octets_each_way_as_saia_burgess_counts_them() -> None:
    """336 us a node at 1.5 Mbit/s and 44 us at 12 Mbit/s: exchanges only, without token and GAP."""
    for baud, us in ((1_500_000, 336), (12_000_000, 44)):
        params = BusParams.preset(baud)
        shares = rotation(params, setups([identifiers(8, 8)] * 10), Case.TYPICAL).slaves
        assert params.ns(sum(shares.values())) / 1000 == pytest.approx(10 * us, rel=0.1)


def test_the_manuals_1_to_2_ms_with_the_configuration_it_needs() -> None:
    """Few stations, a high rate, short objects: five drives with PPO3 at 1.5 Mbit/s."""
    plan = plan_bus(load_config(EXAMPLES / "two_milliseconds.toml"))
    assert plan.params.baud == 1_500_000
    assert [s.setup.input_len + s.setup.output_len for s in plan.slaves] == [8] * 5
    assert 1_000_000 < plan.rotation_ns(Case.SHORTEST) < plan.rotation_ns(Case.TYPICAL) < 2_000_000
    # by hand: 13 characters each way, T_SDR, T_ID1 for each drive; the token and T_ID1; a poll of SD1 and T_SL
    assert plan.rotations[Case.SHORTEST].bits == 5 * (143 + 11 + 143 + 37) + 33 + 37
    assert plan.rotations[Case.TYPICAL].bits == 5 * (143 + 60 + 143 + 37) + 33 + 37 + 66 + 300
    slower = plan_bus(load_config(EXAMPLES / "two_milliseconds.toml"), 500_000)
    assert slower.rotation_ns(Case.SHORTEST) > 2_000_000
