"""Each request of a master's services: SAPs, the longest answer that the cycle leaves time for, requests given up."""

from __future__ import annotations

import pytest
from alarm_kit import AlarmBus, block
from ms1_kit import DL, MS, RS, SC, Ms1Bus, answer, status
from ms2_kit import Ms2Bus, connected, sd1, sd2
from octet_slave import RR

from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import CloseConnections, ConnectionOver, ConnectionsClosed
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.ms2 import Ms2
from dpstack.dpv1.master.ms2_connection import MasterConnection
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection
from dpstack.dpv1.master.plugin_queue import ReadReq, RecordQueue, WriteReq
from dpstack.dpv1.pdu.ms2 import Address, InitiateReq
from dpstack.fdl.interface import Failure, Request
from dpstack.fdl.telegram import Kind, Req, Telegram


class Requests:
    """The guard of a station, which lets everything pass and writes down (DSAP, SSAP, octets, longest answer)."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, int | None, str, int]] = []

    def __call__(self, request: Request) -> str | None:
        if request.dsap is not None and request.dsap <= 51:
            assert request.function is Req.SRD_HIGH
            self.seen.append((request.dsap, request.ssap, request.data.hex(), request.answer))
        return None


def test_ms1() -> None:
    requests = Requests()
    kit = AlarmBus(guard=requests)
    kit.slave.ms1 = lambda data: answer(4, "5E 01 02 01 07" if data[:1] == b"\x5e" else "5F 01 02 01")
    kit.read(1, 2, 9)
    kit.read(1, 2, 0)
    kit.write(1, 2, b"\1")
    kit.raise_and_end(block(2, 3))
    assert requests.seen == [
        (51, 51, "5e010209", 13),
        (51, 51, "5e010200", 4),
        (51, 51, "5f01020101", 4),
        (51, 51, "5c030201", 4),
        (51, 51, "", 4),
    ]


def test_ms2() -> None:
    requests = Requests()
    kit = Ms2Bus(guard=requests)
    kit.slave.direct = True
    kit.open()
    kit.read(1, 1, 2, 9)
    kit.write(1, 1, 2, b"\1\2\3")
    kit.transport(1, 1, 2, b"\1")
    kit.run(100)
    kit.close(1)
    assert requests.seen == [
        (49, 50, "5700000000140100000000000002000200000000", 4),
        (48, 50, "", 16),
        (48, 50, "5e010209", 13),
        (48, 50, "5f010203010203", 4),
        (48, 50, "5101020101", 244),
        (48, 50, "4801", 4),
        (48, 50, "580020", 4),
    ]
    requests.seen.clear()
    far = InitiateReq(200 * MS, source=Address(1, 2, bytes(8)), destination=Address(3, 4, bytes(6)))
    kit.send(OpenConnection(5, 4, far))
    kit.end_of(5, InitiateDone)
    assert [answer for *_, answer in requests.seen] == [4, 30]  # twelve octets and both addresses


@pytest.mark.parametrize(("max_len", "longest"), [(5, 9), (0, 244), (240, 244)])
def test_data_transport_of_a_slave_with_less(max_len: int, longest: int) -> None:
    requests = Requests()
    kit = Ms2Bus(guard=requests)
    kit.slave.initiate = bytes((0x57, max_len)) + kit.slave.initiate[2:]
    kit.open()
    kit.transport(1, 1, 2, b"\1")
    assert {answer for dsap, _, octets, answer in requests.seen if dsap == 48 and octets[:2] == "51"} == {longest}


# --- the state of a connection, request by request ------------------------------------------------------------------

READ = Request(4, Req.SRD_HIGH, bytes.fromhex("5E 58 58 F0"), 48, 50)
ACK = Telegram(Kind.SC, 2, 4, 0)
BUSY = Telegram(Kind.SD1, 2, 4, RR)


@pytest.mark.parametrize(
    ("octets", "outstanding"),
    [("5E5858F0", True), ("48 01", True), ("57 00", True), ("58 00 13", False), ("58", False)],
)
def test_a_request_that_was_sent_is_outstanding(octets: str, outstanding: bool) -> None:
    connection = MasterConnection(1, 4, 200 * MS, 0, outstanding=not outstanding)
    ms2 = Ms2(2, None)
    ms2.started(replace_data(READ, octets, connection))
    assert connection.outstanding is outstanding
    assert ms2.may_be_taken(replace_data(READ, octets, connection)) is outstanding


def replace_data(request: Request, octets: str, tag: object) -> Request:
    return Request(request.da, request.function, bytes.fromhex(octets), request.dsap, request.ssap, tag=tag)


@pytest.mark.parametrize("outstanding", [True, False])
def test_polls_and_the_requests_of_others_leave_it(outstanding: bool) -> None:
    connection = MasterConnection(1, 4, 200 * MS, 0, outstanding=outstanding)
    ms2 = Ms2(2, None)
    ms2.started(replace_data(READ, "", connection))
    ms2.started(READ)
    assert not ms2.may_be_taken(READ)
    for outcome in (Failure.NO_ANSWER, ACK, BUSY):
        ms2.request_ended(READ, outcome, 5)
        ms2.request_ended(replace_data(READ, "", connection), outcome, 0)
    assert (connection.outstanding, connection.answered_at) == (outstanding, 0)


@pytest.mark.parametrize(
    ("outcome", "outstanding", "answered_at"),
    [(ACK, True, 5), (BUSY, False, 5), (Failure.NO_ANSWER, True, 0), (Failure.GARBLED, True, 0)],
)
def test_not_now_means_that_the_request_was_not_taken(
    outcome: Telegram | Failure, outstanding: bool, answered_at: int
) -> None:
    connection = MasterConnection(1, 4, 200 * MS, 0, outstanding=True)
    ms2 = Ms2(2, None)
    ms2.request_ended(replace_data(READ, "5E0102F0", connection), outcome, 5)
    assert (connection.outstanding, connection.answered_at) == (outstanding, answered_at)


def test_a_new_connection() -> None:
    found = MasterConnection(7, 4, 200 * MS, 0)
    assert (found.lane, found.limit_ns, found.limit_text) == (
        (4, -1), 1_000 * MS, "1 s (no C2_Response_Timeout is known of it)",
    )  # fmt: skip
    assert not any((found.max_len, found.answered_at, found.taken, found.outstanding, found.opened, found.ordered))
    assert (found.reason, found.abort, found.stale, found.last) == ("", None, 0, None)
    found.server_sap, found.response_ns = 48, 30 * MS
    assert (found.lane, found.limit_ns, found.limit_text) == ((4, 7), 30 * MS, "0.03 s (its C2_Response_Timeout)")
    slow = MasterConnection(7, 4, 3_000 * MS, 0)
    assert slow.limit_ns == 3_000 * MS


@pytest.mark.parametrize(("response_ns", "third"), [(0, 200), (300 * MS, 100)])
def test_an_idle_that_was_lost_goes_out_again_after_a_third_of_the_time(response_ns: int, third: int) -> None:
    """Of the send time-out of 600 ms, or of the slave's time for a service where that is shorter."""
    kit = Ms2Bus()
    kit.open(send_timeout_ns=600 * MS, response_ns=response_ns)
    times: list[int] = []

    def say(octets: bytes) -> bytes | None:
        if octets[9:-2] != b"\x48\x01":
            return SC
        times.append(kit.bus.now)
        return None if len(times) <= 2 else SC

    kit.slave.says[48] = say
    kit.until(lambda: len(times) == 3)
    assert times[1] - times[0] < MS
    assert third * MS <= times[2] - times[1] < (third + 25) * MS


