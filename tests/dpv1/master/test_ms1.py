"""MS1 of the master against slaves of octets: literal telegrams, every kind of answer, one end each."""

from __future__ import annotations

import pytest
from ms1_kit import MS, Ms1Bus, OctetMs1Slave, answer, first_an_old_one, status
from octet_slave import NR, RR, RS, SC, UE

from dpstack.dp.acyclic.class2 import ReadService, Service, ServiceDone
from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.dp.acyclic.queue import CAPACITY
from dpstack.dp.master.commands import Mode, RemoveSlave, SetMode
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError
from dpstack.machine import LineDown

RDL = 0x0C


def polled(slave: OctetMs1Slave, octets: str, after: int = 1) -> None:
    """The slave acknowledges a request, and answers it at poll number ``after``."""

    def ms1(data: bytes) -> bytes:
        if data:
            slave.asked.clear()
            slave.asked.append(data)
            return SC
        return answer(slave.address, octets) if len(slave.asked) > after else SC

    slave.ms1 = ms1


@pytest.fixture
def kit() -> Ms1Bus:
    return Ms1Bus()


def test_literal_telegrams_of_a_read(kit: Ms1Bus) -> None:
    polled(kit.slave, "5E 01 02 03 AA BB CC")
    start = len(kit.bus.log)
    done = kit.read(1, 2, 8)
    assert done.outcome.data == bytes.fromhex("AA BB CC")
    assert done.text == "slave 4: Read of slot 1, index 2, 3 octets"
    ms1 = [sent.octets.hex(" ") for sent in kit.bus.log[start:] if len(sent.octets) > 8 and sent.octets[7] == 51]
    # SRD high, DSAP 51, SSAP 51; the FCB of the station goes on with each of its requests
    assert ms1[0] == "68 09 09 68 84 82 5d 33 33 5e 01 02 08 32 16"
    assert ms1[1] == "68 05 05 68 84 82 5d 33 33 c9 16"  # data were exchanged between them
    assert ms1[2] == "68 0c 0c 68 82 84 08 33 33 5e 01 02 03 aa bb cc 09 16"


def test_a_write_and_the_parameters_that_open_it(kit: Ms1Bus) -> None:
    assert kit.slave.prm[7:] == b"\x80\0\0"
    polled(kit.slave, "5F 00 2F 02")
    done = kit.write(0, 47, b"\x12\x34")
    assert (done.outcome.failure, done.outcome.data) == (None, b"")
    assert kit.slave.asked[0] == bytes.fromhex("5F 00 2F 02 12 34")
    assert done.text == "slave 4: Write of slot 0, index 47 done"


def test_answered_in_the_request_itself(kit: Ms1Bus) -> None:
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 55")
    assert kit.read().outcome.data == b"\x55"
    assert len(kit.slave.asked) == 1


@pytest.mark.parametrize("not_yet", [SC, status(4, NR), status(4, 0x00), status(4, RR), status(4, UE)])
def test_the_slave_answers_not_yet(kit: Ms1Bus, not_yet: bytes) -> None:
    def ms1(data: bytes) -> bytes:
        if data:
            return SC
        return answer(4, "5E 01 02 01 55") if len(kit.slave.asked) > 20 else not_yet

    kit.slave.ms1 = ms1
    assert kit.read().outcome.data == b"\x55"


@pytest.mark.parametrize("busy", [RR, UE])
def test_a_request_that_is_not_taken_now_is_repeated(kit: Ms1Bus, busy: int) -> None:
    kit.slave.ms1 = lambda data: status(4, busy) if len(kit.slave.asked) < 4 else answer(4, "5E 01 02 01 55")
    assert kit.read().outcome.data == b"\x55"
    assert kit.slave.asked == [bytes.fromhex("5E 01 02 F0")] * 4


