"""UART model: octets as levels on the line, and the characters that a receiver at any rate samples.

8E1: start bit (space), eight data bits with the lowest first, even parity, stop bit (mark); an idle line is mark. A
falling edge starts a receiver. It checks the start bit after half a bit, then samples in the middle of each of its own
bits. After a bad stop bit it waits for mark before it looks for the next edge. All calculations use integers: sample i
hits the sender's bit number floor((2 i + 1) x sent rate / (2 x own rate)).
"""

from __future__ import annotations

from typing import Final, NamedTuple

from dpstack.units import BITS_PER_CHAR, NEVER, NS_PER_S, bits_to_ns

_MARK: Final = ord("1")
_SPACE: Final = ord("0")
_EDGE: Final = b"10"
_STOP: Final = BITS_PER_CHAR - 1

# masks of inverted bits
START_BIT: Final = 0x001
DATA_BITS: Final = 0x1FE
PARITY_BIT: Final = 0x200
STOP_BIT: Final = 0x400


class Character(NamedTuple):
    """A received character: end of its stop bit in ns, data bits, errors."""

    at_ns: int
    octet: int
    parity_error: bool
    framing_error: bool

    @property
    def good(self) -> bool:
        """Whether it has no error, so that a port with IGNPAR delivers it."""
        return not (self.parity_error or self.framing_error)


def _levels(octet: int) -> bytes:
    """The eleven bits of ``octet`` in the order they are sent."""
    data = f"{octet:08b}"[::-1]
    return f"0{data}{data.count('1') & 1}1".encode()


_LEVELS: Final = tuple(map(_levels, range(256)))


def waveform(octets: bytes, flips: dict[int, int] | None = None) -> bytes:
    """The line while ``octets`` are sent without gaps: ``b"1"`` (mark) or ``b"0"`` (space) for each bit.

    ``flips``: bits that noise inverts by octet number; bit 0 of a mask is the start bit, bit 10 the stop bit.
    """
    levels = b"".join([_LEVELS[octet] for octet in octets])
    if not flips:
        return levels
    noisy = bytearray(levels)
    for number, mask in flips.items():
        for bit in range(BITS_PER_CHAR):
            if mask >> bit & 1:
                noisy[number * BITS_PER_CHAR + bit] ^= _MARK ^ _SPACE
    return bytes(noisy)


class Receiver:
    """The receiving half of a UART at ``baud`` bit/s that is switched on at ``since_ns``.

    The caller passes every transmission on the line, in order and not overlapping; between them the line is mark. A
    character may reach beyond the end of a transmission, and into the next one: the next :meth:`sample` or
    :meth:`idle` returns it once it is complete.
    """

    def __init__(self, baud: int, since_ns: int = 0) -> None:
        self.baud = baud
        self._ready_ns = since_ns  # earlier edges do not count
        self._edge_ns = 0  # start edge of the current character
        self._sampled: bytes | None = None  # bits of the current character so far, start bit first
        self._places: dict[int, tuple[int, ...]] = {}

    @property
    def due(self) -> int:
        """The end in ns of the current character if the line stays mark; NEVER without one."""
        return self._edge_ns + bits_to_ns(BITS_PER_CHAR, self.baud) if self._sampled else NEVER

    @property
    def begun_ns(self) -> int | None:
        """The start edge of a character that is not complete yet, in ns; None without one."""
        return None if self._sampled is None else self._edge_ns

    def idle(self, now: int) -> list[Character]:
        """The characters complete at ``now`` (at most one); the line has been mark since the last transmission."""
        if self._sampled and self.due <= now:
            return [self._finished(self._sampled.ljust(BITS_PER_CHAR, b"1"))]
        return []

    def reset(self) -> None:
        self._sampled = None

    def sample(self, start_ns: int, levels: bytes, baud: int) -> list[Character]:
        """The characters complete after ``levels`` (see :func:`waveform`) sent from ``start_ns`` on at ``baud``."""
        found: list[Character] = []
        places = self._places.get(baud)
        if places is None:
            places = tuple((2 * bit + 1) * baud // (2 * self.baud) for bit in range(BITS_PER_CHAR))
            self._places[baud] = places
        if self._sampled is None:
            at = self._first_edge(start_ns, levels, baud)
        else:
            at = self._go_on(start_ns, levels, baud, found)
        size = len(levels)
        while at >= 0:
            if at + places[_STOP] < size:
                bits = bytes([levels[at + place] for place in places])
            else:
                bits = bytes([levels[at + place] for place in places if at + place < size])
            if bits[:1] == b"1":
                at = _next_edge(levels, at + places[0])  # too short for a start bit
                continue
            self._edge_ns = start_ns + bits_to_ns(at, baud)
            if len(bits) < BITS_PER_CHAR:
                self._sampled = bits
                break
            found.append(self._finished(bits))
            at = _next_edge(levels, at + places[_STOP])
        return found

    def _first_edge(self, start_ns: int, levels: bytes, baud: int) -> int:
        """The begin of the first character in ``levels``, -1 for none. The line was mark before."""
        late = self._ready_ns - start_ns
        if late > 0:
            return _next_edge(levels, late * baud // NS_PER_S)
        return 0 if levels[:1] == b"0" else _next_edge(levels, 0)

    def _go_on(self, start_ns: int, levels: bytes, baud: int, found: list[Character]) -> int:
        """Continue the current character; returns the begin of the next one, -1 for none."""
        bits = self._sampled or b""
        place = -1
        while len(bits) < BITS_PER_CHAR:
            at_ns = self._edge_ns + bits_to_ns(2 * len(bits) + 1, 2 * self.baud)
            place = (at_ns - start_ns) * baud // NS_PER_S
            if place >= len(levels):
                self._sampled = bits
                return -1
            bits += levels[place : place + 1] if place >= 0 else b"1"
            if bits == b"1":
                self._sampled = None  # too short for a start bit
                break
        else:
            found.append(self._finished(bits))
        return self._first_edge(start_ns, levels, baud) if place < 0 else _next_edge(levels, place)

    def _finished(self, bits: bytes) -> Character:
        self._sampled = None
        return Character(
            self._edge_ns + bits_to_ns(BITS_PER_CHAR, self.baud),
            int(bits[8:0:-1], 2),
            bool(bits.count(b"1", 1, _STOP) & 1),
            bits[_STOP] == _SPACE,
        )


def _next_edge(levels: bytes, at: int) -> int:
    """The first bit behind bit ``at`` that is space while the one before it is mark; -1 if none exists."""
    return levels.find(_EDGE, at) + 1 or -1


def flipped(octet: int, flips: int) -> int | None:
    """The octet received when the bits ``flips`` of the character of ``octet`` are inverted; None = dropped.

    Bit 0 of ``flips`` is the start bit, 1..8 the data bits, 9 parity, 10 stop. An odd number of errors in data and
    parity is a parity error, a wrong stop bit a framing error, without its start bit a character is not seen.
    """
    if flips & (START_BIT | STOP_BIT):
        return None
    if (flips & (DATA_BITS | PARITY_BIT)).bit_count() & 1:
        return None
    return octet ^ (flips & DATA_BITS) >> 1
