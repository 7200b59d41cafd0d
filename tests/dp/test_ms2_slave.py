"""MS2 of a slave against a master of class 2 in octets: every step, each way out, timers to the bit."""

from __future__ import annotations

import pytest
from octet_class2 import (
    ABORT,
    ABORT_ADDRESS,
    ABORT_REQUEST,
    ABORT_SEQUENCE,
    ABORT_TIMEOUT,
    IDLE,
    INITIATE,
    OPENED,
    RS,
    SC,
    Class2,
)
from octet_wire import MS, Wire, framed
from slave_kit import CFG, PRM, Recorder

from dpstack.dp.device import Device
from dpstack.dp.slave_baud import SearchingSlave
from dpstack.dp.slaveapp import SlaveApp, SlaveAppState, make_slave
from dpstack.dp.v1.connection import Abort
from dpstack.dp.v1.device_records import ImRecords, RecordTable
from dpstack.dp.v1.im import Im0, Im1
from dpstack.dp.v1.ms2_server_states import TABLE, Act, Ev, State
from dpstack.dp.v1.tickets import Records, Ticket, Transport, TransportTicket
from dpstack.dp.v1.times import least_send_timeout
from dpstack.errors import ConfigError, RecordRefused
from dpstack.params import BusParams

READ = "5E 00 01 F0"
READ_RES = "5E 00 01 03 11 22 33"
#: at 500 kbit/s the slave's send time-out is 2 s, longer than the 1 s of INITIATE
TIMEOUT = 2_000 * MS


class Later:
    """Keeps the tickets."""

    def __init__(self) -> None:
        self.tickets: list[Ticket] = []

    def ask(self, ticket: Ticket) -> None:
        self.tickets.append(ticket)


class Slave:
    """Slave 8 on a wire, with ``count`` connections."""

    def __init__(
        self,
        records: Records | None = None,
        count: int = 2,
        *,
        at_once: bool = False,
        transport: Transport | None = None,
        max_len: int = 240,
        device: Device | None = None,
    ) -> None:
        self.device = device or Recorder()
        self.device.records = records or RecordTable({(0, 1): b"\x11\x22\x33", (1, 2): b"\xaa"}, [(1, 2)])
        self.device.ms2 = count
        self.device.ms2_at_once = at_once
        self.device.ms2_max_len = max_len
        self.device.transport = transport
        self.count = count
        station = make_slave(8, self.device, BusParams.preset(500_000))
        self.wire = Wire(station)
        app = station.responder
        assert isinstance(app, SlaveApp)
        self.app = app
        self.master = Class2(self.wire)

    def texts(self) -> list[str]:
        return [event.text.removeprefix("slave 8 (recorder): ") for event in self.wire.station.take_events()]

    def saps(self) -> list[int]:
        return [connection.sap for connection in self.app.connections]

    def state(self) -> SlaveAppState:
        return self.app.state

    def all_free(self) -> bool:
        return self.app.connections_free == self.count and not self.app.connections


# --- the sequence ---------------------------------------------------------------------------------------------------


def test_a_connection_from_initiate_to_abort() -> None:
    slave = Slave()
    master = slave.master
    assert master.ask(49) == SC  # nothing was asked
    assert master.ask(49, INITIATE) == SC
    assert master.ask(49) == "56 30 00 C8"
    assert master.ask(49) == "56 30 00 C8"  # until the server SAP is used: the answer may have been lost
    assert master.ask(48) == OPENED
    assert master.ask(49) == SC
    assert master.service(48, READ) == READ_RES
    assert master.service(48, "5F 01 02 01 BB") == "5F 01 02 01"
    assert master.service(48, "5E 01 02 F0") == "5E 01 02 01 BB"
    (found,) = slave.app.connections
    assert (found.master, found.sap, found.send_timeout_ns, found.services) == (1, 48, TIMEOUT, 3)
    assert slave.app.connections_free == 1
    assert master.ask(48, ABORT) == SC
    assert master.ask(48) == RS
    assert master.ask(48, READ) == RS
    assert slave.all_free()
    assert slave.texts() == [
        "class 2 connection of master 1 opened (server SAP 48, send time-out 2000 ms)",
        "class 2 connection of master 1 (server SAP 48) is over after 3 services: "
        "its master aborted it: its user, reason 5",
    ]
    assert (slave.app.stats.connections, slave.app.stats.closed) == (1, 1)


