"""Alarms at the master: literal octets at the slave's end, every type, both modes, the end of data exchange."""

from __future__ import annotations

import pytest
from alarm_kit import ALL, SC, AlarmBus, AlarmSlave, block

from dpstack.dp.acyclic.class2 import ReadService, Service
from dpstack.dp.acyclic.job import Outcome, ServiceFailure
from dpstack.dp.master.commands import Mode, ReparameteriseSlave, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.alarm_blocks import ModuleState
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.alarm_handler import MAX_OPEN
from dpstack.errors import UsageError

PROCESS = block(2, 3, 1, data="12 34")
PLAIN = block(2, 3)


@pytest.fixture
def kit() -> AlarmBus:
    return AlarmBus()


@pytest.fixture
def slave(kit: AlarmBus) -> AlarmSlave:
    return kit.alarm_slave


def test_literal_telegrams(kit: AlarmBus, slave: AlarmSlave) -> None:
    assert slave.prm[7:10].hex(" ") == "80 fc 00"
    seen = len(kit.bus.log)
    kit.raise_and_end(bytes.fromhex("06 02 03 2D 12 34"))  # sequence number 5, acknowledged by the user too, appears
    wire = [sent.octets.hex(" ") for sent in kit.bus.log[seen:]]
    assert any(octets.startswith("68 11 11 68 82 84 08 3e 3c 08 0c 00 02 12 34 06 02 03 2d 12 34") for octets in wire)
    request, response = (octets for octets in wire if "5c 03 02 2d" in octets)
    assert request.startswith("68 09 09 68 84 82")
    assert request[21:].startswith("33 33 5c 03 02 2d")
    assert response.startswith("68 09 09 68 82 84 08 33 33 5c 03 02 2d")
    (raised,) = kit.raised
    assert (raised.alarm.type, raised.alarm.slot, raised.alarm.sequence) == (2, 3, 5)
    assert raised.alarm.add_ack
    assert raised.alarm.data == b"\x12\x34"
    assert not raised.held
    assert raised.text == (
        "slave 4 (s4): process alarm, slot 3, appears, slot disturbed, data 12 34, "
        "wants to be acknowledged by the user too"
    )
    assert kit.counts.acknowledged == kit.counts.raised == 1


@pytest.mark.parametrize("kind", [1, 2, 3, 4, 5, 6, 32, 126])
@pytest.mark.parametrize("specifier", [0, 1, 2, 3])
def test_every_type(kit: AlarmBus, kind: int, specifier: int) -> None:
    kit.raise_and_end(block(kind, 254, specifier))
    assert kit.blocks == kit.alarm_slave.taken == [block(kind, 254, specifier)]
    assert not kit.remarks


@pytest.mark.parametrize(
    "octets", ["05 07 03 01 00", "05 02 ff 01 00", "05 00 01 01 00", "05 7f 01 01 00", "03 02 01", "3f 01 02"]
)
def test_malformed_device_blocks_are_reported_once_and_counted(kit: AlarmBus, octets: str) -> None:
    kit.change_and_run(50, bytes.fromhex(octets))
    kit.change_and_run(50, bytes.fromhex(octets))
    assert not kit.raised
    assert not kit.statuses
    assert kit.counts.malformed == 2
    assert len([text for text in kit.remarks if "neither alarm nor status" in text]) == 1
    assert kit.master.handlers[4].state is SlaveState.DATA_EXCHANGE


@pytest.mark.parametrize(
    ("kind", "enabled"),
    [
        (1, "diagnostic"),
        (2, "process"),
        (3, "pull_plug"),
        (4, "pull_plug"),
        (5, "status"),
        (6, "update"),
        (32, "manufacturer"),
    ],
)
def test_an_alarm_of_a_kind_that_is_not_enabled_is_reported_and_not_acknowledged(kind: int, enabled: str) -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=tuple(name for name in ALL if name != enabled)))
    kit.raise_and_run(100, block(kind, 1))
    assert not kit.raised
    assert not kit.alarm_slave.acks
    assert kit.counts.not_enabled == 1
    (remark,) = kit.remarks
    assert f'put "{enabled}" into dpv1 = {{ alarms = [...] }}' in remark
    only = AlarmBus(dpv1=Dpv1(alarms=(enabled,)))
    only.alarm_slave.raises(block(kind, 1))
    only.until_ended()


