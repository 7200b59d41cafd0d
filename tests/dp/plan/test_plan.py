"""The plan: rotations counted by hand from the telegrams, T_TR, watchdogs, findings."""

from __future__ import annotations

import pytest

from dpstack.dp.plan.plan import make_plan
from dpstack.dp.plan.rotation_time import Case, Figures, OtherMasters, rotation
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NS_PER_MS, NS_PER_US


def slave(
    address: int = 3,
    config: str = "F3 71",
    *,
    watchdog: int | None = None,
    interval_ns: int = 0,
    max_tsdr: int | None = None,
    every: int = 1,
    on_loss: str = "",
) -> SlaveParams:
    return SlaveParams(
        address=address,
        name=f"s{address}",
        ident=0x1234,
        config=bytes.fromhex(config),
        watchdog_ms=watchdog,
        min_slave_interval_ns=interval_ns,
        max_tsdr={} if max_tsdr is None else dict.fromkeys(BAUD_RATES, max_tsdr),
        every=every,
        on_loss=on_loss,
    )


def params(baud: int = 500_000, *, gap: int | None = 0, t_tr: int | None = None) -> BusParams:
    return BusParams.preset(baud, gap=gap, t_tr=t_tr)


# Counted by hand: request and answer in characters of 11 bits, T_SDR 11, T_ID1 37 (up to 1.5 Mbit/s); token 33 + 37.
SHORTEST = [
    ("F3 71", (9 + 12) * 11 + 11 + (9 + 12) * 11 + 37 + 70),  # PPO1: 12 octets each way
    ("71", (9 + 4) * 11 + 11 + (9 + 4) * 11 + 37 + 70),  # PPO3: 4 octets each way
    ("10", 6 * 11 + 11 + (9 + 1) * 11 + 37 + 70),  # inputs only: the request is SD1
    ("20", (9 + 1) * 11 + 11 + 1 * 11 + 37 + 70),  # outputs only: the answer is SC
    ("00", 6 * 11 + 11 + 1 * 11 + 37 + 70),  # neither
]


@pytest.mark.parametrize(("config", "bits"), SHORTEST)
def test_shortest_by_hand(config: str, bits: int) -> None:
    assert rotation(params(), [slave(config=config)], Case.SHORTEST).bits == bits


def test_shortest_of_several_is_the_sum_and_one_token() -> None:
    both = rotation(params(), [slave(3, "F3 71"), slave(4, "71")], Case.SHORTEST)
    assert both.slaves == {3: 510, 4: 334}
    assert both.bits == 510 + 334 + 70


def test_t_id1_at_12_mbit() -> None:
    # T_QUI 9 + 2 x 16 + 2 + 33 = 76
    assert rotation(params(12_000_000), [slave(config="71")], Case.SHORTEST).bits == 13 * 11 * 2 + 11 + 76 + 33 + 76


def test_without_slaves_only_the_token_goes_round() -> None:
    assert rotation(params(), [], Case.SHORTEST).bits == 70


def test_typical_takes_60_bits_and_a_silent_gap_poll() -> None:
    off = rotation(params(gap=0), [slave()], Case.TYPICAL).bits
    assert off == 580 - 11 + 60
    assert rotation(params(gap=1), [slave()], Case.TYPICAL).bits == off + 66 + 200  # SD1, then T_SL


def test_typical_keeps_a_fast_slave_fast() -> None:
    fast = slave(max_tsdr=15)
    assert rotation(params(), [fast], Case.TYPICAL).bits == 580 - 11 + 15


