"""The time that masters send, as the monitor hears it: octets written by hand."""

from __future__ import annotations

from support import S

from dpstack.capture.transmission import Transmission
from dpstack.dp.pdu.clock import ClockValue
from dpstack.monitor.clock import SentTime
from dpstack.monitor.counters import Change, Counters
from dpstack.units import NS_PER_MS

BAUD = 500_000
NOW = 1_800_000_000 * S
#: the public test vector, sent by station 2
VALUE = bytes.fromhex("68 15 15 68 7f 02 c0 e8 1b 2c 80 80 00 00 00 e8 1b 2c 76 80 00 00 00 00 00 95 16")
#: octets of a Time_Event take 66 bits
EVENT_NS = 132_000


def event(sender: int) -> bytes:
    return bytes((0x10, 0x7F, sender, 0x40, (0x7F + sender + 0x40) & 0xFF, 0x16))


def value(sender: int, data: bytes) -> bytes:
    body = bytes((0x7F, sender, 0xC0)) + data
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


class Line:
    def __init__(self) -> None:
        self.changes: list[Change] = []
        self.counters = Counters(self.changes.append)

    def send(self, at: int, octets: bytes) -> None:
        self.counters.add(Transmission(octets, NOW + at, BAUD))

    def clock(self, address: int = 2) -> SentTime:
        clock = self.counters.masters[address].clock
        assert clock is not None
        return clock


def test_the_public_vector() -> None:
    line = Line()
    line.send(0, event(2))
    line.send(NS_PER_MS, VALUE)
    clock = line.clock()
    assert (clock.values, clock.damaged) == (1, 0)
    assert clock.value is not None
    assert clock.value.time_ns == 1_685_106_176_500_000_000
    assert [(change.kind, change.text) for change in line.changes] == [("clock", "master 2 sends the time")]


def test_interval_and_jitter() -> None:
    line = Line()
    time = 1_685_106_176 * S
    for second, late_ms in enumerate((0, 3, 0, 1)):
        begin = second * S + late_ms * NS_PER_MS
        line.send(begin, event(2))
        # the values say that the event came on the second
        line.send(begin + NS_PER_MS, value(2, ClockValue(time + second * S).build()))
    clock = line.clock()
    assert clock.values == 4
    assert (clock.interval_ns.min_ns, clock.interval_ns.max_ns) == (S - 3 * NS_PER_MS, S + 3 * NS_PER_MS)
    assert (clock.jitter_ns.count, clock.jitter_ns.max_ns) == (3, 3 * NS_PER_MS)


def test_values_without_their_event_and_of_a_wrong_length_are_counted_apart() -> None:
    line = Line()
    line.send(0, VALUE)
    line.send(S, event(2))
    line.send(S + NS_PER_MS, value(2, bytes(17)))
    line.send(2 * S, event(2))
    line.send(4 * S, VALUE)  # too late
    clock = line.clock()
    assert (clock.values, clock.damaged) == (0, 3)


def test_nothing_is_measured_across_a_gap_of_the_capture() -> None:
    line = Line()
    for second in (0, 1):
        line.send(second * S, event(2))
        line.send(second * S + NS_PER_MS, value(2, ClockValue((1_685_106_176 + second) * S).build()))
        line.counters.gap()
    assert line.clock().interval_ns.count == line.clock().jitter_ns.count == 0
