"""Several passive stations behind one port."""

from __future__ import annotations

import pytest
from passive_kit import Application

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.codec import decode
from dpstack.fdl.commands import AtStation
from dpstack.fdl.interface import Reply
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Resp, Telegram
from dpstack.machine import LineDown, LineUp, Machine, pump
from dpstack.params import BusParams
from dpstack.phy.patience import EXACT, Patience
from dpstack.trace import Notice
from dpstack.units import NEVER

BAUD = 500_000
BIT = 2_000
PARAMS = BusParams.preset(BAUD)

# Data_Exchange with one octet from master 2 to 3, 4, 5, and what each answers (its own address as data), by hand
REQUEST = {
    3: bytes.fromhex("68 04 04 68 03 02 6D 11 83 16"),
    4: bytes.fromhex("68 04 04 68 04 02 6D 11 84 16"),
    5: bytes.fromhex("68 04 04 68 05 02 6D 11 85 16"),
}
REPEAT_3 = bytes.fromhex("68 04 04 68 03 02 7D 11 93 16")
ANSWER = {
    3: bytes.fromhex("68 04 04 68 02 03 08 03 10 16"),
    4: bytes.fromhex("68 04 04 68 02 04 08 04 12 16"),
    5: bytes.fromhex("68 04 04 68 02 05 08 05 14 16"),
}
STATUS_9 = bytes.fromhex("10 09 02 49 54 16")
CLEAR = bytes.fromhex("68 07 07 68 FF 82 46 3A 3E 02 00 41 16")


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


class Rig:
    def __init__(self, *, t_sdr: int = 11, patience: Patience = EXACT) -> None:
        self.t_sdr = t_sdr
        self.applications = {number: Numbered(number) for number in (3, 4, 5)}
        self.port = Multidrop([self.station(n) for n in (3, 4)], PARAMS, patience=patience)
        self.sent: list[tuple[int, bytes]] = []
        machine: Machine = self.port  # the contract holds
        assert machine.wake_at() == NEVER

    def station(self, number: int) -> PassiveStation:
        return PassiveStation(number, self.applications[number], PARAMS, t_sdr=self.t_sdr)

    def _transmit(self, octets: bytes, now: int) -> int:
        self.sent.append((now, octets))
        return now + len(octets) * 11 * BIT

    def step(self, chunk: bytes, now: int) -> None:
        pump(self.port, chunk, now, self._transmit)

    def run_until(self, at: int) -> None:
        while (deadline := self.port.wake_at()) <= at:
            self.step(b"", deadline)

    def say(self, octets: bytes, at: int) -> list[bytes]:
        """What is answered within 1000 bit times."""
        before = len(self.sent)
        self.step(octets, at)
        self.run_until(at + 1_000 * BIT)
        return [octets for _, octets in self.sent[before:]]


def test_each_station_answers_for_itself_in_time() -> None:
    rig = Rig()
    for turn, number in enumerate((3, 4, 3, 4)):
        at = 10**6 * (turn + 1) * 10
        assert rig.say(REQUEST[number], at) == [ANSWER[number]]
        assert rig.sent[-1][0] == at + 11 * BIT
    assert rig.say(REQUEST[5], 10**9) == []
    assert rig.say(STATUS_9, 2 * 10**9) == []
    assert rig.port.decoder_stats.telegrams == 6
    assert [station.address for station in rig.port.stations] == [3, 4]


def test_single_octets_give_the_same_answer() -> None:
    rig = Rig()
    for i in range(10):
        rig.run_until(10**6 + i * 11 * BIT)
        rig.step(REQUEST[4][i : i + 1], 10**6 + i * 11 * BIT)
    rig.run_until(10**8)
    assert rig.sent == [(10**6 + 9 * 11 * BIT + 11 * BIT, ANSWER[4])]


def test_a_broadcast_reaches_all() -> None:
    rig = Rig()
    assert rig.say(CLEAR, 10**6) == []
    assert [len(rig.applications[n].indicated) for n in (3, 4, 5)] == [1, 1, 0]


