"""Full texts of the ends of services, of refused orders and of remarks about alarms, one situation each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from alarm_kit import ALL, AlarmBus, block
from ms1_kit import DL, MS, SC, Ms1Bus, answer
from ms2_kit import Ms2Bus, connected, connections_of, sd2
from msgspec import structs

from dpstack.dp.acyclic.job import CancelService, Outcome, ServiceFailure
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_orders import AcknowledgeAlarm, AlarmDone, ConnectionOver, ConnectionsClosed, HoldAlarms
from dpstack.dpv1.master.orders import OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError
from dpstack.fdl.interface import Request

READ = "Read of slot 1, index 2"


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(UsageError) as refused:
        call()
    return str(refused.value)


# --- a read-only bus ------------------------------------------------------------------------------------------------


def no_services(request: Request) -> str | None:
    """The guard of a station that may not use the services of DP-V1."""
    return "read-only" if request.dsap is not None and request.dsap <= 51 else None


def test_services_that_this_station_may_not_use() -> None:
    kit = Ms1Bus(guard=no_services)
    for done, title in ((kit.read(), READ), (kit.write(1, 2, b"\1"), "Write of slot 1, index 2")):
        assert done.outcome == Outcome(ServiceFailure.GUARDED, f"slave 4 was not sent {title}; this bus is read-only")
        assert done.stale == 0
    assert not kit.slave.asked


def test_an_alarm_whose_acknowledgement_this_station_may_not_send() -> None:
    kit = AlarmBus(guard=no_services)
    kit.raise_and_end(block(2, 3))
    title = "Alarm_Ack of process alarm, slot 3, sequence number 0"
    assert kit.ends[0].outcome == Outcome(
        ServiceFailure.GUARDED, f"slave 4 was not sent {title}; this bus is read-only"
    )
    assert kit.remarks == [
        f"was not sent {title}; this bus is read-only; the alarm was delivered, but the slave may wait for ever"
    ]


def test_a_class_2_connection_that_this_station_may_not_use() -> None:
    kit = Ms2Bus(guard=no_services)
    assert kit.open().outcome == Outcome(
        ServiceFailure.GUARDED, "slave 4: Initiate was not sent; this bus is read-only"
    )
    kit.freed()
    closed: list[bool] = []
    kit = Ms2Bus(guard=lambda request: no_services(request) if closed else None)
    kit.open()
    closed.append(True)
    for done, title in (
        (kit.read(1), "Read"), (kit.write(1, 1, 2, b"\1"), "Write"), (kit.transport(1, 1, 2, b""), "Data_Transport"),
    ):  # fmt: skip
        text = f"slave 4: {title} of slot 1, index 2 was not sent; this bus is read-only"
        assert done.outcome == Outcome(ServiceFailure.GUARDED, text)  # so it was not carried out either
    assert not kit.slave.received(0x5F)


@pytest.mark.parametrize(
    "order",
    [RecordOrder(1, Function.READ, 1, 2, address=4), HoldAlarms(4, True), OpenConnection(1, 4)],
    ids=["Read", "HoldAlarms", "OpenConnection"],
)
def test_orders_to_a_read_only_bus(order: Any) -> None:
    kit = Ms1Bus()
    kit.master.context.settings = structs.replace(kit.master.context.settings, read_only=True)
    who = (
        "no connection is opened"
        if isinstance(order, OpenConnection)
        else ("its slaves are not in data exchange with it")
    )
    assert refusal(lambda: kit.send(order)) == f"this bus is read-only: {who}; leave read_only out"
    kit.send(HoldAlarms(4, False))


# --- orders that are refused ----------------------------------------------------------------------------------------


def test_orders_to_slaves_without_dpv1_and_to_strangers() -> None:
    kit = Ms1Bus(dpv1=None)
    for order in (RecordOrder(1, Function.WRITE, 1, 2, address=4), HoldAlarms(4, True)):
        assert refusal(lambda order=order: kit.send(order)) == (  # type: ignore[misc]
            "slave 4 (s4) is not parameterised for DP-V1: no Read, Write, alarms; "
            "if it has them put dpv1 = true into its [[slave]] table"
        )
    kit.send(HoldAlarms(4, False))
    kit.send(AcknowledgeAlarm(4, 1))
    for stray in (RecordOrder(1, Function.READ, 1, 2, address=5), HoldAlarms(5, True), HoldAlarms(5, False),
                  AcknowledgeAlarm(5, 1)):  # fmt: skip
        for bus in (kit, Ms2Bus()):  # without a master there are no slaves either
            assert refusal(lambda stray=stray, bus=bus: bus.send(stray)) == (  # type: ignore[misc]
                "station 5 is no slave of this master: MS1 is between a slave and its own master"
            )
    assert refusal(lambda: Ms1Bus().send(RecordOrder(1, Function.DATA_TRANSPORT, 1, 2, address=4))) == (
        "Data_Transport goes over a class 2 connection only: name one instead of an address"
    )


@pytest.fixture
def kit() -> Ms2Bus:
    return Ms2Bus()


def test_connections_that_cannot_be(kit: Ms2Bus) -> None:
    assert refusal(lambda: kit.order_read(7)) == "there is no open class 2 connection 7; open a new one"
    for ns in (0, -1):
        assert refusal(lambda ns=ns: kit.order_open(send_timeout_ns=ns)) == (  # type: ignore[misc]
            "a send time-out of 0 s or less ends a connection at once: 0.01 s is the least"
        )
    assert refusal(lambda: kit.order_open(response_ns=-MS)) == (
        "-0.001 s is no time for an answer: 0 for as long as is usual"
    )
    assert refusal(lambda: kit.order_open(address=2)) == "address 2 is that of this master itself"
    assert refusal(lambda: kit.order_open(address=127)) == ("address 127: a slave has 0..126 (126: as delivered)")
    assert connections_of(kit.acyclic) == 0
    for token in range(100, 164):
        kit.send(OpenConnection(token, token % 8 + 3))
    assert refusal(lambda: kit.order_open()) == "64 class 2 connections are open already: close one first"


def test_the_most_octets_of_a_connection(kit: Ms2Bus) -> None:
    kit.slave.initiate = bytes.fromhex("57 05 01 00 00 00 00 00 00 02 00 02 00 00 00 00")
    assert kit.open().max_len == 5
    assert kit.write(1, 1, 2, bytes(5)).outcome == Outcome()
    assert refusal(lambda: kit.order_read(1, length=6)) == (
        "slave 4 takes up to 5 octets of data in one service (Max_Len_Data_Unit of its Initiate), not 6"
    )
    for initiate, most in (("57 00", 240), ("57 F1", 240)):
        kit = Ms2Bus()
        kit.slave.initiate = bytes.fromhex(initiate) + kit.slave.initiate[2:]
        assert kit.open().max_len == most
    kit.close(1)
    assert refusal(lambda: kit.order_read(1)) == "there is no open class 2 connection 1; open a new one"


def test_a_connection_that_is_being_closed() -> None:
    kit = connected()
    kit.slave.mute = True
    kit.run(220)
    assert refusal(lambda: kit.order_read(1)) == (
        "there is no open class 2 connection 1: nothing was heard of the slave for 0.2 s (the send time-out); "
        "open a new one"
    )


# --- Initiate -------------------------------------------------------------------------------------------------------

OVER = "slave 4: Initiate has no answer, the class 2 connection is over: the slave aborted it"


@pytest.mark.parametrize(
    ("pdu", "text", "codes"),
    [
        ("58000016", f"{OVER}: its link layer: a reserved reason (reason 0)", (0, 0, 0)),
        (
            "580016",
            f"{OVER}: the send time-out asked for is too short (ABT_STO); ask for 200 ms or more",
            (0, 1, 6),
        ),
        ("580026", f"{OVER}: its user, reason 6", (0, 2, 6)),
        ("580015", f"{OVER}: an impossible service of its user (ABT_IV)", (0, 1, 5)),
        ("5800", f"{OVER}, but why cannot be read: Abort ends after 2 octets: octet 3 (reserved) is missing", None),
        (
            "D780C300",
            "slave 4 refuses Initiate: resource unavailable (80 C3 00: class resource, code 3)",
            (128, 195, 0),
        ),
        (
            "560F",
            "slave 4: its resource manager answers Initiate with unreadable octets: Resource_Manager ends after "
            "2 octets: octet 3 (send_timeout) is missing",
            None,
        ),
        (
            "D7",
            "slave 4 answers Initiate with unreadable octets: DP-V1 negative response ends after 1 octet: octet 2 "
            "(error_decode) is missing",
            None,
        ),
    ],
)
def test_answers_of_the_resource_manager(kit: Ms2Bus, pdu: str, text: str, codes: tuple[int, ...] | None) -> None:
    kit.slave.says = {49: lambda octets: sd2(2, 4, DL, 50, 49, bytes.fromhex(pdu))}
    done = kit.open()
    assert (done.text, done.outcome.codes) == (text, codes)
    assert done.outcome.status == ("80 C3 00" if pdu[:2] == "D7" and codes else "")
    assert kit.events_of(ConnectionOver) == []  # it was never open


@pytest.mark.parametrize("idles", [1, 3])
def test_idle_of_the_resource_manager_is_no_answer_yet(kit: Ms2Bus, idles: int) -> None:
    waiting, usual = [b"\x48\x01"] * idles, kit.slave.manage
    kit.slave.manage = lambda pdu: waiting.pop() if waiting and not pdu else usual(pdu)  # type: ignore[method-assign]
    done = kit.open()
    assert done.text == "slave 4: class 2 connection open, server SAP 48"
    assert done.title == "Initiate"
    assert not waiting


@pytest.mark.parametrize(
    ("free", "channels", "facts"),
    [
        ([], 0, ""),
        ([], 2, " (C2_Max_Count_Channels = 2)"),
        ([7], 0, " (1 of them from here)"),
        ([7], 3, " (C2_Max_Count_Channels = 3, 1 of them from here)"),
    ],
)
def test_no_connection_left(kit: Ms2Bus, free: list[int], channels: int, facts: str) -> None:
    kit.slave.free = free
    if free:
        kit.open()
    done = kit.open(channels=channels)
    assert done.text == (
        f"slave 4 refuses Initiate (RS at SAP 49): all its class 2 connections are in use{facts}, or it has none "
        "(C2_Read_Write_supp of its GSD file); close one, or wait until another master does"
    )
    assert done.outcome.status == "RS"


def test_a_server_sap_that_is_in_use() -> None:
    kit = connected()
    kit.slave.free = [48]
    done = kit.open()
    assert done.outcome == Outcome(
        ServiceFailure.WRONG,
        "slave 4 gives out server SAP 48, which is in use by this master; close that connection first",
    )


# --- services over a connection, and its end ------------------------------------------------------------------------


def test_an_answer_that_cannot_be_read_ends_the_connection() -> None:
    services: list[tuple[Callable[[Ms2Bus], RecordDone], str]] = [
        (lambda kit: kit.read(1), f"slave 4 answers {READ} with unreadable octets: "
                                  "Read response: octet 4 says 5 octets of data, 0 came"),
        (lambda kit: kit.write(1, 1, 2, b"\1"), "slave 4 answers Write of slot 1, index 2 with unreadable octets: "
                                                "Read response: octet 4 says 5 octets of data, 0 came; "
                                                "it may have been carried out"),
    ]  # fmt: skip
    for service, text in services:
        kit = connected()
        kit.slave.serve = lambda pdu: b"\x5e\x01\x02\x05"
        assert service(kit).outcome == Outcome(ServiceFailure.LENGTH, text)
        over = kit.over(1)
        assert over.text == (
            "slave 4: class 2 connection (server SAP 48) is over: the slave answered what cannot be read"
        )
        assert (over.abort, over.ordered) == ((0, 1, 4), False)
        kit.freed()


def test_the_answer_to_a_service_that_was_given_up_never_comes() -> None:
    kit = connected(send_timeout_ns=2_000 * MS, response_ns=300 * MS)
    kit.slave.serve = lambda pdu: None
    given_up = kit.order_read(1, run_ms=20)
    kit.send(CancelService(given_up))
    done = kit.read(1, 3, 4)
    assert [end.text for end in kit.events_of(RecordDone)] == [
        f"{READ} to slave 4 was cancelled",
        "slave 4 has no answer to a service that was given up within 0.3 s (its C2_Response_Timeout); the connection "
        "was ended: open a new one, with a longer response_timeout where it needs that",
    ]
    assert (done.stale, done.outcome.failure) == (0, ServiceFailure.LATE)
    assert kit.over(1).reason == "a service that was given up had no answer in time"
    kit.freed()


def test_an_order_to_close_a_connection_twice_is_no_error() -> None:
    kit = connected()
    over = kit.close(1)
    assert over.text == "slave 4: class 2 connection (server SAP 48) is over: it was closed here"
    kit.close(1)
    assert kit.events_of(ConnectionOver) == [over]
    assert ConnectionsClosed(t_ns=0).text == "no class 2 connection is open any more"


# --- alarms ---------------------------------------------------------------------------------------------------------

ACK = "Alarm_Ack of process alarm, slot 3, sequence number 0"
PROCESS = block(2, 3)
V1 = Dpv1(alarms=ALL, alarm_mode=0, c1_response_timeout_ns=50 * MS)


def _kit(dpv1: Dpv1 = V1, **slave: Any) -> AlarmBus:
    kit = AlarmBus(dpv1=dpv1)
    for name, value in slave.items():
        setattr(kit.alarm_slave, name, value)
    return kit


def _says(octets: str) -> dict[int, Callable[[bytes], bytes]]:
    return {51: lambda _: answer(4, octets)}


WAITS = "; the alarm was delivered, but the slave may wait for ever"
AGAIN = "; it is acknowledged again until it answers"
LATE = (
    "within 0.05 s (its C1_Response_Timeout): it exchanges data, but does not work at this service; "
    "try again, or give it longer (dpv1 = { response_timeout_ms = ... })"
)
REMARKS: dict[str, tuple[dict[str, Any], bytes, str, dict[str, int]]] = {
    "an alarm that is not enabled": (
        {"dpv1": Dpv1(alarms=("process",))}, block(1, 3),
        "its diagnosis holds a diagnosis alarm, a kind that Set_Prm did not enable: neither delivered nor "
        'acknowledged; where it raises them put "diagnostic" into dpv1 = { alarms = [...] }',
        {"not_enabled": 1},
    ),
    "an alarm of the vendor that is not enabled": (
        {"dpv1": Dpv1(alarms=("process",))}, block(40, 3),
        "its diagnosis holds a vendor alarm 40, a kind that Set_Prm did not enable: neither delivered nor "
        'acknowledged; where it raises them put "manufacturer" into dpv1 = { alarms = [...] }',
        {"not_enabled": 1},
    ),
    "a block without its head": (
        {}, bytes.fromhex("03 02 01"),
        "its diagnosis holds a device block that is neither alarm nor status (alarm or status ends after 3 octets: "
        "octet 4 (sequence) is missing): 03 02 01",
        {"malformed": 1},
    ),
    "an acknowledgement that is refused": (
        {"refuses": ["B0"]}, PROCESS,
        f"refuses {ACK}: invalid index (80 B0 00: class access, code 0); its manual lists the records it has{WAITS}",
        {"raised": 1, "refused": 1},
    ),
    "an acknowledgement that is refused for good after it was busy": (
        {"refuses": ["B5", "C2", "B8"]}, PROCESS,
        f"refuses {ACK}: invalid parameter (80 B8 00: class access, code 8){WAITS}",
        {"raised": 1, "refused": 1, "repeated": 2},
    ),
    "a response without its end": (
        {"says": _says("5C")}, PROCESS,
        f"answers {ACK} with unreadable octets: Alarm_Ack ends after 1 octet: octet 2 (slot) is missing{WAITS}",
        {"raised": 1, "refused": 1},
    ),
    "a response with an octet too many": (
        {"says": _says("5C030201AA")}, PROCESS,
        f"answers {ACK} with unreadable octets: Alarm_Ack has 5 octets, octet 4 is the last one{WAITS}",
        {"raised": 1, "refused": 1},
    ),
    "a negative response without its codes": (
        {"says": _says("DC80")}, PROCESS,
        f"answers {ACK} with unreadable octets: DP-V1 negative response ends after 2 octets: octet 3 (error_code_1) "
        f"is missing{WAITS}",
        {"raised": 1, "refused": 1},
    ),
    "the extra SAP is closed": (
        {"dpv1": Dpv1(alarms=ALL, extra_alarm_sap=True)}, PROCESS,
        "SAP 50 is closed, though it says Extra_Alarm_SAP: its alarms are acknowledged at SAP 51 "
        "(extra_alarm_sap = false)",
        {"raised": 1, "acknowledged": 1, "repeated": 1},
    ),
    "it does not answer": (
        {"says": {51: lambda _: None}}, PROCESS, f"does not answer {ACK}{AGAIN}", {"raised": 1, "repeated": 1}
    ),
    "it never works at it": (
        {"says": {51: lambda _: SC}}, PROCESS,
        f"{ACK} to slave 4 had no answer {LATE}{AGAIN}", {"raised": 1, "repeated": 1}
    ),
}  # fmt: skip


@pytest.mark.parametrize(("slave", "raised", "remark", "counted"), REMARKS.values(), ids=REMARKS)
def test_remarks_about_alarms(slave: dict[str, Any], raised: bytes, remark: str, counted: dict[str, int]) -> None:
    kit = _kit(**slave)
    kit.alarm_slave.raises(raised)
    kit.until(lambda: kit.remarks)
    kit.until(lambda: structs.asdict(kit.counts).items() >= counted.items())
    assert kit.remarks == [remark]
    assert {name: count for name, count in structs.asdict(kit.counts).items() if count} == counted


@pytest.mark.parametrize("wrong", ["DE80B500", "5C030200", "5C030101", "5C040201", "5C030209", "5E010200"])
def test_answers_to_other_requests_are_no_acknowledgement(wrong: str) -> None:
    kit = _kit(says=_says(wrong))
    kit.alarm_slave.raises(PROCESS)
    (remark,) = kit.until(lambda: kit.remarks)
    assert remark.startswith(f"{ACK} to slave 4 had no answer, only ")
    assert remark.endswith(f" to other requests {LATE}{AGAIN}")
    assert kit.ends == []


@pytest.mark.parametrize(
    ("mode", "at_a_time", "agreed"),
    [(0, 9, "one of each type"), (1, 9, "2"), (3, 99, "8")],
)
def test_more_alarms_than_agreed(mode: int, at_a_time: int, agreed: str) -> None:
    kit = _kit(Dpv1(alarms=ALL, alarm_mode=mode), at_a_time=at_a_time)
    kit.hold()
    most = 1 if mode == 0 else int(agreed)
    kit.alarm_slave.raises(*(block(2, slot, 1, 0) for slot in range(1, most + 1)))
    kit.until(lambda: len(kit.raised) == most)
    kit.run(10)
    assert (kit.remarks, kit.counts.too_many) == ([], 0)
    kit.alarm_slave.raises(block(2, 99), block(2, 100))
    kit.until(lambda: len(kit.raised) == most + 2)
    where = "one of each type at a time" if mode == 0 else f"{agreed} at a time (alarm_mode)"
    assert kit.remarks == [f"raises more alarms than agreed, which is {where}; see its counters"]
    assert kit.counts.too_many == 2


def test_more_alarms_than_anybody_takes() -> None:
    kit = _kit(Dpv1(alarms=ALL, alarm_mode=7), at_a_time=99)
    kit.hold()
    kit.alarm_slave.raises(*(block(2, slot) for slot in range(66)))
    kit.until(lambda: len(kit.remarks) == 2)
    kit.run(50)
    assert kit.remarks[1] == "raises alarms while 64 wait to be taken: dropped, not acknowledged"
    assert (kit.counts.raised, len(kit.raised), kit.counts.acknowledged) == (64, 64, 0)
    dropped = kit.counts.dropped
    kit.acknowledge(1)
    kit.until(lambda: kit.counts.raised == 65)
    assert kit.counts.dropped >= dropped
    assert [event.number for event in kit.raised] == list(range(1, 66))


@pytest.mark.parametrize("held", [False, True])
def test_alarms_end_with_data_exchange(held: bool) -> None:
    kit = _kit(says={} if held else {51: lambda _: None})
    if held:
        kit.hold()
    kit.alarm_slave.raises(PROCESS)
    (raised,) = kit.until(lambda: kit.raised)
    assert (raised.held, raised.must_arrive) == (held, held)
    kit.alarm_slave.mute = True
    kit.until_ended()
    assert kit.ends[0].outcome == Outcome(ServiceFailure.CLOSED, "slave 4 (s4) left data exchange: its alarms are void")
    assert kit.ends[0].must_arrive
    assert kit.ends[0].text == "slave 4 (s4): left data exchange: its alarms are void"


def test_the_end_of_an_alarm_names_its_slave_once() -> None:
    for text, told in (
        ("", "slave 4 (s4): took the acknowledgement of alarm 7"),
        ("slave 4 refuses Alarm_Ack", "slave 4 (s4): refuses Alarm_Ack"),
        ("slave 4 (s4) left data exchange", "slave 4 (s4): left data exchange"),
        ("slave 41 refuses Alarm_Ack", "slave 4 (s4): slave 41 refuses Alarm_Ack"),
        ("Alarm_Ack to slave 4 had no answer", "slave 4 (s4): Alarm_Ack to slave 4 had no answer"),
    ):
        assert AlarmDone(t_ns=0, address=4, name="s4", number=7, outcome=Outcome(text=text)).text == told
