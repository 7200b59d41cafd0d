"""Searches of the baud rate: traffic in literal octets for a listener behind a UART, and a machine under octets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from random import Random

from octet_slave import frame, sd1

from dpstack.fdl.baud_search import AutoBaud
from dpstack.machine import Machine, pump
from dpstack.phy.uart import Receiver, waveform
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S, bits_to_ns

#: of master 2: a token, FDL status of 5 and 7; their answers
TOKEN = bytes.fromhex("DC 02 02")
STATUS = {5: bytes.fromhex("10 05 02 49 50 16"), 7: bytes.fromhex("10 07 02 49 52 16")}
ANSWER = {5: bytes.fromhex("10 02 05 00 07 16"), 7: bytes.fromhex("10 02 07 00 09 16")}


class OctetLine:
    """``machine`` under literal octets; ``sent``: its transmissions."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.sent: list[bytes] = []
        self.now = 0
        self.deadline = 0

    def hear(self, octets: bytes, after_ns: int = NS_PER_MS) -> None:
        """``octets`` after a time in which the machine may answer those before."""
        until = self.now + after_ns
        while self.deadline <= until:
            self.now = max(self.now, self.deadline)
            self.deadline = pump(self.machine, b"", self.now, self._transmit)
        self.now = until
        self.deadline = pump(self.machine, octets, self.now, self._transmit)

    def _transmit(self, octets: bytes, now: int) -> int:
        self.sent.append(octets)
        return now


#: (idle bit times before it, octets)
Sent = tuple[int, bytes]
Traffic = Callable[[Random], Iterator[Sent]]


def lone_token(rng: Random) -> Iterator[Sent]:
    """A master alone, GAP off, nothing to say."""
    address, idle = rng.randrange(126), rng.choice((33, 37, 37, 76, 100, rng.randrange(33, 1000)))
    while True:
        yield idle, bytes((0xDC, address, address))


def token_ring(rng: Random) -> Iterator[Sent]:
    """Two to five masters that pass the token round."""
    masters = rng.sample(range(126), rng.randrange(2, 6))
    idle = rng.choice((37, 37, 76, rng.randrange(37, 200)))
    while True:
        for place, master in enumerate(masters):
            yield idle, bytes((0xDC, masters[(place + 1) % len(masters)], master))


def absent(rng: Random) -> Iterator[Sent]:
    """A master that asks absent stations for their FDL status, or an absent slave for its diagnosis."""
    master, hsa = rng.randrange(126), rng.randrange(20, 127)
    slot = rng.choice((100, 200, 640, 1000))
    diagnosis = frame(bytes((0x80 | rng.randrange(126), 0x80 | master, 0x6D, 0x3C, 0x3E)))
    diagnosing = rng.random() < 0.5
    while True:
        for address in range(hsa):
            yield 37, bytes((0xDC, master, master))
            yield 37, diagnosis if diagnosing else sd1(address, master, 0x49)
            yield slot, bytes((0xDC, master, master))


def exchange(rng: Random) -> Iterator[Sent]:
    """A master that polls one slave: constant or changing data, a GAP poll now and then."""
    master, slave = rng.sample(range(126), 2)
    inputs, outputs = rng.randrange(0, 33), rng.randrange(0, 33)
    changing = rng.random() < 0.5
    sent, got = rng.randbytes(outputs), rng.randbytes(inputs)
    gap = rng.choice((0, 1, 10))
    turn = 0
    while True:
        turn += 1
        if changing:
            sent, got = rng.randbytes(outputs), rng.randbytes(inputs)
        fc = 0x5D | (turn & 1) << 5
        yield 37, frame(bytes((slave, master, fc)) + sent) if sent else sd1(slave, master, fc)
        yield rng.randrange(11, 60), frame(bytes((master, slave, 8)) + got) if got else b"\xe5"
        if gap and turn % gap == 0:
            yield 37, sd1(turn % 126, master, 0x49)
            yield 100, bytes((0xDC, master, master))
        else:
            yield 37, bytes((0xDC, master, master))


def big_exchange(rng: Random) -> Iterator[Sent]:
    """Long telegrams, mostly zeros, as process data are."""
    master, slave = rng.sample(range(126), 2)
    out, back = bytes(rng.randrange(100, 245)), bytes(rng.randrange(100, 245))
    turn = 0
    while True:
        turn += 1
        yield 37, frame(bytes((slave, master, 0x5D | (turn & 1) << 5)) + out)
        yield 30, frame(bytes((master, slave, 8)) + back)
        yield 37, bytes((0xDC, master, master))