@pytest.mark.parametrize(("answer_", "stale"), [("48 01", 0), ("48 58", 0), ("5E 48 48 00", 1), ("5F 48 48 01", 1)])
def test_an_answer_to_idle_that_is_none_is_counted(answer_: str, stale: int) -> None:
    kit = Ms2Bus()
    kit.open()
    (connection,) = (one for ms2 in kit.acyclic.providers if isinstance(ms2, Ms2) for one in ms2.connections.values())
    kit.slave.serve = lambda pdu: bytes.fromhex(answer_)
    kit.until(lambda: kit.slave.received(0x48))
    kit.run(10)
    assert len(kit.slave.received(0x48)) == 1
    assert (connection.stale, connection.outstanding) == (stale, False)


# --- records of a drive plugin --------------------------------------------------------------------------------------


def test_requests_of_a_plugin_that_cannot_be() -> None:
    for request, text in (
        (ReadReq(1, 300), "index 300 does not exist: 0..255"),
        (ReadReq(255, 2), "slot 255 does not exist: 0..254"),
        (WriteReq(1, 2, bytes(241)), "241 octets of data, 240 are possible in one record"),
    ):
        kit = Ms1Bus(dpv1=Dpv1(c1_max_data_len=64))
        unit = _Unit()
        kit.master.handlers[4].image.plugin = unit  # type: ignore[assignment]
        pending = unit.records.submit(request)
        kit.until(lambda pending=pending: pending.outcome)  # type: ignore[misc]
        assert pending.outcome == Outcome(ServiceFailure.LENGTH, text)
        assert kit.slave.asked == []


class _Unit:
    """A drive plugin, as far as it has records."""

    def __init__(self) -> None:
        self.records = RecordQueue()

    def lost(self, now: int) -> None:
        self.records.clear()

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        return b""

    def safe(self, configured: bytes) -> bytes:
        return configured

    def moved(self, address: int) -> str | None:
        return None


