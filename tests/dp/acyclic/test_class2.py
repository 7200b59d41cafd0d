"""The reading services of a class 2 master: literal octets, every kind of answer, one end each."""

from __future__ import annotations

import pytest
from bus_kit import IDENT, PPO1, SimBus, setup
from class2_kit import MS, Class2Bus
from octet_slave import NR, RR, RS, UE, OctetSlave, sd1, sd2

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.dp.acyclic.queue import CAPACITY, Acyclic
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveDiagnosis, SlaveStateChanged
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.drivers.stack import acyclic_services
from dpstack.errors import UsageError
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.interface import Reply
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Telegram
from dpstack.machine import LineDown, LineUp
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import Event

READS = (Service.DIAGNOSIS, Service.CONFIG, Service.INPUTS, Service.OUTPUTS)


def test_literal_octets(kit: Class2Bus) -> None:
    """Slave 4, in data exchange with master 1, ident 0x0CDA, a word of inputs, an octet of outputs."""
    answers = {
        "68 05 05 68 84 82 6d 3c 3e ed 16": "68 0b 0b 68 82 84 08 3e 3c 00 0c 00 01 0c da 7b 16",
        "68 05 05 68 84 82 5d 3b 3e dc 16": "68 07 07 68 82 84 08 3e 3b 11 20 b8 16",
        "68 05 05 68 84 82 7d 38 3e f9 16": "68 07 07 68 82 84 08 3e 38 12 34 ca 16",
        "68 05 05 68 84 82 5d 39 3e da 16": "68 06 06 68 82 84 0a 3e 39 ff 86 16",
    }

    def slave(octets: bytes, now: int) -> tuple[int, bytes] | None:
        answer = answers.get(octets.hex(" "))
        return None if answer is None else (11, bytes.fromhex(answer))

    kit.bus.slaves[4] = slave
    found = {service: kit.read(4, service) for service in READS}
    assert {outcome.failure for outcome in found.values()} == {None}
    assert found[Service.DIAGNOSIS].data == bytes.fromhex("00 0c 00 01 0c da")
    assert found[Service.CONFIG].data == bytes.fromhex("11 20")
    assert found[Service.INPUTS].data == bytes.fromhex("12 34")
    assert found[Service.OUTPUTS].data == b"\xff"
    assert kit.done[2].text == "slave 4: RD_Inp, 2 octets"


def test_no_inputs_and_no_outputs_are_empty_not_a_refusal(kit: Class2Bus) -> None:
    OctetSlave(kit.bus, 4, master=1)
    assert kit.read(4, Service.INPUTS).data == b""
    assert kit.read(4, Service.OUTPUTS, 0).failure is None


@pytest.mark.parametrize("short", ["e5", "10 02 04 00 06 16", "10 02 04 09 0f 16"])
def test_other_ways_to_say_that_there_is_nothing(kit: Class2Bus, short: str) -> None:
    OctetSlave(kit.bus, 4, master=1).says[56] = lambda octets: bytes.fromhex(short)
    outcome = kit.read(4, Service.INPUTS)
    assert (outcome.failure, outcome.data) == (None, b"")


@pytest.mark.parametrize("service", READS)
def test_nobody_there(kit: Class2Bus, service: Service) -> None:
    outcome = kit.read(77, service)
    assert outcome.failure is ServiceFailure.SILENT
    assert outcome.text == (
        f"slave 77 does not answer {service.title}; check address and power; `dpstack scan` shows who is there"
    )
    asked = [sent.octets[6] for sent in kit.bus.log if sent.octets[0] == 0x68]
    looks = [] if service is Service.DIAGNOSIS else [0x6D, 0x6D]  # is it there at all?
    assert asked == [0x6D, 0x6D, 0x6D, 0x5D, *looks]  # three first requests, one probe


@pytest.mark.parametrize("service", [service for service in READS if service is not Service.DIAGNOSIS])
def test_a_slave_that_is_there_and_leaves_a_service_without_an_answer(kit: Class2Bus, service: Service) -> None:
    OctetSlave(kit.bus, 4, master=1).says[service] = lambda _octets: None
    outcome = kit.read(4, service)
    assert (outcome.failure, outcome.status) == (ServiceFailure.REFUSED, "no answer")
    begins = f"slave 4 is there (it answers Slave_Diag) and leaves {service.title} without an answer; "
    assert outcome.text.startswith(begins)
    assert "address and power" not in outcome.text


