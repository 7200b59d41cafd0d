"""A slave that is silent, unreadable or answers with something else, at MS1, the resource manager and a server SAP."""

from __future__ import annotations

import pytest
from ms1_kit import DL, MS, RS, SC, Ms1Bus, status
from ms2_kit import Ms2Bus, connected, sd1, sd2
from octet_slave import RR

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.orders import CloseConnections, ConnectionOver, ConnectionsClosed

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
def test_ms1(case: str) -> None:
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
