"""Read and Write of a drive plugin to its slave, against octets, beside the services of a program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import pytest
from ms1_kit import DL, MS, SC, Ms1Bus, answer

from dpstack.dp.acyclic.job import CancelService
from dpstack.dp.acyclic.queue import CAPACITY
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dpv1.master.orders import RecordOrder
from dpstack.dpv1.master.plugin_queue import Outcome, PendingRecord, ReadReq, RecordQueue, ServiceFailure, WriteReq
from dpstack.dpv1.pdu.read_write import Function


class Unit:
    """A drive plugin that only reads and writes records."""

    def __init__(self) -> None:
        self.records = RecordQueue()

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        return b""

    def safe(self, configured: bytes) -> bytes:
        return configured

    def moved(self, address: int) -> str | None:
        return None

    def lost(self, now: int) -> None:
        self.records.clear()

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        raise AssertionError

    def take_events(self) -> list[dict[str, object]]:
        return []


def bus_with_unit(dpv1: Dpv1 | None = None) -> tuple[Ms1Bus, RecordQueue]:
    bus = Ms1Bus() if dpv1 is None else Ms1Bus(dpv1=dpv1)
    unit = Unit()
    bus.master.handlers[4].image.plugin = unit
    bus.send(SetMode(Mode.OPERATE))
    return bus, unit.records


def end(bus: Ms1Bus, pending: PendingRecord) -> Outcome:
    """Run until the plugin's service has ended."""
    for _ in range(20_000):
        if pending.outcome is not None:
            return pending.outcome
        bus.bus.run(MS)
    raise AssertionError("no end")


def requests(bus: Ms1Bus) -> list[str]:
    """The requests of MS1 without polls."""
    return [data.hex(" ").upper() for data in bus.slave.asked if data]


def test_write_and_read_are_no_events() -> None:
    bus, queue = bus_with_unit()
    bus.slave.ms1 = lambda data: answer(4, {b"\x5f": "5F 01 2F 02", b"\x5e": "5E 01 2F 03 0A 0B 0C"}[data[:1]])
    written = queue.submit(WriteReq(1, 47, b"\x11\x22"))
    read = queue.submit(ReadReq(1, 47, 240))
    assert end(bus, written) == Outcome()
    assert end(bus, read) == Outcome(data=b"\x0a\x0b\x0c")
    assert requests(bus) == ["5F 01 2F 02 11 22", "5E 01 2F F0"]
    assert bus.done == []


def test_negative_answers_and_impossible_requests() -> None:
    bus, queue = bus_with_unit()
    bus.slave.ms1 = lambda data: answer(4, "DE 80 B5 00", DL)
    refused = end(bus, queue.submit(ReadReq(1, 47, 240)))
    assert (refused.failure, refused.codes) == (ServiceFailure.NEGATIVE, (0x80, 0xB5, 0))
    wrong = end(bus, queue.submit(ReadReq(1, 300, 240)))
    assert wrong.failure is ServiceFailure.LENGTH
    assert requests(bus) == ["5E 01 2F F0"]


def test_no_record_is_longer_than_the_slave_takes() -> None:
    bus, queue = bus_with_unit(Dpv1(c1_max_data_len=64))
    bus.slave.ms1 = lambda data: answer(4, {b"\x5f": "5F 01 2F 40", b"\x5e": "5E 01 2F 01 0A"}[data[:1]])
    refused = end(bus, queue.submit(WriteReq(1, 47, bytes(65))))
    assert (refused.failure, refused.codes) == (ServiceFailure.NEGATIVE, (0x80, 0xB1, 0))
    assert end(bus, queue.submit(WriteReq(1, 47, bytes(64)))) == Outcome()
    assert end(bus, queue.submit(ReadReq(1, 47, 240))) == Outcome(data=b"\x0a")
    assert requests(bus) == [f"5F 01 2F 40{64 * ' 00'}", "5E 01 2F 40"]


def test_it_waits_for_its_turn_when_a_program_has_many() -> None:
    bus, queue = bus_with_unit()
    bus.slave.ms1 = lambda data: answer(4, "5E 01 02 01 07") if data else SC
    tokens = [bus.order_read(1, 2) for _ in range(CAPACITY)]
    pending = queue.submit(ReadReq(1, 2, 5))
    assert end(bus, pending) == Outcome(data=b"\x07")
    assert requests(bus)[0] == "5E 01 02 F0"
    assert "5E 01 02 05" in requests(bus)
    assert len({bus.end(token).token for token in tokens}) == CAPACITY


def test_cancelled_and_lost_before_it_was_sent() -> None:
    bus, queue = bus_with_unit()
    given_up = queue.submit(ReadReq(1, 2, 5))
    queue.cancel(given_up)
    queue.cancel(given_up)
    assert not queue
    bus.run(20)
    assert given_up.outcome is None
    assert requests(bus) == []


