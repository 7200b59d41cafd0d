"""Permanent Read from all slaves, at MS1 and over connections: what it costs the rotation, in exact bus time."""

from __future__ import annotations

import pytest
from bus_kit import IDENT, PPO1, SimBus, all_exchange, setup
from ms2_kit import ms2_in
from support import MS, WorldFactory

from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.telegram_times import acyclic_bits
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.fdl.events import DoesNotFit
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import Event

COUNT, OCTETS = 8, 64
CONNECTED = range(8, 12)


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


# --- over connections ------------------------------------------------------------------------------------------------


class Connected(SimBus):
    """A master with four slaves of octets, and a connection to each over which it reads again and again."""

    def __init__(self, world: World, cycle_ns: int = 0, octets: int = OCTETS, baud: int = 1_500_000) -> None:
        self.octets = octets
        for address in CONNECTED:
            ms2_in(world, address, baud=baud).serve = self._serve
        params = BusParams.preset(baud, address=2, gap=0)
        setups = [setup(address, config=bytes.fromhex("20 10")) for address in CONNECTED]
        super().__init__(world, params, setups, cycle_ns, silent=CONNECTED)
        while not all_exchange(self.master):
            self.run(5 * MS)
        for address in CONNECTED:
            self.send(OpenConnection(address, address))
        self.run(50 * MS if cycle_ns == 0 else 400 * MS)
        assert [event.outcome.failure for event in self.events_of(InitiateDone)] == [None] * len(CONNECTED)

    def _serve(self, pdu: bytes) -> bytes:
        return pdu[:3] + bytes((self.octets,)) + bytes(self.octets) if pdu[0] == 0x5E else b"\x48\x01"

    def rotation(self, for_ns: int, *, reads: int) -> Histogram:
        """The times of the rotations in that time, with so many records (0..32) read from each slave."""
        self.master.rotation = Histogram()
        for token, address in enumerate([*CONNECTED] * reads, 101):
            self.send(RecordOrder(token, Function.READ, 1, 2, self.octets, connection=address))
        self.run(for_ns)
        return self.master.rotation

    @property
    def ends(self) -> list[RecordDone]:
        """The Reads so far; each had its answer."""
        ends = self.events_of(RecordDone)
        assert all(done.outcome.failure is None and len(done.outcome.data) == self.octets for done in ends)
        return ends


def test_records_over_connections_cost_no_more_than_the_plan_says(world: WorldFactory) -> None:
    bus = Connected(world(), octets=240)
    quiet = bus.rotation(50 * MS, reads=0)
    loaded = bus.rotation(50 * MS, reads=32)
    assert len(bus.ends) > 10
    params = bus.master.context.params
    assert 0 < loaded.max_ns - quiet.max_ns <= params.ns(acyclic_bits(params))


def test_no_cycle_is_missed_by_connections(world: WorldFactory) -> None:
    bus = Connected(world(), cycle_ns=5 * MS)
    book = bus.master.cycles
    begun, missed = book.begun, book.missed
    bus.rotation(150 * MS, reads=32)
    assert book.begun - begun in (29, 30, 31)
    assert book.missed == missed
    assert len(bus.ends) > 24


def test_a_service_that_fits_into_no_gap_is_named(world: WorldFactory) -> None:
    """240 octets at 500 kbit/s in a cycle of 4 ms: it goes out in the end, and no connection is lost by the waiting."""
    bus = Connected(world(), cycle_ns=4 * MS, octets=240, baud=500_000)
    bus.rotation(600 * MS, reads=1)
    assert len(bus.ends) == len(CONNECTED)
    told = bus.events_of(DoesNotFit)
    assert any("MS2 connection 48 to station" in event.text for event in told), [event.text for event in told]