def test_answers_in_the_request_itself() -> None:
    slave = Slave(at_once=True)
    master = slave.master
    assert master.ask(49, INITIATE) == "56 30 00 C8"
    assert master.ask(48) == OPENED
    assert master.ask(48, READ) == READ_RES
    assert master.ask(48, IDLE) == IDLE
    assert master.ask(48, "4A") == ABORT_REQUEST
    assert master.ask(48) == RS
    assert slave.all_free()


@pytest.mark.parametrize(
    ("asked", "seconds"), [("00 00", 2), ("00 64", 2), ("00 C8", 2), ("00 C9", 2.01), ("FF FF", 655.35)]
)
def test_the_longer_send_timeout_counts(asked: str, seconds: float) -> None:
    slave = Slave()
    slave.master.initiate(f"57 01 02 03 {asked}" + INITIATE[17:])
    assert slave.app.connections[0].send_timeout_ns == round(seconds * 1_000) * MS


@pytest.mark.parametrize(
    ("baud", "seconds"), [(12_000_000, 1), (1_500_000, 1), (500_000, 2), (187_500, 4), (45_450, 4), (9_600, 4)]
)
def test_the_shortest_send_timeout_by_rate(baud: int, seconds: int) -> None:
    assert least_send_timeout(baud) == seconds * 1_000 * MS


def test_addresses_come_back_crosswise() -> None:
    """S_Addr of type 1 (with a network address) and D_Addr with API 1, SCL 2."""
    slave = Slave(max_len=64)
    sap = slave.master.initiate("57 00 00 00 00 64 01 00 00 00 00 00 01 08 00 02 03 04 0A 0B 0C 0D 0E 0F 01 02")
    assert slave.master.ask(sap) == "57 40 01 00 00 00 00 00 00 02 01 08 01 02 03 04 0A 0B 0C 0D 0E 0F"


# --- an Initiate that is refused --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "abort", "reason"),
    [
        ("5E 00 01 F0", ABORT_REQUEST, "MS"),
        ("57", ABORT_REQUEST, "Initiate"),
        (INITIATE[:-3], ABORT_REQUEST, "3 came"),
        (INITIATE + " 00", ABORT_REQUEST, "5 came"),
        ("57 00 00 00 00 64 01 00 00 00 00 00 00 03 00 02 00 00 00 00 00", ABORT_REQUEST, "type 0 has 2"),
        ("57 00 00 00 00 64 01 00 00 00 00 00 00 02 05 02 00 00 00 00", ABORT_REQUEST, "D_Addr of type 5"),
        ("48 01", ABORT_REQUEST, ""),
        ("00", ABORT_REQUEST, ""),
        (
            "57 00 00 00 00 64 01 00 00 00 00 00 00 02 01 08 00 00 01 02 00 00 00 00 00 00",
            ABORT_ADDRESS,
            "another network",
        ),
    ],
)
def test_an_initiate_that_cannot_be_is_aborted_at_its_server_sap(request_: str, abort: str, reason: str) -> None:
    slave = Slave(count=1)
    sap = slave.master.initiate(request_)
    assert slave.app.connections == ()
    assert slave.master.ask(sap) == abort
    assert slave.master.ask(sap) == RS
    (told,) = slave.texts()
    assert told.startswith("Initiate of master 1 refused: ")
    assert reason in told or reason == "MS"
    assert slave.all_free()
    slave.master.connect()


def test_no_connection_free() -> None:
    slave = Slave(count=1)
    slave.master.connect()
    other = Class2(slave.wire, 3)
    assert other.ask(49, INITIATE) == RS
    assert slave.master.ask(49, INITIATE) == RS
    slave.master.ask(48, ABORT)
    assert other.connect() == 48


def test_a_slave_without_ms2() -> None:
    slave = Slave(count=0)
    for sap in (49, 48, 0):
        assert slave.master.ask(sap) == RS
        assert slave.master.ask(sap, INITIATE) == RS


