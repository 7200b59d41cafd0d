"""Reports that a master joined or left the ring; octets at random cause none."""

from __future__ import annotations

from random import Random

import pytest
from support import MS

from dpstack.fdl.active.las_gap import Announced
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.events import MasterSeen
from dpstack.fdl.interface import DecoderStats
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.units import chars_to_ns


def of(*members: int) -> frozenset[int]:
    return frozenset(members)


def test_joined_with_its_second_token() -> None:
    announced = Announced(DecoderStats())
    assert announced.token(4, of(4)) == []
    assert announced.token(4, of(4)) == [(4, True)]
    assert announced.token(4, of(4)) == []
    assert announced.masters == {4}
    assert announced.token(9, of(4, 9)) == []
    assert announced.token(4, of(4, 9)) == []
    assert announced.token(9, of(4, 9)) == [(9, True)]


def test_left_when_its_predecessor_passes_it_over_twice() -> None:
    announced = Announced(DecoderStats())
    announced.certain(4, True)
    announced.certain(9, True)
    assert announced.token(4, of(4)) == []
    assert announced.token(4, of(4, 9)) == []  # it was only one token that said so
    assert announced.token(4, of(4)) == []
    assert announced.token(2, of(4)) == []
    assert announced.token(4, of(4)) == [(9, False)]


def test_an_unreadable_octet_between_two_tokens_begins_anew() -> None:
    received = DecoderStats()
    announced = Announced(received)
    announced.token(4, of(4))
    received.skipped += 1
    assert announced.token(4, of(4)) == []
    assert announced.token(4, of(4)) == [(4, True)]
    assert announced.token(7, of(7)) == []
    received.skipped += 5
    assert announced.token(7, of(7)) == []
    assert announced.token(7, of(7)) == [(4, False), (7, True)]


def test_a_checked_telegram_counts_at_once() -> None:
    announced = Announced(DecoderStats())
    assert announced.certain(5, True) == [(5, True)]
    assert announced.certain(5, True) == []
    assert announced.certain(5, False) == [(5, False)]
    announced.certain(6, True)
    announced.forget()
    assert announced.certain(6, False) == []


@pytest.mark.parametrize("pause_ns", [2 * MS, 50 * MS])
@pytest.mark.parametrize("longest", [20, 200])
def test_octets_at_random_are_no_masters(pause_ns: int, longest: int) -> None:
    """As at a wrong rate: alone on the bus in between, or never given the silence to claim the token."""
    rng = Random(longest)
    station = ActiveStation(BusParams.preset(500_000, address=7), [])
    now, sent = 0, 0

    def transmit(octets: bytes, at: int) -> int:
        nonlocal sent
        sent += 1
        return at + chars_to_ns(len(octets), 500_000)

    station.command(GoOnline(), 0)
    deadline = pump(station, b"", 0, transmit)
    for _ in range(500):
        until = now + rng.randrange(pause_ns)
        while deadline <= until:
            now = max(now, deadline)
            deadline = pump(station, b"", now, transmit)
        now = until
        deadline = pump(station, rng.randbytes(rng.randrange(1, longest)), now, transmit)
        assert [e.text for e in station.take_events() if isinstance(e, MasterSeen)] == []
    assert (sent > 50) is (pause_ns > 10 * MS)