def test_one_answer_at_a_time() -> None:
    rig = Rig(t_sdr=400)
    assert rig.say(REQUEST[3] + REQUEST[4], 10**6) == [ANSWER[4]]  # the master gave up on 3
    rig.step(REQUEST[3], 10**9)
    rig.step(STATUS_9, 10**9 + 100 * BIT)
    rig.run_until(2 * 10**9)
    assert len(rig.sent) == 1
    assert rig.port.stations[0].stats.dropped == 2
    rig.step(REQUEST[3], 10**10)
    rig.step(CLEAR, 10**10 + 100 * BIT)
    rig.run_until(2 * 10**10)
    assert len(rig.sent) == 1


def test_a_repetition_gets_the_kept_answer() -> None:
    rig = Rig()
    assert rig.say(REQUEST[3], 10**6) == [ANSWER[3]]
    assert rig.say(REPEAT_3, 10**8) == [ANSWER[3]]
    assert rig.applications[3].served == [decode(REQUEST[3])]


def test_noise_behind_a_request() -> None:
    rig = Rig()
    rig.step(REQUEST[3], 10**6)
    rig.step(b"\x00", 10**6 + 5 * BIT)
    rig.run_until(10**8)
    assert rig.sent == [(10**6 + 16 * BIT, ANSWER[3])]
    rig.step(REQUEST[4], 10**9)
    rig.step(b"\x68", 10**9 + 5 * BIT)
    rig.run_until(2 * 10**9)
    assert rig.sent[1:] == [(10**9 + 38 * BIT, ANSWER[4])]
    slow = Rig(patience=Patience(stall_ns=50_000_000))
    slow.step(REQUEST[4], 10**9)
    slow.step(b"\x68", 10**9 + 5 * BIT)
    slow.run_until(2 * 10**9)
    assert slow.sent == []


def test_a_request_behind_a_stalled_start() -> None:
    rig = Rig()
    rig.step(bytes.fromhex("68 C8 C8 68") + REQUEST[3], 10**6)
    rig.run_until(10**8)
    assert rig.sent == [(10**6 + 33 * BIT, ANSWER[3])]


def test_stations_come_and_go_while_running() -> None:
    rig = Rig()
    rig.port.add(rig.station(5))
    assert rig.say(REQUEST[5], 10**6) == [ANSWER[5]]
    rig.step(REQUEST[5], 10**8)
    gone = rig.port.remove(5)  # in the middle of its answer
    assert gone.address == 5
    rig.run_until(10**9)
    assert len(rig.sent) == 1
    assert rig.say(REQUEST[5], 2 * 10**9) == []
    assert rig.say(REQUEST[4], 3 * 10**9) == [ANSWER[4]]
    rig.port.add(gone)
    assert rig.say(REQUEST[5], 4 * 10**9) == [ANSWER[5]]


def test_an_action_at_a_station_may_change_its_address_and_its_deadline() -> None:
    rig = Rig()

    def act(now: int) -> None:
        application = rig.applications[3]
        assert application.station is not None
        application.station.set_address(5)
        application.due = now + 7

    assert rig.port.wake_at() == NEVER
    rig.port.command(AtStation(act), 10**6)
    assert rig.port.wake_at() == 10**6 + 7
    assert rig.say(REQUEST[3], 10**8) == []
    moved = rig.say(REQUEST[5], 10**9)
    assert [octets[:7] for octets in moved] == [bytes.fromhex("68 04 04 68 02 05 08")]
    assert len(rig.applications[3].ticks) == 1


def test_misuse() -> None:
    rig = Rig()
    with pytest.raises(ConfigError, match="two stations with address 4"):
        rig.port.add(rig.station(4))
    slow = PassiveStation(5, rig.applications[5], BusParams.preset(9_600))
    with pytest.raises(ConfigError, match="9600 bit/s"):
        rig.port.add(slow)
    for call in (rig.port.remove, rig.port.silence, rig.port.resume):
        with pytest.raises(UsageError, match="no station 9 on this port; there are: 3, 4"):
            call(9)
    with pytest.raises(UsageError, match="str"):
        rig.port.command("jump", 0)
    with pytest.raises(UsageError, match="none"):
        Multidrop([], PARAMS).remove(1)


