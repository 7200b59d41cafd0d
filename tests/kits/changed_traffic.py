"""The traffic of a small bus in virtual time, and a strategy of parts of it, with changes: lost, damaged, late."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from itertools import groupby

from bus_kit import SimBus
from hypothesis import strategies as st
from support import MS, S

from dpstack.capture.transmission import Columns, Damage, Transmission
from dpstack.params import BusParams
from dpstack.sim.world import World

BAUD = 1_500_000
EPOCH = 1_790_000_000 * S


@cache
def traffic() -> tuple[Transmission, ...]:
    """Bring-up and exchange of four slaves, one that is absent, one that goes."""
    heard: list[Transmission] = []
    world = World(referee=False)
    world.log.listener = lambda one: heard.append(Transmission(one.octets, one.start_ns + EPOCH, BAUD))
    bus = SimBus(world, BusParams.preset(BAUD, address=2), (3, 4, 5, 6, 9), silent=(9,), watchdog_ms=500)
    world.run_for(40 * MS)
    world.remove(bus.slaves[4])
    world.run_for(6 * MS)
    return tuple(heard)


Change = Callable[[Transmission], list[Transmission]]


def _shift(one: Transmission, ns: int) -> Transmission:
    return one._replace(t_ns=(one.t_ns or 0) + ns)


def _flipped(one: Transmission) -> Transmission:
    return one._replace(octets=one.octets[:-1] + bytes((one.octets[-1] ^ 4,)))


def _other_data(one: Transmission) -> Transmission:
    octets = bytearray(one.octets)
    if len(octets) > 9:
        octets[7] ^= 1
        octets[-2] = octets[-2] + 1 - 2 * (~octets[7] & 1) & 0xFF
    return one._replace(octets=bytes(octets))


#: by name: what may happen to one transmission
CHANGES: dict[str, Change] = {
    "lost": lambda one: [],
    "twice": lambda one: [one, one],
    "damaged": lambda one: [_flipped(one)],
    "marked": lambda one: [one._replace(damage=int(Damage.PARITY_OR_FRAMING))],
    "noise": lambda one: [one._replace(octets=b"\x68" * 300), one],
    "other data": lambda one: [_other_data(one)],
    "without a time": lambda one: [one._replace(t_ns=None)],
    "together": lambda one: [_shift(one, -15_000)],
    "earlier": lambda one: [_shift(one, -S)],
    "another rate": lambda one: [one._replace(baud=500_000)],
    "no rate": lambda one: [one._replace(baud=0)],
    "short acknowledgement": lambda one: [one._replace(octets=b"\xe5")],
    "the token to another one": lambda one: [one._replace(octets=b"\xdc\x05\x02")],
}


@st.composite
def recorded(draw: st.DrawFn) -> list[list[Transmission]]:
    """A part of the traffic, with changes at some places and pauses after some, in batches."""
    whole = traffic()
    begin = draw(st.integers(0, len(whole) - 100))
    part = whole[begin : begin + draw(st.integers(50, 150))]
    places = st.integers(0, len(part) - 1)
    changes = draw(st.dictionaries(places, st.sampled_from(sorted(CHANGES)), max_size=12))
    pauses = draw(st.dictionaries(places, st.sampled_from([50_000, S, 3 * S, 61 * S]), max_size=3))
    ends = draw(st.sets(places, max_size=4))
    batches: list[list[Transmission]] = [[]]
    shift = 0
    for number, one in enumerate(part):
        moved = _shift(one, shift)
        batches[-1] += CHANGES[changes[number]](moved) if number in changes else [moved]
        shift += pauses.get(number, 0)
        if number in ends:
            batches.append([])
    return batches


def in_columns(heard: Iterable[Transmission]) -> list[Columns | list[Transmission]]:
    """``heard`` as a reader of pcapng delivers it."""
    found: list[Columns | list[Transmission]] = []
    for (baud, usual), part in groupby(heard, lambda one: (one.baud, one.t_ns is not None and not one.damage)):
        if usual:
            octets, times, *_ = zip(*part, strict=True)
            found.append(Columns(baud, list(octets), list(times)))
        else:
            found += [[one] for one in part]
    return found