def test_the_queue_of_a_plugin() -> None:
    queue = RecordQueue()
    assert (bool(queue), queue.take()) == (False, None)
    first, second = queue.submit(ReadReq(1, 2)), queue.submit(WriteReq(1, 2, b""))
    assert (first.request, first.outcome, first.cancelled) == (ReadReq(1, 2), None, False)
    queue.cancel(first)
    assert (first.cancelled, bool(queue), queue.take(), bool(queue)) == (True, True, second, False)
    queue.cancel(second)
    assert second.cancelled
    queue.submit(ReadReq(1, 2))
    queue.clear()
    assert not queue


def test_a_plugin_of_a_slave_without_dpv1_waits() -> None:
    kit = Ms1Bus(dpv1=None)
    unit = _Unit()
    kit.master.handlers[4].image.plugin = unit  # type: ignore[assignment]
    pending = unit.records.submit(ReadReq(1, 2))
    kit.run(20)
    assert (pending.outcome, bool(unit.records), kit.slave.asked) == (None, True, [])


# --- A slave that is silent, unreadable or answers with something else, at MS1, the resource manager and a server SAP


GARBLED = sd2(2, 4, DL, 51, 51, b"\1")[:-2] + b"\0\x16"  # its check octet
OF_ANOTHER_SAP = sd2(2, 4, DL, 51, 60, b"\1")
OF_ANOTHER_STATION = sd1(2, 9, 0)
SILENT, UNREADABLE, WRONG = ServiceFailure.SILENT, ServiceFailure.UNREADABLE, ServiceFailure.WRONG
Answer = tuple[bytes | None, ServiceFailure, str, str, str]
CABLE = "look for a second station with its address, and at cable and termination"
ANSWERS: dict[str, Answer] = {
    "silent": (None, SILENT, "does not answer", "does not answer", "check its power and the cable"),
    "another station": (OF_ANOTHER_STATION, SILENT, "does not answer", "does not answer",
                        "check its power and the cable"),
    "garbled": (GARBLED, UNREADABLE, "gives no readable answer to", "gives no readable answer to", CABLE),
    "another SAP": (OF_ANOTHER_SAP, WRONG, "gives no readable answer to", "gives answers that do not belong to",
                    "look for a second station with its address"),
}  # fmt: skip


@pytest.mark.parametrize("case", ["garbled", "another SAP"])
def test_an_unusable_answer_at_ms1(case: str) -> None:
    octets, failure, does, _, _ = ANSWERS[case]
    kit = Ms1Bus()
    kit.slave.ms1 = lambda data: octets
    read, write = kit.read().outcome, kit.write(1, 2, b"\1").outcome
    assert (read.failure, read.text) == (failure, f"slave 4 {does} Read of slot 1, index 2; try again")
    text = f"slave 4 {does} Write of slot 1, index 2; it may have been carried out: read it back"
    assert (write.failure, write.text) == (failure, text)


@pytest.mark.parametrize("case", ANSWERS.values(), ids=ANSWERS)
def test_a_server_sap(case: Answer) -> None:
    octets, failure, _, does, todo = case
    limit = "within 0.05 s (its C2_Response_Timeout); the connection was ended"
    for service, after in (("Read", ""), ("Write", "; it may have been carried out")):
        kit = connected(response_ns=50 * MS)
        kit.slave.says[48] = lambda _: octets
        done = kit.read(1) if service == "Read" else kit.write(1, 1, 2, b"\1")
        title = f"{service} of slot 1, index 2"
        assert done.outcome.failure is failure
        assert done.text == f"slave 4 {does} {title} {limit}: {todo}, then open a new one{after}"
        over = kit.over(1)
        assert over.text == (f"slave 4: class 2 connection (server SAP 48) is over: {title} had no answer in time")
        assert (over.abort, over.ordered) == ((0, 1, 3), False)
    kit = Ms2Bus()
    kit.slave.says[48] = lambda _: octets
    done_ = kit.open(response_ns=50 * MS)
    assert done_.text == f"slave 4 {does} Initiate {limit}: {todo}, then open a new one"
    assert kit.events_of(ConnectionOver) == []  # it was never open


