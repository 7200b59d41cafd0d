"""Initiate of the master against slaves of octets: every end of it. Neither end keeps anything after a failure."""

from __future__ import annotations

import pytest
from ms2_kit import DL, MS, SC, Ms2Bus, connected, sd2

from dpstack.dp.acyclic.job import CancelService, ServiceFailure
from dpstack.dp.services import reading_only
from dpstack.dpv1.master.alarm_orders import CloseConnection, ConnectionOver
from dpstack.dpv1.master.orders import InitiateDone

RDL = 0x0C


def failed(kit: Ms2Bus, **more: int) -> InitiateDone:
    """An Initiate that leaves nothing."""
    done = kit.open(**more)
    kit.freed()
    assert not kit.events_of(ConnectionOver)
    assert done.outcome.failure is not None
    return done


@pytest.fixture
def kit() -> Ms2Bus:
    return Ms2Bus()


def test_no_connection_left_or_none_at_all(kit: Ms2Bus) -> None:
    kit.slave.free = [48]
    kit.open()
    done = kit.open()
    assert done.outcome.failure is ServiceFailure.REFUSED
    assert done.outcome.status == "RS"
    assert done.text == (
        "slave 4 refuses Initiate (RS at SAP 49): all its class 2 connections are in use (1 of them from here), or it "
        "has none (C2_Read_Write_supp of its GSD file); close one, or wait until another master does"
    )
    assert kit.read(1).outcome.data == b"\1\2"
    kit.close(1)
    assert kit.open().server_sap == 48


def test_initiate_to_an_absent_slave() -> None:
    kit = Ms2Bus(())
    done = failed(kit)
    assert done.outcome.failure is ServiceFailure.SILENT
    assert done.text == "slave 4 does not answer Initiate; check address and power"


def test_a_slave_of_dp_v0_is_there_and_has_no_connections(kit: Ms2Bus) -> None:
    kit.slave.says[49] = lambda _octets: None  # a chip of DP-V0 knows no SAP 49, and says nothing at all
    done = failed(kit)
    assert done.outcome.failure is ServiceFailure.REFUSED
    assert done.outcome.status == "no answer"
    assert done.text == (
        "slave 4 is there (it answers Slave_Diag) and leaves Initiate (SAP 49) without an answer; it has no class 2 "
        "connections (a device of DP-V0, or C2_Read_Write_supp = 0 in its GSD file): records of a DP-V1 slave can be "
        "asked for by its own master, of a DP-V0 slave by nobody"
    )


@pytest.mark.parametrize(
    ("answer", "failure", "text"),
    [
        ("58 00 1F", ServiceFailure.ABORTED, "it has no connection left (ABT_RES)"),
        ("58 02 12", ServiceFailure.ABORTED, "a request that cannot be read (ABT_FE in a remote subnet)"),
        ("58", ServiceFailure.ABORTED, "the slave aborted it, but why cannot be read"),
        ("D7 80 C3 00", ServiceFailure.NEGATIVE, "slave 4 refuses Initiate: resource unavailable (80 C3 00"),
        ("57 F0", ServiceFailure.LENGTH, "unreadable octets"),
        ("56 31 00 64", ServiceFailure.LENGTH, "49 is no server SAP"),
        ("56 30 00", ServiceFailure.LENGTH, "unreadable octets"),
        ("5E 01 02 00", ServiceFailure.LENGTH, "octet 1 is 0x5E"),
    ],
)
def test_other_answers_of_the_resource_manager(kit: Ms2Bus, answer: str, failure: ServiceFailure, text: str) -> None:
    kit.slave.says[49] = lambda octets: SC if octets[9:-2] else sd2(2, 4, DL, 50, 49, bytes.fromhex(answer))
    done = kit.open()
    assert done.outcome.failure is failure
    assert text in done.text
    kit.freed()


