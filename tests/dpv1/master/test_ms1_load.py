"""Permanent Read of 64 octets from all of eight slaves: what it costs the rotation, in exact bus time."""

from __future__ import annotations

import pytest
from bus_kit import IDENT, PPO1, SimBus, setup
from support import MS, WorldFactory

from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.telegram_times import acyclic_bits
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import Event

COUNT, OCTETS = 8, 64


class Loaded(SimBus):
    """A master with eight slaves; ``asking``: each is read again and again."""

    def __init__(self, world: World, baud: int, cycle_ns: int = 0, octets: int = OCTETS) -> None:
        self.octets = octets
        self.asking = False
        self.ends: list[RecordDone] = []
        self._token = 0
        params = BusParams.preset(baud, address=2, gap=0)
        devices = {address: MirrorDevice(IDENT, PPO1) for address in range(3, 3 + COUNT)}
        for device in devices.values():
            device.records = RecordTable({(1, 2): bytes(octets)})
        super().__init__(world, params, [setup(a, Dpv1()) for a in devices], cycle_ns, t_sdr=60, devices=devices)
        self.until_exchanging()
        world.run_for(20 * MS)

    def on_events(self, events: list[Event]) -> None:
        self.ends += [event for event in events if isinstance(event, RecordDone)]

    def rotation(self, for_ns: int) -> Histogram:
        """The times of the rotations in that time."""
        self.master.rotation = Histogram()
        self.ends.clear()
        end = self.world.now + for_ns
        told = 0
        if self.asking:
            for address in self.slaves:
                self._ask(address)
        while self.world.now < end:
            self.world.run_for(MS // 5)
            if self.asking:
                for done in self.ends[told:]:
                    self._ask(done.address)
                told = len(self.ends)
        return self.master.rotation

    def _ask(self, address: int) -> None:
        self._token += 1
        self.world.command(self.station, RecordOrder(self._token, Function.READ, 1, 2, self.octets, address=address))


@pytest.mark.parametrize("baud", [500_000, 1_500_000])
def test_the_rotation_is_at_most_a_third_longer(world: WorldFactory, baud: int) -> None:
    bus = Loaded(world(), baud)
    quiet = bus.rotation(200 * MS)
    bus.asking = True
    loaded = bus.rotation(500 * MS)
    assert all(done.outcome.failure is None for done in bus.ends)
    assert loaded.quantile_ns(0.99) <= 1.3 * quiet.quantile_ns(0.99)
    by_slave = [sum(done.address == address for done in bus.ends) for address in bus.slaves]
    assert max(by_slave) - min(by_slave) <= 1


def test_the_longest_records_cost_no_more_than_the_plan_says(world: WorldFactory) -> None:
    bus = Loaded(world(), 1_500_000, octets=240)
    quiet = bus.rotation(100 * MS)
    bus.asking = True
    loaded = bus.rotation(300 * MS)
    params = bus.master.context.params
    assert 0 < loaded.max_ns - quiet.max_ns <= params.ns(acyclic_bits(params))


def test_no_cycle_is_missed(world: WorldFactory) -> None:
    bus = Loaded(world(), 1_500_000, 6 * MS)
    bus.asking = True
    book = bus.master.cycles
    begun, missed = book.begun, book.missed
    bus.rotation(300 * MS)
    assert book.begun - begun in (49, 50, 51)
    assert book.missed == missed
    assert len(bus.ends) > 24
    assert all(done.outcome.failure is None for done in bus.ends)
