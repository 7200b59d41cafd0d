"""The class 3 master: resolution from the measured port, clocks that jump or have an impossible year, other senders."""

from __future__ import annotations

from dpstack.dp.acyclic.clock_master import ClockMaster, HeardClocks
from dpstack.dp.pdu.clock import ClockValue
from dpstack.fdl.interface import Failure
from dpstack.fdl.telegram import SHORT_ACK, Kind, Telegram
from dpstack.params import BROADCAST, BusParams
from dpstack.phy.patience import Lateness
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_MS, NS_PER_S

#: 2026-11-29 00:00:00 UTC
T = 1_795_910_400 * NS_PER_S
YEAR = 365 * 86_400 * NS_PER_S
#: the public test vector (2023-05-26 13:02:56.5 UTC)
VALUE = bytes.fromhex("e81b2c8080000000e81b2c76800000000000")


class Rig:
    """A class 3 master that gets the token every second."""

    def __init__(self) -> None:
        self.offset = T
        self.synchronised = True
        self.lateness = Lateness(20 * NS_PER_MS)
        self.clock = ClockMaster(
            BusParams.preset(500_000),
            NS_PER_S,
            lambda now: self.offset + now,
            lambda: self.synchronised,
            lambda: self.lateness,
        )

    def hold(self, now: int) -> list[bytes]:
        """A token hold at ``now``: the data of its telegrams."""
        sent = []
        while (request := self.clock.next_request(now, False)) is not None:
            self.clock.started(request, now)
            now += NS_PER_MS
            self.clock.result(request, SHORT_ACK, now)
            sent.append(request.data)
        return sent

    @property
    def told(self) -> list[str]:
        events = self.clock.take_events()
        assert all(event.severity is Severity.WARNING for event in events)
        return [event.text for event in events]


def test_the_resolution_follows_the_port() -> None:
    rig = Rig()
    before = ClockValue.parse(rig.hold(0)[1])
    rig.lateness = Lateness(900_000, answers=1000)
    after = ClockValue.parse(rig.hold(2 * NS_PER_S)[1])
    assert (before.resolution_ms, after.resolution_ms) == (100, 1)
    assert rig.clock.held == rig.lateness
    assert rig.clock.sent == 2
    assert rig.told == []


def test_a_computer_without_a_clock_sends_no_time_and_says_so_once() -> None:
    rig = Rig()
    rig.offset = 0  # 1970: a computer whose clock has no battery
    assert rig.hold(0) == rig.hold(NS_PER_S) == []
    (said,) = rig.told
    assert "the time is not sent while the clock of this computer is wrong" in said
    assert rig.clock.trouble
    rig.offset = T
    assert len(rig.hold(2 * NS_PER_S)) == 2
    assert (rig.clock.trouble, rig.told) == ("", [])


def test_a_clock_set_back_between_the_two_telegrams_ends_the_pair() -> None:
    rig = Rig()
    event = rig.clock.next_request(0, False)
    assert event is not None
    rig.clock.started(event, 0)
    rig.clock.result(event, SHORT_ACK, NS_PER_MS)
    rig.offset = 0
    assert rig.hold(NS_PER_MS) == []
    assert rig.clock.sent == 0


def test_a_clock_of_this_computer_that_jumps_by_a_year_is_reported() -> None:
    rig = Rig()
    rig.hold(0)
    rig.offset += YEAR
    value = ClockValue.parse(rig.hold(2 * NS_PER_S)[1])
    assert value.previous_ns is not None
    assert value.time_ns - value.previous_ns == YEAR + 2 * NS_PER_S
    (said,) = rig.told
    assert "the clock of this computer was set by +31536000.000 s" in said


def test_a_damaged_time_event_has_no_value() -> None:
    rig = Rig()
    event = rig.clock.next_request(0, False)
    assert event is not None
    rig.clock.started(event, 0)
    rig.clock.result(event, Failure.ABANDONED, NS_PER_MS)
    assert rig.clock.next_request(NS_PER_MS, False) is event


class Heard:
    def __init__(self, *, sends: bool) -> None:
        self.events: list[Event] = []
        self.clocks = HeardClocks(self.events.append, sends=sends)

    def send(self, sender: int, at: int, value: bytes = VALUE) -> None:
        self.clocks.hear(Telegram(Kind.SD1, BROADCAST, sender, 0x40), at)
        self.clocks.hear(Telegram(Kind.SD2, BROADCAST, sender, 0xC0, data=value), at + NS_PER_MS)

    @property
    def told(self) -> list[tuple[str, Severity]]:
        return [(event.text, event.severity) for event in self.events]


def test_another_clock_master_is_reported_once() -> None:
    heard = Heard(sends=True)
    for second in range(3):
        heard.send(5, second * NS_PER_S)
    assert heard.told == [
        (
            "clock: master 5 and this master send the time: devices follow one of them or jump; let one send it",
            Severity.WARNING,
        )
    ]
    assert heard.clocks.masters[5].values == 3


def test_two_others_are_a_warning_and_one_alone_is_not() -> None:
    heard = Heard(sends=False)
    heard.send(5, 0)
    heard.send(7, NS_PER_S)
    assert [severity for _, severity in heard.told] == [Severity.INFO, Severity.WARNING]
    assert heard.told[1][0].startswith("clock: master 7 and master 5 send the time:")


def test_damaged_pairs_and_silent_masters_do_not_count() -> None:
    heard = Heard(sends=False)
    heard.send(5, 0, bytes(17))
    heard.clocks.hear(Telegram(Kind.SD2, BROADCAST, 5, 0xC0, data=VALUE), NS_PER_S)
    assert not heard.clocks.masters
    heard.send(5, 2 * NS_PER_S)
    heard.clocks.forget_silent(1000 * NS_PER_S)
    assert not heard.clocks.masters


def test_times_that_were_missed_are_left_out() -> None:
    rig = Rig()
    rig.hold(0)
    assert len(rig.hold(5 * NS_PER_S)) == 2
    assert rig.hold(5 * NS_PER_S + NS_PER_MS) == []
    assert len(rig.hold(6 * NS_PER_S + NS_PER_MS)) == 2
