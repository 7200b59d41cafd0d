"""When a master is told as joined or left, and that octets at random tell of none."""

from __future__ import annotations

from random import Random

import pytest
from support import MS

from dpstack.fdl.active.las_gap import Announced
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.decoder import DecoderStats
from dpstack.fdl.events import MasterSeen
from dpstack.machine import pump
from dpstack.params import BusParams
from dpstack.units import chars_to_ns


def of(*members: int) -> frozenset[int]:
    return frozenset(members)


def test_joined_with_its_second_token() -> None:
    told = Announced(DecoderStats())
    assert told.token(4, of(4)) == []
    assert told.token(4, of(4)) == [(4, True)]
    assert told.token(4, of(4)) == []
    assert told.masters == {4}
    assert told.token(9, of(4, 9)) == []
    assert told.token(4, of(4, 9)) == []
    assert told.token(9, of(4, 9)) == [(9, True)]


def test_left_when_its_predecessor_passes_it_over_twice() -> None:
    told = Announced(DecoderStats())
    told.certain(4, True)
    told.certain(9, True)
    assert told.token(4, of(4)) == []
    assert told.token(4, of(4, 9)) == []  # it was only one token that said so
    assert told.token(4, of(4)) == []
    assert told.token(2, of(4)) == []
    assert told.token(4, of(4)) == [(9, False)]


def test_an_unreadable_octet_between_two_tokens_begins_anew() -> None:
    received = DecoderStats()
    told = Announced(received)
    told.token(4, of(4))
    received.skipped += 1
    assert told.token(4, of(4)) == []
    assert told.token(4, of(4)) == [(4, True)]
    assert told.token(7, of(7)) == []
    received.skipped += 5
    assert told.token(7, of(7)) == []
    assert told.token(7, of(7)) == [(4, False), (7, True)]


def test_a_checked_telegram_counts_at_once() -> None:
    told = Announced(DecoderStats())
    assert told.certain(5, True) == [(5, True)]
    assert told.certain(5, True) == []
    assert told.certain(5, False) == [(5, False)]
    told.certain(6, True)
    told.forget()
    assert told.certain(6, False) == []


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
