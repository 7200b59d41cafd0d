"""Several passive stations behind one port."""

from __future__ import annotations

import pytest

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.commands import AtStation
from dpstack.fdl.interface import Reply
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.machine import Machine
from dpstack.params import BusParams
from dpstack.trace import Notice
from dpstack.units import NEVER
from tests.fdl.passive_kit import Application, Bench

BAUD = 500_000
BIT = 2_000
PARAMS = BusParams.preset(BAUD)

# Data_Exchange with one octet from master 2 to 3, 4, 5, and what each answers (its own address as data), by hand
REQUEST = {
    3: "68 04 04 68 03 02 6D 11 83 16",
    4: "68 04 04 68 04 02 6D 11 84 16",
    5: "68 04 04 68 05 02 6D 11 85 16",
}
REPEAT_3 = "68 04 04 68 03 02 7D 11 93 16"
ANSWER = {
    3: "68 04 04 68 02 03 08 03 10 16",
    4: "68 04 04 68 02 04 08 04 12 16",
    5: "68 04 04 68 02 05 08 05 14 16",
}
STATUS_9 = "10 09 02 49 54 16"
CLEAR = "68 07 07 68 FF 82 46 3A 3E 02 00 41 16"


class Numbered(Application):
    """Answers its number; with every request it becomes due anew."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number
        self.due_after_request = NEVER

    def serve(self, request: Telegram, now: int) -> Reply | None:
        self.due = self.due_after_request
        super().serve(request, now)
        return Reply(Resp.DL, bytes((self.number,)))


class Rig(Bench):
    """Stations 3 and 4 behind one port; station 5 is made, but not there yet."""

    def __init__(self, *, t_sdr: int = 11) -> None:
        self.applications = {number: Numbered(number) for number in (3, 4, 5)}
        self.stations = {
            number: PassiveStation(number, application, PARAMS, t_sdr=t_sdr)
            for number, application in self.applications.items()
        }
        self.multidrop = Multidrop([self.stations[3], self.stations[4]], PARAMS)
        super().__init__(self.multidrop, "octets")
        machine: Machine = self.multidrop  # the contract holds
        assert machine.wake_at() == NEVER


@pytest.fixture
def rig() -> Rig:
    return Rig()


def test_each_station_answers_for_itself_in_time(rig: Rig) -> None:
    for turn, number in enumerate((3, 4, 3, 4)):
        at = 10**8 * (turn + 1)
        assert rig.answers(REQUEST[number], at) == [ANSWER[number]]
        assert rig.sent[-1][0] == at + 11 * BIT
    assert rig.answers(REQUEST[5], 10**9) == []
    assert rig.answers(STATUS_9, 2 * 10**9) == []
    assert rig.multidrop.decoder_stats.telegrams == 6
    assert [station.address for station in rig.multidrop.stations] == [3, 4]


def test_a_broadcast_reaches_all(rig: Rig) -> None:
    assert rig.answers(CLEAR, 10**6) == []
    assert [len(rig.applications[n].indicated) for n in (3, 4, 5)] == [1, 1, 0]


def test_one_answer_at_a_time() -> None:
    rig = Rig(t_sdr=400)
    assert rig.answers(REQUEST[3] + REQUEST[4], 10**6) == [ANSWER[4]]  # the master gave up on 3
    rig.say(REQUEST[3], 10**9)
    rig.say(STATUS_9, 10**9 + 100 * BIT)
    rig.run_until(2 * 10**9)
    assert len(rig.sent) == 1
    assert rig.multidrop.stations[0].stats.dropped == 2
    rig.say(REQUEST[3], 10**10)
    rig.say(CLEAR, 10**10 + 100 * BIT)
    rig.run_until(2 * 10**10)
    assert len(rig.sent) == 1


def test_stations_come_and_go_while_running(rig: Rig) -> None:
    rig.multidrop.add(rig.stations[5])
    assert rig.answers(REQUEST[5], 10**6) == [ANSWER[5]]
    rig.say(REQUEST[5], 10**8)
    rig.multidrop.remove(rig.stations[5])  # in the middle of its answer
    rig.run_until(10**9)
    assert len(rig.sent) == 1
    assert rig.answers(REQUEST[5], 2 * 10**9) == []
    assert rig.answers(REQUEST[4], 3 * 10**9) == [ANSWER[4]]
    rig.multidrop.add(rig.stations[5])
    assert rig.answers(REQUEST[5], 4 * 10**9) == [ANSWER[5]]


def test_an_action_at_a_station_may_change_its_address_and_its_deadline(rig: Rig) -> None:

    def act(now: int) -> None:
        application = rig.applications[3]
        assert application.station is not None
        application.station.set_address(5)
        application.due = now + 7

    assert rig.multidrop.wake_at() == NEVER
    rig.multidrop.command(AtStation(act), 10**6)
    assert rig.multidrop.wake_at() == 10**6 + 7
    assert rig.answers(REQUEST[3], 10**8) == []
    moved = rig.answers(REQUEST[5], 10**9)
    assert [octets[:20] for octets in moved] == ["68 04 04 68 02 05 08"]
    assert len(rig.applications[3].ticks) == 1


def test_misuse(rig: Rig) -> None:
    with pytest.raises(ConfigError, match="two stations with address 4"):
        Multidrop([*rig.multidrop.stations, PassiveStation(4, rig.applications[4], PARAMS)], PARAMS)
    slow = PassiveStation(5, rig.applications[5], BusParams.preset(9_600))
    with pytest.raises(ConfigError, match="9600 bit/s"):
        rig.multidrop.add(slow)
    for call in (rig.multidrop.remove, rig.multidrop.silence, rig.multidrop.resume):
        with pytest.raises(UsageError, match="station 5 is not on this port; there are: 3, 4"):
            call(rig.stations[5])
    with pytest.raises(UsageError, match="str"):
        rig.multidrop.command("jump", 0)
    with pytest.raises(UsageError, match="none"):
        Multidrop([], PARAMS).remove(rig.stations[5])


def test_a_silenced_station_is_deaf_and_mute_for_a_while(rig: Rig) -> None:
    rig.say(REQUEST[3], 10**6)
    rig.multidrop.silence(rig.stations[3], 10**9)
    rig.applications[3].due = 5 * 10**8
    rig.multidrop.poke()
    rig.run_until(10**6 + 1_000 * BIT)
    assert rig.sent == []
    assert rig.answers(CLEAR, 10**8) == []
    assert rig.answers(REQUEST[3], 2 * 10**8) == []
    assert rig.answers(REQUEST[4], 3 * 10**8) == [ANSWER[4]]
    rig.run_until(10**9 - 1)
    assert rig.applications[3].ticks == [5 * 10**8]  # its application goes on
    assert len(rig.applications[3].indicated) == 0
    assert rig.answers(REQUEST[3], 10**9) == [ANSWER[3]]
    rig.multidrop.silence(rig.stations[3])
    assert rig.answers(REQUEST[3], 10**12) == []
    rig.multidrop.resume(rig.stations[3])
    assert rig.answers(REQUEST[3], 2 * 10**12) == [ANSWER[3]]


def test_a_station_that_changes_its_address(rig: Rig) -> None:
    rig.applications[4].move_to = 5
    assert rig.answers(REQUEST[4], 10**6) == [ANSWER[4]]  # still under the old one
    rig.applications[4].move_to = None
    assert rig.answers(REQUEST[4], 10**8) == []
    assert rig.answers(REQUEST[5], 10**9) == ["68 04 04 68 02 05 08 04 13 16"]
    assert [station.address for station in rig.multidrop.stations] == [3, 5]
    rig.multidrop.stations[1].set_address(3)  # two with one address, from outside: the first one answers
    assert rig.answers(REQUEST[3], 10**10) == [ANSWER[3]]
    assert rig.answers(REQUEST[5], 10**11) == []


def test_deadlines_of_the_applications(rig: Rig) -> None:
    first, second = rig.applications[3], rig.applications[4]
    first.due_after_request = 10**8
    second.due_after_request = 10**8 + 7
    rig.answers(REQUEST[3], 10**6)
    assert rig.multidrop.wake_at() == 10**8
    rig.answers(REQUEST[4], 3 * 10**7)
    assert rig.multidrop.wake_at() == 10**8
    first.due_after_request = 10**8 + 9  # a watchdog that is re-armed moves the earliest deadline away
    rig.answers(REQUEST[3], 6 * 10**7)
    assert rig.multidrop.wake_at() == 10**8 + 7
    rig.run_until(10**9)
    assert (first.ticks, second.ticks) == ([10**8 + 9], [10**8 + 7])
    assert rig.multidrop.wake_at() == NEVER


def test_another_baud_rate_is_for_all(rig: Rig) -> None:
    rig.say(REQUEST[3], 10**6)
    rig.multidrop.set_params(BusParams.preset(1_500_000))
    rig.run_until(10**8)
    assert rig.sent == []
    rig.answers(REQUEST[4], 10**9)
    assert rig.sent == [(10**9 + 7_333, ANSWER[4])]
    assert {station.baud for station in rig.multidrop.stations} == {1_500_000}


def test_events_of_all(rig: Rig) -> None:
    for number in (4, 3):
        rig.applications[number].events.append(Notice(t_ns=number, source="test", message="x"))
    assert [event.t_ns for event in rig.multidrop.take_events()] == [3, 4]
    assert rig.multidrop.take_events() == []
