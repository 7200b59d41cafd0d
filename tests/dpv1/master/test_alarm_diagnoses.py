"""Diagnoses that bring an alarm again, replace one, or come by themselves: which of them is a new alarm."""

from __future__ import annotations

import pytest
from alarm_kit import ALL, SC, AlarmBus, block

from dpstack.dp.acyclic.job import Outcome
from dpstack.dp.pdu.dpv1_status import Dpv1

PROCESS = block(2, 3)
OTHER = block(2, 4)


def test_a_diagnosis_that_the_master_reads_by_itself_brings_no_alarm_again() -> None:
    """The acknowledgement is under way: a diagnosis that the slave asks for would bring a new one."""
    kit = AlarmBus()
    slave = kit.alarm_slave
    slave.static = True
    slave.says[51] = lambda octets: SC
    slave.raises(PROCESS)
    kit.run(400)
    assert slave.diagnosed > 3
    assert (kit.blocks, kit.ends) == ([PROCESS], [])
    slave.flag = True
    kit.run(20)
    assert (kit.blocks, [end.outcome for end in kit.ends]) == ([PROCESS] * 2, [Outcome()])


@pytest.mark.parametrize("taken", [False, True])
def test_another_alarm_in_its_place(taken: bool) -> None:
    """After an acknowledgement without any answer the slave has taken it; while one is under way that is open."""
    kit = AlarmBus()
    slave = kit.alarm_slave
    slave.says[51] = lambda octets: None if taken else SC
    slave.raises(PROCESS)
    if taken:
        kit.until(lambda: kit.remarks)
    else:
        kit.run(20)
    assert kit.ends == []
    slave.shown, slave.flag = OTHER, True
    kit.run(30)
    assert kit.blocks == [PROCESS, OTHER]
    assert [(end.number, end.outcome) for end in kit.ends] == ([(1, Outcome())] if taken else [])
    assert (kit.counts.acknowledged, kit.counts.too_many) == (int(taken), 0)


def test_an_alarm_that_nobody_has_acknowledged_again_and_changed() -> None:
    kit = AlarmBus()
    slave = kit.alarm_slave
    kit.hold()
    slave.raises(PROCESS)
    kit.until(lambda: kit.raised)
    slave.flag = True
    kit.run(20)
    assert (slave.diagnosed, kit.counts.too_many, kit.remarks) == (3, 0, [])
    for changes in (1, 2):
        slave.shown, slave.flag = block(2, 3, data="AA" * changes), True
        kit.run(20)
        assert kit.counts.too_many == changes
    assert kit.blocks == [PROCESS]
    assert kit.remarks == ["raises more alarms than agreed, which is one of each type at a time; see its counters"]


@pytest.mark.parametrize("lost", [0, 2])
def test_a_diagnosis_that_is_offered_again_after_silence(lost: int) -> None:
    """Behind the diagnosis both attempts of a Read get lost: the slave cannot know that its diagnosis was read. Without
    that, the same diagnosis again means a new alarm, because the first may have been acknowledged."""
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=0, extra_alarm_sap=True))
    slave = kit.alarm_slave
    slave.sap = 50
    slave.says[50] = lambda octets: SC  # its acknowledgement is under way
    slave.raises(PROCESS)
    kit.run(20)
    slave.changes(bytes.fromhex("42 01"))
    read = slave.diagnosed
    while slave.diagnosed == read:
        kit.bus.run(20_000)
    slave.lose("r" * lost)
    kit.order_read()
    slave.flag = slave.flag or not lost
    kit.run(30)
    assert slave.diagnosed >= read + 2
    assert kit.blocks == [PROCESS] * (1 if lost else 2)
    assert len(kit.ends) == (0 if lost else 1)