@pytest.mark.parametrize(
    ("answer", "failure", "text"),
    [
        (
            "58 00 16",
            ServiceFailure.ABORTED,
            "is too short (ABT_STO); ask for 200 ms or more",
        ),
        ("58 00 17", ServiceFailure.ABORTED, "ABT_IA"),
        ("58 00 25", ServiceFailure.ABORTED, "its user, reason 5"),
        ("D7 80 B2 00", ServiceFailure.NEGATIVE, "slave 4 refuses Initiate: invalid slot"),
        ("57 F0 01 00", ServiceFailure.LENGTH, "unreadable octets"),
        ("57 F0 01 00 00 00 00 00 00 02 00 09 00 00 00 00", ServiceFailure.LENGTH, "2 and 9 octets of addresses"),
        ("5E 01 02 00", ServiceFailure.LENGTH, "slave 4 answers Initiate with unreadable octets"),
    ],
)
def test_the_server_sap_refuses(kit: Ms2Bus, answer: str, failure: ServiceFailure, text: str) -> None:
    kit.slave.initiate = bytes.fromhex(answer)
    done = failed(kit)
    assert done.outcome.failure is failure
    assert text in done.text
    if failure is ServiceFailure.ABORTED:
        octets = bytes.fromhex(answer)
        assert done.outcome.codes == (octets[1], octets[2] >> 4, octets[2] & 15)
    assert kit.slave.received(0x58) == ([b"\x58\x00\x14"] if failure is ServiceFailure.LENGTH else [])  # ABT_RE


def test_the_longer_send_timeout_counts(kit: Ms2Bus) -> None:
    kit.slave.timeout = b"\x01\x90"
    assert kit.open(send_timeout_ns=100 * MS).send_timeout_ns == 4_000 * MS
    assert kit.open(send_timeout_ns=5_000 * MS).send_timeout_ns == 5_000 * MS


def test_a_slave_that_never_answers_initiate(kit: Ms2Bus) -> None:
    kit.slave.polls = 1 << 20
    done = failed(kit, response_ns=300 * MS)
    assert done.outcome.failure is ServiceFailure.LATE
    assert "has no answer to Initiate within 0.3 s (its C2_Response_Timeout)" in done.text
    assert kit.slave.heard[-1] == (48, b"\x58\x00\x13")  # ABT_TO


def test_a_resource_manager_that_never_answers(kit: Ms2Bus) -> None:
    kit.slave.says[49] = lambda octets: SC
    done = failed(kit, response_ns=300 * MS)
    assert done.outcome.failure is ServiceFailure.LATE
    assert "its resource manager has no answer to Initiate within 0.3 s" in done.text


def test_a_server_sap_that_the_slave_names_twice_stays_with_its_connection(kit: Ms2Bus) -> None:
    kit.slave.free = [48, 48]
    kit.open()
    done = kit.open()
    assert done.outcome.failure is ServiceFailure.WRONG
    assert "gives out server SAP 48, which is in use by this master" in done.text
    assert not kit.slave.received(0x58)


@pytest.mark.parametrize("lost", [(0,), (0, 1), (1,), (1, 2), (2, 3), (3,), (4,), (5,)])
def test_telegrams_of_initiate_are_lost(kit: Ms2Bus, lost: tuple[int, ...]) -> None:
    """Requests and answers, with their repetitions: there is a connection in the end, and nothing else."""
    kit.lose(lost)
    done = kit.open()
    assert done.outcome.failure is None, done.text
    assert kit.read(1).outcome.data == b"\1\2"


def test_an_initiate_whose_answers_are_lost_is_polled_and_not_sent_again(kit: Ms2Bus) -> None:
    kit.lose_first(2, lambda sent: sent.octets[0] == 0xE5)
    assert kit.open().server_sap == 48
    assert [(sap, pdu[:1].hex()) for sap, pdu in kit.slave.heard] == [(49, "57"), (49, ""), (48, "")]
    assert list(kit.slave.sessions) == [48]