def test_longest_counts_retries_diagnosis_acyclic_global_control_and_gap() -> None:
    p = params(gap=1)
    retry = 21 * 11 + 200
    exchange = retry + 21 * 11 + 100 + 21 * 11 + 37
    diagnosis = (11 * 11 + 200) + 11 * 11 + 100 + 255 * 11 + 37
    acyclic = (255 * 11 + 200) + 255 * 11 + 100 + 15 * 11 + 37  # Write of 240 octets, its answer has four
    control = 13 * 11 + 100
    assert rotation(p, [slave()], Case.LONGEST).bits == exchange + diagnosis + acyclic + control + 66 + 200 + 70


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_cases_are_in_order_at_every_rate(baud: int) -> None:
    slaves = [slave(n) for n in range(3, 13)]
    plan = make_plan(params(baud, gap=None), slaves)
    bits = [plan.rotations[case].bits for case in (Case.SHORTEST, Case.TYPICAL, Case.NORMAL, Case.LONGEST)]
    assert bits == sorted(bits)
    assert bits[0] < bits[-1]


def test_min_slave_interval_holds_the_rounds_back() -> None:
    # 286 bits at 12 Mbit/s are less than 100 us = 1200 bits: the token goes round (109 bits) until they are over
    p = params(12_000_000)
    free, held = (
        [rotation(p, [slave(config="71", interval_ns=ns)], case).bits for case in (Case.SHORTEST, Case.TYPICAL)]
        for ns in (0, 100 * NS_PER_US)
    )
    assert free[0] < 1200
    assert held[0] == 1200
    assert (held[1] - free[1]) % 109 == 0
    assert 1200 <= held[1] < 1200 + 109
    plan = make_plan(p, [slave(config="71", interval_ns=100 * NS_PER_US)])
    assert any("Min_Slave_Interval" in note for note in plan.notes)
    assert not plan.findings


def test_watchdog_is_three_times_the_longest_but_not_less_than_200() -> None:
    assert Figures(params(), [slave()]).watchdog_ms() == 200
    assert Figures(params(), [slave()]).watchdog_ms(pty=True) == 1000
    slow = params(9600)
    longest = slow.ns(rotation(slow, [slave()], Case.LONGEST).bits)
    recommended = Figures(slow, [slave()]).watchdog_ms()
    assert recommended % 10 == 0
    assert 3 * longest <= recommended * NS_PER_MS < 3 * longest + 10 * NS_PER_MS


def test_t_tr_is_the_tables_unless_the_round_needs_more() -> None:
    assert Figures(params(), [slave()]).t_tr_preset == 100_000
    many = [slave(n, "FF FF FF FF") for n in range(3, 100)]
    normal = rotation(params(), many, Case.NORMAL).bits
    assert normal > 100_000
    acyclic = 255 * 11 + 100 + 15 * 11 + 37  # a Write of 240 octets, its answer has four
    # after a whole token rotation there must be time left for a whole hold: all but the token (33) and T_ID1 (37)
    assert Figures(params(), many).t_tr_preset == (normal + acyclic) + (normal + acyclic - 70)


def test_t_tr_counts_an_acyclic_service_of_every_master() -> None:
    acyclic = 255 * 11 + 100 + 15 * 11 + 37
    normal = rotation(params(), [slave()], Case.NORMAL).bits
    hold = normal - 70
    assert Figures(params(), [slave()]).t_tr_needed == normal + acyclic + hold + acyclic
    assert Figures(params(), [slave()], OtherMasters(alike=2)).t_tr_needed == 3 * (normal + acyclic) + hold + acyclic
    listed = Figures(params(), [slave()], OtherMasters(rounds=(10_000, 500)))
    assert listed.t_tr_needed == normal + 10_500 + 3 * acyclic + (10_000 - 70) + acyclic


def test_finding_watchdog_shorter_than_the_longest_rotation() -> None:
    plan = make_plan(params(9600), [slave(watchdog=200)])
    (finding,) = plan.findings
    assert "slave 3 (s3)" in finding
    assert "watchdog of 200 ms" in finding
    assert "9.6 kbit/s" in finding
    assert make_plan(params(9600), [slave()]).findings == ()


def test_finding_t_tr_too_small() -> None:
    plan = make_plan(params(t_tr=3000), [slave(n) for n in range(3, 23)])
    (finding,) = plan.findings
    assert "t_tr = 3000" in finding