def test_all_server_saps() -> None:
    slave = Slave(count=49)
    assert [slave.master.connect() for _ in range(49)] == list(range(48, -1, -1))
    assert slave.master.ask(49, INITIATE) == RS
    assert slave.master.service(0, READ) == READ_RES
    for sap in range(49):
        assert slave.master.ask(sap, ABORT) == SC
    assert slave.all_free()


def test_initiates_before_an_answer_was_fetched_are_named_one_after_the_other() -> None:
    slave = Slave(count=3)
    for _ in range(3):
        assert slave.master.ask(49, INITIATE) == SC
    assert [slave.master.manager() for _ in range(5)] == [48, 47, 46, 46, 46]
    assert [slave.master.ask(sap) for sap in (46, 47, 48)] == [OPENED] * 3
    assert slave.master.ask(49) == SC
    assert len(slave.app.connections) == 3


def test_where_none_is_free_the_next_initiate_takes_the_place_of_one_that_was_not_fetched() -> None:
    slave = Slave(count=1)
    assert slave.master.ask(49, INITIATE) == SC
    assert slave.master.connect() == 48
    assert slave.texts()[1].endswith("0 services: another Initiate of its master came before the answer was fetched")
    assert len(slave.app.connections) == 1


def test_what_was_wrong_with_an_earlier_initiate_is_no_answer_to_the_next() -> None:
    slave = Slave(count=3)
    assert slave.master.ask(49, "57") == SC
    assert slave.master.connect() == 47
    assert slave.app.connections_free == 2


def test_one_that_was_fetched_is_not_taken_away() -> None:
    slave = Slave(count=1)
    assert slave.master.initiate() == 48
    assert slave.master.ask(49, INITIATE) == RS
    assert slave.master.ask(49) == "56 30 00 C8"
    assert slave.master.ask(48) == OPENED


def test_initiate_again_after_it_was_fetched_opens_a_second_one() -> None:
    slave = Slave(count=3)
    first, second = slave.master.initiate(), slave.master.initiate()
    assert (first, second) == (48, 47)
    assert slave.master.ask(second) == OPENED
    assert slave.master.ask(first) == OPENED
    assert slave.master.ask(49) == SC


# --- whose it is ------------------------------------------------------------------------------------------------------


def test_several_masters_at_once_and_nobody_gets_what_is_not_his() -> None:
    later = Later()
    slave = Slave(later, count=3)
    masters = [Class2(slave.wire, sa) for sa in (1, 3, 5)]
    for master in masters:
        assert master.ask(49, INITIATE) == SC
    assert [master.manager() for master in masters] == [48, 47, 46]
    for sap, master in zip((48, 47, 46), masters, strict=True):
        assert master.ask(sap) == OPENED
        assert master.ask(sap, f"5E 00 {sap:02X} F0") == SC
    assert [ticket.asker.master for ticket in later.tickets] == [1, 3, 5]
    for ticket in reversed(later.tickets):
        ticket.answer(bytes((ticket.asker.master,)))
    for sap, master in zip((48, 47, 46), masters, strict=True):
        others = [other for other in masters if other is not master]
        assert [other.ask(sap) for other in others] == [RS, RS]
        assert [other.ask(sap, ABORT) for other in others] == [RS, RS]
        assert master.ask(sap) == f"5E 00 {sap:02X} 01 {master.sa:02X}"
    assert Class2(slave.wire, 1, ssap=51).ask(48) == RS  # another user of the same master
    assert len(slave.app.connections) == 3


# --- services ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "response"),
    [
        ("5E 00 02 F0", "DE 80 B0 00"),
        ("5E 02 01 F0", "DE 80 B2 00"),
        ("5E FF 01 F0", "DE 80 B2 00"),
        ("5E 00", "DE 80 B8 00"),
        ("5E 00 01 F1", "DE 80 B1 00"),
        ("5F 01 02 05 BB", "DF 80 B1 00"),
        ("5F 00 01 03 01 02 03", "DF 80 B6 00"),
        ("51 00 01 01 55", "D1 80 A9 00"),
        ("51 00", "D1 80 B8 00"),
        ("51 00 01 02 55", "D1 80 B8 00"),
        ("51 FF 01 01 55", "D1 80 B2 00"),
    ],
)
def test_what_is_answered_with_a_code_and_the_connection_goes_on(request_: str, response: str) -> None:
    slave = Slave()
    sap = slave.master.connect()
    assert slave.master.service(sap, request_) == response
    assert slave.master.service(sap, READ) == READ_RES