def slow_manager(kit: Ms2Bus, polls: int) -> None:
    """The resource manager acknowledges Initiate, and names the server SAP at poll number ``polls``."""
    left = [polls]

    def say(octets: bytes) -> bytes | None:
        pdu = octets[9:-2]
        if not pdu:
            left[0] -= 1
            if left[0] > 0:
                return SC
        answer = kit.slave.manage(pdu)
        return SC if answer is None else sd2(2, 4, DL, 50, 49, answer)

    kit.slave.says[49] = say


def initiates(kit: Ms2Bus) -> int:
    """The number of Initiates that reached the slave, without repetitions of the link layer."""
    asked = [octets for octets in kit.slave.requests if octets[0] == 0x68 and octets[7] == 49]
    return sum(octets[9] == 0x57 for octets in asked if len(octets) > 12)


def test_an_initiate_that_was_acknowledged_is_not_sent_again_when_a_poll_is_lost() -> None:
    """A second Initiate would open another connection."""
    kit = connected()
    kit.close(1)
    kit.slave.requests.clear()
    slow_manager(kit, 4)
    # a poll, with its repetition
    kit.lose_first(2, lambda sent: sent.sender == 2 and len(sent.octets) == 11 and sent.octets[7] == 49)
    assert kit.open().outcome.failure is None
    assert (initiates(kit), list(kit.slave.sessions)) == (1, [48])


def test_an_initiate_that_arrived_at_last_is_not_sent_again(kit: Ms2Bus) -> None:
    """The first one and polls after it were lost, the second one is acknowledged, and its answer takes a while."""
    slow_manager(kit, 3)
    # Initiate and polls, with their repetitions
    kit.lose_first(4, lambda sent: sent.sender == 2 and sent.octets[0] == 0x68 and sent.octets[7] == 49)
    assert kit.open().outcome.failure is None
    assert (initiates(kit), list(kit.slave.sessions)) == (1, [48])


@pytest.mark.parametrize("polls", [1, 2, 3])
@pytest.mark.parametrize("free", [[48], [48, 47]])
def test_an_initiate_is_not_sent_again_before_a_poll_is_answered(kit: Ms2Bus, free: list[int], polls: int) -> None:
    """The slave took it, and was silent for a while: a second one would be refused, or leave a connection there."""
    kit.slave.free = [*free]
    silent = [polls]

    def say(octets: bytes) -> bytes | None:
        if octets[9:-2]:
            kit.slave.usual(octets)
            return None
        silent[0] -= 1
        return None if silent[0] >= 0 else kit.slave.usual(octets)

    kit.slave.says[49] = say
    done = kit.open()
    assert (done.outcome.failure, done.server_sap) == (None, 48), done.text
    assert len(kit.slave.received(0x57)) == 1
    assert list(kit.slave.sessions) == [48]


def test_an_initiate_is_sent_again_to_a_slave_that_answers_polls_and_has_not_received_it(kit: Ms2Bus) -> None:
    """More often than one that is silent: it says at each poll that it has nothing."""
    # six, each with its repetition
    kit.lose_first(2 * 6, lambda sent: sent.sender == 2 and len(sent.octets) > 12 and sent.octets[9] == 0x57)
    assert kit.open().outcome.failure is None
    assert (initiates(kit), list(kit.slave.sessions)) == (1, [48])


def test_an_answer_for_an_earlier_master_comes_before_the_initiate_is_taken(kit: Ms2Bus) -> None:
    """RDL: the Initiate was not taken."""
    kit.slave.says_first(2, 49, sd2(2, 4, RDL, 50, 49, b"\x56\x11\x00\x64"))
    done = kit.open()
    assert (done.outcome.failure, done.server_sap) == (None, 48)
    assert [pdu[:1].hex() for _, pdu in kit.slave.heard] == ["57", "", ""]


