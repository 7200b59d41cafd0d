"""A line of octets in virtual time for fuzz targets: one machine, and stations that know telegrams as numbers only."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from typing import Final

from dpstack.machine import Pumped, pump
from dpstack.units import NEVER

SC: Final = b"\xe5"
DL, DH, RS, NR = 0x08, 0x0A, 0x03, 0x09
BITS_PER_CHAR: Final = 11
#: a telegram that begins so is a request with SAPs
_HAS_SAPS: Final = 0x80


def sd1(da: int, sa: int, fc: int) -> bytes:
    """A telegram without data."""
    return bytes((0x10, da, sa, fc, (da + sa + fc) & 0xFF, 0x16))


def sd2(da: int, sa: int, fc: int, data: bytes, saps: tuple[int, int] | None = None) -> bytes:
    """A telegram with data, with DSAP and SSAP if they are given; at most 246 octets behind FC."""
    if saps is not None:
        da, sa, data = da | 0x80, sa | 0x80, bytes(saps) + data
    body = bytes((da, sa, fc)) + data[:246]
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


class Asked:
    """A request as octets say it. ``dsap`` None: Data_Exchange, or FDL status where ``status`` is true."""

    __slots__ = ("da", "data", "dsap", "fc", "sa", "ssap", "status")

    def __init__(self, octets: bytes) -> None:
        head = 4 if octets[0] == 0x68 else 1
        da, sa, self.fc = octets[head : head + 3]
        data = octets[head + 3 : -2]
        self.dsap: int | None = None
        self.ssap: int | None = None
        if da & _HAS_SAPS:
            self.dsap, data = data[0], data[1:]
        if sa & _HAS_SAPS:
            self.ssap, data = data[0], data[1:]
        self.da, self.sa, self.data = da & 0x7F, sa & 0x7F, data
        self.status = self.fc & 0x0F == 9

    def answer(self, data: bytes, fc: int = DL) -> bytes:
        """The telegram with ``data`` that answers this request."""
        if self.dsap is None or self.ssap is None:
            return sd2(self.sa, self.da, fc, data)
        return sd2(self.sa, self.da, fc, data, (self.ssap, self.dsap))

    def refusal(self, fc: int = RS) -> bytes:
        return sd1(self.sa, self.da, fc)


class Line:
    """The line of ``machine`` at ``baud`` bit/s. ``heard(octets, end_ns)`` gets each telegram that it sends."""

    def __init__(self, machine: Pumped, baud: int, heard: Callable[[bytes, int], None]) -> None:
        self.now = 1_000_000
        self.telegrams = 0
        self._machine = machine
        self._bit_ns = 1_000_000_000 // baud
        self._heard = heard
        self._edge = getattr(machine, "activity", None)
        self._arriving: list[tuple[int, int, bytes]] = []
        self._count = 0
        self.due = self.now

    def say(self, octets: bytes, at: int, bits: int = 0) -> int:
        """Put ``octets`` of another station on the line ``bits`` after ``at``. Returns the time of their end."""
        begin = at + bits * self._bit_ns
        end = begin + BITS_PER_CHAR * len(octets) * self._bit_ns
        self._count += 2
        heapq.heappush(self._arriving, (begin, self._count, b""))
        heapq.heappush(self._arriving, (end, self._count + 1, octets))
        return end

    def forget(self) -> None:
        """Take back what has not arrived."""
        self._arriving.clear()

    def pump(self, octets: bytes = b"") -> None:
        """One step of the machine."""
        self.due = pump(self._machine, octets, self.now, self._transmit)

    def step(self, until: int) -> bool:
        """Go on to the next octets or the next deadline, not beyond ``until``. Whether there was one."""
        arriving = self._arriving
        at = min(self.due, arriving[0][0] if arriving else NEVER)
        if at > until:
            self.now = max(self.now, until)
            return False
        self.now = max(self.now, at)
        octets = b""
        if arriving and arriving[0][0] <= self.now:
            octets = heapq.heappop(arriving)[2]
            if not octets and self._edge is not None:  # a start edge
                self._edge(self.now)
        self.pump(octets)
        return True

    def run(self, ns: int) -> None:
        """All steps of the next ``ns``."""
        until = self.now + ns
        while self.step(until):
            pass

    def _transmit(self, octets: bytes, now: int) -> int:
        self.telegrams += 1
        end = now + BITS_PER_CHAR * len(octets) * self._bit_ns
        self._heard(octets, end)
        return end


class CorrectSlave:
    """A slave of octets that does what it should: bring-up, data exchange, Read and Write of any record at SAP 51."""

    def __init__(self, address: int, ident: int, config: bytes, inputs: bytes) -> None:
        self.address = address
        self.ident = ident.to_bytes(2, "big")
        self.config = config
        self.inputs = inputs
        self.master = 255
        self.ready = False
        self.outputs: bytes | None = None
        #: the last outputs, without repetitions
        self.changes: list[bytes] = []
        self.exchanges = 0
        self.refusals = 0
        self.record = b""
        self._last: tuple[int, bytes] | None = None
        self._kept: bytes | None = None

    def restart(self) -> None:
        """Switched off and on."""
        self.master, self.ready, self.outputs, self.record, self._last = 255, False, None, b"", None

    def answer(self, octets: bytes) -> bytes | None:
        """The answer to a request to this slave; a repetition (the same frame count bit) gets the same answer again."""
        asked = Asked(octets)
        if asked.fc & 0x10 and self._last == (asked.fc, octets):
            return self._kept
        self._kept = self._served(asked)
        self._last = asked.fc, octets
        return self._kept

    def _served(self, asked: Asked) -> bytes | None:
        if asked.status:
            return sd1(asked.sa, self.address, 0)
        match asked.dsap:
            case 60:
                ready = self.master != 255
                head = (0 if self.ready else 2, 0x0C if ready else 5, 0, self.master)
                return asked.answer(bytes(head) + self.ident)
            case 61:
                good = asked.data[4:6] == self.ident and asked.data[0] & 0xC0 == 0x80
                self.master, self.ready = (asked.sa if good else 255), False
                return SC
            case 62:
                self.ready = self.master == asked.sa and asked.data == self.config
                return SC
            case 51 if self.ready:
                return self._served_record(asked)
            case None if self.ready and asked.sa == self.master:
                if asked.data != self.outputs:
                    self.changes = [*self.changes[-7:], asked.data]
                self.outputs = asked.data
                self.exchanges += 1
                return asked.answer(self.inputs) if self.inputs else SC
        self.refusals += 1
        return asked.refusal()

    def _served_record(self, asked: Asked) -> bytes:
        data = asked.data
        if not data:
            answer, self.record = self.record, b""
            return asked.answer(answer) if answer else SC
        match data[0]:
            case 0x5E:
                self.record = data[:3] + bytes((2,)) + data[1:3]
            case 0x5F:
                self.record = data[:4]
            case 0x5C:
                self.record = data
            case _:
                self.record = bytes((data[0] | 0x80, 0x80, 0xB5, 0))
        return SC