@pytest.mark.parametrize(
    ("request_", "abort"),
    [
        ("00", ABORT_REQUEST),
        ("4A", ABORT_REQUEST),
        ("FF FF FF", ABORT_REQUEST),
        ("DE 80 B0 00", ABORT_REQUEST),
        (INITIATE, ABORT_SEQUENCE),
        ("56 30 00 C8", ABORT_SEQUENCE),
        ("5C 00 01 00", ABORT_SEQUENCE),
    ],
)
def test_what_has_no_place_in_a_connection_ends_it(request_: str, abort: str) -> None:
    slave = Slave(count=1)
    sap = slave.master.connect()
    assert slave.master.service(sap, request_) == abort
    assert slave.master.ask(sap) == RS
    assert slave.all_free()


def test_data_that_is_longer_than_the_slave_takes() -> None:
    slave = Slave(max_len=2)
    sap = slave.master.initiate()
    assert slave.master.ask(sap)[:5] == "57 02"
    assert slave.master.service(sap, READ) == "5E 00 01 02 11 22"
    assert slave.master.service(sap, "5F 01 02 03 01 02 03") == "DF 80 B1 00"
    assert slave.texts()[-1] == "MS2 of master 1 refused: 3 octets of data, 2 are possible"


def test_an_answer_that_comes_later_and_idle_until_then() -> None:
    later = Later()
    slave = Slave(later)
    sap = slave.master.connect()
    assert slave.master.service(sap, READ) == SC
    start = slave.wire.now
    told = []
    while slave.wire.now < start + 3 * TIMEOUT:
        slave.wire.pass_time(300 * MS)
        told.append(slave.master.ask(sap))
    assert set(told) == {SC, IDLE}
    assert told.count(IDLE) == 5  # from half the send time-out on
    later.tickets[0].answer(b"\x55")
    assert slave.master.ask(sap) == "5E 00 01 01 55"
    assert slave.master.ask(sap) == SC  # once: it shall not be taken for the next one's
    assert slave.master.service(sap, READ) == SC


def test_functions_that_fail() -> None:
    def transport(ticket: TransportTicket) -> None:
        if ticket.request.slot:
            raise RecordRefused(0xC2, 7)
        ticket.answer(bytes(241))

    class Broken:
        def ask(self, ticket: Ticket) -> None:
            raise ZeroDivisionError("records are broken")

    slave = Slave(Broken(), transport=transport)
    sap = slave.master.connect()
    slave.texts()
    assert slave.master.service(sap, READ) == "DE 80 A0 00"
    assert slave.master.service(sap, "51 01 02 00") == "D1 80 C2 07"
    assert slave.master.service(sap, "51 00 02 00") == "D1 80 A1 00"
    assert slave.texts() == [
        "Read of slot 0, index 1 of master 1 refused: its function failed (ZeroDivisionError: records are broken)",
        "Data_Transport to slot 0, index 2 of master 1 refused: its function failed "
        "(PduError: 241 octets of data, 240 are possible in one service)",
    ]


def test_data_transport() -> None:
    slave = Slave(transport=lambda ticket: ticket.answer(ticket.request.data[::-1]))
    sap = slave.master.connect()
    assert slave.master.service(sap, "51 03 04 02 AA BB") == "51 03 04 02 BB AA"
    assert slave.master.service(sap, "51 03 04 00") == "51 03 04 00"
    longest = " ".join(f"{n:02X}" for n in range(240))
    back = " ".join(f"{n:02X}" for n in reversed(range(240)))
    assert slave.master.service(sap, f"51 03 04 F0 {longest}") == f"51 03 04 F0 {back}"


