"""The limits of a slave's alarms: those agreed in Set_Prm, those that wait, and the sequence numbers."""

from __future__ import annotations

import pytest

from dpstack.dp.pdu.alarm_blocks import Alarm, Status
from dpstack.dpv1.slave.alarms import MAX_WAITING, AlarmServer, AlarmSupport
from dpstack.errors import AlarmError, UsageError

KINDS = frozenset({"diagnostic", "process"})


def server(sequence: int, status_3: int, *, room: int = 60) -> AlarmServer:
    made = AlarmServer(AlarmSupport(KINDS, sequence), room, "x")
    made.agree(0xFF, status_3)
    made.open()
    return made


@pytest.mark.parametrize("sequence", [0, 2, 5, 32])
def test_the_alarms_at_a_time_are_the_fewer_of_master_and_slave(sequence: int) -> None:
    """EN 50170: 0 is type mode, then 2, 4, 8, 12, 16, 24, 32 in sequence."""
    asked = [0, 2, 4, 8, 12, 16, 24, 32]
    found = [server(sequence, 0xF8 | code).limit for code in range(8)]
    assert found == [min(limit, sequence) for limit in asked]
    assert AlarmServer(AlarmSupport(KINDS, sequence), 60).limit == 0


@pytest.mark.parametrize(("code", "limit"), [(1, 2), (2, 4)])
def test_so_many_alarms_are_on_their_way_and_no_more(code: int, limit: int) -> None:
    alarms = server(32, code)
    for slot in range(limit + 3):
        alarms.alarm(Alarm(type=2, slot=slot, specifier=0))
        alarms._fetched = True
        alarms._advance()
    assert [raised.alarm.slot for raised in alarms.pending] == list(range(limit + 3))
    assert len(alarms._on_its_way) == limit
    assert [raised.alarm.sequence for raised in alarms._on_its_way.values()] == list(range(limit))


def test_so_many_wait() -> None:
    alarms = server(0, 0)
    for slot in range(MAX_WAITING + 1):  # one is on its way
        alarms.alarm(Alarm(type=2, slot=slot % 255, specifier=0))
    with pytest.raises(AlarmError) as refused:
        alarms.alarm(Alarm(type=2, slot=1, specifier=0))
    assert refused.value.reason == "queue full"
    assert f"{MAX_WAITING} alarms wait already; its master does not acknowledge them" in str(refused.value)
    for _ in range(MAX_WAITING):
        alarms.status(Status(type=1, slot=1, specifier=0))
    with pytest.raises(AlarmError) as refused:
        alarms.status(Status(type=1, slot=1, specifier=0))
    assert refused.value.reason == "queue full"
    assert f"{MAX_WAITING} wait already; its master does not fetch them" in str(refused.value)


@pytest.mark.parametrize(("room", "fits"), [(4, True), (3, False)])
def test_the_room_in_the_diagnosis(room: int, fits: bool) -> None:
    alarms = server(0, 0, room=room)
    if fits:
        alarms.alarm(Alarm(type=2, slot=1, specifier=0))
        return
    with pytest.raises(UsageError) as refused:
        alarms.alarm(Alarm(type=2, slot=1, specifier=0))
    assert str(refused.value) == (
        "slave x: a block of 4 octets, its diagnosis has room for 3 (Max_Diag_Data_Len); give fewer octets of data"
    )