@pytest.mark.parametrize("service", READS)
@pytest.mark.parametrize(("fc", "name"), [(RS, "RS"), (RR, "RR"), (UE, "UE")])
def test_refusals(kit: Class2Bus, service: Service, fc: int, name: str) -> None:
    slave = OctetSlave(kit.bus, 4, master=1, inputs=b"\1", outputs=b"\2")
    slave.says[service] = lambda octets: sd1(2, 4, fc)
    outcome = kit.read(4, service)
    assert (outcome.failure, outcome.status) == (ServiceFailure.REFUSED, name)
    assert outcome.text.startswith(f"slave 4 refuses {service.title} ({name}); ")
    assert len(slave.requests) == (1 if fc == RS else 4)  # what is busy is asked again


def test_busy_for_a_moment(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 4, master=1, inputs=b"\x11\x22")

    def busy_twice(octets: bytes) -> bytes:
        if len(slave.requests) < 3:
            return sd1(2, 4, RR)
        return sd2(2, 4, 0x08, 62, 56, b"\x11\x22")

    slave.says[56] = busy_twice
    assert kit.read(4, Service.INPUTS).data == b"\x11\x22"


@pytest.mark.parametrize(
    ("sap", "answer", "failure"),
    [
        (60, sd2(2, 4, 0x08, 62, 60, b"\0\0\0\0\0"), ServiceFailure.LENGTH),
        (60, b"\xe5", ServiceFailure.WRONG),
        (60, sd1(2, 4, NR), ServiceFailure.REFUSED),
        (59, bytes.fromhex("68 03 03 68 02 04 08 0e 16"), ServiceFailure.WRONG),
        (59, sd1(2, 4, 0x00), ServiceFailure.WRONG),
        (56, sd2(2, 4, 0x08, 62, 57, b"\1"), ServiceFailure.WRONG),
        (56, sd2(2, 4, 0x08, 51, 56, b"\1"), ServiceFailure.WRONG),
        (56, sd2(2, 4, 0x00, 62, 56, b"\1"), ServiceFailure.WRONG),
        (60, b"\x68\x05\x05\x68\x00\x01\x02", ServiceFailure.UNREADABLE),
        (60, b"\xff\xff\xff", ServiceFailure.UNREADABLE),
    ],
)
def test_answers_that_are_none(sap: int, answer: bytes, failure: ServiceFailure) -> None:
    kit = Class2Bus(mode="octets")
    slave = OctetSlave(kit.bus, 4, master=1)
    slave.says[sap] = lambda octets: answer
    outcome = kit.read(4, Service(sap))
    assert outcome.failure is failure, outcome.text
    assert "; " in outcome.text  # what to do
    assert kit.read(4, Service.DIAGNOSIS if sap != 60 else Service.CONFIG).failure is None  # and the next is served


def test_a_length_that_is_not_the_configured_one(kit: Class2Bus) -> None:
    OctetSlave(kit.bus, 4, master=1, inputs=b"\1\2\3")
    assert kit.read(4, Service.INPUTS, 3).data == b"\1\2\3"
    outcome = kit.read(4, Service.INPUTS, 2)
    assert outcome.failure is ServiceFailure.LENGTH
    assert outcome.text.startswith("slave 4 answers RD_Inp with 3 octets instead of 2; its real configuration differs")


def test_a_late_answer_is_not_taken_for_the_next_ones(kit: Class2Bus) -> None:
    """The answer to RD_Inp comes when RD_Outp was asked already; the SAPs tell them apart, and a repetition of the
    same service keeps the first of two back."""
    slave = OctetSlave(kit.bus, 4, master=1, inputs=b"\xaa", outputs=b"\xbb")
    assert kit.read(4, Service.DIAGNOSIS).failure is None

    def late_at_first(octets: bytes, now: int) -> tuple[int, bytes] | None:
        slave.delay = 300 if len(slave.requests) < 8 else 11  # T_SL is 200
        return slave(octets, now)

    kit.bus.slaves[4] = late_at_first
    kit.send(ReadService(101, 4, Service.INPUTS))
    kit.send(ReadService(102, 4, Service.OUTPUTS))
    kit.send(ReadService(103, 4, Service.INPUTS))
    for token in (101, 102, 103):
        kit.end(token)
    data = {done.token: done.outcome.data for done in kit.done[1:] if done.outcome.failure is None}
    assert data.items() <= {101: b"\xaa", 102: b"\xbb", 103: b"\xaa"}.items()
    assert data[103] == b"\xaa"


# --- the queue ------------------------------------------------------------------------------------------------------


def test_one_request_a_token_hold(kit: Class2Bus) -> None:
    OctetSlave(kit.bus, 4, master=1)
    for token in range(10):
        kit.send(ReadService(token, 4, Service.DIAGNOSIS))
    kit.end(9)
    kinds = "".join("T" if sent.octets[0] == 0xDC else "q" for sent in kit.bus.log if sent.sender == 2)
    assert "qq" not in kinds
    assert [done.token for done in kit.done] == list(range(10))  # in their order


