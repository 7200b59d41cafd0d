"""A simulated CPU: memory areas, mode and clock behind the same PDUs, and its station on the bus."""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Final

from dpstack.errors import PduError
from dpstack.fdl.interface import RS_REPLY, SC_REPLY, Reply, Responder
from dpstack.fdl.telegram import Req, Resp, Telegram
from dpstack.ppi.addresses import AREAS, BIT, ELEMENT_LENGTH, PpiAddress, PpiValue, parse_address
from dpstack.ppi.pdu import (
    ACKNOWLEDGEMENT,
    ANSWER,
    NEGOTIATE,
    PDU_LENGTH,
    READ,
    REQUEST,
    RUN,
    STOP,
    USER_DATA,
    WRITE,
    CpuPdu,
    Item,
    clock_octets,
    item_data,
    parse_clock,
    parse_items,
    parse_pdu,
)
from dpstack.units import NS_PER_MS, ns_to_s

_GOOD, _NOT_ALLOWED, _BEYOND, _WRONG_TYPE = 0xFF, 0x03, 0x05, 0x06
_NO_FUNCTION, _TOO_LONG = 0x8104, 0x8500
#: octets of the areas, those of a CPU 226 (system manual of S7-200, table of memory ranges); elements of T and C
SIZES: Final[Mapping[str, int]] = {
    "V": 10240,
    "M": 32,
    "I": 16,
    "Q": 16,
    "SM": 550,
    "S": 32,
    "AI": 64,
    "AQ": 64,
    "T": 256,
    "C": 256,
}
_BY_CODE: Final = {area.code: area.name for area in AREAS.values()}
_WITHOUT_DATA: Final = Reply(Resp.NR)
_NOT_YET: Final = Reply(Resp.RR)
_BEGIN: Final = datetime.datetime(2026, 1, 1)  # the clock of the CPU has no zone
_TICKING: Final = 20 * NS_PER_MS


