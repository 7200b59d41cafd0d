"""MS2 of a slave against a master of class 2 in octets: the sequence, its services, every state of the slave."""

from __future__ import annotations

import pytest
from octet_class2 import (
    ABORT,
    ABORT_REQUEST,
    ABORT_SEQUENCE,
    IDLE,
    INITIATE,
    OPENED,
    RS,
    SC,
    Class2,
)
from octet_wire import MS
from slave_kit import CFG, PRM, Recorder

from dpstack.dp.slave.application import SlaveAppState
from dpstack.dpv1.pdu.im import Im0, Im1
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.dpv1.timeouts import least_send_timeout
from dpstack.errors import ConfigError, RecordRefused
from tests.dpv1.ms2_slave_kit import READ, READ_RES, TIMEOUT, Later, Slave, cyclic

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
    (found,) = ms2_of(slave.app).connections
    assert (found.master, found.sap, found.send_timeout_ns, found.services) == (1, 48, TIMEOUT, 3)
    assert ms2_of(slave.app).free == 1
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
    assert ms2_of(slave.app).connections[0].send_timeout_ns == round(seconds * 1_000) * MS


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
    assert [request.asker.master for request in later.requests] == [1, 3, 5]
    for request in reversed(later.requests):
        request.answer(bytes((request.asker.master,)))
    for sap, master in zip((48, 47, 46), masters, strict=True):
        others = [other for other in masters if other is not master]
        assert [other.ask(sap) for other in others] == [RS, RS]
        assert [other.ask(sap, ABORT) for other in others] == [RS, RS]
        assert master.ask(sap) == f"5E 00 {sap:02X} 01 {master.sa:02X}"
    assert Class2(slave.wire, 1, ssap=51).ask(48) == RS  # another user of the same master
    assert len(ms2_of(slave.app).connections) == 3


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
def test_refusals_with_a_code_that_keep_the_connection(request_: str, response: str) -> None:
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
def test_requests_out_of_place_end_a_connection(request_: str, abort: str) -> None:
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
    later.requests[0].answer(b"\x55")
    assert slave.master.ask(sap) == "5E 00 01 01 55"
    assert slave.master.ask(sap) == SC  # once: it shall not be taken for the next one's
    assert slave.master.service(sap, READ) == SC


def test_functions_that_fail() -> None:
    def transport(request: RecordRequest) -> None:
        if request.service.slot:
            raise RecordRefused(0xC2, 7)
        request.answer(bytes(241))

    class Broken:
        def ask(self, request: RecordRequest) -> None:
            raise ZeroDivisionError("records are broken")

    slave = Slave(Broken(), transport=transport)
    sap = slave.master.connect()
    slave.texts()
    assert slave.master.service(sap, READ) == "DE 80 A0 00"
    assert slave.master.service(sap, "51 01 02 00") == "D1 80 C2 07"
    assert slave.master.service(sap, "51 00 02 00") == "D1 80 A1 00"
    line = Broken.ask.__code__.co_firstlineno + 1
    assert slave.texts() == [
        "Read of slot 0, index 1 of master 1 refused: its function failed (ZeroDivisionError: records are broken), "
        f"in ask(), test_ms2_slave.py line {line}",
        "Data_Transport to slot 0, index 2 of master 1 refused: its function failed "
        "(PduError: 241 octets of data, 240 are possible in one service), "
        f"in transport(), test_ms2_slave.py line {transport.__code__.co_firstlineno + 3}",
    ]


def test_data_transport() -> None:
    slave = Slave(transport=lambda request: request.answer(request.service.data[::-1]))
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
    later.requests[0].answer(b"\x01")
    assert master.ask(sap) == "5E 00 01 01 01"
    for number in range(2, 12):  # the watchdog is 100 ms: class 2 neither keeps it up nor disturbs it
        slave.wire.pass_time(80 * MS)
        assert cyclic(slave, 0x5D if number % 2 == 0 else 0x7D, "55")[-8:-6] == f"{number:02X}"
        assert master.ask(second, READ) == SC
        later.requests[-1].answer(bytes((number,)))
        assert master.ask(second) == f"5E 00 01 01 {number:02X}"
    for _ in range(4):
        slave.wire.pass_time(40 * MS)
        assert master.ask(second) != RS
    assert slave.state() is SlaveAppState.WAIT_PRM
    assert len(ms2_of(slave.app).connections) == 2
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


def test_impossible_settings_are_refused_at_once() -> None:
    for count, max_len in ((50, 240), (-1, 240), (1, 0), (1, 241)):
        with pytest.raises(ConfigError, match="ms2"):
            Slave(count=count, max_len=max_len)