@pytest.mark.parametrize(
    ("octets", "failure", "text"),
    [
        ("DE 80 B5 00", ServiceFailure.NEGATIVE, "slave 4 refuses Read of slot 1, index 2: state conflict (80 B5 00"),
        ("DE 80 B0 07", ServiceFailure.NEGATIVE, "invalid index (80 B0 07"),
        ("DE 80 B6 11", ServiceFailure.NEGATIVE, "; the record is read-only, write-only, or locked"),
        ("DE FE 01 02", ServiceFailure.NEGATIVE, "codes of FMS"),
        ("5E 01 02 05 55", ServiceFailure.LENGTH, "octet 4 says 5 octets of data, 1 came"),
        ("5E 01 02 09 01 02 03 04 05 06 07 08 09", ServiceFailure.LENGTH, "with 9 octets, 8 were asked for"),
        ("00 01 02 03", ServiceFailure.LENGTH, "octet 1 is 0x00"),
        ("5E", ServiceFailure.LENGTH, "octet 2 (slot) is missing"),
    ],
)
def test_negative_and_unreadable_answers(kit: Ms1Bus, octets: str, failure: ServiceFailure, text: str) -> None:
    polled(kit.slave, octets)
    outcome = kit.read(1, 2, 8).outcome
    assert outcome.failure is failure
    assert text in outcome.text
    assert outcome.codes == (tuple(bytes.fromhex(octets)[1:]) if failure is ServiceFailure.NEGATIVE else None)
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 55")
    assert kit.read().outcome.data == b"\x55"  # and the next is served


def test_a_write_that_took_another_length(kit: Ms1Bus) -> None:
    polled(kit.slave, "5F 01 02 01")
    outcome = kit.write(1, 2, b"\1\2").outcome
    assert outcome.failure is ServiceFailure.LENGTH
    assert outcome.text == "slave 4 says it took 1 octet by Write of slot 1, index 2, 2 were given"


def test_answers_to_other_requests_are_dropped_and_counted(kit: Ms1Bus) -> None:
    others = ["5E 01 03 01 11", "5E 02 02 01 22", "5F 01 02 01", "DF 80 B0 00", "5E 01 02 01 55"]

    def ms1(data: bytes) -> bytes:
        return SC if data else answer(4, others.pop(0))

    kit.slave.ms1 = ms1
    done = kit.read()
    assert (done.outcome.data, done.stale) == (b"\x55", 4)


def test_old_data_that_come_instead_of_taking_the_request(kit: Ms1Bus) -> None:
    kit.slave.ms1 = lambda data: (
        answer(4, "5E 09 09 01 11", RDL) if len(kit.slave.asked) == 1 else answer(4, "5E 01 02 01 55")
    )
    done = kit.read()
    assert (done.outcome.data, done.stale) == (b"\x55", 1)
    assert kit.slave.asked == [bytes.fromhex("5E 01 02 F0")] * 2


@pytest.mark.parametrize(
    ("code", "failure", "of", "text"),
    [
        pytest.param(RS, ServiceFailure.REFUSED, "RS", "C1_Read_Write_supp", id="it has no MS1"),
        pytest.param(RR, ServiceFailure.LATE, "", "it was busy all the time; try again", id="it is always busy"),
    ],
)
def test_a_slave_that_takes_no_request(kit: Ms1Bus, code: int, failure: ServiceFailure, of: str, text: str) -> None:
    kit.slave.ms1 = lambda data: status(4, code)
    outcome = kit.read().outcome
    assert (outcome.failure, outcome.status) == (failure, of)
    assert text in outcome.text


@pytest.mark.parametrize(
    ("dpv1", "ms", "of"),
    [(Dpv1(), 1_000, "no C1_Response_Timeout"), (Dpv1(c1_response_timeout_ns=70 * MS), 70, "its C1_Response_Timeout)")],
)
def test_a_slave_that_never_answers(dpv1: Dpv1, ms: int, of: str) -> None:
    kit = Ms1Bus(dpv1=dpv1)
    begun = kit.bus.now
    done = kit.read()
    assert done.outcome.failure is ServiceFailure.LATE
    assert f"had no answer within {ms / 1000:g} s (" in done.outcome.text
    assert of in done.outcome.text
    assert ms <= (kit.bus.now - begun) // MS <= ms + 30


def after_a_late_read() -> Ms1Bus:
    """The slave has 100 ms for an answer, and did not answer a Read in this time."""
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=100 * MS))
    assert kit.read().outcome.failure is ServiceFailure.LATE
    return kit


def test_a_late_answer_is_fetched_before_the_next_request() -> None:
    """The answer comes after its time-out: it is not taken for the next one, though it looks the same."""
    kit = after_a_late_read()
    old = first_an_old_one(kit.slave)
    done = kit.read()
    assert (done.outcome.data, done.stale, old) == (b"\x22", 1, [])
    assert kit.read().stale == 0


