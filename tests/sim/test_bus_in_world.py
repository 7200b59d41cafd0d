"""Real stations in the world with the referee on: what the simulation is for."""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from bus_kit import IDENT, PPO1, SimBus, mirror
from fire_kit import make_ring
from slave_kit import make_slave
from support import MS, S, WorldFactory, present

from dpstack.dp.master.events import SlaveState
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.params import BusParams
from dpstack.sim.referee import Rule
from dpstack.trace import WireEntry
from dpstack.units import BAUD_RATES, NEVER, bits_to_ns

P500 = BusParams.preset(500_000, address=2, hsa=20)


def bring_up(make: WorldFactory, slaves: int = 3, seed: int = 0, expect: Iterable[Rule] = ()) -> SimBus:
    return SimBus(make(seed=seed, expect=expect), P500, range(5, 5 + slaves)).until_exchanging()


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_data_exchange_at_every_rate(world: WorldFactory, baud: int) -> None:
    bus = SimBus(world(), BusParams.preset(baud, address=2, hsa=8), [5, 6]).until_exchanging(within_ns=60 * S)
    for address in (5, 6):
        bus.master.images[address].outputs = bytes([address] * 12)
    bus.world.run_for(bits_to_ns(20_000, baud))
    for address in (5, 6):
        assert bus.master.images[address].inputs == bytes([address] * 12)


def test_the_wire_log_is_the_same_for_the_same_seed_and_another_for_another(world: WorldFactory) -> None:
    logs: list[list[WireEntry]] = []
    for seed in (1, 1, 2):
        bus = SimBus(world(seed=seed), P500, range(5, 9))
        log: list[WireEntry] = []
        bus.world.log.listener = log.append
        bus.world.faults.noise(1e-4)
        bus.world.run_for(S)
        logs.append(log)
    assert logs[0] == logs[1]
    assert logs[1] != logs[2]
    assert len(logs[0]) > 1_000


@pytest.mark.parametrize("per_bit", [1e-5, 1e-4, 1e-3])
def test_no_station_breaks_the_rules_under_noise(world: WorldFactory, per_bit: float) -> None:
    for seed in range(2):
        bus = bring_up(world, seed=seed)
        bus.world.faults.noise(per_bit)
        bus.world.run_for(2 * S)
        assert any(entry.note == "damaged" for entry in bus.world.log)
        bus.world.faults.clear()
        bus.until_exchanging(within_ns=15 * S)


@pytest.fixture
def bus(world: WorldFactory) -> SimBus:
    return bring_up(world)


def test_a_slave_switched_off_and_on_again(bus: SimBus) -> None:
    bus.world.remove(bus.slaves[5])
    bus.world.run_for(S)
    assert bus.master.handlers[5].state is not SlaveState.DATA_EXCHANGE
    assert bus.master.handlers[6].state is SlaveState.DATA_EXCHANGE
    bus.world.add(mirror(5, P500))
    bus.until_exchanging()


def test_a_slave_that_falls_silent_for_a_time(bus: SimBus) -> None:
    bus.world.silence(bus.slaves[6], S)
    bus.world.run_for(S // 2)
    assert bus.master.handlers[6].state is not SlaveState.DATA_EXCHANGE
    assert any("silenced" in entry.note for entry in bus.world.log)
    bus.until_exchanging()


def test_a_slave_cut_off_in_the_middle_of_its_answer(bus: SimBus) -> None:
    world_ = bus.world
    slave = bus.slaves[5]
    while not (len(world_.log) and list(world_.log)[-1].octets[:6] == bytes.fromhex("68 0F 0F 68 05 02")):
        world_.step()
    world_.run_for(bits_to_ns(11 + 5 * 11 + 3, 500_000))
    world_.remove(slave)
    assert "cut off after 5 of 21 octets" in list(world_.log)[-1].note
    world_.run_for(S)
    world_.add(mirror(5, P500))
    bus.until_exchanging()


def test_two_slaves_with_one_address_are_seen_by_the_referee(world: WorldFactory) -> None:
    bus = bring_up(world, expect=[Rule.COLLISION])
    # the second one tells nothing but its status until it is parameterised, so it collides where it answers too
    bus.world.add(mirror(6, P500, t_sdr=12))
    bus.world.run_for(S)


def test_a_slave_slower_than_t_sl_is_seen_by_the_referee(world: WorldFactory) -> None:
    w = world(expect=[Rule.COLLISION])
    present(w.referee).allow(*Rule)
    slow = mirror(5, P500, t_sdr=P500.t_sl + 15)
    bus = SimBus(w, P500, [])
    w.add(slow)
    w.run_for(S)
    assert bus.station.in_ring


def test_a_damaged_answer_is_asked_for_again(world: WorldFactory) -> None:
    bus = bring_up(world, slaves=1)
    before = bus.station.stats.station(5).retries
    for octet in (0, 1, 5, -2, -1):
        bus.world.faults.damage(lambda tx: tx.sender == "5" and len(tx.octets) == 21, octet=octet)
        bus.world.run_for(20 * MS)
    assert bus.station.stats.station(5).retries - before == 5
    assert bus.exchanging


def test_garbage_on_the_line_disturbs_the_ring_only_shortly(bus: SimBus) -> None:
    for number in range(50):
        bus.world.run_for(777_777)
        bus.world.inject(bytes((number * 37 & 0xFF, 0x68, 0xE5, 0x10)))
    bus.world.run_for(300 * MS)
    bus.until_exchanging()


def test_a_station_at_another_rate_hears_only_garbage(bus: SimBus) -> None:
    other = mirror(9, BusParams.preset(1_500_000, address=2))
    bus.world.add(other)
    bus.world.run_for(S)
    assert bus.exchanging
    assert other.decoder.stats.octets > 1_000
    assert other.stats.requests == 0


# --- the ring ---
@pytest.mark.parametrize("addresses", [(1, 2), (2, 3, 4), (0, 7, 19), (3, 2, 1, 0)])
def test_masters_find_each_other_and_share_one_token(world: WorldFactory, addresses: tuple[int, ...]) -> None:
    ring = make_ring(world, *addresses)
    ring.world.run_for(S)
    assert ring.whole
    assert ring.referee.tokens.ring == set(addresses)


@pytest.mark.parametrize("seed", range(3))
def test_lost_tokens_are_passed_again(world: WorldFactory, seed: int) -> None:
    ring = make_ring(world, 2, 7, 12, seed=seed)
    for _ in range(20):
        ring.drop_tokens(1)
        ring.world.run_for(30 * MS)
    ring.world.run_for(S)
    assert ring.whole
    assert sum(station.stats.token_retries for station in ring.masters.values()) >= 20


def test_a_poke_brings_the_deadline_of_a_device_forward(world: WorldFactory) -> None:
    ticks: list[int] = []

    class Ticking(MirrorDevice):
        def tick(self, now: int) -> None:
            ticks.append(now)
            self.due_at = NEVER

    device = Ticking(IDENT, PPO1)
    w = world()
    slave = make_slave(5, device, P500)
    w.add(slave)
    w.run_for(MS)
    device.due_at = 3 * MS
    w.poke(slave)
    w.run_for(9 * MS)
    assert ticks == [3 * MS]