def test_statuses_are_reported_when_they_are_new_and_never_acknowledged(kit: AlarmBus, slave: AlarmSlave) -> None:
    message = block(0x81, 2, 1, data="55")
    kit.change_and_run(50, message)
    kit.change_and_run(50, message + bytes.fromhex("05 82 00 00 c9"))  # as before, and modules 1, 3 and 4 are ill
    kit.change_and_run(50, bytes.fromhex("04 9e 01 00 04 9f 00 00 04 a0 01 00"))
    kit.change_and_run(50, message)
    assert [told.status.type for told in kit.statuses] == [1, 2, 30, 31, 32, 1]
    assert kit.statuses[1].status.modules == (
        ModuleState.INVALID,
        ModuleState.WRONG,
        ModuleState.OK,
        ModuleState.MISSING,
    )
    states = kit.statuses[1].text
    assert states == "slave 4 (s4): module status: slot 1 data invalid, slot 2 wrong module, slot 4 no module"
    assert kit.statuses[0].text == "slave 4 (s4): status message, slot 2, appears, slot disturbed, data 55"
    assert not slave.acks
    assert kit.counts.statuses == 6


def test_channels_of_the_same_diagnosis_come_along(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.rest = bytes.fromhex("42 01 83 45 21")
    slave.raises(block(1, 2))
    kit.until(lambda: bool(kit.raised))
    (raised,) = kit.raised
    assert raised.texts == ("slots with a diagnosis: 1", "slot 4, input channel 5 (bit): short circuit")
    assert raised.text.endswith("; slot 4, input channel 5 (bit): short circuit")


# --- alarms that stay in the diagnosis ------------------------------------------------------------------------------


def test_an_acknowledged_alarm_that_stays_in_the_diagnosis_for_a_while(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.keeps = True
    kit.raise_and_end(PROCESS)
    kit.change_and_run(40, bytes.fromhex("42 01"))  # something else asks to be read
    slave.shown = b""
    slave.flag = True
    kit.run(500)
    assert kit.blocks == [PROCESS]


def test_numbered_alarms_that_stay_in_the_diagnosis(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.keeps = True
    blocks = [block(2, 3, 0, number) for number in range(3)]
    slave.raises(*blocks)
    kit.until_taken(len(blocks))
    for at in range(1, 5):
        kit.run(150)
        slave.changes(bytes((0x42, at)))  # something else asks to be read
    assert kit.blocks == blocks


def test_unnumbered_alarms_in_a_static_diagnosis(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.keeps = True
    slave.static = True
    kit.raise_and_run(1000, PROCESS)
    assert slave.diagnosed > 5
    assert len(kit.raised) <= 2  # the second by mistake: from then on it is known
    slave.raises(PROCESS)  # asks to be read, with nothing else new
    kit.until_taken(2)
    kit.run(600)
    assert len(kit.raised) <= 3


class _Changing(AlarmSlave):
    """Something else in its diagnosis changes with every acknowledgement."""

    def acknowledged(self, ack: bytes) -> bytes | None:
        self.rest = bytes((0x42, len(self.acks)))
        return super().acknowledged(ack)


@pytest.mark.parametrize("behind", [[], [block(126, 1)]])
def test_equal_alarms_beside_other_changes_of_the_diagnosis(behind: list[bytes]) -> None:
    kit = AlarmBus(kind=_Changing)
    slave = kit.alarm_slave
    slave.raises(PROCESS, PROCESS, *behind)  # the last one takes the place of the second at once
    kit.until_taken(2 + len(behind), 1000)
    assert kit.blocks == [PROCESS, PROCESS, *behind]


@pytest.mark.parametrize("mode", [0, 3])
def test_equal_alarms_one_after_the_other(mode: int) -> None:
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=mode))
    slave = kit.alarm_slave
    slave.raises(*[PROCESS] * 5)
    kit.until_taken(5)
    kit.run(300)
    assert kit.blocks == [PROCESS] * 5


def test_a_diagnosis_that_is_read_again_and_again(kit: AlarmBus, slave: AlarmSlave) -> None:
    kit.hold()
    slave.raises(PROCESS)
    for at in range(20):
        kit.change_and_run(10, bytes((0x42, at)))
    assert slave.diagnosed > 10
    assert kit.blocks == [PROCESS]
    kit.acknowledge(1)
    kit.until_taken()
    kit.run(300)
    assert kit.blocks == [PROCESS]


def test_class_2_reads_the_diagnosis_before_its_master_does(kit: AlarmBus, slave: AlarmSlave) -> None:
    for number in range(20):
        kit.send(ReadService(1000 + number, 4, Service.DIAGNOSIS))
        kit.raise_and_run(20, block(2, 3, data=f"{number:02X}"))
    kit.until_taken(20)
    assert kit.blocks == slave.taken == [block(2, 3, data=f"{number:02X}") for number in range(20)]


# --- too much, and the end ----------------------------------------------------------------------------------------


def test_a_storm_of_alarms_is_reported_once_and_data_exchange_goes_on() -> None:
    kit = AlarmBus((4, 5))
    slave = kit.alarm_slave
    slave.at_a_time = 2000  # it does not care for what was agreed
    kit.hold()
    slave.raises(*(block(2, at % 255, 1, at // 255) for at in range(300)))
    before = kit.master.handlers[5].exchanges
    kit.until(lambda: not slave.queue and not slave.flag)
    kit.run(20)
    assert kit.counts.raised == MAX_OPEN
    assert kit.counts.dropped == 300 - MAX_OPEN
    assert kit.counts.too_many == 299
    assert len(kit.remarks) == 2
    assert kit.master.handlers[5].exchanges - before > 290
    assert not slave.acks
    kit.hold(False)
    kit.until(lambda: len(slave.taken) >= MAX_OPEN)
    kit.run(100)
    assert kit.blocks == slave.taken  # one that still stood in the diagnosis came when there was room
    assert len(slave.taken) == MAX_OPEN + 1


def test_an_alarm_that_replaces_an_unacknowledged_one(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.at_a_time = 2000  # it does not care for what was agreed
    kit.hold()
    blocks = [block(2, 3, data=f"{number:02X}") for number in range(3)]
    kit.raise_and_run(100, *blocks)
    assert kit.blocks == blocks[:1]
    assert kit.counts.too_many == 2
    assert len(kit.remarks) == 1
    kit.acknowledge(1)
    kit.until(lambda: len(kit.raised) == 2)  # the one that stands in its diagnosis
    assert kit.blocks[1] == blocks[2]


def leaves(kit: AlarmBus) -> None:
    """The slave falls out of data exchange and comes back."""
    slave = kit.alarm_slave
    slave.mute = True
    kit.until(lambda: kit.master.handlers[4].state is not SlaveState.DATA_EXCHANGE)
    slave.mute = False
    slave.queue.clear()
    slave.open.clear()
    slave.left.clear()
    slave.shown = b""
    kit.until_exchanging()


@pytest.mark.parametrize("after_ms", [0, 2, 4, 6, 8, 10, 12, 14])
@pytest.mark.parametrize("hold", [False, True])
def test_the_slave_leaves_data_exchange_at_every_step_of_an_alarm(after_ms: int, hold: bool) -> None:
    kit = AlarmBus()
    slave = kit.alarm_slave
    if hold:
        kit.hold()
    slave.polls = 1
    kit.raise_and_run(after_ms, PROCESS, block(1, 2))
    leaves(kit)
    was = len(kit.raised)
    assert kit.blocks == [PROCESS, block(1, 2)][:was]  # what was delivered stays delivered
    assert sorted(end.number for end in kit.ends) == [*range(1, was + 1)]
    kit.alarm_slave.raises(PROCESS)
    kit.until(lambda: len(kit.raised) == was + 1)
    if hold:
        for number in range(1, was + 2):
            kit.acknowledge(number)
    kit.until(lambda: len(kit.ends) == was + 1)
    assert slave.taken[-1] == PROCESS
    assert kit.ends[-1].outcome.failure is None


def test_untaken_alarms_are_bounded_over_many_restarts_of_the_slave(kit: AlarmBus) -> None:
    kit.hold()
    for _ in range(3):
        for kind in range(32, 62):
            kit.raise_and_run(12, block(kind, 1))
        leaves(kit)
    assert kit.counts.raised == MAX_OPEN
    assert kit.counts.dropped > 0
    for number in range(1, 11):
        kit.acknowledge(number)
    kit.alarm_slave.raises(PROCESS)
    kit.until(lambda: kit.blocks[-1] == PROCESS)


def test_an_alarm_that_was_in_the_diagnosis_before_data_exchange(kit: AlarmBus, slave: AlarmSlave) -> None:
    slave.mute = True
    kit.until(lambda: kit.master.handlers[4].state is SlaveState.OFFLINE)
    slave.mute = False
    slave.raises(PROCESS)
    slave.rest = block(0x81, 2)
    kit.until(lambda: slave.taken == [PROCESS])
    assert kit.blocks == [PROCESS]
    assert [told.status.type for told in kit.statuses] == [1]


def test_stop_and_other_parameters(kit: AlarmBus, slave: AlarmSlave) -> None:
    kit.hold()
    slave.raises(PROCESS)
    kit.until(lambda: bool(kit.raised))
    kit.send(ReparameteriseSlave(kit.setup(4, watchdog_ms=500)))
    assert kit.ends[0].outcome.failure is ServiceFailure.CLOSED
    slave.open.clear()
    slave.shown = b""
    kit.until_exchanging()
    slave.raises(block(1, 1))
    kit.until(lambda: len(kit.raised) == 2)
    assert kit.raised[1].held
    assert kit.raised[1].number == 2
    kit.send(SetMode(Mode.STOP))
    kit.acknowledge(2)
    kit.run(300)
    assert not slave.acks
    assert kit.counts.raised == 2


def test_misuse() -> None:
    kit = AlarmBus(dpv1=None)
    with pytest.raises(UsageError, match=r"slave 4 \(s4\) is not parameterised for DP-V1"):
        kit.hold()
    with pytest.raises(UsageError, match="station 9 is no slave of this master"):
        kit.acknowledge(1, address=9)
    kit.raise_and_run(50, PROCESS)
    assert not kit.raised
    assert kit.counts_of(4) is None
    with_it = AlarmBus()
    with_it.acknowledge(7)  # one that is over is no error


# --- Diagnoses that bring an alarm again, replace one, or come by themselves: which of them is a new alarm ----------


OTHER = block(2, 4)


def test_a_diagnosis_that_the_master_reads_by_itself_brings_no_alarm_again() -> None:
    """The acknowledgement is under way: a diagnosis that the slave asks for would bring a new one."""
    kit = AlarmBus()
    slave = kit.alarm_slave
    slave.static = True
    slave.says[51] = lambda octets: SC
    kit.raise_and_run(400, PLAIN)
    assert slave.diagnosed > 3
    assert (kit.blocks, kit.ends) == ([PLAIN], [])
    slave.flag = True
    kit.run(20)
    assert (kit.blocks, [end.outcome for end in kit.ends]) == ([PLAIN] * 2, [Outcome()])


@pytest.mark.parametrize("taken", [False, True])
def test_another_alarm_in_its_place(taken: bool) -> None:
    """After an acknowledgement without any answer the slave has taken it; while one is under way that is open."""
    kit = AlarmBus()
    slave = kit.alarm_slave
    slave.says[51] = lambda octets: None if taken else SC
    slave.raises(PLAIN)
    if taken:
        kit.until(lambda: kit.remarks)
    else:
        kit.run(20)
    assert kit.ends == []
    slave.shown, slave.flag = OTHER, True
    kit.run(30)
    assert kit.blocks == [PLAIN, OTHER]
    assert [(end.number, end.outcome) for end in kit.ends] == ([(1, Outcome())] if taken else [])
    assert (kit.counts.acknowledged, kit.counts.too_many) == (int(taken), 0)


def test_an_alarm_that_nobody_has_acknowledged_again_and_changed() -> None:
    kit = AlarmBus()
    slave = kit.alarm_slave
    kit.hold()
    slave.raises(PLAIN)
    kit.until(lambda: kit.raised)
    slave.flag = True
    kit.run(20)
    assert (slave.diagnosed, kit.counts.too_many, kit.remarks) == (3, 0, [])
    for changes in (1, 2):
        slave.shown, slave.flag = block(2, 3, data="AA" * changes), True
        kit.run(20)
        assert kit.counts.too_many == changes
    assert kit.blocks == [PLAIN]
    assert kit.remarks == ["raises more alarms than agreed, which is one of each type at a time; see its counters"]


@pytest.mark.parametrize("lost", [0, 2])
def test_a_diagnosis_that_is_offered_again_after_silence(lost: int) -> None:
    """Behind the diagnosis both attempts of a Read get lost: the slave cannot know that its diagnosis was read. Without
    that, the same diagnosis again means a new alarm, because the first may have been acknowledged."""
    kit = AlarmBus(dpv1=Dpv1(alarms=ALL, alarm_mode=0, extra_alarm_sap=True))
    slave = kit.alarm_slave
    slave.sap = 50
    slave.says[50] = lambda octets: SC  # its acknowledgement is under way
    kit.raise_and_run(20, PLAIN)
    slave.changes(bytes.fromhex("42 01"))
    read = slave.diagnosed
    while slave.diagnosed == read:
        kit.bus.run(20_000)
    slave.lose("r" * lost)
    kit.order_read()
    slave.flag = slave.flag or not lost
    kit.run(30)
    assert slave.diagnosed >= read + 2
    assert kit.blocks == [PLAIN] * (1 if lost else 2)
    assert len(kit.ends) == (0 if lost else 1)