def test_the_slave_falls_silent() -> None:
    bus, queue = bus_with_unit()
    pending = queue.submit(ReadReq(1, 2, 5))
    bus.slave.mute = True
    assert end(bus, pending).failure in (ServiceFailure.SILENT, ServiceFailure.CLOSED)
    later = queue.submit(ReadReq(1, 2, 5))
    bus.run(200)
    assert later.outcome is None  # it waits for data exchange, unless the unit gives it up


@dataclass
class Drive:
    """The slave's end of record 47: one response at a time, "not yet" to the first ``busy`` Reads for each."""

    busy: int = 1
    response: bytes | None = None
    polls: int = 0

    def __call__(self, data: bytes) -> bytes | None:
        if data[:1] == b"\x5f":
            self.response, self.polls = data[4:], 0
            return answer(4, f"5F 01 2F {len(data) - 4:02X}")
        if data[2:3] != b"\x2f":
            return answer(4, "5E 01 02 01 07")
        self.polls += 1
        if self.response is None or self.polls <= self.busy:
            return answer(4, "DE 80 B5 00")
        response, self.response = self.response, None
        return answer(4, f"5E 01 2F {len(response):02X} {response.hex()}")


def drive_and_unit(busy: int = 1) -> tuple[Ms1Bus, RecordQueue]:
    bus, queue = bus_with_unit()
    bus.slave.ms1 = Drive(busy)
    return bus, queue


def test_a_request_of_record_47_runs_wholly_before_that_of_another_user() -> None:
    bus, queue = drive_and_unit()
    program = bus.write(1, 47, b"\xb1")
    plugin = queue.submit(WriteReq(1, 47, b"\x11"))
    assert program.outcome == Outcome()
    assert bus.read().outcome.data == b"\x07"  # another record overtakes the plugin
    assert bus.read(1, 47).outcome.codes == (0x80, 0xB5, 0)
    assert plugin.outcome is None
    assert bus.read(1, 47).outcome.data == b"\xb1"
    assert end(bus, plugin) == Outcome()
    token = bus.order_read(1, 47)  # without a turn: it waits
    assert end(bus, queue.submit(ReadReq(1, 47, 240))).codes == (0x80, 0xB5, 0)
    assert end(bus, queue.submit(ReadReq(1, 47, 240))) == Outcome(data=b"\x11")
    assert bus.end(token).outcome.codes == (0x80, 0xB5, 0)


FREED = {
    "the program never reads": ([], 1_900, 2_100),
    "its Read was cancelled": (["read", "cancel"], 0, 100),
    "its Write was refused": (["refuse"], 0, 100),
    "the slave left data exchange and came back": (["leave"], 0, 1_500),
    "it reads without end, and the drive is never ready": (["read on"], 9_000, 10_100),
}


@pytest.mark.parametrize(("steps", "from_ms", "to_ms"), FREED.values(), ids=FREED)
def test_record_47_is_free_again_when(steps: list[str], from_ms: int, to_ms: int) -> None:
    bus, queue = drive_and_unit(busy=1_000_000)
    if "refuse" in steps:
        bus.slave.ms1 = lambda data: answer(4, "DF 80 C2 00")
    bus.write(1, 47, b"\xb1")
    bus.slave.ms1 = Drive(busy=1_000_000)
    if "leave" in steps:
        bus.slave.mute = True
        bus.run(400)
        bus.slave.mute = False
        bus.until_exchanging()
    begun = bus.bus.now
    if "cancel" in steps:
        bus.send(CancelService(bus.order_read(1, 47)))
    pending = queue.submit(WriteReq(1, 47, b"\x11"))
    while pending.outcome is None:
        if "read on" in steps:
            bus.order_read(1, 47)
        bus.run(20)
    assert pending.outcome == Outcome()
    assert from_ms <= (bus.bus.now - begun) // MS <= to_ms


def test_a_request_over_record_47_that_is_given_up_while_it_waits() -> None:
    bus, queue = drive_and_unit()
    bus.write(1, 47, b"\xb1")
    given_up = queue.submit(WriteReq(1, 47, b"\x11"))
    bus.send(RecordOrder(90, Function.WRITE, 1, 47, data=b"\x12", timeout_ns=500 * MS, address=4, user=7))
    bus.run(100)
    queue.cancel(given_up)
    assert bus.end(90).outcome.text == (
        "Write of slot 1, index 47 to slave 4 was not over after 0.5 s: record 47 of this slave was in use all the time"
    )
    bus.run(3_000)
    assert requests(bus) == ["5F 01 2F 01 B1"]
