"""Noise on a wire: random bit errors, bursts and lost octets, with a seed so that a run can be repeated."""

from __future__ import annotations

from math import log1p
from random import Random

from dpstack.errors import ConfigError
from dpstack.phy.uart import START_BIT
from dpstack.units import BITS_PER_CHAR


class BitNoise:
    """Inverts each bit with the probability ``per_bit`` (0 <= P < 1), independently of the others.

    The random number is the distance to the next error (geometric distribution), so that a telegram without errors
    costs one comparison.
    """

    def __init__(self, per_bit: float, rng: Random) -> None:
        if not 0 <= per_bit < 1:
            raise ConfigError(f"error rate {per_bit} is a probability per bit: 0 <= P < 1, for instance 1e-4")
        self.per_bit = per_bit
        self._rng = rng
        self._sound_bits = self._draw() if per_bit else 0  # until the next error

    def flips(self, size: int) -> dict[int, int]:
        """The inverted bits of the next ``size`` octets, by octet number: bit 0 start, 1..8 data, 9 parity, 10 stop."""
        found: dict[int, int] = {}
        if not self.per_bit:
            return found
        bits = size * BITS_PER_CHAR
        at = self._sound_bits
        while at < bits:
            number, bit = divmod(at, BITS_PER_CHAR)
            found[number] = found.get(number, 0) | 1 << bit
            at += 1 + self._draw()
        self._sound_bits = at - bits
        return found

    def _draw(self) -> int:
        return int(log1p(-self._rng.random()) / log1p(-self.per_bit))


class Bursts:
    """Bursts of errors: one begins with each bit with the probability ``per_bit`` (0 < P < 1) and lasts ``bits`` bits,
    of which each is inverted with the probability 1/2. A burst goes on in the next telegram."""

    def __init__(self, per_bit: float, bits: int, rng: Random) -> None:
        self._begins = BitNoise(per_bit, rng)
        self._bits = bits
        self._left = 0  # bits of a burst that has begun
        self._rng = rng

    def flips(self, size: int) -> dict[int, int]:
        """The inverted bits of the next ``size`` octets, as :meth:`BitNoise.flips`."""
        begins = self._begins.flips(size)
        if not begins and not self._left:
            return begins
        found: dict[int, int] = {}
        for number in range(size):
            begin = begins.get(number, 0)
            for bit in range(BITS_PER_CHAR):
                if begin >> bit & 1:
                    self._left = self._bits
                if self._left:
                    self._left -= 1
                    found[number] = found.get(number, 0) | self._rng.getrandbits(1) << bit
        return {number: mask for number, mask in found.items() if mask}


class LostOctets:
    """Each octet is lost with the probability ``per_octet`` (0 < P < 1), as one whose start bit no receiver sees."""

    def __init__(self, per_octet: float, rng: Random) -> None:
        self._per_octet = per_octet
        self._rng = rng

    def flips(self, size: int) -> dict[int, int]:
        """The start bits of the lost ones among the next ``size`` octets, as :meth:`BitNoise.flips`."""
        return {number: START_BIT for number in range(size) if self._rng.random() < self._per_octet}