class SimulatedCpu:
    """Memory, mode and clock of an S7-200 (CPU 226) behind its PDUs. It runs no program: tests set what it would."""

    def __init__(self) -> None:
        self._memory = {name: bytearray(size * ELEMENT_LENGTH.get(name, 1)) for name, size in SIZES.items()}
        #: whether it is in RUN
        self.running = True
        #: whether it refuses RUN and STOP from outside (mode switch in STOP or RUN)
        self.locked = False
        self._clock = _BEGIN
        self._clock_at = 0
        self["SM0.0"] = True

    def __getitem__(self, text: str) -> PpiValue:
        """The value of an address, for instance ``cpu["VW100"]``, also of AQ, which masters cannot read."""
        address = parse_address(text)
        return address.value(self._part(address))

    def __setitem__(self, text: str, value: PpiValue) -> None:
        """Set a value, also of I, AI, T and C, as its program and its inputs would."""
        address = parse_address(text)
        memory, at = self._memory[address.area.name], address.start
        if address.area.name in ELEMENT_LENGTH:
            length = address.length
            octets = int(value).to_bytes(length - 1, "big")
            memory[at * length + 1 : (at + 1) * length] = octets
        elif address.size == BIT:
            self._set_bit(memory, at, bool(value))
        else:
            memory[at // 8 : at // 8 + address.length] = address.octets(value)

    def _part(self, address: PpiAddress) -> bytes:
        item = Item(address.size, address.count, address.area.block, address.area.code, address.start)
        return self._octets(address.area.name, item)

    @staticmethod
    def _set_bit(memory: bytearray, at: int, on: bool) -> None:
        memory[at // 8] = memory[at // 8] & ~(1 << at % 8) | on << at % 8

    def clock(self, now: int) -> datetime.datetime:
        """The clock at time ``now`` in ns."""
        return self._clock + datetime.timedelta(seconds=ns_to_s(now - self._clock_at))

    # --- requests ---------------------------------------------------------------------------------------------------
    def answer(self, octets: bytes, now: int) -> bytes:
        """The answer to a request, in octets. Damaged requests are refused."""
        try:
            request = parse_pdu(octets)
        except PduError:
            return CpuPdu(ACKNOWLEDGEMENT, 0, b"", b"", _NO_FUNCTION).octets
        if request.kind == USER_DATA:
            return self._user_data(request, now).octets
        return self._function(request).octets

    def _function(self, request: CpuPdu) -> CpuPdu:
        parameter, sequence = request.parameter, request.sequence
        function = parameter[0] if parameter and request.kind == REQUEST else -1
        try:
            match function:
                case value if value == NEGOTIATE:
                    length = PDU_LENGTH.to_bytes(2, "big")
                    return CpuPdu(ANSWER, sequence, parameter[:6] + length)
                case value if value == READ:
                    answer = CpuPdu(ANSWER, sequence, parameter[:2], self._read(parse_items(parameter)))
                    if len(answer.octets) > PDU_LENGTH:
                        return CpuPdu(ACKNOWLEDGEMENT, sequence, b"", b"", _TOO_LONG)
                    return answer
                case value if value == WRITE:
                    return CpuPdu(ANSWER, sequence, parameter[:2], self._write(parse_items(parameter), request.data))
                case value if value in (RUN, STOP):
                    return self._switch(sequence, value)
        except PduError:
            pass
        return CpuPdu(ACKNOWLEDGEMENT, sequence, b"", b"", _NO_FUNCTION)

    def _switch(self, sequence: int, function: int) -> CpuPdu:
        if self.locked:
            return CpuPdu(ANSWER, sequence, b"", b"", 0x8001)
        self.running = function == RUN
        return CpuPdu(ANSWER, sequence, bytes([function]))

    def _read(self, items: list[Item]) -> bytes:
        data = b""
        for item in items:
            code, octets = self._readable(item)
            data += b"\0" * (len(data) % 2) + item_data(code, item.size, octets)
        return data

    def _readable(self, item: Item) -> tuple[int, bytes]:
        name = _BY_CODE.get(item.area)
        if name is None or (name == "V" and item.block != 1):
            return 0x0A, b""
        if name == "AQ":
            return _NOT_ALLOWED, b""
        octets = self._octets(name, item)
        if len(octets) > PDU_LENGTH:  # fits no answer, and no length of one
            return 0x07, b""
        return (_GOOD, octets) if octets else (_BEYOND, b"")

    def _octets(self, name: str, item: Item) -> bytes:
        """The octets of an item; empty if they are beyond the memory."""
        memory, at = self._memory[name], item.start
        if name in ELEMENT_LENGTH:
            length = ELEMENT_LENGTH[name]
            end = (at + item.count) * length
            return bytes(memory[at * length : end]) if end <= len(memory) else b""
        if item.size == BIT:
            return bytes([memory[at // 8] >> at % 8 & 1]) if at // 8 < len(memory) else b""
        length = item.count * (2 if name in ("AI", "AQ") else 1)
        part = memory[at // 8 : at // 8 + length]
        return bytes(part) if len(part) == length else b""

    def _write(self, items: list[Item], data: bytes) -> bytes:
        codes = bytearray()
        at = 0
        for item in items:
            length = int.from_bytes(data[at + 2 : at + 4], "big")
            length = (length + 7) // 8
            codes.append(self._write_item(item, data[at + 4 : at + 4 + length]))
            at += 4 + length + length % 2
        return bytes(codes)

    def _write_item(self, item: Item, octets: bytes) -> int:
        name = _BY_CODE.get(item.area)
        if name is None or (name == "V" and item.block != 1):
            return 0x0A
        if name in ELEMENT_LENGTH or not AREAS[name].writable:
            return _NOT_ALLOWED
        present = self._octets(name, item)
        if not present:
            return _BEYOND
        if len(present) != len(octets):
            return 0x07
        memory = self._memory[name]
        if item.size == BIT:
            self._set_bit(memory, item.start, bool(octets[0] & 1))
        else:
            memory[item.start // 8 : item.start // 8 + len(octets)] = octets
        return _GOOD

    def _user_data(self, request: CpuPdu, now: int) -> CpuPdu:
        parameter = request.parameter
        done = parameter[:3] + b"\x08\x12" + parameter[5:8] if len(parameter) == 8 else b""
        if done[6:7] == b"\x01":
            data = b"\xff\x09\x00\x0a" + clock_octets(self.clock(now))
            return CpuPdu(USER_DATA, request.sequence, done + b"\0\0\0\0", data)
        if done[6:7] == b"\x02":
            try:
                self._clock, self._clock_at = parse_clock(request.data[4:]), now
            except PduError:
                return CpuPdu(USER_DATA, request.sequence, done + b"\0\0\x81\x07", b"\x0a\0\0\0")
            return CpuPdu(USER_DATA, request.sequence, done + b"\0\0\0\0", b"\x0a\0\0\0")
        return CpuPdu(ACKNOWLEDGEMENT, request.sequence, b"", b"", _NO_FUNCTION)


class CpuStation(Responder):
    """The simulated CPU at its station: a request is acknowledged with SC; polls get RR until the answer is there.

    ``answer_ns``: from the request to its answer. ``mute``: it acknowledges and never answers. ``silent_until``: it
    neither receives nor answers until this time in ns.
    """

    def __init__(self, cpu: SimulatedCpu | None = None, *, answer_ns: int = _TICKING) -> None:
        #: memory, mode and clock
        self.cpu = cpu if cpu is not None else SimulatedCpu()
        self.answer_ns = answer_ns
        self.mute = False
        self.silent_until = 0
        #: requests since the start
        self.requests = 0
        self._answers: dict[int, tuple[int, bytes]] = {}

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if now < self.silent_until:
            return None
        if request.function not in (Req.SRD_LOW, Req.SRD_HIGH) or request.dsap is not None or request.ssap is not None:
            return RS_REPLY
        if request.data:
            self.requests += 1
            self._answers[request.sa] = (now + self.answer_ns, self.cpu.answer(request.data, now))
            return SC_REPLY
        ready_at, answer = self._answers.get(request.sa, (0, b""))
        if not answer:
            return _WITHOUT_DATA
        if self.mute or now < ready_at:
            return _NOT_YET
        del self._answers[request.sa]
        return Reply(Resp.DL, answer)