def test_an_unfetched_answer_survives_a_cancelled_service() -> None:
    kit = after_a_late_read()
    token = kit.order_read(run_ms=20)
    kit.send(CancelService(token))
    assert kit.end(token).outcome.failure is ServiceFailure.CANCELLED
    old = first_an_old_one(kit.slave)
    assert (kit.read().outcome.data, old) == (b"\x22", [])


def test_an_unfetched_answer_that_never_comes() -> None:
    kit = after_a_late_read()
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 22") if data else SC
    assert kit.read().outcome.data == b"\x22"


def test_one_service_for_a_slave_at_a_time_in_order_and_several_slaves_at_once() -> None:
    kit = Ms1Bus((4, 5))
    busy = {4: 0, 5: 0}
    most = {4: 0, 5: 0}
    together = 0

    def ms1_of(slave: OctetMs1Slave) -> None:
        here, request, polls = slave.address, b"", 0

        def ms1(data: bytes) -> bytes:
            nonlocal request, polls, together
            if data:
                request, polls = data, 0
                busy[here] += 1
                most[here] = max(most[here], busy[here])
                together = max(together, sum(busy.values()))
                return SC
            polls += 1
            if polls < 5:
                return SC
            busy[here] -= 1
            return answer(here, f"5E {request[1]:02X} {request[2]:02X} 01 {request[2]:02X}")

        slave.ms1 = ms1

    for slave in kit.slaves.values():
        ms1_of(slave)
    tokens = [kit.order_read(1, index, address=address) for index in range(5) for address in (4, 5)]
    for token in tokens:
        kit.end(token)
    assert most == {4: 1, 5: 1}
    assert together == 2
    for address in (4, 5):
        mine = [done for done in kit.done if done.address == address]
        assert [done.outcome.data[0] for done in mine] == [0, 1, 2, 3, 4]


def test_a_slow_slave_holds_no_other_one_up() -> None:
    """Slave 4 never answers; meanwhile 5 is read, and class 2 asks too: everybody has a turn."""
    kit = Ms1Bus((4, 5))
    kit.slaves[5].ms1 = lambda data: answer(5, "5E 01 02 01 22")
    kit.order_read()
    begun = kit.bus.now
    for _ in range(10):
        assert kit.read(address=5).outcome.data == b"\x22"
    kit.send(ReadService(99, 4, Service.CONFIG))
    while not any(isinstance(event, ServiceDone) for event in kit.bus.events):
        kit.run(1)
    assert kit.bus.now - begun < 200 * MS
    assert kit.acyclic.waiting == 1


def test_data_exchange_goes_on_with_one_request_at_most_between(kit: Ms1Bus) -> None:
    start = len(kit.bus.log)
    for _ in range(8):
        kit.order_read()
    kit.run(300)
    kinds = [
        "data" if sent.octets[0] == 0x10 and sent.octets[3] != 0x49 else "ms1"
        for sent in kit.bus.log[start:]
        if sent.sender == 2 and (sent.octets[0] == 0x10 or (sent.octets[0] == 0x68 and sent.octets[7] == 51))
    ]
    assert kinds.count("ms1") > 20
    assert "ms1 ms1" not in " ".join(kinds)


# --- ends from outside --------------------------------------------------------------------------------------------


def test_misuse_raises_at_once(kit: Ms1Bus) -> None:
    for slot, index, length, address, what in (
        (255, 0, 240, 4, "slot 255 does not exist"),
        (0, 256, 240, 4, "index 256 does not exist"),
        (0, 0, 241, 4, "241 octets of data, 240 are possible"),
        (0, 0, 240, 9, "station 9 is no slave of this master"),
    ):
        with pytest.raises(UsageError, match=what):
            kit.order_read(slot, index, length, address=address)
    with pytest.raises(UsageError, match="241 octets of data, 240 are possible"):
        kit.write(0, 0, bytes(241))
    with pytest.raises(UsageError, match="dpv1 = true"):
        Ms1Bus(dpv1=None).order_read()
    for _ in range(CAPACITY):
        kit.order_read()
    with pytest.raises(UsageError, match="32 services for slave 4 are waiting already"):
        kit.order_read()


def test_each_event_has_its_end_once(kit: Ms1Bus) -> None:
    polled(kit.slave, "5E 01 02 00")
    for _ in range(3):
        kit.read()
    assert [done.token for done in kit.bus.events if isinstance(done, RecordDone)] == [1, 2, 3]


# --- Services of MS1 that are cut short: the slave is silent or leaves data exchange, the port, Stop, time, cancelled