def test_the_queue_is_bounded(kit: Class2Bus) -> None:
    for token in range(CAPACITY):
        kit.send(ReadService(token, 9, Service.DIAGNOSIS))
    with pytest.raises(UsageError, match="32 class 2 services are waiting already: await their results first"):
        kit.send(ReadService(99, 9, Service.DIAGNOSIS))
    kit.end(CAPACITY - 1)
    assert len(kit.done) == CAPACITY
    assert kit.acyclic.waiting == 0


@pytest.mark.parametrize(
    ("address", "text"),
    [
        (127, "address 127: a slave has 0..126"),
        (-1, "address -1: a slave has"),
        (2, "address 2 is that of this master"),
    ],
)
def test_addresses_that_cannot_be(kit: Class2Bus, address: int, text: str) -> None:
    with pytest.raises(UsageError, match=text):
        kit.send(ReadService(1, address, Service.DIAGNOSIS))
    with pytest.raises(UsageError, match="does not read"):
        kit.send(ReadService(1, 5, Service.SET_ADDRESS))
    assert kit.acyclic.waiting == 0


def test_the_port_vanishes_with_services_waiting_and_under_way(kit: Class2Bus) -> None:
    OctetSlave(kit.bus, 4, master=1)
    for token in (101, 102, 103):
        kit.send(ReadService(token, 4, Service.DIAGNOSIS))
    while not any(sent.octets[0] == 0x68 for sent in kit.bus.log):
        kit.bus.run(10_000)
    kit.send(LineDown("unplugged"))
    assert [done.outcome.failure for done in kit.done] == [ServiceFailure.LINE] * 3
    assert kit.done[0].outcome.text == (
        "Slave_Diag to slave 4 was not over when the port vanished (unplugged); it can be repeated when the port is "
        "back"
    )
    # ordered meanwhile it waits for the port
    outcome = kit.read(4, Service.INPUTS)
    assert outcome.failure is ServiceFailure.LINE
    assert outcome.text == (
        "RD_Inp to slave 4 was not over after 5 s: the port vanished (unplugged); it can be repeated when the port is "
        "back"
    )
    kit.send(ReadService(200, 4, Service.DIAGNOSIS))
    kit.send(LineUp())
    assert kit.end(200).failure is None
    assert kit.read(4, Service.DIAGNOSIS).failure is None


def test_without_a_token_it_ends_in_time(kit: Class2Bus) -> None:
    kit.send(GoOffline())
    kit.bus.run(10 * MS)
    begun = kit.bus.now
    outcome = kit.read(4, Service.INPUTS)
    assert outcome.failure is ServiceFailure.LATE
    assert outcome.text.startswith("RD_Inp to slave 4 was not over after 5 s: this station was given no token")
    assert 5_000 * MS <= kit.bus.now - begun <= 5_002 * MS
    kit.send(GoOnline())
    OctetSlave(kit.bus, 4, master=1)
    assert kit.read(4, Service.DIAGNOSIS).failure is None


def test_cancelled_ones_are_asked_no_more(kit: Class2Bus) -> None:
    slave = OctetSlave(kit.bus, 4, master=1)
    kit.send(ReadService(1, 4, Service.DIAGNOSIS))
    kit.send(ReadService(2, 4, Service.CONFIG))
    kit.send(CancelService(2))
    kit.send(CancelService(77))
    assert kit.end(1).failure is None
    assert kit.end(2).failure is ServiceFailure.CANCELLED
    assert len(slave.requests) == 1


# --- beside a class 1 master ----------------------------------------------------------------------------------------


def class2_in(bus: SimBus, address: int, told: list[Event]) -> tuple[ActiveStation, Acyclic]:
    """A class 2 master of its own at ``address``."""
    class2 = acyclic_services(address)
    station = ActiveStation(BusParams.preset(500_000, address=address), [class2], now=bus.world.now)
    bus.world.add(station, on_events=told.extend)
    bus.world.command(station, GoOnline())
    return station, class2


def ends(told: list[Event]) -> dict[int, ServiceDone]:
    return {event.token: event for event in told if isinstance(event, ServiceDone)}


