"""Class 2 connections beside data exchange: what they cost the rotation, and that a fixed cycle is kept."""

from __future__ import annotations

from bus_kit import add_station, all_exchange, setup
from ms2_kit import Ms2Server, ms2_in
from support import MS, WorldFactory

from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.telegram_times import acyclic_bits
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.drivers.stack import acyclic_services
from dpstack.fdl.events import DoesNotFit
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.stats import Histogram
from dpstack.trace import Event

SLAVES = range(8, 12)


def long_records(server: Ms2Server, octets: int) -> None:
    server.serve = lambda pdu: pdu[:3] + bytes((octets,)) + bytes(octets) if pdu[0] == 0x5E else b"\x48\x01"


class Loaded:
    """A master with four slaves, and a connection to each over which it reads again and again."""

    def __init__(self, world: World, *, cycle_ns: int = 0, octets: int = 64, baud: int = 1_500_000) -> None:
        self.world = world
        self.octets = octets
        self.events: list[Event] = []
        self.token = 100
        params = BusParams.preset(baud, address=2, gap=0)
        for address in SLAVES:
            long_records(ms2_in(world, address, baud=baud), octets)
        setups = [setup(address, config=bytes.fromhex("20 10")) for address in SLAVES]
        self.master = Master(params, setups, MasterSettings(cycle_ns=cycle_ns))
        acyclic = acyclic_services(2, self.master)
        self.station = add_station(world, params, self.master, acyclic, on_events=self.events.extend)
        while not all_exchange(self.master):
            world.run_for(5 * MS)
        for address in SLAVES:
            world.command(self.station, OpenConnection(address, address))
        world.run_for(50 * MS if cycle_ns == 0 else 400 * MS)
        opened = [event for event in self.events if isinstance(event, InitiateDone)]
        assert [event.outcome.failure for event in opened] == [None] * len(SLAVES)

    def rotation(self, for_ns: int, *, reads: int) -> Histogram:
        """The times of the rotations in that time, with so many records (0..32) read from each slave."""
        self.master.rotation = Histogram()
        for _ in range(reads):
            for address in SLAVES:
                self.token += 1
                self.world.command(
                    self.station, RecordOrder(self.token, Function.READ, 1, 2, self.octets, connection=address)
                )
        self.world.run_for(for_ns)
        return self.master.rotation

    @property
    def ends(self) -> list[RecordDone]:
        """The Reads so far; each had its answer."""
        ends = [event for event in self.events if isinstance(event, RecordDone)]
        assert all(done.outcome.failure is None and len(done.outcome.data) == self.octets for done in ends)
        return ends


def test_records_cost_no_more_than_the_plan_says(world: WorldFactory) -> None:
    bus = Loaded(world(), octets=240)
    quiet = bus.rotation(50 * MS, reads=0)
    loaded = bus.rotation(50 * MS, reads=32)
    assert len(bus.ends) > 10
    params = bus.master.context.params
    assert 0 < loaded.max_ns - quiet.max_ns <= params.ns(acyclic_bits(params))


def test_no_cycle_is_missed(world: WorldFactory) -> None:
    bus = Loaded(world(), cycle_ns=5 * MS)
    book = bus.master.cycles
    begun, missed = book.begun, book.missed
    bus.rotation(150 * MS, reads=32)
    assert book.begun - begun in (29, 30, 31)
    assert book.missed == missed
    assert len(bus.ends) > 24


def test_a_service_that_fits_into_no_gap_is_named(world: WorldFactory) -> None:
    """240 octets at 500 kbit/s in a cycle of 4 ms: it goes out in the end, and no connection is lost by the waiting."""
    bus = Loaded(world(), cycle_ns=4 * MS, octets=240, baud=500_000)
    bus.rotation(600 * MS, reads=1)
    assert len(bus.ends) == len(SLAVES)
    told = [event for event in bus.events if isinstance(event, DoesNotFit)]
    assert any("MS2 connection 48 to station" in event.text for event in told), [event.text for event in told]
