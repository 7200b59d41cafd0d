"""A listening station on the virtual wire: it delivers what the world put on the line, to the nanosecond, and sends
nothing."""

from __future__ import annotations

from itertools import pairwise

import pytest
from bus_kit import SimBus
from support import MS, S

from dpstack.capture.listener import Listener
from dpstack.capture.transmission import Damage, Transmission
from dpstack.errors import UsageError
from dpstack.fdl.baud_search import BaudFound
from dpstack.machine import LineDown, LineUp, RateRefused
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event, WireEntry
from dpstack.units import bits_to_ns, chars_to_ns

EPOCH = 1_800_000_000 * S


@pytest.mark.parametrize("baud", [19_200, 500_000, 12_000_000])
def test_every_transmission_of_a_bus_with_its_time(baud: int) -> None:
    world = World(keep=100_000)
    bus = SimBus(world, BusParams.preset(baud, address=2), [3, 4])
    assert world.run(world.now + 60 * S, lambda: bus.exchanging)
    heard: list[Transmission] = []
    world.add(Listener(world.now, heard.append, baud=baud, epoch_ns=EPOCH), name="listener")
    begun = world.now
    world.run_for(bits_to_ns(100_000, baud))
    sent = [entry for entry in world.log if entry.start_ns >= begun]
    assert len(sent) > 20
    assert heard == [Transmission(entry.octets, entry.start_ns + EPOCH, baud) for entry in sent]
    assert not any(entry.sender == "listener" for entry in sent)


def test_damaged_telegrams_are_delivered_with_their_damage_and_nothing_else_is() -> None:
    world = World(seed=5, keep=100_000, referee=False)
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3, 4])
    assert world.run(world.now + 60 * S, lambda: bus.exchanging)
    heard: list[Transmission] = []
    world.add(Listener(world.now, heard.append, baud=500_000), name="listener")
    begun = world.now
    world.faults.noise(1e-3)
    world.run_for(200 * MS)
    intact = {entry.octets for entry in _since(world, begun)}
    assert sum(not one.damage for one in heard) > 100
    assert all(one.octets in intact for one in heard if not one.damage)
    damaged = [one for one in heard if one.damage]
    assert {one.damage for one in damaged} >= {Damage.TOO_SHORT, Damage.START_DELIMITER}
    ends = [(one.t_ns, one.t_ns + chars_to_ns(len(one.octets), 500_000)) for one in heard if one.t_ns is not None]
    assert all(end <= start for (_, end), (start, _) in pairwise(ends))


def _since(world: World, begun: int) -> list[WireEntry]:
    return [entry for entry in world.log if entry.start_ns >= begun]


def test_the_rate_is_found_and_found_again_where_the_bus_changes_it() -> None:
    world = World(keep=100_000, referee=False)
    bus = SimBus(world, BusParams.preset(500_000, address=2), [3])
    heard: list[Transmission] = []
    events: list[Event] = []
    listener = Listener(world.now, heard.append)
    world.add(listener, name="listener", on_events=events.extend)
    assert world.run(world.now + 5 * S, lambda: bool(heard))
    assert listener.found == 500_000
    world.remove(bus.station)
    SimBus(world, BusParams.preset(1_500_000, address=2), [4])
    count = len(heard)
    assert world.run(world.now + 60 * S, lambda: heard[-1].baud == 1_500_000)
    assert len(heard) > count
    assert [event.baud for event in events if isinstance(event, BaudFound)] == [500_000, 1_500_000]


def test_a_lost_port_and_refused_rates() -> None:
    heard: list[Transmission] = []
    fixed = Listener(0, heard.append, baud=9600)
    fixed.receive(bytes.fromhex("68 05 05"), 10 * MS)
    fixed.command(LineDown("unplugged"), 20 * MS)
    fixed.command(LineUp(), 2 * S)
    assert [(one.octets.hex(), one.damage) for one in heard] == [("680505", Damage.TOO_SHORT)]
    with pytest.raises(UsageError, match="cannot do 9600"):
        fixed.command(RateRefused("the adapter cannot do 9600"), 3 * S)
    searching = Listener(0, heard.append)
    first = searching.baud
    searching.command(RateRefused("too fast"), 0)
    assert searching.baud < first
    with pytest.raises(UsageError, match="only listens"):
        fixed.command(object(), 0)


@pytest.mark.parametrize(
    "octets",
    [
        "68 03 03 68 02 05 08 0F 16",  # LE = 3
        "A2 05 02 6D 01 02 03 04 05 06 07 08 98 16",  # SD3
        "68 06 06 68 85 82 6D 3C 3E 01 EF 16",
        "10 05 02 49 50 16",
        "DC 02 02",
        "E5",
    ],
)
def test_every_kind_of_telegram_is_delivered_as_it_was_sent(octets: str) -> None:
    world = World(referee=False)
    heard: list[Transmission] = []
    world.add(Listener(0, heard.append, baud=500_000), name="listener")
    world.inject(bytes.fromhex(octets))
    world.run_for(10 * MS)
    assert [(one.octets, one.damage) for one in heard] == [(bytes.fromhex(octets), 0)]