def test_im_each_asker_has_a_call_of_its_own() -> None:
    slave = Slave(ImRecords([Im0(order_id="X"), Im1("fan", "hall")]), count=2)
    one, two = slave.master, Class2(slave.wire, 3)
    first, second = one.connect(), two.connect()
    assert one.service(first, "5F 00 FF 04 08 00 FD E8") == "5F 00 FF 04"
    assert two.service(second, "5F 00 FF 04 08 00 FD E9") == "5F 00 FF 04"
    assert one.service(first, "5E 00 FF F0")[:23] == "5E 00 FF 44 08 00 FD E8"
    assert two.service(second, "5E 00 FF F0")[:23] == "5E 00 FF 44 08 00 FD E9"
    one.ask(first, ABORT)
    assert one.service(one.connect(), "5E 00 FF F0") == "DE 80 B5 00"  # a new connection has called nothing


# --- in every state of the slave --------------------------------------------------------------------------------------


def cyclic(slave: Slave, fc: int, unit: str) -> str:
    """Something of the class 1 master 2."""
    da, sa = (0x88, 0x82) if fc & 0x100 else (0x08, 0x02)
    return slave.wire.ask(framed(da, sa, fc & 0xFF, unit))


def test_in_every_state_and_the_cycle_of_class_1_goes_on() -> None:
    later = Later()
    slave = Slave(later)
    master = slave.master
    assert slave.state() is SlaveAppState.WAIT_PRM
    sap = master.connect()
    assert master.ask(sap, READ) == SC
    assert cyclic(slave, 0x16D, "3D 3E" + PRM.hex()) == "E5"
    assert slave.state() is SlaveAppState.WAIT_CFG
    assert master.ask(sap) == SC
    assert cyclic(slave, 0x15D, "3E 3E" + CFG.hex()) == "E5"
    assert slave.state() is SlaveAppState.DATA_EXCH
    second = master.connect()
    assert cyclic(slave, 0x7D, "55")[-11:-6] == "08 01"  # the first exchange
    later.tickets[0].answer(b"\x01")
    assert master.ask(sap) == "5E 00 01 01 01"
    for number in range(2, 12):  # the watchdog is 100 ms: class 2 neither keeps it up nor disturbs it
        slave.wire.pass_time(80 * MS)
        assert cyclic(slave, 0x5D if number % 2 == 0 else 0x7D, "55")[-8:-6] == f"{number:02X}"
        assert master.ask(second, READ) == SC
        later.tickets[-1].answer(bytes((number,)))
        assert master.ask(second) == f"5E 00 01 01 {number:02X}"
    for _ in range(4):
        slave.wire.pass_time(40 * MS)
        assert master.ask(second) != RS
    assert slave.state() is SlaveAppState.WAIT_PRM
    assert len(slave.app.connections) == 2
    assert slave.app.stats.watchdogs == 1


def test_a_device_that_is_broken_is_still_asked() -> None:
    device = Recorder()
    slave = Slave(device=device)
    sap = slave.master.connect()
    cyclic(slave, 0x16D, "3D 3E" + PRM.hex())
    cyclic(slave, 0x15D, "3E 3E" + CFG.hex())
    device.broken = "exchange"
    assert cyclic(slave, 0x7D, "55")[9:11] == "03"
    assert slave.app.failure is not None
    assert slave.master.service(sap, READ) == READ_RES


# --- time -------------------------------------------------------------------------------------------------------------


def silent_for(slave: Slave, since: int, ns: int) -> None:
    """Until ``ns`` after ``since``, exactly."""
    slave.wire.pass_time(since + ns - slave.wire.now)


def reach(slave: Slave, later: Later, step: str) -> None:
    """A connection of master 1 at SAP 48, up to ``step``; each step is one telegram."""
    steps = ("initiate", "manager", "opened", "asked", "fetched", "idle", "idle answered")
    master = slave.master
    for one in steps[: steps.index(step) + 1]:
        match one:
            case "initiate":
                assert master.ask(49, INITIATE) == SC
            case "manager":
                assert master.manager() == 48
            case "opened":
                assert master.ask(48) == OPENED
            case "asked":
                assert master.ask(48, READ) == SC
            case "fetched":
                later.tickets[0].answer()
                assert master.ask(48) == "5E 00 01 00"
            case "idle":
                assert master.ask(48, IDLE) == SC
            case "idle answered":
                assert master.ask(48) == IDLE