def test_a_silenced_station_is_deaf_and_mute_for_a_while() -> None:
    rig = Rig()
    rig.step(REQUEST[3], 10**6)
    rig.port.silence(3, 10**9)
    rig.applications[3].due = 5 * 10**8
    rig.port.poke()
    rig.run_until(10**6 + 1_000 * BIT)
    assert rig.sent == []
    assert rig.say(CLEAR, 10**8) == []
    assert rig.say(REQUEST[3], 2 * 10**8) == []
    assert rig.say(REQUEST[4], 3 * 10**8) == [ANSWER[4]]
    rig.run_until(10**9 - 1)
    assert rig.applications[3].ticks == [5 * 10**8]  # its application goes on
    assert len(rig.applications[3].indicated) == 0
    assert rig.say(REQUEST[3], 10**9) == [ANSWER[3]]
    rig.port.silence(3)
    assert rig.say(REQUEST[3], 10**12) == []
    rig.port.resume(3)
    assert rig.say(REQUEST[3], 2 * 10**12) == [ANSWER[3]]


def test_a_station_that_changes_its_address() -> None:
    rig = Rig()
    rig.applications[4].move_to = 5
    assert rig.say(REQUEST[4], 10**6) == [ANSWER[4]]  # still under the old one
    rig.applications[4].move_to = None
    assert rig.say(REQUEST[4], 10**8) == []
    assert rig.say(REQUEST[5], 10**9) == [bytes.fromhex("68 04 04 68 02 05 08 04 13 16")]
    assert [station.address for station in rig.port.stations] == [3, 5]
    rig.port.stations[1].set_address(3)  # two with one address, from outside: the first one answers
    rig.port.poke()
    assert rig.say(REQUEST[3], 10**10) == [ANSWER[3]]
    assert rig.say(REQUEST[5], 10**11) == []


def test_deadlines_of_the_applications() -> None:
    rig = Rig()
    first, second = rig.applications[3], rig.applications[4]
    first.due_after_request = 10**8
    second.due_after_request = 10**8 + 7
    rig.say(REQUEST[3], 10**6)
    assert rig.port.wake_at() == 10**8
    rig.say(REQUEST[4], 10**7)
    assert rig.port.wake_at() == 10**8
    first.due_after_request = 10**8 + 9  # a watchdog that is re-armed moves the earliest deadline away
    rig.say(REQUEST[3], 2 * 10**7)
    assert rig.port.wake_at() == 10**8 + 7
    rig.run_until(10**9)
    assert (first.ticks, second.ticks) == ([10**8 + 9], [10**8 + 7])
    assert rig.port.wake_at() == NEVER


def test_the_line_goes_down_and_comes_back() -> None:
    rig = Rig()
    rig.step(REQUEST[3], 10**6)
    rig.port.command(LineDown("gone"), 10**6 + 1)
    rig.run_until(10**8)
    assert rig.sent == []
    rig.port.command(LineUp(), 10**8)
    assert rig.say(REPEAT_3, 10**9) == [ANSWER[3]]
    assert rig.applications[3].served == [decode(REQUEST[3]), decode(REPEAT_3)]  # the frame count was forgotten


def test_another_baud_rate_is_for_all() -> None:
    rig = Rig()
    rig.step(REQUEST[3], 10**6)
    rig.port.set_params(BusParams.preset(1_500_000))
    rig.run_until(10**8)
    assert rig.sent == []
    rig.say(REQUEST[4], 10**9)
    assert rig.sent == [(10**9 + 7_333, ANSWER[4])]
    assert {station.baud for station in rig.port.stations} == {1_500_000}


def test_events_of_all() -> None:
    rig = Rig()
    for number in (4, 3):
        rig.applications[number].events.append(Notice(t_ns=number, source="test", message="x"))
    assert [event.t_ns for event in rig.port.take_events()] == [3, 4]
    assert rig.port.take_events() == []
