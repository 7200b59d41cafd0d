"""Ends of a class 2 connection of the master: by the slave, by silence, from outside. Neither end keeps anything."""

from __future__ import annotations

import pytest
from ms2_kit import MS, Ms2Bus, connected, connections_of, served

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dpv1.master.alarm_orders import CloseConnection, CloseConnections, ConnectionOver, ConnectionsClosed
from dpstack.dpv1.master.orders import InitiateDone, RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.machine import LineDown, LineUp

# --- by the slave, by silence ---------------------------------------------------------------------------------------

_ABORTS = [
    ("00 11", "a service that is not allowed in this state (ABT_SE)"),
    ("00 12", "a request that cannot be read (ABT_FE)"),
    ("01 13", "nothing was heard from the other end in time (ABT_TO in its own subnet)"),
    ("00 14", "a response that cannot be read (ABT_RE)"),
    ("00 15", "an impossible service of its user (ABT_IV)"),
    ("00 16", "the send time-out asked for is too short (ABT_STO)"),
    ("00 17", "ABT_IA"),
    ("00 18", "it still waits for the end of a service (ABT_OC)"),
    ("02 1F", "it has no connection left (ABT_RES in a remote subnet)"),
    ("00 1A", "reason 10"),
    ("00 02", "its link layer: no resource (RR)"),
    ("00 24", "its user, reason 4"),
    ("00 3C", "instance 3, reason 12, both reserved"),
    ("00 11 00 00 03 03", "ABT_SE"),
]


@pytest.fixture
def kit() -> Ms2Bus:
    return connected()


@pytest.mark.parametrize(("abort", "text"), _ABORTS)
def test_the_slave_aborts(kit: Ms2Bus, abort: str, text: str) -> None:
    octets = b"\x58" + bytes.fromhex(abort)
    kit.slave.serve = lambda pdu: octets
    first, second = kit.order_read(1), kit.order_read(1)
    done = kit.end_of(first, RecordDone)
    codes = (octets[1], octets[2] >> 4 & 3, octets[2] & 15)
    assert (done.outcome.failure, done.outcome.codes) == (ServiceFailure.ABORTED, codes)
    assert text in done.text
    assert "Read of slot 1, index 2 has no answer, the class 2 connection is over: the slave aborted it: " in done.text
    assert kit.end_of(second, RecordDone).outcome == done.outcome
    over = kit.over(1)
    assert (over.abort, over.ordered) == (codes, False)
    assert text in over.text
    assert kit.slave.heard[-1][1][:1] != b"\x58"  # the slave needs no Abort
    kit.freed()
    with pytest.raises(UsageError, match="there is no open class 2 connection 1; open a new one"):
        kit.order_read(1)


def test_a_server_sap_that_is_closed_at_once(kit: Ms2Bus) -> None:
    """A slave that was restarted knows nothing of the connection."""
    kit.slave.sessions.clear()
    done = kit.read(1)
    assert done.outcome.failure is ServiceFailure.ABORTED
    assert "the slave has closed server SAP 48 (RS): it was restarted" in done.text
    kit.over(1)
    kit.freed()


@pytest.mark.parametrize(
    "answer",
    ["5E 01 02 05 01 02", "5E 01 02 00 01", "5E", "5E 01 02 F1" + " 55" * 240, "DE 80", "00", "57 00", "56 30 00 64"],
)
def test_wrong_lengths_end_the_connection(kit: Ms2Bus, answer: str) -> None:
    kit.slave.serve = lambda pdu: bytes.fromhex(answer)
    done = kit.read(1)
    assert done.outcome.failure is ServiceFailure.LENGTH
    assert kit.over(1).abort == (0, 1, 4)
    assert kit.slave.heard[-1] == (48, b"\x58\x00\x14")  # ABT_RE
    kit.freed()


def test_more_octets_than_requested(kit: Ms2Bus) -> None:
    kit.slave.serve = lambda pdu: b"\x5e\x01\x02\x03\x01\x02\x03"
    done = kit.read(1, length=2)
    assert "with 3 octets, 2 were asked for" in done.text
    kit.over(1)
    kit.freed()


def test_a_negative_answer_ends_the_service_only(kit: Ms2Bus) -> None:
    kit.slave.serve = lambda pdu: bytes((pdu[0] | 0x80, 0x80, 0xB5, 7))
    for done in (kit.read(1), kit.write(1, 1, 2, b"\1"), kit.transport(1, 1, 2, b"")):
        assert (done.outcome.failure, done.outcome.codes) == (ServiceFailure.NEGATIVE, (0x80, 0xB5, 7))
        assert "state conflict" in done.text
    kit.slave.serve = served
    assert kit.read(1).outcome.data == b"\1\2"


def test_answers_to_other_requests_are_dropped(kit: Ms2Bus) -> None:
    session = kit.slave.sessions[48]

    def serve(pdu: bytes) -> bytes:
        for other in ("5E 09 09 00", "5F 01 02 00", "DF 80 B0 00", "DE 80 B0 00" if pdu[0] == 0x51 else "D1 80 B0 00"):
            if other != "D1 80 B0 00":
                session.waiting.append((1, bytes.fromhex(other)))
        return served(pdu) or b""

    kit.slave.serve = serve
    done = kit.read(1)
    assert (done.outcome.data, done.stale) == (b"\1\2", 3)