@pytest.mark.parametrize(
    ("step", "factor"),
    [("initiate", 1), ("opened", 2), ("asked", 1), ("fetched", 2), ("idle", 1), ("idle answered", 2)],
)
def test_silence_ends_it_to_the_nanosecond(step: str, factor: int) -> None:
    later = Later()
    slave = Slave(later, count=1)
    reach(slave, later, step)
    deadline = slave.master.heard + factor * TIMEOUT
    slave.wire.pass_time(deadline - 1 - slave.wire.now)
    assert slave.saps() == [48]
    assert slave.app.wake_at() == deadline
    slave.wire.pass_time(1)
    assert slave.saps() == []
    assert slave.texts()[-1].endswith(f"nothing was heard of its master for {factor * 2000} ms")
    # the Abort waits for another send time-out, then the connection is forgotten
    assert slave.app.wake_at() == deadline + TIMEOUT
    slave.wire.pass_time(TIMEOUT - 1)
    assert slave.app.wake_at() == deadline + TIMEOUT
    slave.wire.pass_time(1)
    assert slave.app.wake_at() > deadline + 10 * TIMEOUT
    assert slave.master.ask(48) == RS
    assert slave.all_free()


def test_the_abort_after_silence_is_fetched() -> None:
    later = Later()
    slave = Slave(later, count=1)
    reach(slave, later, "asked")
    dropped: list[int] = []
    later.tickets[0].abandoned = lambda: dropped.append(1)
    slave.wire.pass_time(TIMEOUT + MS)
    assert dropped == [1]
    assert not later.tickets[0].asker.open
    assert slave.master.ask(48, READ) == SC  # nothing is left but the Abort
    assert slave.master.ask(48) == ABORT_TIMEOUT
    assert slave.master.ask(48) == RS
    assert len(later.tickets) == 1
    slave.master.connect()


def test_a_connection_that_is_over_is_given_to_who_asks() -> None:
    slave = Slave(count=1)
    slave.master.connect()
    slave.wire.pass_time(2 * TIMEOUT + MS)
    other = Class2(slave.wire, 3)
    assert other.connect() == 48
    assert slave.master.ask(48) == RS
    assert [connection.master for connection in slave.app.connections] == [3]


def test_polls_and_idle_keep_it() -> None:
    slave = Slave(count=1)
    sap = slave.master.connect()
    for _ in range(4):
        slave.wire.pass_time(2 * TIMEOUT - 20 * MS)
        assert slave.master.service(sap, IDLE) == IDLE
        slave.wire.pass_time(2 * TIMEOUT - 20 * MS)
        assert slave.master.ask(sap) == SC
    assert len(slave.app.connections) == 1


# --- every way out ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", ["initiate", "manager", "opened", "asked", "fetched", "idle", "idle answered"])
def test_an_abort_of_the_master_at_every_step(step: str) -> None:
    later = Later()
    slave = Slave(later, count=1)
    reach(slave, later, step)
    assert slave.master.ask(48, ABORT) == SC
    assert slave.master.ask(48) == RS
    assert slave.master.ask(49) == SC
    assert slave.all_free()
    assert all(not ticket.open or ticket.response for ticket in later.tickets)
    slave.master.connect()


@pytest.mark.parametrize("subnet", [0, 1, 2, 7])
@pytest.mark.parametrize("instance", [0, 1, 2, 3])
@pytest.mark.parametrize("reason", [1, 2, 3, 4, 5, 6, 7, 8, 15, 0, 12])
def test_each_reason_of_an_abort_is_told(subnet: int, instance: int, reason: int) -> None:
    slave = Slave(count=1)
    sap = slave.master.connect()
    slave.master.ask(sap, f"58 {subnet:02X} {instance << 4 | reason:02X} 00")
    assert slave.texts()[-1].endswith(f"its master aborted it: {Abort(reason, instance, subnet).text}")
    assert slave.all_free()


@pytest.mark.parametrize("short", ["58", "58 00", "58 00 25", "58 00 25 00 01 02 03"])
def test_an_abort_of_another_length_is_an_abort(short: str) -> None:
    slave = Slave(count=1)
    assert slave.master.ask(slave.master.connect(), short) == SC
    assert slave.all_free()


