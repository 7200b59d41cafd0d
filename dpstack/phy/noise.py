"""Noise on a wire: random bit errors, with a seed so that a run can be repeated."""

from __future__ import annotations

from math import log1p
from random import Random

from dpstack.errors import ConfigError
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