def test_the_slave_leaves_data_exchange(kit: Ms1Bus) -> None:
    tokens = [kit.order_read(), kit.order_read(2, 2)]
    kit.run(20)
    kit.slave.mute = True
    for token in tokens:
        outcome = kit.end_of(token, RecordDone, 500).outcome
        assert outcome.failure in (ServiceFailure.CLOSED, ServiceFailure.SILENT), outcome
    assert "was given up: the slave is not in data exchange but in " in kit.end(tokens[1]).outcome.text
    kit.slave.mute = False
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 22") if data else SC
    kit.until_exchanging()
    assert kit.read().outcome.data == b"\x22"  # nothing is owed: it has forgotten everything


def test_a_slave_that_is_not_in_data_exchange(kit: Ms1Bus) -> None:
    kit.slave.mute = True
    kit.run(200)
    outcome = kit.read().outcome
    assert outcome.failure is ServiceFailure.CLOSED
    assert "not in data exchange but in offline" in outcome.text


def test_the_slave_is_removed_the_master_stops_the_port_vanishes() -> None:
    kit = Ms1Bus((4, 5))
    first = kit.order_read(run_ms=10)
    kit.send(RemoveSlave(4))
    assert "removed from this bus" in kit.end(first).outcome.text
    second = kit.order_read(address=5, run_ms=10)
    kit.send(LineDown("unplugged"))
    outcome = kit.end(second).outcome
    assert (outcome.failure, "unplugged" in outcome.text) == (ServiceFailure.LINE, True)


def test_stop_leaves_a_service_without_data_exchange(kit: Ms1Bus) -> None:
    token = kit.order_read(run_ms=10)
    kit.send(SetMode(Mode.STOP))
    outcome = kit.end(token).outcome
    assert outcome.failure is ServiceFailure.CLOSED
    assert outcome.text.endswith(
        "was given up: the master is in Stop, where nothing is sent to slaves; repeat it in Clear or Operate"
    )


def test_cancelled_under_way_its_answer_is_fetched_later(kit: Ms1Bus) -> None:
    token = kit.order_read(run_ms=20)
    kit.send(CancelService(token))
    assert kit.end(token).outcome.failure is ServiceFailure.CANCELLED
    first_an_old_one(kit.slave)
    assert kit.read().outcome.data == b"\x22"


def test_silence_a_read_is_repeated_a_write_is_not(kit: Ms1Bus) -> None:
    def silent_twice(data: bytes) -> bytes | None:
        return None if len(kit.slave.asked) <= 4 else answer(4, "5E 01 02 01 22")  # each time with its repetition

    kit.slave.ms1 = silent_twice
    assert kit.read().outcome.data == b"\x22"
    kit.slave.ms1 = lambda data: None
    outcome = kit.write(1, 2, b"\1").outcome
    assert outcome.failure is ServiceFailure.SILENT
    assert outcome.text.endswith("does not answer Write of slot 1, index 2; it may have been carried out: read it back")
    assert kit.read().outcome.failure is ServiceFailure.SILENT


@pytest.mark.parametrize("cut", ["its time", "the slave's time", "data exchange", "the port", "Stop"])
def test_a_write_that_is_cut_short_may_have_been_carried_out(kit: Ms1Bus, cut: str) -> None:
    tokens = (1, 2, 3)
    kit.slave.ms1 = lambda data: SC  # taken, and never answered
    timeout = 200 * MS if cut == "its time" else 1_500 * MS
    kit.send(RecordOrder(1, Function.WRITE, 1, 2, data=b"\1", timeout_ns=timeout, address=4))
    kit.send(RecordOrder(2, Function.READ, 1, 2, 240, timeout_ns=timeout, address=4))
    kit.send(RecordOrder(3, Function.WRITE, 1, 3, data=b"\1", timeout_ns=timeout, address=4))
    kit.run(20)
    match cut:
        case "data exchange":
            kit.slave.mute = True
        case "the port":
            kit.send(LineDown("unplugged"))
        case "Stop":
            kit.send(SetMode(Mode.STOP))
        case _:
            pass
    outcomes = [kit.end(token).outcome for token in tokens]
    assert all(outcome.failure is not None for outcome in outcomes)
    asked, read, never_asked = (outcome.text for outcome in outcomes)
    assert asked.endswith("; it may have been carried out: read it back")
    assert "carried out" not in read
    assert "carried out" not in never_asked