@pytest.mark.parametrize("step", ["initiate", "opened", "asked", "fetched"])
@pytest.mark.parametrize("way", ["restart", "initial reset", "rate lost", "address"])
def test_what_else_ends_it(way: str, step: str) -> None:
    later = Later()
    device = Recorder()
    device.set_slave_add = True
    slave = Slave(later, count=1, device=device)
    reach(slave, later, step)
    slave.texts()
    now = slave.wire.now
    match way:
        case "restart":
            slave.app.restart(now)
        case "initial reset":
            slave.app.initial_reset(now)
        case "rate lost":
            slave.app.rate_lost(now)
        case "address":
            assert cyclic(slave, 0x16D, "37 3E 09 0A 35 00") == "E5"
    assert slave.all_free()
    (told,) = [text for text in slave.texts() if "class 2 connection" in text]
    reasons = {
        "restart": "the slave was switched off",
        "initial reset": "the slave was switched off",
        "rate lost": "the baud rate was lost",
        "address": "the slave has another address",
    }
    assert told.endswith(f": {reasons[way]}")
    assert all(not ticket.open or ticket.response for ticket in later.tickets)
    later.tickets.clear()
    assert slave.app.wake_at() > now + 100 * TIMEOUT


def test_a_slave_that_searches_its_rate_gives_them_back() -> None:
    slave = Slave(count=1)
    searching = SearchingSlave(slave.wire.station, slave.app, rates=[500_000])
    slave.master.connect()
    searching._reached(searching.state.SEARCH, slave.wire.now)
    assert slave.all_free()


# --- the table --------------------------------------------------------------------------------------------------------


REQUESTS = {
    Ev.POLL: "",
    Ev.SERVICE: READ,
    Ev.IDLE: IDLE,
    Ev.ABORT: ABORT,
    Ev.OUT_OF_PLACE: INITIATE,
    Ev.UNREADABLE: "4A",
}


def test_the_table_is_whole() -> None:
    assert set(TABLE) == {(state, event) for state in State for event in Ev}
    assert all(row.source for row in TABLE.values())


@pytest.mark.parametrize(("state", "event"), list(TABLE))
def test_every_row_of_the_table(state: State, event: Ev) -> None:
    later = Later()
    slave = Slave(later, count=1)
    master = slave.master
    reach(slave, later, {State.OPEN: "fetched", State.ANSWERED: "idle"}.get(state, "asked"))
    if state is State.OVER:
        master.ask(48, INITIATE)
    tickets = len(later.tickets)
    slave.texts()
    act = TABLE[state, event].act
    if event is Ev.SILENCE:
        slave.wire.pass_time(2 * TIMEOUT)
        assert slave.all_free()
        after = master.ask(48)
        assert after == (RS if act is Act.FREE else ABORT_TIMEOUT)
        return
    first = master.ask(48, REQUESTS[event])
    again = master.ask(48)
    told = slave.texts()
    aborts = {Act.SEQUENCE: ABORT_SEQUENCE, Act.REQUEST_PDU: ABORT_REQUEST}
    if event is Ev.POLL:
        answers = {State.OPEN: SC, State.WORKING: SC, State.ANSWERED: IDLE, State.OVER: ABORT_SEQUENCE}
        assert first == answers[state]
        assert again == (RS if state is State.OVER else SC)
    elif act is Act.FREE:
        assert (first, again) == (SC, RS)
    elif act in aborts:
        assert (first, again) == (SC, aborts[act])
        assert master.ask(48) == RS
        assert len(told) == 1
    else:
        expected = {State.OPEN: IDLE if event is Ev.IDLE else SC, State.ANSWERED: IDLE, State.OVER: ABORT_SEQUENCE}
        assert (first, again) == (SC, expected.get(state, SC))
    assert len(later.tickets) == tickets + (act is Act.SERVE)
    assert slave.all_free() is (act in (Act.FREE, Act.SEQUENCE, Act.REQUEST_PDU) or state is State.OVER)


def test_what_cannot_be_is_refused_at_once() -> None:
    for count, max_len in ((50, 240), (-1, 240), (1, 0), (1, 241)):
        with pytest.raises(ConfigError, match="ms2"):
            Slave(count=count, max_len=max_len)
