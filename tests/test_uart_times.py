"""The times of the UART level, by hand at four rates, and that a slow port lengthens deadlines but no minimum gap."""

from __future__ import annotations

from itertools import pairwise

import pytest
from ring_bus import ListUser, RingBus, fixed

from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Req
from dpstack.params import T_SYN, BusParams
from dpstack.phy.line import Line
from dpstack.phy.patience import ADAPTER, EXACT, HOST, Patience, slack
from dpstack.units import NS_PER_MS

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
