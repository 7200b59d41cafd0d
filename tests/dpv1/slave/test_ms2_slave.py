"""MS2 of a slave against a master of class 2 in octets: the sequence, its services, every state of the slave."""

from __future__ import annotations

import pytest
from octet_class2 import (
    ABORT,
    ABORT_ADDRESS,
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
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.dpv1.slave.resource_manager import ms2_of
from dpstack.dpv1.timeouts import least_send_timeout
from dpstack.errors import ConfigError, RecordRefused, UsageError
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


# --- Initiate at a slave: what the resource manager gives out, what it refuses, and to whom -------------------------


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
    assert ms2_of(slave.app).connections == ()
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
    assert len(ms2_of(slave.app).connections) == 3


def test_without_a_free_connection_initiate_takes_the_place_of_an_unfetched_one() -> None:
    slave = Slave(count=1)
    assert slave.master.ask(49, INITIATE) == SC
    assert slave.master.connect() == 48
    assert slave.texts()[1].endswith("0 services: another Initiate of its master came before the answer was fetched")
    assert len(ms2_of(slave.app).connections) == 1


def test_the_fault_of_an_earlier_initiate_is_no_answer_to_the_next() -> None:
    slave = Slave(count=3)
    assert slave.master.ask(49, "57") == SC
    assert slave.master.connect() == 47
    assert ms2_of(slave.app).free == 2


def test_a_fetched_connection_is_not_taken_away() -> None:
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


# --- Connections of class 2 that a slave refuses: by its device, by the length; Aborts of its application -----------


class Picky(Recorder):
    """A device that opens connections for the profile 0x1234 only, and fails over 0x9999; its records never answer."""

    def __init__(self, longest: int = 244) -> None:
        super().__init__()
        self.ms2_max_initiate = longest
        self.dropped = 0

    def initiate(self, master: int, wanted: InitiateReq) -> None:
        if wanted.profile_ident == 0x9999:
            raise ZeroDivisionError("no such profile")
        if wanted.profile_ident != 0x1234:
            raise RecordRefused(0xB6, master)

    def ask(self, request: RecordRequest) -> None:
        request.abandoned = self.drop

    def drop(self) -> None:
        self.dropped += 1


class PickySlave(Slave):
    """Slave 8 with a picky device, and a master of class 2."""

    def __init__(self, longest: int = 244) -> None:
        self.picky = Picky(longest)
        super().__init__(self.picky, count=1, device=self.picky)

    def connect(self) -> int:
        """The server SAP of a connection for the profile 0x1234."""
        sap = self.master.initiate(initiate(0x1234))
        assert self.master.ask(sap) == OPENED
        return sap


def initiate(profile: int, extra: str = "") -> str:
    """For ``profile``; ``extra``: network address and MAC of the source."""
    kind = f"01 {2 + len(bytes.fromhex(extra)):02X}" if extra else "00 02"
    return f"57 00 00 00 00 64 01 00 00 00 {profile:04X} {kind} 00 02 00 00 {extra} 00 00"


@pytest.mark.parametrize(
    ("profile", "answer", "told"),
    [
        (0, "D7 80 B6 01", "Initiate of master 1 refused: its function: "),
        (
            0x9999,
            "D7 80 C3 00",
            "Initiate of master 1 refused: its function failed (ZeroDivisionError: no such profile)",
        ),
    ],
)
def test_a_device_refuses_initiate_by_a_negative_response(profile: int, answer: str, told: str) -> None:
    slave = PickySlave()
    sap = slave.master.initiate(initiate(profile))
    assert ms2_of(slave.app).connections == ()
    assert slave.master.ask(sap) == answer
    assert slave.master.ask(sap) == RS
    (text,) = slave.texts()
    assert text.startswith(told)
    assert slave.app.stats.connections == 0
    slave.connect()
    assert slave.picky.calls == []


def test_an_initiate_that_is_too_long() -> None:
    slave = PickySlave(longest=27)
    longer = initiate(0x1234, "00 01 02 03 04 05 06 07")
    assert len(bytes.fromhex(longer)) == 28
    sap = slave.master.initiate(longer)
    assert slave.master.ask(sap) == ABORT_REQUEST
    (text,) = slave.texts()
    assert "Initiate of 28 octets, 27 are possible (Max_Initiate_PDU_Length)" in text
    slave.picky.ms2_max_initiate = 28
    sap = slave.master.initiate(longer)
    assert slave.master.ask(sap)[:2] == "57"


@pytest.mark.parametrize("longest", [19, 245])
def test_impossible_lengths_of_initiate(longest: int) -> None:
    with pytest.raises(ConfigError, match="ms2_max_initiate"):
        PickySlave(longest)


@pytest.mark.parametrize("step", ["opened", "working"])
@pytest.mark.parametrize("reason", [0, 15])
def test_the_application_aborts(step: str, reason: int) -> None:
    """Its master fetches the Abort; who works at a service is told; then there is room again."""
    slave = PickySlave()
    sap = slave.connect()
    if step == "working":
        assert slave.master.ask(sap, READ) == SC
    ms2_of(slave.app).abort(sap, reason, slave.wire.now)
    assert ms2_of(slave.app).connections == ()
    assert slave.picky.dropped == (step == "working")
    assert slave.master.ask(sap) == f"58 00 2{reason:X}"
    assert slave.master.ask(sap) == RS
    assert slave.texts()[-1].endswith(f"services: it was aborted here (reason {reason})")
    assert ms2_of(slave.app).free == 1
    with pytest.raises(UsageError, match=f"no open class 2 connection at server SAP {sap}; see connections"):
        ms2_of(slave.app).abort(sap, 0, slave.wire.now)


def test_an_abort_that_is_not_fetched_frees_the_connection() -> None:
    slave = PickySlave()
    sap = slave.connect()
    with pytest.raises(UsageError, match=r"an Abort has no reason 16: 0\.\.15"):
        ms2_of(slave.app).abort(sap, 16, slave.wire.now)
    ms2_of(slave.app).abort(sap, 0, slave.wire.now)
    with pytest.raises(UsageError, match="no open class 2 connection"):
        ms2_of(slave.app).abort(sap, 0, slave.wire.now)
    slave.wire.pass_time(2_001 * MS)
    assert slave.master.ask(sap) == RS
    assert slave.master.initiate(INITIATE) == sap
