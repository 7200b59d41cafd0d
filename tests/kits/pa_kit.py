"""A process device of PROFIBUS PA in records of octets: a pressure transmitter with one analogue input.

Nothing of the project makes its octets: they are packed here by the tables of the profile.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from dpstack.dpv1.pdu.read_write import ReadReq
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.errors import AcyclicError, RecordRefused

PB, AI, TB = (0, 16), (1, 16), (1, 80)
MBAR, DEGC, METRE = 1138, 1001, 1010
INVALID_INDEX, ACCESS_DENIED = 0xB0, 0xB6
#: relative indices whose write counts ST_REV up, by block
_STATIC: Mapping[tuple[int, int], frozenset[int]] = {
    PB: frozenset({2, 3, 4, 5, 20, 21, 22}),
    AI: frozenset({2, 3, 4, 5, 11, 12, 13, 14, 17, 18, 19, 21, 23, 25, 27, 34}),
    TB: frozenset({2, 3, 4, 5, 11, 12, 14, 19, 30, 33, 34, 35, 36}),
}


def words(*numbers: int) -> bytes:
    return struct.pack(f">{len(numbers)}H", *numbers)


def f32(*numbers: float) -> bytes:
    return struct.pack(f">{len(numbers)}f", *numbers)


def block_object(kind: int, parent: int, number: int, parameters: int, view: int = 0, views: int = 0) -> bytes:
    """DS-32 of profile 3.02."""
    head = bytes((250, kind, parent, number)) + words(0, 0, 0, 0x4002, 0x0302)
    return head + bytes((10,)) + words(parameters, view) + bytes((views,))


def _standard(kind: bytes, tag: str) -> dict[int, bytes]:
    return {
        0: kind,
        1: words(7),
        2: tag.encode().ljust(32),
        3: words(0),
        4: b"\0",
        5: b"\x08",
        6: b"\x08\x98\x08",
        7: bytes(8),
    }


def transmitter(serial: str = "S-1", tag: str = "TANK LEVEL") -> dict[tuple[int, int], bytes]:
    """The records of the transmitter by slot and index."""
    physical = _standard(block_object(1, 1, 1, 29), tag) | {
        8: b"1.04.02".ljust(16),
        9: b"2.0".ljust(16),
        10: words(17),
        11: b"CERABAR".ljust(16),
        12: serial.encode().ljust(16),
        13: bytes(4),
        14: bytes(6),
        15: b"\xff" * 4,
        16: b"\xff" * 6,
        17: b"ATEX".ljust(32),
        18: words(2457),
        19: words(0),
        20: b"tank 7".ljust(32),
        21: b" " * 32,
        22: b"2026-11-01".ljust(16),
        24: b"\x00",
        25: b"\x00",
        26: b"\x03\0\0\0\x02\0\0\0",
    }
    function = _standard(block_object(2, 1, 1, 46, 0x01E0, 1), "FB PRESSURE") | {
        8: bytes(10),
        10: f32(3.5) + b"\x80",
        11: f32(10.0, 0.0),
        12: f32(4.0, 0.0) + words(METRE) + b"\x02",
        13: b"\0",
        14: words(0x0112),
        16: f32(0.0),
        17: b"\x01",
        18: f32(0.0),
        19: f32(0.5),
        21: f32(3.9),
        23: f32(3.8),
        25: f32(0.2),
        27: f32(0.1),
        **{at: bytes(16) for at in (30, 31, 32, 33)},
        34: b"\x80" + f32(0.0) + b"\0",
    }
    transducer = _standard(block_object(3, 1, 7, 60), "") | {
        8: f32(350.0),
        9: f32(1000.0),
        10: f32(-100.0),
        11: f32(400.0),
        12: f32(0.0),
        13: f32(10.0),
        14: words(MBAR),
        15: f32(350.0) + b"\x80",
        16: words(1),
        17: struct.pack(">I", 4711),
        18: f32(350.1) + b"\x80",
        19: words(MBAR),
        20: words(0),
        27: f32(21.5) + b"\x80",
        28: words(DEGC),
        29: f32(350.0) + b"\x80",
        30: words(MBAR),
        33: b"\0",
        34: f32(400.0, 0.0),
        35: f32(400.0, 0.0),
        50: words(42),
    }
    blocks = {PB: physical, AI: function, TB: transducer}
    records = {
        (slot, index + relative): octets
        for (slot, index), block in blocks.items()
        for relative, octets in block.items()
    }
    records[1, 0] = words(0, 1, 1, 6, 1, 3)
    records[1, 1] = words(0x0104, 1, 0x0105, 1, 0x0106, 1, 0x0010, 29, 0x0150, 60, 0x0110, 46)
    records[1, 0xE0] = records[1, 17] + records[1, 22] + records[1, 23] + records[1, 26]
    return records


@dataclass
class Transmitter:
    """The device of :func:`transmitter`: writes are checked and counted as a device does. ``delay``: of each service in
    s; ``on_access``: called before each with slot, index, and the octets of a write."""

    records: dict[tuple[int, int], bytes] = field(default_factory=transmitter)
    delay: float = 0.0
    on_access: Callable[[int, int, bytes | None], None] | None = None
    asked: list[tuple[int, int]] = field(default_factory=list)
    written: list[tuple[int, int, bytes]] = field(default_factory=list)

    async def read(self, slot: int, index: int) -> bytes:
        """The octets of a record. Raises RecordRefused."""
        await asyncio.sleep(self.delay)
        return self.get(slot, index)

    async def write(self, slot: int, index: int, data: bytes) -> None:
        """Raises RecordRefused."""
        await asyncio.sleep(self.delay)
        self.put(slot, index, data)

    def ask(self, request: RecordRequest) -> None:
        """As the records of a slave in a world."""
        service = request.service
        try:
            if isinstance(service, ReadReq):
                request.answer(self.get(service.slot, service.index)[: service.length])
            else:
                self.put(service.slot, service.index, service.data)
                request.answer(b"")
        except RecordRefused as refused:
            request.refuse(refused.code_1, refused.code_2)

    def get(self, slot: int, index: int) -> bytes:
        """The octets of a record. Raises RecordRefused."""
        self.asked.append((slot, index))
        self._access(slot, index, None)
        if (slot, index) not in self.records:
            raise RecordRefused(INVALID_INDEX)
        return self.records[slot, index]

    def put(self, slot: int, index: int, data: bytes) -> None:
        """Write a record. Raises RecordRefused."""
        self._access(slot, index, data)
        if (slot, index) not in self.records:
            raise RecordRefused(INVALID_INDEX)
        locked = self.records[0, 34] == words(0) and (slot, index) != (0, 34)
        if locked or self.records.get((0, 41), b"\0") != b"\0":
            raise RecordRefused(ACCESS_DENIED)
        self.written.append((slot, index, data))
        self.records[slot, index] = data
        self._count(slot, index)

    def _access(self, slot: int, index: int, data: bytes | None) -> None:
        if self.on_access is not None:
            self.on_access(slot, index, data)

    def _count(self, slot: int, index: int) -> None:
        own, first = max((place for place in _STATIC if place[0] == slot and place[1] <= index), key=lambda one: one[1])
        if index - first in _STATIC[own, first]:
            self.records[own, first + 1] = words(struct.unpack(">H", self.records[own, first + 1])[0] + 1)
        if index - first == 5:  # TARGET_MODE
            mode = self.records[own, first + 6]
            self.records[own, first + 6] = self.records[slot, index] + mode[1:]


def reader(
    records: Mapping[tuple[int, int], bytes], asked: list[tuple[int, int]] | None = None
) -> Callable[..., object]:
    """A function that reads records as a bus does: a missing one is refused with AcyclicError."""

    async def read(slot: int, index: int) -> bytes:
        if asked is not None:
            asked.append((slot, index))
        if (slot, index) not in records:
            text = f"slave 9 refuses Read of slot {slot}, index {index}: invalid index"
            raise AcyclicError(9, text, service="Read", slot=slot, index=index, codes=(0x80, INVALID_INDEX, 0))
        return records[slot, index]

    return read
