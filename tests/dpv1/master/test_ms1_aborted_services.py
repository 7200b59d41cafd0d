"""Services of MS1 that are cut short: the slave is silent or leaves data exchange, the port, Stop, time, cancelled."""

from __future__ import annotations

import pytest
from ms1_kit import MS, Ms1Bus, answer, first_an_old_one
from octet_slave import SC

from dpstack.dp.acyclic.job import ServiceFailure
from dpstack.dp.acyclic.queue import CancelService
from dpstack.dp.master.commands import Mode, RemoveSlave, SetMode
from dpstack.dpv1.master.orders import RecordDone, RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.machine import LineDown


@pytest.fixture
def kit() -> Ms1Bus:
    return Ms1Bus()


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
    first = kit.order_read()
    kit.run(10)
    kit.send(RemoveSlave(4))
    assert "removed from this bus" in kit.end(first).outcome.text
    second = kit.order_read(address=5)
    kit.run(10)
    kit.send(LineDown("unplugged"))
    outcome = kit.end(second).outcome
    assert (outcome.failure, "unplugged" in outcome.text) == (ServiceFailure.LINE, True)


def test_stop_leaves_a_service_without_data_exchange(kit: Ms1Bus) -> None:
    token = kit.order_read()
    kit.run(10)
    kit.send(SetMode(Mode.STOP))
    outcome = kit.end(token).outcome
    assert outcome.failure is ServiceFailure.CLOSED
    assert outcome.text.endswith(
        "was given up: the master is in Stop, where nothing is sent to slaves; repeat it in Clear or Operate"
    )


def test_cancelled_under_way_its_answer_is_fetched_later(kit: Ms1Bus) -> None:
    token = kit.order_read()
    kit.run(20)
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