def test_a_slave_that_never_answers_a_service() -> None:
    kit = connected(response_ns=400 * MS)
    kit.slave.serve = lambda pdu: None
    begun = kit.bus.now
    done = kit.read(1)
    assert 400 * MS <= kit.bus.now - begun < 450 * MS
    assert done.outcome.failure is ServiceFailure.LATE
    assert done.text == (
        "slave 4 has no answer to Read of slot 1, index 2 within 0.4 s (its C2_Response_Timeout); "
        "the connection was ended: open a new one, with a longer response_timeout where it needs that"
    )
    assert kit.over(1).reason == "Read of slot 1, index 2 had no answer in time"
    assert kit.slave.heard[-1] == (48, b"\x58\x00\x13")
    kit.freed()


def test_a_write_without_an_answer_may_have_been_carried_out() -> None:
    kit = connected(response_ns=100 * MS)
    kit.slave.serve = lambda pdu: None
    assert kit.write(1, 1, 2, b"\1").text.endswith("; it may have been carried out")
    kit.over(1)
    ref = kit.open().token
    kit.slave.serve = lambda pdu: b"\x58\x00\x11"
    assert kit.transport(ref, 1, 2, b"\1").text.endswith("(ABT_SE); it may have been carried out")
    ref = kit.open().token
    kit.slave.serve = lambda pdu: None
    tokens = [kit.next_token(), kit.next_token()]
    for token in tokens:
        kit.send(RecordOrder(token, Function.WRITE, 1, 2, data=b"\1", connection=ref))
    kit.run(5)
    kit.send(CloseConnection(ref))
    under_way, waiting = (kit.end_of(token, RecordDone).text for token in tokens)
    assert under_way.endswith("is over: it was closed here; it may have been carried out")
    assert waiting.endswith("is over: it was closed here")  # it was never sent
    kit.freed()


def test_the_slave_vanishes(kit: Ms2Bus) -> None:
    kit.slave.mute = True
    begun = kit.bus.now
    done = kit.read(1)
    assert 190 * MS < kit.bus.now - begun < 210 * MS
    assert done.outcome.failure is not None
    assert "nothing was heard of the slave for 0.2 s (the send time-out)" in done.text
    kit.over(1)
    kit.freed()


def test_the_slave_vanishes_while_nothing_is_asked(kit: Ms2Bus) -> None:
    kit.slave.mute = True
    begun = kit.bus.now
    assert kit.over(1).reason == "nothing was heard of the slave for 0.2 s (the send time-out)"
    assert kit.bus.now - begun < 400 * MS
    kit.freed()


# --- ends from outside --------------------------------------------------------------------------------------------


def test_closed_with_services_waiting(kit: Ms2Bus) -> None:
    kit.slave.polls = 100
    tokens = [kit.order_read(1) for _ in range(3)]
    kit.run(10)
    kit.send(CloseConnection(1))
    for token in tokens:
        outcome = kit.end_of(token, RecordDone).outcome
        assert (outcome.failure, outcome.codes) == (ServiceFailure.ABORTED, (0, 2, 0))
        assert outcome.text.endswith("the class 2 connection is over: it was closed here")
    kit.over(1)
    kit.freed()
    kit.send(CloseConnection(1))  # once more is no error
    kit.send(CloseConnection(99))


def test_an_abort_that_is_lost_is_sent_again(kit: Ms2Bus) -> None:
    # the request and its repetition, twice
    lost = kit.lose_first(4, lambda sent: sent.octets[0] == 0x68 and sent.octets[9:10] == b"\x58")
    kit.close(1)
    assert len(lost) == 4
    kit.freed()


def test_close_all_connections() -> None:
    kit = Ms2Bus((4, 5))
    kit.send(CloseConnections())
    assert len(kit.events_of(ConnectionsClosed)) == 1  # there were none
    for address in (4, 5, 4):
        kit.open(address)
    kit.order_open(5)
    kit.send(CloseConnections())
    with pytest.raises(UsageError, match="the bus is being closed"):
        kit.order_open()
    kit.run(50)
    assert len(kit.events_of(ConnectionsClosed)) == 2
    kit.freed()
    assert {over.reason for over in kit.events_of(ConnectionOver)} == {"the bus was closed here"}


def test_the_port_vanishes_and_comes_back(kit: Ms2Bus) -> None:
    """The slave still holds the connection: it gets Abort."""
    token = kit.order_read(1)
    opening = kit.order_open()
    kit.run(2)
    kit.send(LineDown("unplugged"))
    assert kit.end_of(token, RecordDone).outcome.failure is ServiceFailure.LINE
    assert kit.end_of(opening, InitiateDone).outcome.failure is ServiceFailure.LINE
    kit.run(100)
    kit.send(LineUp())
    assert "the port vanished (unplugged)" in kit.over(1).reason
    kit.freed()
    assert kit.open().outcome.failure is None


def test_the_port_vanishes_for_good(kit: Ms2Bus) -> None:
    kit.send(LineDown("unplugged"))
    kit.over(1)
    assert connections_of(kit.acyclic) == kit.acyclic.waiting == 0


def test_the_station_leaves_the_ring(kit: Ms2Bus) -> None:
    token = kit.order_read(1)
    kit.send(GoOffline())
    done = kit.end_of(token, RecordDone)
    assert "nothing was heard of the slave" in done.text
    kit.run(300)
    kit.send(GoOnline())
    kit.over(1)
    assert connections_of(kit.acyclic) == kit.acyclic.waiting == 0
