"""Characters of a line, sampled from its levels, and the transmissions that they make."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dpstack.capture.cutter import Cutter
from dpstack.capture.transmission import Transmission
from dpstack.params import T_SYN
from dpstack.phy.marked import MarkedOctets
from dpstack.phy.uart import Character, Receiver
from dpstack.units import BITS_PER_CHAR, bits_to_ns, chars_to_ns, ns_to_bits

_INVERT: Final = bytes.maketrans(b"01", b"10")
#: bits of silence that end a piece: the characters of a telegram follow each other without any
_GAP_BITS: Final = 2
#: octets of one piece
_MOST_OCTETS: Final = 4096


class Sampler:
    """Samples the levels of one channel as a UART at ``baud`` does (:mod:`dpstack.phy.uart`).

    ``rate``: samples/s of the levels; ``inverted``: an idle line is low; ``begin_ns``: time of sample 0.
    """

    def __init__(self, rate: int, baud: int, *, inverted: bool = False, begin_ns: int = 0) -> None:
        self._rate = rate
        self._inverted = inverted
        self._begin_ns = begin_ns
        self._receiver = Receiver(baud)
        #: samples of a character, and some
        self._char = (BITS_PER_CHAR + 1) * rate // baud + 1
        #: levels from the start edge of a character on that is not complete yet, and the sample of this edge
        self._open = b""
        self._open_at = 0
        self._waits_for_mark = True

    def add(self, start: int, levels: bytes) -> list[Character]:
        """The characters that are complete with ``levels`` from sample ``start`` on, see :meth:`Waveform.pieces`."""
        if self._inverted:
            levels = levels.translate(_INVERT)
        found: list[Character] = []
        if self._open:
            opened, self._open = self._open, b""
            opened += opened[-1:] * min(self._char, start - self._open_at - len(opened))
            if self._open_at + len(opened) == start:
                levels, start = opened + levels, self._open_at
            else:
                self._sample(self._open_at, opened, found)
        self._sample(start, levels, found)
        return found

    def _sample(self, start: int, levels: bytes, found: list[Character]) -> None:
        if self._waits_for_mark:
            mark = levels.find(b"1")
            if mark < 0:
                return
            levels, start = levels[mark:], start + mark
        receiver = self._receiver
        found += receiver.sample(self._begin_ns + bits_to_ns(start, self._rate), levels, self._rate)
        begun_ns = receiver.begun_ns
        self._waits_for_mark = begun_ns is None and levels[-1:] == b"0"
        if begun_ns is not None:
            receiver.reset()
            self._open_at = ns_to_bits(begun_ns - self._begin_ns, self._rate)
            self._open = levels[self._open_at - start :]


class Assembler:
    """Makes transmissions of characters at ``baud``, each timed by the start edge of its first character.

    ``parity_errors``, ``framing_errors``: characters with them so far.
    """

    def __init__(self, baud: int) -> None:
        self._cutter = Cutter(baud, bits_to_ns(T_SYN, baud), marked="in the waveform")
        self._baud = baud
        self._char_ns = chars_to_ns(1, baud)
        self._gap_ns = bits_to_ns(_GAP_BITS, baud)
        self._octets = bytearray()
        self._marks: list[int] = []
        self._begin_ns = self._end_ns = 0
        self.parity_errors = 0
        self.framing_errors = 0

    def add(self, characters: Iterable[Character]) -> list[Transmission]:
        found: list[Transmission] = []
        for at_ns, octet, parity_error, framing_error in characters:
            begin_ns = at_ns - self._char_ns
            if begin_ns - self._end_ns > self._gap_ns or len(self._octets) == _MOST_OCTETS:
                found += self._piece()
            if not self._octets:
                self._begin_ns = begin_ns
            if parity_error or framing_error:
                self._marks.append(len(self._octets))
                self.parity_errors += parity_error
                self.framing_errors += framing_error
            self._octets.append(octet)
            self._end_ns = at_ns
        return found

    def close(self) -> list[Transmission]:
        """The transmissions of the characters that are left."""
        return self._piece() + self._cutter.give_up()

    def _piece(self) -> list[Transmission]:
        if not self._octets:
            return []
        octets = bytes(self._octets)
        if self._marks:
            octets = MarkedOctets(octets, tuple(self._marks))
            self._marks.clear()
        self._octets.clear()
        return self._cutter.feed(octets, self._begin_ns + chars_to_ns(len(octets), self._baud))