@pytest.mark.parametrize("step", range(24))
def test_initiate_cancelled_or_closed_at_every_step(step: int) -> None:
    """The slave keeps nothing, and gives out all its connections again."""
    for order in (CancelService, CloseConnection):
        kit = Ms2Bus()
        kit.slave.polls = 3
        kit.order_open()
        kit.bus.run(step * MS // 4)
        kit.send(order(1))
        kit.run(100)
        done = kit.end_of(1, InitiateDone)
        if done.outcome.failure is None and order is CancelService:
            kit.close(1)  # it was too late to cancel it
        kit.freed()
        assert kit.slave.free == [48, 47]
        assert len(kit.events_of(ConnectionOver)) == (done.outcome.failure is None)


def test_initiate_closed_at_every_moment() -> None:
    """Also between handing on and sending: what the link layer has already goes out. One that was open ends as such,
    one that was not is never reported as open."""
    opened = 0
    for step in range(0, 3_200, 24):
        kit = Ms2Bus()
        kit.order_open()
        kit.bus.run(step * 1_000)
        was_open = bool(kit.events_of(InitiateDone))
        kit.send(CloseConnection(1))
        done = kit.end_of(1, InitiateDone)
        assert done.outcome.failure is (None if was_open else ServiceFailure.ABORTED)
        kit.freed()
        assert len(kit.events_of(ConnectionOver)) == was_open
        opened += was_open
    assert 0 < opened < 100


def test_initiate_times_out(kit: Ms2Bus) -> None:
    kit.slave.polls = 1 << 20
    token = kit.order_open(timeout_ns=50 * MS)
    done = kit.end_of(token, InitiateDone)
    assert done.outcome.failure is ServiceFailure.LATE
    kit.freed()


def test_a_read_only_bus() -> None:
    kit = Ms2Bus(guard=reading_only)
    done = failed(kit)
    assert done.outcome.failure is ServiceFailure.GUARDED
    assert done.text == "slave 4: Initiate was not sent; this bus is read-only"


# --- one after the other ------------------------------------------------------------------------------------------


def at_the_manager(kit: Ms2Bus) -> str:
    """The requests at SAP 49: I for Initiate, n for a poll."""
    return "".join("I" if pdu else "n" for sap, pdu in kit.slave.heard if sap == 49)


def test_the_resource_manager_is_asked_for_one_connection_at_a_time(kit: Ms2Bus) -> None:
    """A slave chip has one Resource_Manager answer: the next Initiate waits until the last one has its server SAP."""
    kit.slave.free = [48, 47, 46]
    tokens = [kit.order_open() for _ in range(3)]
    assert sorted(kit.end_of(token, InitiateDone).server_sap for token in tokens) == [46, 47, 48]
    assert at_the_manager(kit) == "InInIn"


@pytest.mark.parametrize("step", range(12))
def test_the_next_initiate_waits_until_the_slave_has_the_connection_of_a_cancelled_one_back(step: int) -> None:
    """Otherwise it would get the server SAP of the one that is to be aborted."""
    kit = Ms2Bus()
    kit.slave.free = [48, 47, 46]
    tokens = [kit.order_open() for _ in range(3)]
    kit.bus.run(step * MS // 4)
    kit.send(CancelService(tokens[0]))
    kit.end_of(tokens[0], InitiateDone)
    done = [kit.end_of(token, InitiateDone) for token in tokens[1:]]
    assert [end.outcome.failure for end in done] == [None, None], [end.text for end in done]
    assert all(kit.read(token).outcome.data == b"\1\2" for token in tokens[1:])
    assert "II" not in at_the_manager(kit)


def test_a_cancelled_initiate_does_not_end_another_connection() -> None:
    """The slave still names the server SAP that it gave out last."""
    kit = connected()
    kit.slave.says[49] = lambda octets: SC
    token = kit.order_open()
    kit.run(3)
    kit.slave.says[49] = lambda octets: sd2(2, 4, DL, 50, 49, b"\x56\x30\x00\x0a")
    kit.send(CancelService(token))
    kit.end_of(token, InitiateDone)
    kit.run(100)
    assert kit.read(1).outcome.data == b"\1\2"