TRAFFIC: tuple[Traffic, ...] = (lone_token, token_ring, absent, exchange, big_exchange)


def upside_down(levels: bytes) -> bytes:
    """The line with its two wires reversed."""
    return levels.translate(bytes.maketrans(b"01", b"10"))


class Line:
    """``traffic`` at ``baud`` bit/s, whose clock is off by up to 0.3 %; a listener begins somewhere in it."""

    def __init__(
        self,
        baud: int,
        traffic: Iterator[Sent],
        rng: Random,
        *,
        flip_rate: float = 0.0,
        wiring: Callable[[bytes], bytes] = bytes,
    ) -> None:
        self.baud = round(baud * rng.uniform(0.997, 1.003))
        self.telegrams = 0  # that have begun since the listener began
        self._traffic = traffic
        self._rng = rng
        self._flip_rate = flip_rate
        self._wiring = wiring
        self._free_ns = 0
        for _ in range(rng.randrange(4)):
            self._free_ns += self._length(next(traffic))
        self.begun_ns = rng.randrange(self._free_ns + 1) + self._free_ns

    def _length(self, sent: Sent) -> int:
        idle, octets = sent
        return bits_to_ns(idle + len(octets) * BITS_PER_CHAR, self.baud)

    def _levels(self, octets: bytes) -> bytes:
        if not self._flip_rate:
            return self._wiring(waveform(octets))
        flips: dict[int, int] = {}
        for bit in range(len(octets) * BITS_PER_CHAR):
            if self._rng.random() < self._flip_rate:
                flips[bit // BITS_PER_CHAR] = flips.get(bit // BITS_PER_CHAR, 0) | 1 << bit % BITS_PER_CHAR
        return self._wiring(waveform(octets, flips))

    def listen(self, search: AutoBaud, *, most: int = 100_000) -> None:
        """Let ``search`` listen until it has a result, or ``most`` telegrams have passed."""
        receiver = Receiver(search.baud, self.begun_ns)
        for idle, octets in self._traffic:
            start = self._free_ns + bits_to_ns(idle, self.baud)
            self._free_ns = start + bits_to_ns(len(octets) * BITS_PER_CHAR, self.baud)
            receiver = self._time_passes(search, receiver, start)
            levels = self._levels(octets)
            since = start
            while since >= 0 and search.result is None:
                since = self._sent(search, receiver, start, levels, since)
                if receiver.baud != search.baud:
                    receiver = Receiver(search.baud, max(since, self.begun_ns))
            self.telegrams += self._free_ns > self.begun_ns
            if search.result is not None or self.telegrams >= most:
                return

    def _time_passes(self, search: AutoBaud, receiver: Receiver, until: int) -> Receiver:
        """The line is idle up to ``until``."""
        while search.result is None and min(search.wake_at(), receiver.due) <= until:
            now = min(search.wake_at(), receiver.due)
            for char in receiver.idle(now):
                if char.good:
                    search.receive(bytes((char.octet,)), now)
            search.wake(now)
            if search.baud != receiver.baud:
                receiver = Receiver(search.baud, now)
        return receiver

    def _sent(self, search: AutoBaud, receiver: Receiver, start: int, levels: bytes, since: int) -> int:
        """One transmission, or the rest of it; returns when the listener changed its rate, -1 when it did not."""
        for char in receiver.sample(start, levels, self.baud):
            now = self._wakes(search, receiver, char.at_ns)
            if now >= 0:
                return now
            if char.good:
                search.receive(bytes((char.octet,)), char.at_ns)
            if search.baud != receiver.baud or search.result is not None:
                return char.at_ns
        return self._wakes(search, receiver, self._free_ns)

    def _wakes(self, search: AutoBaud, receiver: Receiver, until: int) -> int:
        while search.result is None and search.wake_at() <= until:
            now = search.wake_at()
            search.wake(now)
            if search.baud != receiver.baud:
                return now
        return -1


def found(baud: int, traffic: Traffic, seed: int, *, flip_rate: float = 0.0) -> tuple[AutoBaud, Line]:
    """One seeded run: a search that listens to ``traffic`` at ``baud``."""
    rng = Random(f"{baud} {traffic.__name__} {seed}")
    line = Line(baud, traffic(rng), rng, flip_rate=flip_rate)
    search = AutoBaud(line.begun_ns, limit_ns=60 * NS_PER_S)
    line.listen(search)
    return search, line
