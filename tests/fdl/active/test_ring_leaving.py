"""A master that leaves a ring on slow ports: what the others lose by it, counted by hand from the wire."""

from __future__ import annotations

from itertools import pairwise

import pytest
from ring_bus import RingBus, Sent, ring_of

from dpstack.fdl.active.states import State
from dpstack.fdl.commands import GoOffline
from dpstack.phy.patience import EXACT, HOST, Patience
from dpstack.units import NS_PER_MS

#: 187.5 kbit/s: T_SL 100 and the octet that has to end, 111 bit times
SLOT_MS = 0.592


def ring(patience: Patience, *addresses: int, mode: str = "whole") -> RingBus:
    ms = 8_000 if patience is HOST else 600
    return ring_of(*addresses, baud=187_500, mode=mode, patience=patience, ms=ms, hsa=9)


def silences(log: list[Sent]) -> list[float]:
    """The silences of more than 5 ms, in ms."""
    found = [(after.start - before.end) / NS_PER_MS for before, after in pairwise(log)]
    return [silence for silence in found if silence > 5]


@pytest.mark.parametrize("leaving", [1, 3, 7], ids=["before", "between", "behind"])
def test_a_leaving_master_costs_the_stall_of_a_host_once(leaving: int) -> None:
    """50 ms at the first token, 12.5 at each of the two repetitions; the new successor takes its first token.

    It was 3 x 50 ms, 50 ms for the token that the new successor refused, and 50 ms for the next GAP poll.
    """
    bus = ring(HOST, 2, 5, leaving, mode="chunk")
    begun = len(bus.log)
    bus.command(bus.stations[2], GoOffline(), run_ms=3_000)
    assert silences(bus.log[begun - 1 :]) == pytest.approx([50 + SLOT_MS, 12.5 + SLOT_MS, 12.5 + SLOT_MS], abs=0.1)
    assert [set(station.las) for station in bus.stations[:2]] == [{2, 5}, {2, 5}]
    assert all(station.stats.tokens_lost == 0 for station in bus.stations)


@pytest.mark.parametrize("mode", ["whole", "octets"])
def test_the_new_successor_takes_the_first_token_of_a_station_that_repeated_a_pass_in_vain(mode: str) -> None:
    bus = ring(EXACT, 2, 3, 5, mode=mode)
    two, three, five = bus.stations
    bus.until(three, State.ACTIVE_IDLE)
    bus.kill(three)
    begun = len(bus.log)
    bus.run_ms(20)
    tokens = [sent.octets.hex() for sent in bus.log[begun:] if sent.octets[0] == 0xDC]
    vain = tokens.index("dc0302")
    assert tokens[vain : vain + 5] == ["dc0302", "dc0302", "dc0302", "dc0502", "dc0205"]
    assert two.las == five.las == {2, 5}


@pytest.mark.parametrize(
    ("heard", "taken"),
    [
        (("dc0302", "dc0502"), True),
        (("dc0302", "dc0302", "dc0502"), True),
        (("dc0502",), False),
        (("dc0302", "100903495516", "dc0502"), False),  # station 3 asks: it took the token after all
        (("dc0302", "dc0603", "dc0502"), False),
        (("dc0302", "dc0501"), False),  # another one than who repeated
        (("dc0302", "100903495516", "dc0502", "dc0502"), True),  # as ever
    ],
)
def test_a_station_repeats_a_pass_in_vain_when_it_passes_twice(heard: tuple[str, ...], taken: bool) -> None:
    """Station 3 comes before station 5 in its ring: a token from another one is a stranger's, refused once.

    Station 5 has heard one pass from 2 to 3 when its time begins.
    """
    bus = ring(EXACT, 2, 3, 5)
    five = bus.stations[2]
    bus.until(five, State.USE_TOKEN)
    bus.until(five, State.ACTIVE_IDLE)
    assert bus.log[-1].octets.hex() == "dc0302"
    del bus.stations[:2]
    bus.run_bits(100)
    tokens = five.stats.tokens
    for octets in heard:
        bus._say(bytes.fromhex(octets), 99)
        bus.run_bits(11 * len(octets) // 2 + 50)
    assert five.stats.tokens == tokens + taken
