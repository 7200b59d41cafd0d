"""``extra_idle_bits``: slaves that find the end of a telegram by a pause get it before whatever the master sends."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise

import pytest
from api_kit import bus_of, operating, stack_of
from bus_kit import SimBus
from support import MS

import dpstack
from dpstack.dp.plan.rotation_time import Case
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import WireEntry
from dpstack.units import ns_to_bits

pytestmark = pytest.mark.virtual_time

BAUD = 500_000
EXTRA = 300
#: after an answer or a token: T_QUI 0 + 2 x T_SET 1 + 2 + T_SYN 33; after Global_Control: max T_SDR 100
T_ID1, T_ID2 = 37 + EXTRA, 100 + EXTRA
SLAVES = {"3", "4", "5"}


def kind(entry: WireEntry) -> str:
    """What stands on the wire, told by its octets alone (master 2)."""
    octets, slave = entry.octets, entry.sender in SLAVES
    if slave:
        return "answer"
    if octets[0] == 0xDC:
        return "token"
    if octets[0] == 0x10:
        return "gap poll"
    return "global control" if octets[4] & 0x7F == 127 else "request"


def test_the_pause_is_kept_before_everything_that_is_sent(w: World) -> None:
    """Requests, retries, GAP polls, tokens and Global_Control, in exact bits; a slave dies on the way."""
    bus = SimBus(w, BusParams.preset(BAUD, gap=1, hsa=20, extra_idle=EXTRA, t_tr=5_000), (3, 4, 5))
    entries: list[WireEntry] = []
    w.log.listener = entries.append
    bus.until_exchanging()
    w.run_for(300 * MS)
    w.remove(bus.slaves[4])
    w.run_for(300 * MS)
    assert bus.station.stats.station(4).retries

    pauses: dict[tuple[str, str], set[int]] = defaultdict(set)
    wire = sorted(entries, key=lambda entry: entry.start_ns)
    for before, after in pairwise(wire):
        pauses[kind(before), kind(after)].add(ns_to_bits(after.start_ns - before.end_ns, BAUD))
    answers = {key: found for key, found in pauses.items() if key[1] == "answer"}
    assert set().union(*answers.values()) == {11}  # a slave's own time is as short as ever
    sent = {key: found for key, found in pauses.items() if key[1] != "answer"}
    assert {what for _, what in sent} == {"request", "gap poll", "token", "global control"}
    for (before_, after_), found in sent.items():
        # after a slot time of 200 bits in vain the pause is not over yet
        exact = {T_ID2 if before_ == "global control" else T_ID1}
        if after_ == "token":  # after a claim, tokens to oneself are TS = 2 bits late for one pass over the GAP
            found = found - {bits + 2 for bits in exact}
        assert found == exact, (before_, after_)
    assert ("request", "request") in sent  # repeated in vain, and given up
    assert ("gap poll", "token") in sent


@pytest.mark.parametrize("extra", [0, 1, 50, 1_000])
async def test_the_plan_counts_it(extra: int) -> None:
    tables: list[dict[str, object]] = [
        {"name": f"s{address}", "address": address, "ident": 1, "config": "20 10"} for address in (3, 4)
    ]

    async with operating(*tables, gap=0, extra_idle_bits=extra) as bus:
        master = stack_of(bus).master
        master.rotation = Histogram()  # without the rounds of the bring-up
        await bus.rotated(30)
        # each slave: SD2 with one octet both ways, T_SDR 11, T_ID1; the token and T_ID1
        by_hand = 2 * (110 + 11 + 110 + 37 + extra) + 33 + 37 + extra
        assert bus.plan.rotations[Case.SHORTEST].bits == by_hand
        assert abs(master.rotation.min_ns - by_hand * 2_000) <= 5 * 2_000


async def test_the_plan_shows_it_and_names_what_is_impossible() -> None:
    async with bus_of(extra_idle_bits=50) as bus:
        parameters = bus.plan.as_dict()["parameters"]
        assert isinstance(parameters, dict)
        assert (parameters["extra_idle"], parameters["t_id1"], parameters["t_id2"]) == (50, 87, 150)
    with pytest.raises(dpstack.ConfigError, match=r"extra_idle_bits"):
        bus_of(extra_idle_bits=-1)