def test_finding_slave_slower_than_t_sl() -> None:
    plan = make_plan(params(), [slave(max_tsdr=400)])
    assert any("t_sl = 200" in finding and "415" in finding for finding in plan.findings)


def test_watchdog_of_every_nth_round() -> None:
    p = params(187_500)
    longest_ms = p.ns(rotation(p, [slave()], Case.LONGEST).bits) / NS_PER_MS
    watchdog = round(longest_ms * 2) // 10 * 10 + 10
    assert not make_plan(p, [slave(watchdog=watchdog)]).findings
    assert make_plan(p, [slave(watchdog=watchdog, every=5)]).findings


def test_outputs_of_each_slave_when_the_master_stops() -> None:
    plan = make_plan(params(), [slave(3, on_loss="coasts"), slave(4, watchdog=0), slave(5, watchdog=1234)])
    assert [s.on_loss for s in plan.slaves] == [
        "after 200 ms: coasts",
        "goes on with its last outputs: its watchdog is off",
        "after 1240 ms: as its manual says (usually outputs off)",
    ]
    assert [s.watchdog_ms for s in plan.slaves] == [200, 0, 1240]
    assert any("watchdog is off" in note for note in plan.notes)


def test_as_dict_has_the_shape_of_the_command() -> None:
    data = make_plan(params(), [slave()], notes=["a note"], findings=["a finding"]).as_dict()
    assert data["baud"] == 500_000
    assert data["rotation_us"] == {"min": 1160.0, "typical": 1258.0, "max": pytest.approx(28_000, rel=0.5)}
    assert isinstance(data["parameters"], dict)
    assert data["parameters"]["t_sl"] == 200
    assert data["findings"] == ["a finding"]
    assert data["notes"] == ["a note"]
    (one,) = data["slaves"] if isinstance(data["slaves"], list) else []
    assert one["address"] == 3


def test_the_watchdog_outlasts_the_death_of_a_neighbour_on_a_slow_adapter() -> None:
    """60 ms of slack, one retry: the others wait 2 x (T_SL + 60 ms) = 120.8 ms; three times that is over 200 ms."""
    params = BusParams.preset(500_000, address=2)
    setups = [SlaveParams(address=3, name="one", ident=1, config=b"\x71")]
    assert Figures(params, setups).watchdog_ms() == 200
    assert Figures(params, setups, host_slack_ns=60_000_000).watchdog_ms() >= 370


def test_a_watchdog_shorter_than_the_worst_case_with_a_dying_slave() -> None:
    """While one slave dies the others wait for its slot time and the host's slack, with the retry: 2 x 50.4 ms."""
    assert make_plan(params(), [slave(watchdog=100)]).findings == ()
    plan = make_plan(params(), [slave(watchdog=100)], host_slack_ns=50 * NS_PER_MS)
    (finding,) = plan.findings
    assert "its watchdog of 100 ms is shorter than the longest rotation can take" in finding
    assert "101 ms of it waiting for a slave that dies" in finding


def test_an_effective_watchdog_other_than_asked_for_is_noted() -> None:
    plan = make_plan(params(), [slave(watchdog=215), slave(4, watchdog=200)])
    assert [s.watchdog_ms for s in plan.slaves] == [220, 200]
    (note,) = plan.notes
    assert note.startswith("slave 3 (s3): its watchdog is 220 ms instead of 215 ms")


def test_a_data_control_time_shorter_than_the_bus_can_be() -> None:
    plan = make_plan(params(), [slave(every=1000), slave(4)], data_control_ns=100 * NS_PER_MS)
    (finding,) = [f for f in plan.findings if "data_control_time_ms" in f]
    assert finding.startswith("slave 3 (s3): 1000 of the longest rotations can take")
    assert make_plan(params(), [slave(), slave(4)], data_control_ns=100 * NS_PER_MS).findings == ()
