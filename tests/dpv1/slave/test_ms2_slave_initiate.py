"""Initiate at a slave: what the resource manager gives out, what it refuses, and to whom."""

from __future__ import annotations

import pytest
from octet_class2 import (
    ABORT,
    ABORT_ADDRESS,
    ABORT_REQUEST,
    INITIATE,
    OPENED,
    RS,
    SC,
    Class2,
)

from dpstack.dpv1.slave.resource_manager import ms2_of
from tests.dpv1.ms2_slave_kit import READ, READ_RES, Slave


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