def test_beside_another_class_1_master_that_notices_nothing(w: World) -> None:
    params = BusParams.preset(500_000, address=2)
    bus = SimBus(w, params, (3, 4, 5)).until_exchanging()
    told: list[Event] = []
    station, class2 = class2_in(bus, 0, told)
    while not station.in_ring:
        w.run_for(10 * MS)
    w.run_for(100 * MS)
    states = sum(isinstance(e, SlaveStateChanged) for e in bus.events)
    bus.master.images[4].outputs = bytes(range(12))
    w.run_for(50 * MS)
    token = 0
    for _ in range(20):
        for service in READS:
            w.command(station, ReadService(token := token + 1, 4, service))
        while class2.waiting:
            w.run_for(MS)
    found = ends(told)
    assert len(found) == token
    assert {done.outcome.failure for done in found.values()} == {None}
    diagnosis = Diagnosis.parse(found[1].outcome.data)
    assert diagnosis is not None
    assert (diagnosis.ident, diagnosis.master) == (IDENT, 2)
    assert found[2].outcome.data == PPO1
    assert found[3].outcome.data == found[4].outcome.data == bytes(range(12))
    assert bus.exchanging
    assert sum(isinstance(e, SlaveStateChanged) for e in bus.events) == states
    stats = bus.station.stats
    assert [(s.retries, s.timeouts, s.late, s.wrong) for a, s in stats.stations.items() if a in (3, 4, 5)] == [
        (0, 0, 0, 0)
    ] * 3
    for app in bus.apps:
        assert (app.state, app.master, app.stats.watchdogs) == (SlaveAppState.DATA_EXCH, 2, 0)


def test_beside_the_class_1_master_of_its_own_station(w: World) -> None:
    """Every rotation has its data exchange; with a service it is longer by that one service at most."""
    params = BusParams.preset(500_000, address=2, gap=0)
    bus = SimBus(w, params, (3, 4, 5)).until_exchanging()
    w.run_for(500 * MS)
    quiet = bus.master.rotation.max_ns
    rounds = bus.master.rounds
    begun = w.now
    for token in range(CAPACITY):
        bus.send(ReadService(token, 4, Service.CONFIG))
    while bus.acyclic.waiting:
        w.run_for(MS)
    found = ends(bus.events)
    assert {done.outcome.data for done in found.values()} == {PPO1}
    assert bus.exchanging
    service = params.ns(11 * (11 + 13) + 2 * params.t_id1 + 11)
    assert bus.master.rotation.max_ns <= quiet + service
    assert bus.master.rounds - rounds >= CAPACITY
    assert w.now - begun >= CAPACITY * service
    assert bus.station.stats.stations[4].retries == 0


def test_without_time_to_spare_it_ends_and_says_so(w: World) -> None:
    """T_TR so short that data exchange alone uses it up: the cycle goes on, the service does not get in."""
    params = BusParams.preset(500_000, address=2, gap=0).replace(t_tr=256)
    bus = SimBus(w, params, (3, 4)).until_exchanging()
    bus.send(ReadService(1, 3, Service.CONFIG, timeout_ns=300 * MS))
    w.run_for(301 * MS)
    outcome = ends(bus.events)[1].outcome
    assert outcome.failure is ServiceFailure.LATE
    assert outcome.text == (
        "Get_Cfg to slave 3 was not over after 0.3 s: no token hold had time left for it; "
        "T_TR is too short, or too many services wait"
    )
    assert bus.exchanging


class TellsOnce(SlaveApp):
    """Shows Stat_Diag in exactly one diagnosis."""

    __slots__ = ("tells",)

    def __init__(self, device: MirrorDevice) -> None:
        super().__init__(device)
        self.tells = False

    def serve(self, request: Telegram, now: int) -> Reply | None:
        reply = super().serve(request, now)
        if request.dsap == 60 and self.tells and reply is not None:
            self.tells = False
            reply = reply._replace(data=bytes((reply.data[0], reply.data[1] | 0x02)) + reply.data[2:])
        return reply


def test_its_own_master_gets_a_diagnosis_that_it_read(w: World) -> None:
    """What a slave shows in one diagnosis only is not lost for the master by being read for somebody else."""
    params = BusParams.preset(500_000, address=2)
    app = TellsOnce(MirrorDevice(IDENT, PPO1))
    w.add(PassiveStation(3, app, params))
    master = Master(params, [setup(3)], MasterSettings(watchdog_ms=200))
    class2 = acyclic_services(2, master)
    told: list[Event] = []
    station = ActiveStation(params, [master, class2])
    w.add(station, on_events=told.extend)
    w.command(station, GoOnline())
    w.command(station, SetMode(Mode.OPERATE))
    w.run_for(500 * MS)
    image = master.images[3]
    told.clear()
    app.tells = True
    w.command(station, ReadService(1, 3, Service.DIAGNOSIS))
    w.run_for(50 * MS)
    assert ends(told)[1].outcome.data[1] & 0x02
    validity = [image.valid]
    w.run_for(200 * MS)  # and it asks again, as with any static diagnosis
    validity.append(image.valid)
    assert [e.diagnosis.stat_diag for e in told if isinstance(e, SlaveDiagnosis)] == [True, False]
    assert validity == [False, True]
