"""The scanner: ident, state and owner of every slave, and nobody notices that it was there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pytest
from bus_kit import IDENT, PPO1, SimBus, mirror
from ring_bus import ListUser, RingBus
from support import MS, KeepsEvents, S, WorldFactory, instance, present

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.dp.master.scanner import Found, ScanDone, Scanner, StationSeen, SurveyOrder
from dpstack.dp.pdu.diagnosis import Diagnosis, SlaveView, view_of
from dpstack.dp.services import reading_only
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.events import StationFound, TokenLost
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.livelist import LiveList
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Req, StationType
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT
from dpstack.sim.world import World
from dpstack.trace import Event, Notice


@dataclass
class Scan(KeepsEvents):
    """A scanning master in ``world``."""

    world: World
    address: int = 0
    baud: int = 500_000
    configs: bool = False
    #: addresses of the live list, None for all
    addresses: Sequence[int] | None = None
    #: see Scanner
    period_ns: int = 0
    wanted: Sequence[int] = ()

    def __post_init__(self) -> None:
        params = BusParams.preset(self.baud, address=self.address)
        self.events: list[Event] = []
        live = LiveList(self.address) if self.addresses is None else LiveList(self.address, addresses=self.addresses)
        self.scanner = Scanner(self.address, live, configs=self.configs, period_ns=self.period_ns, wanted=self.wanted)
        self.station = ActiveStation(params, [self.scanner], guard=reading_only, now=self.world.now)
        self.world.add(self.station, on_events=self.events.extend)

    def run(self, within_ns: int = 10 * S) -> dict[int, Found]:
        """Join, scan, leave."""
        self.world.command(self.station, GoOnline())
        end = self.world.now + within_ns
        while not self.scanner.done:
            assert self.world.now < end, f"{self.station.state.name}, {len(self.scanner.found)} found"
            self.world.run_for(MS)
        self.world.command(self.station, GoOffline())
        while self.station.in_ring:
            assert self.world.now < end
            self.world.run_for(MS)
        self.world.remove(self.station)
        assert self.station.stats.refused == 0
        return self.scanner.found


def brief(found: dict[int, Found]) -> list[tuple[object, ...]]:
    return [(f.address, f.kind.name, f.ident, f.state and f.state.value, f.master) for _, f in sorted(found.items())]


@pytest.fixture
def bus() -> RingBus:
    return RingBus()


@pytest.mark.parametrize("baud", [9_600, 500_000, 12_000_000])
def test_a_silent_bus(w: World, baud: int) -> None:
    params = BusParams.preset(baud)
    for address in (3, 126):
        w.add(mirror(address, params))
    found = Scan(w, baud=baud, configs=True).run(60 * S)
    assert brief(found) == [(3, "SLAVE", IDENT, "wait_prm", None), (126, "SLAVE", IDENT, "wait_prm", None)]
    assert {f.config for f in found.values()} == {PPO1}


def test_beside_another_master_that_notices_nothing(world: WorldFactory) -> None:
    """The same plant with and without the scan: no slave lost, no retry, a rotation longer by one poll at most."""
    figures = []
    for scanned in (False, True):
        w = world()
        params = BusParams.preset(500_000, address=2)
        bus = SimBus(w, params, (3, 4, 5)).until_exchanging()
        w.run_for(500 * MS)
        before = sum(isinstance(e, SlaveStateChanged) for e in bus.events)
        if scanned:
            scan = Scan(w, configs=True)
            found = scan.run()
            assert not scan.events_of(TokenLost)
            assert brief(found) == [
                (2, "MASTER_IN_RING", None, None, None),
                *((a, "SLAVE", IDENT, "data_exchange", 2) for a in (3, 4, 5)),
            ]
            assert {found[a].config for a in (3, 4, 5)} == {PPO1}
        w.run_for(2 * S)
        assert bus.exchanging
        assert sum(isinstance(e, SlaveStateChanged) for e in bus.events) == before
        stats = bus.station.stats
        assert [(s.retries, s.timeouts, s.late, s.wrong) for a, s in stats.stations.items() if a in (3, 4, 5)] == [
            (0, 0, 0, 0)
        ] * 3
        assert stats.tokens_lost == 0
        for app in bus.apps:
            assert app.state is SlaveAppState.DATA_EXCH
            assert app.master == 2
            assert app.stats.watchdogs == 0
        figures.append((bus.master.rotation.quantile_ns(0.5), bus.master.rotation.max_ns))
    (p50, _), (p50_scanned, longest) = figures
    assert p50_scanned < p50 * 1.2  # most rotations of the run were without the scanner
    token_and_poll = params.ns(2 * 33 + 6 * 11 + 3 * params.t_id1 + params.t_sl)
    diagnosis = params.ns(11 * (9 + 17) + 2 * params.t_id1 + 11)
    assert longest < figures[0][1] + token_and_poll + diagnosis + params.ns(2 * params.t_sl)


def test_the_owners_watchdog_still_runs_while_others_ask(w: World) -> None:
    """A Slave_Diag of another master is no sign of life of the owner."""
    params = BusParams.preset(500_000, address=2)
    bus = SimBus(w, params, (3,)).until_exchanging()
    scan = Scan(w, addresses=[3], period_ns=MS)
    w.command(scan.station, GoOnline())
    w.run_for(500 * MS)
    assert bus.exchanging
    states = [e.found.state for e in scan.events_of(StationSeen)]
    assert states == [SlaveView.DATA_EXCHANGE]
    bus.send(SetMode(Mode.STOP))
    w.run_for(1 * S)
    assert bus.apps[0].stats.watchdogs == 1
    states = [e.found.state for e in scan.events_of(StationSeen)]
    assert states == [SlaveView.DATA_EXCHANGE, SlaveView.WAIT_PRM]


def test_a_slave_that_goes_and_comes_while_it_is_watched(w: World) -> None:
    params = BusParams.preset(500_000)
    slave = mirror(3, params)
    w.add(slave)
    scan = Scan(w, period_ns=50 * MS, wanted=[3])
    w.command(scan.station, GoOnline())
    w.run_for(1 * S)
    w.remove(slave)
    w.run_for(1 * S)
    assert scan.scanner.found == {}
    w.add(slave)
    w.run_for(1 * S)
    told = [(e.present, e.text) for e in scan.events_of(StationSeen)]
    assert told == [
        (True, "station 3: slave, ident 0x1234, wait_prm"),
        (False, "station 3 no longer answers"),
        (True, "station 3: slave, ident 0x1234, wait_prm"),
    ]


def scan_octets(bus: RingBus, addresses: Sequence[int]) -> Scanner:
    """Station 2 scans slaves that know octets only."""
    scanner = Scanner(2, LiveList(2, addresses=addresses), configs=True)
    bus.master(2, scanner, gap=0)
    bus.run(200 * MS)
    return scanner


def test_a_station_that_is_no_dp_slave_stays_unknown(bus: RingBus) -> None:
    """It answers FDL status, and RS to everything else."""
    status, refusal = bytes.fromhex("10 02 04 00 06 16"), bytes.fromhex("10 02 04 03 09 16")
    bus.slaves[4] = lambda octets, now: (11, status if octets[0] == 0x10 else refusal)
    scanner = scan_octets(bus, range(8))
    assert scanner.done
    assert brief(scanner.found) == [(4, "SLAVE", None, "unknown", None)]
    assert scanner.found[4].as_dict() == {
        "address": 4,
        "type": "slave",
        "ident": None,
        "state": "unknown",
        "master": None,
    }


def test_literal_octets(bus: RingBus) -> None:
    """Slave 4, in data exchange with master 1, ident 0x0CDA; it knows octets only."""
    answers = {
        "10 04 02 49 4f 16": "10 02 04 00 06 16",
        "68 05 05 68 84 82 6d 3c 3e ed 16": "68 0b 0b 68 82 84 08 3e 3c 00 0c 00 01 0c da 7b 16",
        "68 05 05 68 84 82 5d 3b 3e dc 16": "68 06 06 68 82 84 08 3e 3b 21 a8 16",
    }

    def slave(octets: bytes, now: int) -> tuple[int, bytes] | None:
        answer = answers.get(octets.hex(" "))
        return None if answer is None else (11, bytes.fromhex(answer))

    bus.slaves[4] = slave
    scanner = scan_octets(bus, [4])
    assert brief(scanner.found) == [(4, "SLAVE", 0x0CDA, "data_exchange", 1)]
    assert scanner.found[4].config == b"\x21"
    assert scanner.found[4].text == "station 4: slave, ident 0x0CDA, data_exchange, master 1"


def test_a_station_that_is_gone_hides_none_that_was_found_with_it() -> None:
    """Events of the live list that come at once, one of them of another kind."""

    class Told(LiveList):
        def take_events(self) -> list[Event]:
            gone, other = StationFound(t_ns=1, address=3, kind=None), Notice(t_ns=1, source="a", message="b")
            kinds = {4: StationType.SLAVE, 5: StationType.MASTER_READY}
            return [other, gone, *(StationFound(t_ns=1, address=address, kind=kind) for address, kind in kinds.items())]

    scanner = Scanner(2, Told(2), configs=True)
    scanner.token_received(0)
    request = present(scanner.next_request(0, False))
    scanner.result(request, Failure.NO_ANSWER, 1)
    assert brief(scanner.found) == [(4, "SLAVE", None, "unknown", None), (5, "MASTER_READY", None, None, None)]
    assert [event.text for event in scanner.take_events()] == ["station 5: master ready"]
    asked = []
    for _ in range(2):
        scanner.token_received(2)
        request = present(scanner.next_request(2, False))
        asked.append((request.da, request.dsap))
        scanner.result(request, Failure.REFUSED, 3)  # asked again
    assert asked == [(4, 60), (4, 60)]


@pytest.mark.parametrize("quick", [False, True])
def test_a_survey_asks_its_addresses_once_and_leaves_out_what_the_master_knows(bus: RingBus, quick: bool) -> None:
    """Slaves 4 and 5 name master 2, which asks, as their owner; Slave_Diag of slave 5 is left to the master."""
    answers = {
        "10 04 02 49 4f 16": "10 02 04 00 06 16",
        "10 05 02 49 50 16": "10 02 05 00 07 16",
        "68 05 05 68 84 82 6d 3c 3e ed 16": "68 0b 0b 68 82 84 08 3e 3c 00 0c 00 02 0c da 7c 16",
        "68 05 05 68 84 82 5d 3b 3e dc 16": "68 06 06 68 82 84 08 3e 3b 21 a8 16",
    }
    asked: list[str] = []

    def slave(octets: bytes, now: int) -> tuple[int, bytes] | None:
        asked.append(octets.hex(" "))
        answer = answers.get(octets.hex(" "))
        return None if answer is None else (11, bytes.fromhex(answer))

    bus.slaves[4] = bus.slaves[5] = slave
    order = SurveyOrder(token=77, addresses=(4, 5), skip=(5,), configs=True, quick=quick)
    scanner = order.link_user(BusParams.preset(500_000, address=2), EXACT, 0)
    bus.master(2, scanner, gap=0)
    bus.run(400 * MS)
    (done,) = bus.events_of(ScanDone)
    assert (done.token, done.stations) == (77, 2)
    assert [(f.address, f.ident, f.master, f.config) for f in done.found] == [
        (4, 0x0CDA, None, b"\x21"),
        (5, None, None, None),
    ]
    assert set(asked) == set(answers)


def test_a_slave_that_names_whoever_asks_has_no_owner(bus: RingBus) -> None:
    answers = {
        "10 04 02 49 4f 16": "10 02 04 00 06 16",
        "68 05 05 68 84 82 6d 3c 3e ed 16": "68 0b 0b 68 82 84 08 3e 3c 00 0c 00 02 0c da 7c 16",
    }
    bus.slaves[4] = lambda octets, now: (11, bytes.fromhex(answers.get(octets.hex(" "), "e5")))
    scanner = scan_octets(bus, [4])
    assert brief(scanner.found) == [(4, "SLAVE", 0x0CDA, "data_exchange", None)]


@pytest.mark.parametrize(
    ("octets", "state"),
    [
        ("02 05 00 ff 12 34", SlaveView.WAIT_PRM),
        ("42 05 00 ff 12 34", SlaveView.WAIT_PRM),
        ("02 04 00 02 12 34", SlaveView.WAIT_CFG),
        ("00 0c 00 02 12 34", SlaveView.DATA_EXCHANGE),
        ("08 0e 00 02 12 34", SlaveView.DATA_EXCHANGE),
        ("00 04 00 ff 12 34", SlaveView.UNKNOWN),
    ],
)
def test_states_from_diagnosis(octets: str, state: SlaveView) -> None:
    assert view_of(Diagnosis.parse(bytes.fromhex(octets))) is state


# --- the guard of a read-only bus -----------------------------------------------------------------------------------

READS = [
    Request(3, Req.FDL_STATUS),
    Request(3, Req.IDENT),
    Request(3, Req.SRD_HIGH, b"", 60, 62),
    Request(3, Req.SRD_LOW, b"", 59, 62),
    Request(3, Req.SRD_HIGH, b"", 56, 62),
    Request(3, Req.SRD_HIGH, b"", 57, 62),
]
WRITES = [
    Request(3, Req.SRD_HIGH, b""),
    Request(3, Req.SRD_HIGH, b"\x01"),
    Request(3, Req.SRD_HIGH, b"\x80", 61, 62),
    Request(3, Req.SRD_HIGH, b"\x20", 62, 62),
    Request(3, Req.SRD_HIGH, b"\x01", 60, 62),
    Request(3, Req.SRD_HIGH, b"", 51, 51),
    Request(3, Req.SRD_HIGH, b"", 0, 50),
    Request(126, Req.SRD_HIGH, b"\x05\x12\x34\x00", 55, 62),
    Request(3, Req.SDA_LOW, b"", 60, 62),
    Request(127, Req.SDN_HIGH, b"\x00\x00", 58, 62),
    Request(127, Req.CLOCK_VALUE),
]


@pytest.mark.parametrize("request_", READS)
def test_reading_passes(request_: Request) -> None:
    assert reading_only(request_) is None


@pytest.mark.parametrize(
    ("request_", "name"),
    [
        (Request(3, Req.SRD_HIGH, b"\x01"), "Data_Exchange"),
        (Request(3, Req.SRD_LOW, b""), "Data_Exchange"),
        (Request(3, Req.SDA_LOW, b"\x01"), "SDA_LOW"),
        (Request(3, Req.SRD_HIGH, b"\x80", 61, 62), "Set_Prm"),
        (Request(3, Req.SRD_HIGH, b"\x01", 60, 62), "Slave_Diag"),
        (Request(3, Req.SRD_HIGH, b"", 51, 51), "a service at SAP 51"),
    ],
)
def test_a_request_that_is_refused_is_named(request_: Request, name: str) -> None:
    text = f"{name} to station 3 was not sent: this bus is read-only; please report it, nothing may try"
    assert reading_only(request_) == text


def test_nothing_else_leaves_a_guarded_station(bus: RingBus) -> None:
    user = ListUser(high=[*WRITES, *READS])
    station = ActiveStation(BusParams.preset(500_000, address=2, gap=0), [user], guard=reading_only)
    bus.stations.append(station)
    bus.command(station, GoOnline())
    bus.run(100 * MS)
    assert [request for request, outcome, _ in user.results if outcome is Failure.REFUSED] == WRITES
    assert [request.dsap for request, _ in user.starts] == [request.dsap for request in READS]
    assert station.stats.refused == len(WRITES)
    told = bus.events_of(Notice)
    assert len(told) == 9  # each kind once: Data_Exchange with 0 and with 1 octet is the same
    assert told[0].message.startswith("Data_Exchange to station 3 was not sent: this bus is read-only")


def test_a_master_behind_the_guard_takes_no_slave(w: World) -> None:
    """Whatever a DP master tries: the slave stays where it is, and the attempt is a finding."""
    params = BusParams.preset(500_000, address=2)
    slave: PassiveStation = mirror(3, params)
    w.add(slave)
    events: list[Event] = []
    master = Master(params, [SlaveParams(address=3, name="s3", ident=IDENT, config=PPO1)])
    station = ActiveStation(params, [master], guard=reading_only)
    w.add(station, on_events=events.extend)
    w.command(station, GoOnline())
    w.command(station, SetMode(Mode.OPERATE))
    w.run_for(2 * S)
    app = instance(slave.responder, SlaveApp)
    assert app.state is SlaveAppState.WAIT_PRM
    assert isinstance(app.device, MirrorDevice)
    assert [e for e in events if isinstance(e, Notice) and "Set_Prm to station 3 was not sent" in e.text]
    assert station.stats.stations[3].answers > 0
    assert StationType.SLAVE in station.stations.values()