def test_the_resource_manager() -> None:
    nobody = (
        "slave 4 is there (it answers Slave_Diag) and leaves Initiate (SAP 49) without an answer; it has no class 2 "
        "connections (a device of DP-V0, or C2_Read_Write_supp = 0 in its GSD file): records of a DP-V1 slave can be "
        "asked for by its own master, of a DP-V0 slave by nobody"
    )
    for octets, failure, text in (
        (None, ServiceFailure.REFUSED, nobody),
        (OF_ANOTHER_STATION, ServiceFailure.REFUSED, nobody),
        (GARBLED, UNREADABLE, f"slave 4 gives no readable answer to Initiate; {CABLE}"),
        (OF_ANOTHER_SAP, WRONG, f"slave 4 gives no readable answer to Initiate; {CABLE}"),
    ):
        kit = Ms2Bus()
        kit.slave.says[49] = lambda _, octets=octets: octets  # type: ignore[misc]
        done = kit.open(response_ns=50 * MS)
        assert (done.outcome.failure, done.text) == (failure, text)
    kit = Ms2Bus()
    kit.slave.mute = True
    assert kit.open(response_ns=50 * MS).text == "slave 4 does not answer Initiate; check address and power"
    kit = Ms2Bus()
    kit.slave.says[49] = lambda _: SC
    done = kit.open(response_ns=50 * MS)
    assert (done.outcome.failure, done.text) == (
        ServiceFailure.LATE,
        "slave 4: its resource manager has no answer to Initiate within 0.05 s (its C2_Response_Timeout); try again, "
        "or give it longer (response_timeout)",
    )


LATE_TODO = "; try again, or give it longer (dpv1 = { response_timeout_ms = ... })"


@pytest.mark.parametrize(
    ("octets", "failure", "text"),
    [
        (
            status(4, RS), ServiceFailure.REFUSED,
            "slave 4 refuses {} (RS): SAP 51 is closed; it was switched off and on just now, has no Read and Write "
            "(C1_Read_Write_supp of its GSD file), or takes them only with other parameters",
        ),
        (
            status(4, RR), ServiceFailure.LATE,
            "{} to slave 4 had no answer within 0.03 s (its C1_Response_Timeout): it was busy all the time" + LATE_TODO,
        ),
        (
            SC, ServiceFailure.LATE,
            "{} to slave 4 had no answer within 0.03 s (its C1_Response_Timeout): it exchanges data, but does not work "
            "at this service" + LATE_TODO,
        ),
    ],
)  # fmt: skip
def test_ms1_that_answers_nothing(octets: bytes, failure: ServiceFailure, text: str) -> None:
    kit = Ms1Bus(dpv1=Dpv1(c1_response_timeout_ns=30 * MS))
    kit.slave.ms1 = lambda data: octets
    read, write = kit.read().outcome, kit.write(1, 2, b"\1").outcome
    assert (read.failure, read.text) == (failure, text.replace("{}", "Read of slot 1, index 2", 1))
    maybe = "; it may have been carried out: read it back" if failure is ServiceFailure.LATE else ""
    assert (write.failure, write.text) == (failure, text.replace("{}", "Write of slot 1, index 2", 1) + maybe)


def test_the_end_of_the_bus() -> None:
    kit = connected()
    kit.open()
    kit.send(CloseConnections())
    kit.until(lambda: kit.events_of(ConnectionsClosed))
    assert [(over.text, over.ordered, over.abort) for over in kit.events_of(ConnectionOver)] == [
        (f"slave 4: class 2 connection (server SAP {sap}) is over: the bus was closed here", True, (0, 2, 0))
        for sap in (48, 47)
    ]
    (closed,) = kit.events_of(ConnectionsClosed)
    assert (closed.text, closed.must_arrive) == ("no class 2 connection is open any more", True)
    kit.send(CloseConnections())  # nothing is open
    assert len(kit.events_of(ConnectionsClosed)) == 2
    kit.freed()


# --- services that end with data exchange ---------------------------------------------------------------------------


def test_reasons_for_which_a_service_of_ms1_can_not_end_any_more() -> None:
    kit = Ms1Bus()
    (ms1,) = (one for one in kit.acyclic.providers if isinstance(one, Ms1))
    handler = kit.master.handlers[4]
    since = handler.since
    assert ms1.bar(handler, since) == ""
    assert ms1.bar(handler, since - 1) == "the slave left data exchange and came back; repeat it"
    removed = "the slave was removed from this bus, or parameterised anew; repeat it afterwards"
    assert ms1.bar(Ms1Bus().master.handlers[4], since) == removed
    assert Ms1(None).bar(handler, since) == removed
    kit.slave.mute = True
    kit.until(lambda: handler.state is not SlaveState.DATA_EXCHANGE)
    gone = ms1.bar(handler, since)
    assert gone.startswith("the slave is not in data exchange but in ")
    assert handler.fault is not None
    assert gone.endswith(f" ({handler.fault.text}); repeat it when it is")
    kit.slave.mute = False
    kit.until_exchanging()
    assert ms1.bar(handler, since) == "the slave left data exchange and came back; repeat it"
    kit.send(SetMode(Mode.STOP))
    kit.until(lambda: kit.master.mode is Mode.STOP)
    assert ms1.bar(handler, handler.since) == (
        "the master is in Stop, where nothing is sent to slaves; repeat it in Clear or Operate"
    )
