"""The clock of a slave: VPC3+S's formula, monitoring, jumps, two masters, damaged values."""

from __future__ import annotations

import pytest

from dpstack.dp.pdu.clock import ClockValue
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, PRM_STRUCTURE
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.pdu.prm_contents import TimeAr
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.clock_receiver import ClockJumped, ClockLost, ClockReceiver, ClockSet, PlantClock, clock_of
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.params import BROADCAST
from dpstack.units import NS_PER_MS, NS_PER_S

#: the public test vector (2023-05-26 13:02:56.5 UTC)
T = 1_685_106_176_500_000_000
VALUE = bytes.fromhex("e81b2c8080000000e81b2c76800000000000")


class Rig:
    def __init__(self) -> None:
        self.app = SlaveApp(MirrorDevice(0x1234, b"\x31"), address=5)
        self.receiver: ClockReceiver = clock_of(self.app)

    def send(self, at: int, value: bytes | None = VALUE, sender: int = 2) -> None:
        """A Time_Event that ends at ``at`` and its Clock_Value a millisecond later."""
        self.app.indicate(Telegram(Kind.SD1, BROADCAST, sender, 0x40), at)
        if value is not None:
            self.app.indicate(Telegram(Kind.SD2, BROADCAST, sender, 0xC0, data=value), at + NS_PER_MS)

    def parameterise(self, interval_10ms: int, seconds: int = 0, fraction: int = 0) -> None:
        block = PrmBlock.of(TimeAr(interval_10ms, seconds, fraction))
        user = bytes((DPV1_ENABLE, 0, PRM_STRUCTURE)) + block.octets
        self.receiver.parameterised(SetPrm(ident=0x1234, user_prm=user))

    def clock(self, at: int) -> PlantClock:
        return self.receiver.plant_clock(at)

    @property
    def events(self) -> list[str]:
        return [type(event).__name__ for event in self.app.take_events()]


def test_the_time_counts_from_the_end_of_the_time_event() -> None:
    rig = Rig()
    assert rig.clock(0) == PlantClock()
    rig.send(1000)
    clock = rig.clock(1000 + NS_PER_S)
    assert clock == PlantClock(T + NS_PER_S, True, 2, 1, False, 0)
    assert rig.events == ["ClockSet"]


def test_delay_and_monitoring_of_set_prm() -> None:
    rig = Rig()
    rig.parameterise(100, 1, 1 << 31)
    rig.send(0)
    assert rig.clock(0).time_ns == T + NS_PER_S * 3 // 2
    due = NS_PER_MS + NS_PER_S * 3 // 2  # half an interval for the jitter of the master
    assert rig.app.wake_at() == due
    rig.app.tick(due)
    lost = rig.clock(due)
    assert not lost.synchronised
    assert lost.time_ns == T + NS_PER_S * 3 // 2 + due  # it runs on
    assert rig.events == ["ClockSet", "ClockLost"]
    rig.send(2 * due, sender=9)  # the first one is silent: another may take over
    assert rig.clock(2 * due).master == 9
    assert rig.events == ["ClockSet", "ClockJumped"]


def test_a_clock_that_jumps_by_a_year() -> None:
    rig = Rig()
    rig.send(0)
    year = 365 * 86_400 * NS_PER_S
    rig.send(NS_PER_S, ClockValue(T + NS_PER_S + year, T).build())
    events = rig.app.take_events()
    jump = events[-1]
    assert isinstance(events[0], ClockSet)
    assert isinstance(jump, ClockJumped)
    assert jump.by_ns == year
    assert jump.text.endswith("moved its clock by +31536000.000 s")
    assert rig.clock(NS_PER_S).time_ns == T + NS_PER_S + year


def test_the_second_of_two_clock_masters_is_reported_once_and_not_followed() -> None:
    rig = Rig()
    rig.send(0)
    for n in range(1, 4):
        rig.send(n * NS_PER_S, ClockValue(T).build(), sender=3)
    assert rig.clock(0).master == 2
    assert rig.events == ["ClockSet", "RequestRefused"]


@pytest.mark.parametrize("value", [b"", bytes(17), bytes(19)])
def test_damaged_values_change_nothing(value: bytes) -> None:
    rig = Rig()
    rig.send(0)
    rig.send(NS_PER_S, value)
    assert rig.clock(NS_PER_S).time_ns == T + NS_PER_S
    assert rig.events == ["ClockSet", "RequestRefused"]


def test_a_value_without_its_event_is_dropped() -> None:
    rig = Rig()
    rig.app.indicate(Telegram(Kind.SD2, BROADCAST, 2, 0xC0, data=VALUE), 0)
    rig.send(0, None)
    rig.app.indicate(Telegram(Kind.SD2, BROADCAST, 2, 0xC0, data=VALUE), 2 * NS_PER_S)  # too late
    assert rig.clock(0) == PlantClock()


def test_a_sender_that_is_not_synchronised_itself() -> None:
    rig = Rig()
    rig.send(0, ClockValue(T, synchronised=False, summer_time=True, resolution_ms=10).build())
    assert rig.clock(0) == PlantClock(T, False, 2, 10, True, 0)


def test_events_in_words() -> None:
    clock_set = ClockSet(t_ns=0, address=5, name="valve", master=2, time_ns=T)
    assert clock_set.text.endswith("its clock follows master 2: 2023-05-26 13:02:56.500 UTC")
    lost = ClockLost(t_ns=0, address=5, name="valve", master=2, interval_ns=10 * NS_PER_S)
    assert "no time of master 2 for more than 10 s" in lost.text
